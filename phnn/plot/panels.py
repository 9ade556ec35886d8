"""Shared parts of the plots: models and recordings as given, panels, axes in suitable units, and tables.

Measured points of a frequency response, from recordings of single sines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn import predictor
from phnn.diagnose.diagnosis import Diagnosis
from phnn.errors import InputRefused
from phnn.model import Model
from phnn.parameters import prefixed
from phnn.prediction import Predicted
from phnn.recordings import Campaign, campaign_of
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording
from phnn.report.figures.style import RC
from phnn.report.formatting import listing
from phnn.signals.least_squares import HARMONICS, deviation, harmonic_weights

if TYPE_CHECKING:
    from phnn.modal.model import ModalFit


@dataclass(frozen=True)
class Point:
    """Response in one recording of a single sine.

    Attributes:
        name: of the recording; frequency [Hz]; amplitude: of the input.
        gain: ``Y_1/U_1``; std: its standard deviation by the noise, of either part.
        harmonics: (4,) ``|Y_k|/|Y_1|`` for k = 2 … 5.
    """

    name: str
    frequency: float
    amplitude: float
    gain: complex
    std: float
    harmonics: Array


def point(recording: Recording) -> Point | None:
    """Return the response in a recording of a single sine, by its last whole periods; None of any other recording."""
    drive = excitation_of(recording.u, recording.dt)
    if drive.kind != "sine" or drive.cycles < 1.0 or not np.isfinite(recording.y).all():
        return None
    period = recording.period or 1.0 / drive.low_Hz
    # The first period holds the transient.
    whole = max(1, int(drive.cycles + 1e-6) - (recording.start.state != "periodic"))
    rows = slice(max(drive.span[0], drive.span[1] - round(whole * period / recording.dt)), drive.span[1])
    if period / recording.dt < 2 * HARMONICS + 2:
        return None
    waves = harmonic_weights(recording.t[rows], period)
    into, out = waves[0] @ recording.u[rows], waves @ recording.y[rows]
    noise = recording.noise if recording.noise_found else np.nan
    std = noise * deviation(waves[0], recording.noise_correlation) / np.sqrt(2.0) / abs(into)
    return Point(
        recording.name, 1.0 / period, float(abs(into)), complex(out[0] / into), float(std),
        np.abs(out[1:]) / abs(out[0]),
    )  # fmt: skip


Array = NDArray[np.float64]
# Recordings that are drawn where nobody chose some: more do not fit on a screen.
MOST = 12


@dataclass(frozen=True)
class Plot:
    """A kind of plot: how it is drawn, and the same as tables.

    Attributes:
        draw: returns a new figure of all panels.
        tables: everything that is drawn, by the ending of a file's name; columns have units, ``_1`` for none.
    """

    draw: Callable[[], Figure]
    tables: Mapping[str, pd.DataFrame]

    def figure(self) -> Figure:
        """Return a figure in the look of all figures."""
        with rc_context(RC):
            return self.draw()


def scaled(name: str, unit: str, *values: Any) -> tuple[float, str]:
    """Return the size of the unit in which values up to the largest one given read well, and the label of their axis;
    no unit is shown for ``1``."""
    sizes = [np.abs(np.asarray(v)[np.isfinite(v)]).max(initial=0.0) for v in values]
    size, shown = prefixed(float(max(sizes, default=0.0)), unit)
    return size, name if shown == "1" else f"{name} ({shown})"


def column(name: str, unit: str) -> str:
    """Return the name of a column with its unit."""
    return f"{name}_{unit.replace(' ', '')}"


def model_of(given: Any, outside: bool = False) -> Model | ModalFit:
    """Return the model that is given: itself, the final one of a diagnosis, or that in a folder.

    Args:
        outside: the file in the folder may be a link that leads out of it.

    Raises:
        InputRefused: there is no model, or a damaged one.
    """
    if isinstance(given, Diagnosis):
        return given.model
    if isinstance(given, str | Path):
        return predictor.load(given, outside)
    found: Model | ModalFit = given
    return found


def network_model(given: Any) -> Model:
    """Return the same, which must be the model of a network.

    Raises:
        InputRefused: it is a model of modes.
    """
    found = model_of(given)
    if not isinstance(found, Model):
        raise InputRefused(
            "a model of phnn modes has no inputs of its own here: give phnn.Model(phnn.Setup(model.to_network()))"
        )
    return found


def predictions(given: Any, campaign: Campaign | str | Path, recordings: Sequence[str] | None) -> tuple[Predicted, ...]:
    """Return the predictions of the recordings that are drawn; see `chosen`."""
    return tuple(predictor.predictions(model_of(given), chosen(campaign, recordings)))


def chosen(campaign: Campaign | str | Path, recordings: Sequence[str] | None) -> Campaign:
    """Return a campaign of the recordings that are named, or of the first dozen whose output was recorded.

    Raises:
        InputRefused: there is no recording of a name, or none that can be drawn.
    """
    campaign = campaign_of(campaign)
    known = {r.name: r for r in campaign.recordings if bool(np.isfinite(r.y).any())}
    strange = [name for name in recordings or () if name not in known]
    if strange:
        raise InputRefused(f"no recording {strange[0]!r} with an output; there are {listing(known)}")
    if not known:
        raise InputRefused(f"{campaign.folder}: no output was recorded: there is nothing to compare a model with")
    kept = [known[name] for name in recordings] if recordings else list(known.values())[:MOST]
    return replace(campaign, recordings=tuple(kept))
