"""An identified base model together with the recordings that it was identified from."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from phnn.errors import InputRefused
from phnn.html import table, titled
from phnn.identification.base import NumericalError, Progress, identify_base, quiet
from phnn.identification.fit import Fit
from phnn.identification.plan import Options
from phnn.model import Model
from phnn.models.actuator import hrc
from phnn.models.store import save
from phnn.network.elements import Network
from phnn.recordings import Campaign, campaign_of
from phnn.recordings.manifest import MODELS, choice
from phnn.results import Place
from phnn.setup import Setup

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Identified:
    """Attributes:
    campaign: the recordings.
    fit: estimates, covariance, residuals and sensitivities.
    error: numerical error of the fit.
    options: how it was made.
    """

    campaign: Campaign
    fit: Fit
    error: NumericalError
    options: Options

    def __repr__(self) -> str:
        return f"<Identified from {self.campaign.folder}: {self.model!r}>"

    def __str__(self) -> str:
        return f"{self.fit.setup.name} from {self.campaign.folder}\n{self.to_dataframe().to_string()}"

    def _repr_html_(self) -> str:
        shown = self.to_dataframe().reset_index()
        rows = [[None if v != v else v for v in row] for row in shown.itertuples(index=False)]
        return titled(f"Fit of {self.fit.setup.name} to {self.campaign.folder}", table(list(shown.columns), rows))

    def to_dataframe(self) -> pd.DataFrame:
        """Return a table of the parameters [SI]: value, standard error, 95 % interval, unit, meaning and remark.

        A parameter that was not estimated has NaN, and the remark says why.
        """
        import pandas as pd

        std, nothing = self.fit.std(), (math.nan, math.nan)
        rows = {
            name: (p.value, std.get(name, math.nan), *(self.fit.interval(name) or nothing), p.unit, p.description,
                   self.fit.note(name))
            for name, p in self.fit.setup.parameters.items()
        }  # fmt: skip
        columns = ["value", "std_error", "low_95", "high_95", "unit", "meaning", "remark"]
        return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("parameter")

    @property
    def model(self) -> Model:
        """Return the base model with its estimates."""
        return model_of(self.fit)

    @property
    def parameters(self) -> dict[str, tuple[float, float | None]]:
        """Estimate and standard error by name [SI]; the error is None for a parameter that was not estimated."""
        std = self.fit.std()
        return {name: (value, std.get(name)) for name, value in self.fit.setup.values().items()}


def model_of(fitted: Fit) -> Model:
    """Return the model of a fit, with the finest sub-steps and the inputs of its plan."""
    return Model(fitted.setup, fitted.plan.finest, fitted.plan.inputs)


def save_fit(fitted: Fit, place: Path | Place) -> None:
    """Write the model of a fit into a folder, for `phnn.load` and `phnn predict`."""
    save(fitted.setup, place, fitted.plan.finest, fitted.plan.inputs)


def identify(
    model: Network | Setup | Campaign | str | Path | None,
    campaign: Campaign | str | Path | None = None,
    options: Options | None = None,
    progress: Progress = quiet,
) -> Identified:
    """Identify a model from the identification parts of a campaign.

        fit = phnn.identify(phnn.read("recordings/"))        # the model that the manifest names
        fit = phnn.identify(phnn.models.hrc(hysterons=2), phnn.read("recordings/"))
        value, standard_error = fit.parameters["k"]          # [N/m]

    Args:
        model: a network, or one with amplifier and sensor, or the name of a ready model such as ``"motor"``. Of the
            actuator `phnn.models.hrc` only the number of hysterons counts: it needs no starting values, nor does a
            ready model by its name. Any other model starts from its own values. None, or recordings alone in its
            place: what the manifest names.
        campaign: recordings, or their folder; see `phnn.read`.
        options: how hard to try.
        progress: called with a line of text at every stage.

    Raises:
        InputRefused: no recording is for identification, ports or outputs that the network does not have, anchors of
            parameters that it does not have.
    """
    chosen = options or Options()
    if campaign is None:
        model, campaign = None, model
    known = campaign_of(campaign)
    stated = known if model is None else replace(known, setup=_manifest_setup(model))  # type: ignore[arg-type]
    fitted, error = identify_base(stated, chosen, progress)
    return Identified(stated, fitted, error, chosen)


def _manifest_setup(model: Network | Setup | str) -> dict[str, object]:
    """Return what a manifest would say under ``setup`` for a model.

    Raises:
        InputRefused: it is neither a network nor a setup.
    """
    if isinstance(model, str):
        choice(model, MODELS, "model")
        return {"model": model}
    setup = Setup(model) if isinstance(model, Network) else model
    if not isinstance(setup, Setup):
        raise InputRefused(f"model: a {type(model).__name__}: give a Network such as phnn.models.hrc(hysterons=2)")
    if any(block.kind == "bouc_wen" for block in setup.amplifier):
        return {"model": "bouc_wen"}
    hysterons = sum(s.name.startswith("Q_") for s in setup.network.storages)
    if not (setup.amplifier or setup.sensor or setup.sources) and _elements(setup.network) == _elements(hrc(hysterons)):
        return {"model": "piezo_actuator", "hysterons": hysterons}
    return {"network": setup}


def _elements(network: Network) -> tuple[object, ...]:
    """Return all of a network but the values of its parameters."""
    return tuple(getattr(network, f.name) for f in fields(network) if f.name != "parameters")
