"""Plot of residuals against noise: autocorrelation, correlation with the input, and spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import norm

from phnn.diagnosis.diagnosis import Diagnosis
from phnn.errors import InputRefused
from phnn.model import Model
from phnn.plot.panels import Array, Panels, column, grid, predictions, scaled, under_each_other
from phnn.prediction import Predicted
from phnn.recordings.recording import Campaign, Recording
from phnn.report.figures.style import AFTER, BEFORE, FAINT, INK, RC, literal, quiet_grid
from phnn.report.spectrum import amplitude_density
from phnn.signals.first_order import density_of
from phnn.signals.whiteness import correlation, cross_deviation, own_deviation

if TYPE_CHECKING:
    from phnn.modal.store import StoredModes

# Probability that a correlation of noise lies within its band.
LEVEL = 0.99
# Largest lag that is drawn where nobody says another, in samples and as a share of them; fewest samples.
_LAGS, _SHARE, _FEWEST = 100, 0.25, 32


@dataclass(frozen=True)
class Correlated:
    """Correlations at some lags, and where noise alone would lie.

    Attributes:
        lags: (K,) in samples; values: (K,) correlations.
        centre: (K,) what the noise has; reach: (K,) half width of its band.
        tested: (K,) those that are counted: the autocorrelation at lag zero is one.
    """

    lags: NDArray[np.int64]
    values: Array
    centre: Array
    reach: Array
    tested: NDArray[np.bool_]

    @property
    def outside(self) -> NDArray[np.bool_]:
        """(K,) whether a correlation lies outside the band of the noise."""
        return np.asarray(self.tested & (np.abs(self.values - self.centre) > self.reach))

    @property
    def count(self) -> str:
        """How many lie outside, and how many of them chance would give."""
        number = int(self.tested.sum())
        return f"{int(self.outside.sum())} of {number} outside ({(1.0 - LEVEL) * number:.2g} expected)"


@dataclass(frozen=True)
class Tested:
    """The residual of one recording.

    Attributes:
        recording: what was recorded; own, by_input: correlations with itself and with the input.
        f, density: (K,) frequencies [Hz] and amplitude density of the residual; noise: (K,) that of the noise.
    """

    recording: Recording
    own: Correlated
    by_input: Correlated
    f: Array
    density: Array
    noise: Array


@dataclass(frozen=True)
class Residuals:
    """Residuals of recordings.

    Attributes:
        found: one for each row of panels.
    """

    found: tuple[Tested, ...]

    def draw(self, axes: Any = None) -> Panels:
        """(R, 3) axes: autocorrelation, correlation with the input, spectrum of each recording."""
        count = len(self.found)
        with rc_context(RC):
            panels = grid(axes, count, 3, 11.4, 2.9 * count + 0.3)
            for row, one in zip(panels, self.found, strict=True):
                _draw_correlated(row[0], one.own, "autocorrelation of the residual")
                _draw_correlated(row[1], one.by_input, "correlation with the input")
                _draw_spectrum(row[2], one)
                row[0].set_title(literal(one.recording.name, 40))
        return panels

    def tables(self) -> dict[str, pd.DataFrame]:
        """Correlations with their bands, and spectra."""
        return {
            "": under_each_other(_correlations(one) for one in self.found),
            "_spectrum": under_each_other(_spectrum(one) for one in self.found),
        }


def residuals(
    model: Model | StoredModes | Diagnosis | str | Path,
    campaign: Campaign | str | Path | None = None,
    *,
    recordings: Sequence[str] | None = None,
    lags: int | None = None,
    axes: Any = None,
) -> Panels:
    """Draw what a model leaves: is it noise, or does it follow from its own past or from the input?

        axes = phnn.plot.residuals(diagnosis)
        axes = phnn.plot.residuals("out/model", phnn.read("recordings/"), lags=25)

    The bands hold 99 % of the correlations that noise alone would give; noise has the autocorrelation that the
    recordings showed before any model was fitted. The legend counts the correlations outside. Lags of a slow or
    periodic input are no independent tests: they leave their band together.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        campaign: recordings with outputs; those of the diagnosis if left out.
        recordings: names of those to draw; the first twelve if left out.
        lags: largest lag in samples; 100, or a quarter of the samples, if left out.
        axes: (R, 3) axes to draw into.

    Returns:
        (R, 3) axes: autocorrelation, correlation with the input, amplitude density against that of the noise.

    Raises:
        InputRefused: there is no such model or recording, too few samples, or another number of axes.
        SolverFailed: a step has no solution.
    """
    return whiteness(model, campaign, recordings, lags).draw(axes)


def whiteness(
    model: Any, campaign: Campaign | str | Path | None, recordings: Sequence[str] | None = None, lags: int | None = None
) -> Residuals:
    """What `residuals` draws."""
    if campaign is None:
        if not isinstance(model, Diagnosis):
            raise InputRefused("campaign: left out, and a model has no recordings: give phnn.read(folder)")
        campaign = model.campaign
    return Residuals(tuple(_tested(one, lags) for one in predictions(model, campaign, recordings)))


def _tested(one: Predicted, lags: int | None) -> Tested:
    r, e, u = one.recording, one.error, one.recording.u[one.scored]
    most = int(_SHARE * e.size)
    reach = min(_LAGS, most) if lags is None else lags
    if e.size < _FEWEST or not 0 < reach < e.size:
        raise InputRefused(f"{r.name}: {e.size} scored samples for {reach} lags: give fewer lags, at least one")
    rho, far = r.noise_correlation, float(norm.ppf(0.5 + 0.5 * LEVEL))
    own_lags, both = np.arange(reach + 1, dtype=np.int64), np.arange(-reach, reach + 1, dtype=np.int64)
    centre = np.zeros(reach + 1)
    known = min(rho.size, reach + 1)
    # The estimator divides by all samples, also where fewer pairs are that far apart.
    centre[:known] = rho[:known] * (1.0 - np.arange(known) / e.size)
    own = Correlated(
        own_lags, correlation(e, e, reach)[reach:], centre, far * own_deviation(rho, e.size, reach), own_lags > 0
    )
    moved = np.full(both.size, bool(np.ptp(u) > 0.0))
    by_input = Correlated(
        both, correlation(e, u, reach), np.zeros(both.size), far * cross_deviation(rho, u, reach), moved
    )
    f, density = amplitude_density(e, r.dt)
    # One-sided: white noise of unit variance has the density 2 Δt.
    level = r.noise * np.sqrt(2.0 * r.dt * density_of(rho, f * r.dt)) if r.noise_found else np.full(f.size, np.nan)
    return Tested(r, own, by_input, f, density, level)


def _draw_correlated(axes: Axes, found: Correlated, label: str) -> None:
    low, high = found.centre - found.reach, found.centre + found.reach
    axes.fill_between(found.lags, low, high, color=FAINT, linewidth=0, label=f"{100 * LEVEL:.0f} % of noise alone")
    inside = ~found.outside
    axes.vlines(found.lags, 0.0, found.values, color=AFTER, linewidth=0.7, alpha=0.6)
    axes.plot(found.lags[inside], found.values[inside], "o", color=AFTER, markersize=2.4)
    axes.plot(found.lags[~inside], found.values[~inside], "D", color=BEFORE, markersize=3.4, label=found.count)
    axes.axhline(0.0, color=INK, linewidth=0.7)
    # Lag zero of the autocorrelation is one whatever the residual: it need not fill the panel.
    shown = found.tested if found.tested.any() else np.ones(found.lags.size, dtype=bool)
    largest = float(np.abs(np.concatenate([found.values[shown], low[shown], high[shown]])).max())
    axes.set_ylim(-1.15 * largest, 1.75 * largest)
    axes.set_xlabel("lag (samples)")
    axes.set_ylabel(f"{label} (1)")
    axes.legend(loc="upper right", borderaxespad=0.1)
    quiet_grid(axes)


def _draw_spectrum(axes: Axes, one: Tested) -> None:
    unit = f"{one.recording.units.output}/√Hz"
    left = scaled("residual", unit, float(np.median(one.density)))
    axes.loglog(one.f, left(one.density), color=AFTER, linewidth=0.9, label="residual")
    drawn = left(one.density[one.density > 0.0])
    floor = float(np.percentile(drawn, 1.0)) if drawn.size else 1.0
    if np.isfinite(one.noise).all():
        axes.loglog(one.f, left(one.noise), color=INK, linewidth=1.3, dashes=(4, 2), label="noise of the recording")
        floor = min(floor, float(left(one.noise.min())))
    if drawn.size:
        axes.set_ylim(0.5 * floor, 6.0 * max(float(drawn.max()), floor))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(left.label)
    axes.legend(loc="upper right", borderaxespad=0.1)
    quiet_grid(axes)


def _correlations(one: Tested) -> pd.DataFrame:
    rows = []
    for name, found in (("residual", one.own), ("input", one.by_input)):
        rows.append(
            pd.DataFrame(
                {
                    "recording": one.recording.name,
                    "with": name,
                    "lag_samples": found.lags,
                    "lag_s": found.lags * one.recording.dt,
                    "correlation_1": found.values,
                    "band_low_1": found.centre - found.reach,
                    "band_high_1": found.centre + found.reach,
                    "outside_1": found.outside.astype(int),
                }
            )
        )
    return under_each_other(rows)


def _spectrum(one: Tested) -> pd.DataFrame:
    unit = f"{one.recording.units.output}/sqrt(Hz)"
    return pd.DataFrame(
        {
            "recording": one.recording.name,
            "frequency_Hz": one.f,
            column("residual", unit): one.density,
            column("noise", unit): one.noise,
        }
    )
