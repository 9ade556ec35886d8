"""The steps of work with recordings: identify, diagnose, predict, compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phnn.diagnose.diagnosis import Diagnosis as Finished
from phnn.diagnose.diagnosis import diagnose as run_diagnosis
from phnn.effects import Effect
from phnn.identification.base import Progress, quiet
from phnn.identification.identified import Identified, identify
from phnn.identification.options import Options
from phnn.model import Model
from phnn.prediction import Predicted
from phnn.predictor import loaded, predictor
from phnn.recordings import Campaign, campaign_of
from phnn.report.result import write

if TYPE_CHECKING:
    from phnn.comparison.models import Result
    from phnn.modal.fit import ModalFit

__all__ = ["Diagnosis", "compare", "diagnose", "identify", "load", "predict"]


@dataclass(frozen=True)
class Diagnosis(Finished):
    """A finished diagnosis that can be written.

        diagnosis = phnn.diagnose(phnn.read("recordings/"))
        diagnosis.verdict                                # named, equivalent, unknown or none
        diagnosis.probability["creep"]                   # 0.97
        diagnosis.after.over_noise("confirmation")       # held-out residual over noise
        diagnosis.model.simulate(t, voltage)             # (N,) displacement [m]
        diagnosis.write("out/")                          # diagnosis.json, report.html, model/

    All attributes are those of `phnn.diagnose.diagnosis.Diagnosis`.
    """

    def write(self, out: str | Path, overwrite: bool = False) -> dict[str, Any]:
        """Write models, ``diagnosis.json`` and ``report.html`` into a folder; returns the document.

        Args:
            out: apart from the recordings; results of an earlier diagnosis in it are replaced.
            overwrite: also where they were changed since.

        Raises:
            InputRefused: the folder belongs to the recordings or to another run, holds files of others with the names
                of results, or cannot be written to.
        """
        return write(self, out, overwrite)


def diagnose(
    recorded: Campaign | Identified | str | Path,
    options: Options | None = None,
    progress: Progress = quiet,
    effects: Sequence[Effect] | None = None,
    budget: float | None = None,
) -> Diagnosis:
    """Fit the base model, search for what it misses, weigh all models, and conclude.

        diagnosis = phnn.diagnose(phnn.read("recordings/"))

    A model that cannot be fitted is no candidate, and a part that fails is left out: `Diagnosis.ended` tells what.
    Ctrl-C ends the search with the best so far.

    Args:
        recorded: recordings with their identification and confirmation parts, their folder, or what `phnn.identify`
            returned.
        options: how hard to try; those of the identification where it has been done, defaults otherwise.
        progress: called with a line of text at every stage, for example ``print``.
        effects: the catalogue to use; all effects that can exist otherwise.
        budget: seconds after which the search ends with the best so far; one fit of the base model and its test are
            finished in any case.

    Raises:
        InputRefused: a criterion is not known, the executor does not answer, an effect to do without is not in the
            catalogue, recordings have several inputs or outputs, or the budget is not positive; nothing has been fitted
            yet then.
    """
    known = recorded if isinstance(recorded, Identified) else campaign_of(recorded)
    return Diagnosis(**vars(run_diagnosis(known, options, progress, effects, budget=budget, answers=True)))


def load(folder: str | Path) -> Model | ModalFit:
    """Load a model that a command or `Model.save` wrote.

        y = phnn.load("out/model").simulate(t, voltage)
        network = phnn.load("out/modes/model").to_network()  # of a model that phnn modes wrote

    Args:
        folder: ``model/`` or ``base/`` of a result, or the file of a model.

    Returns:
        A `Model`; of ``phnn modes`` the fit, a `phnn.modal.fit.ModalFit`.

    Raises:
        InputRefused: there is no model, or a damaged one.
    """
    return loaded(Path(folder))


def predict(model: Model | ModalFit | str | Path, campaign: Campaign | str | Path) -> tuple[Predicted, ...]:
    """Simulate the recordings of a campaign, in their order.

        for found in phnn.predict("out/model", phnn.read("other/")):
            print(found.recording.name, found.table)

    Where an output was recorded, the first samples of a recording give the zero and the initial state; they are not
    scored.

    Args:
        model: what `phnn.load` returned, or its folder; models of ``phnn modes`` included.
        campaign: recordings, or their folder. ``phnn.read(folder, need_output=False)`` reads one without outputs.

    Raises:
        InputRefused: there is no model, or a damaged one, or the recordings do not fit its ports and outputs.
        SolverFailed: a step has no solution.
    """
    known = campaign_of(campaign, need_output=False)
    return tuple(predictor(Path(model) if isinstance(model, str) else model)(known))


def compare(
    campaign: Campaign | str | Path,
    out: str | Path,
    settings: Sequence[str] = (),
    progress: Progress = quiet,
    overwrite: bool = False,
) -> dict[str, Result]:
    """Fit several kinds of model to a campaign, score them on all recordings, and return them by name.

        results = phnn.compare(phnn.read("recordings/"), "compared/", ["models=[phs,linear]"])
        results["linear"].evaluation.over_noise("confirmation")  # held-out residual over noise

    Args:
        campaign: recordings with their uses, or their folder.
        out: where `compare.md`, its table, figure and models go.
        settings: ``key=value`` in the grammar of hydra, as for ``phnn compare``; see ``configs/compare.yaml``.
        progress: called with a line of text at every stage.
        overwrite: replace results that were changed since.

    Raises:
        InputRefused: a setting is unknown or out of range, recordings cannot be used, or results of other settings lie
            in ``out``.
    """
    from phnn.comparison.models import Settings
    from phnn.comparison.run import compare as run_comparison
    from phnn.configuration import compose

    chosen = Settings.from_config(compose("compare", settings))
    return run_comparison(campaign_of(campaign), Path(out), chosen, progress, overwrite)
