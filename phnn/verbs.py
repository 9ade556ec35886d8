"""Diagnose recordings, and write what was found: `phnn.diagnose`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phnn.diagnose.diagnosis import Diagnosis as Finished
from phnn.diagnose.diagnosis import diagnose as run_diagnosis
from phnn.effects import Effect
from phnn.identification.base import Progress, quiet
from phnn.identification.identified import Identified
from phnn.identification.plan import Options
from phnn.recordings import Campaign, campaign_of
from phnn.report.result import write
from phnn.report.statements import summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Diagnosis(Finished):
    """A finished diagnosis that can be written.

        diagnosis = phnn.diagnose(phnn.read("recordings/"))
        print(diagnosis)                                 # Creep is missing: 97 % sure …
        diagnosis.verdict                                # named, equivalent, unknown or none
        diagnosis.missing                                # ("creep",)
        diagnosis.probability                            # {"creep": 0.97, "extra_hysteron": 0.03, "none": 0.0}
        diagnosis.after.over_noise("confirmation")       # held-out residual over noise
        diagnosis.model.simulate(t, voltage)             # (N,) displacement [m]
        diagnosis.plot()                                 # figure: held-out error before and after
        diagnosis.write("out/")                          # diagnosis.json, report.html, model/

    All attributes are those of `phnn.diagnose.diagnosis.Diagnosis`.
    """

    def __repr__(self) -> str:
        names = ", ".join(claim.effect.name for claim in self.claims) or "nothing"
        return f"<Diagnosis of {self.campaign.folder}: {self.verdict}, added to the model: {names}>"

    def __str__(self) -> str:
        return summary(self)

    def _repr_html_(self) -> str:
        from phnn.report.sections import notebook

        return notebook(self)

    @property
    def missing(self) -> tuple[str, ...]:
        """Return the effects that the base model leaves out, ``"unknown"`` for one without a proven name."""
        if self.verdict == "none":
            return ()
        return tuple(c.name if c.claimed else "unknown" for c in self.claims) or ("unknown",)

    def plot(self) -> Figure:
        """Return a figure of the error before and after against the noise, on the worst held-out recording."""
        from phnn.report.sections import error_figure

        return error_figure(self)

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
