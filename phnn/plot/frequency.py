"""Plots over frequency: the response of a model, and residuals against noise.

`bode` draws the response at an amplitude, by simulation, beside that at a small amplitude. A sine
``u = u_0 + A sin ωt`` drives the model into its steady cycle; the describing function is the ratio of the complex
amplitudes of output and input at the fundamental, ``Y_1/U_1``, and the harmonics ``|Y_k|/|Y_1|`` say what it leaves
out. Steps are halved until the response, extrapolated to steps of no size, has converged. `residuals` draws
autocorrelation, correlation with the input, and spectrum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from phnn.diagnose.diagnosis import Diagnosis
from phnn.errors import InputRefused, SolverFailed
from phnn.model import Model
from phnn.parameters import quantity
from phnn.plot.signals import Array, Plot, Point, column, network_model, point, predictions, scaled
from phnn.prediction import Predicted
from phnn.recordings import Campaign, campaign_of
from phnn.recordings.recording import Recording, Start, unrecorded
from phnn.report.figures import amplitude_density
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, FAINT, INK, finish, literal, log_axis, new_figure
from phnn.report.words import vocabulary_of
from phnn.setup import Setup
from phnn.signals.first_order import correlation, cross_deviation, density_of, own_deviation
from phnn.signals.least_squares import HARMONICS, harmonic_weights
from phnn.trajectory import simulate

if TYPE_CHECKING:
    from phnn.modal.model import ModalFit


Complex = NDArray[np.complex128]

# Samples of a period, and numbers of steps between two of them after the first one.
_SAMPLES, _STEPS = 256, (2, 4, 8, 16)
# Relative change of the extrapolated response at which steps are fine enough. Steps are of second order.
_CONVERGED, _ORDER = 1e-7, 2
# Amplitude of the linearised response over that of the other one: far below every threshold, far above rounding.
_SMALL = 1e-6
# Amplitudes that differ by less than this share count as the same.
_ALIKE = 0.1
# Frequencies that are drawn where recordings say between which, and how far beyond them.
_POINTS, _BEYOND = 40, 2.0
# Harmonics that are drawn, over the largest one.
_VISIBLE = 1e-4
_MARKS = ("s", "^", "v", "P")


@dataclass(frozen=True)
class Bode:
    """Frequency response of a model.

    Attributes:
        frequencies: (F,) [Hz]; amplitude: of the input.
        gain: (F,) describing function; error: (F,) by how much the last halving of the steps has changed it.
        harmonics: (F, 4) ``|Y_k|/|Y_1|`` for k = 2 … 5.
        linear: (F,) response to a small amplitude.
        units: of input and output; words: what they are called.
        measured: responses in recordings.
    """

    frequencies: Array
    amplitude: float
    gain: Complex
    error: Array
    harmonics: Array
    linear: Complex
    units: tuple[str, str]
    words: tuple[str, str]
    measured: tuple[Point, ...] = ()

    @property
    def gain_unit(self) -> str:
        """Return the unit of the response."""
        into, out = self.units
        return out if into == "1" else f"{out}/({into})" if "/" in into or " " in into else f"{out}/{into}"

    def plot(self) -> Plot:
        """Return magnitude, phase and harmonics, with the model's responses and those measured where there are any."""
        unit = self.gain_unit
        model = pd.DataFrame(
            {
                "frequency_Hz": self.frequencies,
                column("magnitude", unit): np.abs(self.gain),
                "phase_deg": _degrees(self.gain),
                column("numerical_error", unit): self.error,
                column("linear_magnitude", unit): np.abs(self.linear),
                "linear_phase_deg": _degrees(self.linear),
                **{f"harmonic_{k + 2}_1": self.harmonics[:, k] for k in range(HARMONICS - 1)},
            }
        )
        rows = [
            {
                "recording": p.name,
                "frequency_Hz": p.frequency,
                column("amplitude", self.units[0]): p.amplitude,
                column("magnitude", unit): abs(p.gain),
                column("magnitude_std", unit): p.std,
                "phase_deg": self.beside(p),
                **{f"harmonic_{k + 2}_1": p.harmonics[k] for k in range(HARMONICS - 1)},
            }
            for p in self.measured
        ]
        return Plot(self._draw, {"": model, "_measured": pd.DataFrame(rows)} if rows else {"": model})

    def _draw(self) -> Figure:
        figure = new_figure(7.2, 8.4)
        panels = figure.subplots(3, 1, sharex=True, height_ratios=[1.3, 1.0, 1.0])
        size, label = scaled(f"{self.words[1]} by {self.words[0]}", self.gain_unit, np.abs(self.gain))
        at = f"at {quantity(self.amplitude, self.units[0])}"
        shown: tuple[Callable[[Complex], Array], ...] = (lambda g: np.abs(g) / size, _degrees)
        for axes, value in zip(panels, shown, strict=False):
            axes.plot(self.frequencies, value(self.gain), color=AFTER, linewidth=1.6, label=at)
            small = {"color": INK, "linewidth": 1.2, "dashes": (4, 2), "label": "at small amplitude"}
            axes.plot(self.frequencies, value(self.linear), **small)
        # Measured points; those of another amplitude are hollow.
        for same, name in ((True, "measured"), (False, "measured at another amplitude")):
            if some := self.at_its_amplitude(same):
                f, fill = [p.frequency for p in some], BEFORE if same else "none"
                gains, phases = [abs(p.gain) / size for p in some], [self.beside(p) for p in some]
                for axes, values in zip(panels, (gains, phases), strict=False):
                    axes.plot(f, values, "o", color=BEFORE, markersize=5.0, markerfacecolor=fill, label=name)
        _draw_harmonics(panels[2], self)
        log_axis(panels[0], "y")
        for axes in panels:
            log_axis(axes)
        finish(panels[0], "", label)
        finish(panels[1], "", "phase (degrees)", None)
        return figure

    def at_its_amplitude(self, same: bool) -> list[Point]:
        """Return the measured responses at the amplitude of the model's, or those at another one."""
        return [p for p in self.measured if (abs(p.amplitude / self.amplitude - 1.0) <= _ALIKE) == same]

    def beside(self, point: Point) -> float:
        """Return the phase of a measured response [degrees], in the turn that is nearest to the model's."""
        near = float(np.interp(np.log(point.frequency), np.log(self.frequencies), _degrees(self.gain)))
        phase = float(np.degrees(np.angle(point.gain)))
        return phase + 360.0 * round((near - phase) / 360.0)


def bode(
    model: Model | Diagnosis | str | Path,
    frequencies: ArrayLike | None = None,
    amplitude: float | None = None,
    *,
    offset: float = 0.0,
    campaign: Campaign | str | Path | None = None,
) -> Figure:
    """Draw the frequency response of a model at an amplitude, and its response to small amplitudes.

        figure = phnn.plot.bode(model, np.geomspace(1.0, 1000.0, 40), amplitude=75.0)

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        frequencies: (F,) [Hz]; between those of the campaign's sines, and a factor of two beyond, if left out.
        amplitude: of the input, SI; the largest of the campaign's sines if left out.
        offset: constant input about which it swings.
        campaign: recordings whose single sines are drawn as points.

    Returns:
        A figure with magnitude, phase, and harmonics 2 to 5 over the fundamental.

    Raises:
        InputRefused: there is no such model, frequencies or amplitude are not positive, or are left out where no sine
            was recorded.
        SolverFailed: a step has no solution, or there is no steady cycle; names the frequency.
    """
    return response(model, frequencies, amplitude, offset, campaign).plot().figure()


def response(
    model: Any,
    frequencies: ArrayLike | None = None,
    amplitude: float | None = None,
    offset: float = 0.0,
    campaign: Campaign | str | Path | None = None,
) -> Bode:
    """Return what `bode` draws."""
    setup = network_model(model).setup
    recorded = () if campaign is None else campaign_of(campaign).recordings
    measured = tuple(p for r in recorded if (p := point(r)) is not None)
    f, size = _asked(frequencies, amplitude, measured)
    gain, harmonics, error = map(np.array, zip(*(_converged(setup, size, offset, x) for x in f), strict=True))
    linear = np.array([_converged(setup, _SMALL * size, offset, x)[0] for x in f])
    words = vocabulary_of(setup.network)
    # Behind an imposed motion the sensor sees the force.
    out = (words.effort, words.effort_unit or "1") if setup.network.senses else (words.output, words.output_unit)
    units, names = (words.source_unit, out[1]), (words.source, out[0])
    return Bode(f, size, gain, error, harmonics, linear, units, names, measured)


def _asked(frequencies: ArrayLike | None, amplitude: float | None, measured: Sequence[Point]) -> tuple[Array, float]:
    """Return the frequencies and amplitude as given, or as recorded."""
    if (frequencies is None or amplitude is None) and not measured:
        raise InputRefused("frequencies and amplitude: give both, or recordings of single sines")
    if frequencies is None:
        known = [p.frequency for p in measured]
        frequencies = np.geomspace(min(known) / _BEYOND, max(known) * _BEYOND, _POINTS)
    f = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    size = max(p.amplitude for p in measured) if amplitude is None else float(amplitude)
    if f.ndim != 1 or not f.size or not (np.isfinite(f).all() and (f > 0.0).all()):
        raise InputRefused("frequencies: give a row of positive numbers [Hz]")
    if not (np.isfinite(size) and size > 0.0):
        raise InputRefused(f"amplitude = {size:g}: give a positive number")
    return np.sort(f), size


def _converged(setup: Setup, amplitude: float, offset: float, frequency: float) -> tuple[complex, Array, float]:
    """Return ``Y_1/U_1``, harmonics (4,) over the fundamental, and the change by the last halving of the steps."""
    best = coarse = _amplitudes(setup, amplitude, offset, frequency, 1)
    for steps in _STEPS:
        fine = _amplitudes(setup, amplitude, offset, frequency, steps)
        # Richardson: the error of a step of second order falls to a quarter.
        better = fine + (fine - coarse) / (2**_ORDER - 1)
        change = float(abs(better[0] - best[0]))
        best, coarse = better, fine
        if change <= _CONVERGED * abs(best[0]):
            break
    size = abs(best[0])
    return complex(best[0]), np.abs(best[1:]) / (size if size > 0.0 else 1.0), change


def _amplitudes(setup: Setup, amplitude: float, offset: float, frequency: float, substeps: int) -> Complex:
    """Return (5,) complex amplitudes of the output's harmonics over that of the input, in the steady cycle."""
    period = 1.0 / frequency
    t = np.arange(_SAMPLES) * period / _SAMPLES
    u = offset + amplitude * np.sin(2.0 * np.pi * np.arange(_SAMPLES) / _SAMPLES)
    sine = replace(unrecorded(f"{frequency:g} Hz", t, u), start=Start("periodic"), period=period)
    try:
        y = simulate(setup, sine, substeps).y
    except SolverFailed as error:
        raise SolverFailed(f"response at {frequency:g} Hz and {amplitude:g}: {error}") from error
    waves = harmonic_weights(t, period)
    return np.asarray((waves @ y) / (waves[0] @ u))


def _degrees(gain: Complex) -> Array:
    """Return the phase [degrees] without jumps along the frequencies."""
    return np.degrees(np.unwrap(np.angle(gain)))


def _draw_harmonics(axes: Axes, bode: Bode) -> None:
    """Harmonics in percent of the fundamental."""
    for k in range(HARMONICS - 1):
        colour, mark = CATEGORIES[k], _MARKS[k]
        axes.plot(bode.frequencies, 100.0 * bode.harmonics[:, k], color=colour, linewidth=1.3, label=f"{k + 2}")
        for same in (True, False):
            some = bode.at_its_amplitude(same)
            values = [100.0 * p.harmonics[k] for p in some]
            fill = colour if same else "none"
            axes.plot([p.frequency for p in some], values, mark, color=colour, markersize=4.5, markerfacecolor=fill)
    log_axis(axes, "y")
    largest = 100.0 * float(max([bode.harmonics.max(), *(p.harmonics.max() for p in bode.measured)]))
    if largest > 0.0:
        # Harmonics that symmetry forbids are rounding, and would press all others against the top.
        axes.set_ylim(_VISIBLE * largest, 3.0 * largest)
    finish(axes, "frequency (Hz)", "harmonics over fundamental (%)", ncols=HARMONICS - 1, title="harmonic")


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
        """Return (K,) whether a correlation lies outside the band of the noise."""
        return np.asarray(self.tested & (np.abs(self.values - self.centre) > self.reach))

    @property
    def count(self) -> str:
        """Return how many lie outside, and how many of them chance would give."""
        number = int(self.tested.sum())
        return f"{int(self.outside.sum())} of {number} outside ({(1.0 - LEVEL) * number:.2g} expected)"


@dataclass(frozen=True)
class Tested:
    """The residual of one recording.

    Attributes:
        recording: what was recorded; autocorrelation: of the residual; by_input: its correlation with the input.
        f, density: (K,) frequencies [Hz] and amplitude density of the residual; noise: (K,) that of the noise.
    """

    recording: Recording
    autocorrelation: Correlated
    by_input: Correlated
    f: Array
    density: Array
    noise: Array


def residuals(
    model: Model | ModalFit | Diagnosis | str | Path,
    campaign: Campaign | str | Path | None = None,
    *,
    recordings: Sequence[str] | None = None,
    lags: int | None = None,
) -> Figure:
    """Draw what a model leaves: is it noise, or does it follow from its own past or from the input?

        figure = phnn.plot.residuals(diagnosis)
        figure = phnn.plot.residuals("out/model", phnn.read("recordings/"), lags=25)

    The bands hold 99 % of the correlations that noise alone would give; noise has the autocorrelation that the
    recordings showed before any model was fitted. The legend counts the correlations outside. Lags of a slow or
    periodic input are no independent tests: they leave their band together.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        campaign: recordings with outputs; those of the diagnosis if left out.
        recordings: names of those to draw; the first twelve if left out.
        lags: largest lag in samples; 100, or a quarter of the samples, if left out.

    Returns:
        A figure with autocorrelation, correlation with the input, and amplitude density against that of the noise.

    Raises:
        InputRefused: there is no such model or recording, too few samples.
        SolverFailed: a step has no solution.
    """
    return whiteness(residual_tests(model, campaign, recordings, lags)).figure()


def residual_tests(
    model: Any, campaign: Campaign | str | Path | None, recordings: Sequence[str] | None = None, lags: int | None = None
) -> list[Tested]:
    """Test the residual of each recording."""
    if campaign is None:
        if not isinstance(model, Diagnosis):
            raise InputRefused("campaign: left out, and a model has no recordings: give phnn.read(folder)")
        campaign = model.campaign
    return [_tested(one, lags) for one in predictions(model, campaign, recordings)]


def whiteness(tests: Sequence[Tested]) -> Plot:
    """Return what `residuals` draws: a row of panels for each recording."""

    def draw() -> Figure:
        figure = new_figure(11.4, 2.9 * len(tests) + 0.3)
        for row, one in zip(figure.subplots(len(tests), 3, squeeze=False), tests, strict=True):
            _draw_correlated(row[0], one.autocorrelation, "autocorrelation of the residual")
            _draw_correlated(row[1], one.by_input, "correlation with the input")
            _draw_spectrum(row[2], one)
            row[0].set_title(literal(one.recording.name, 40))
        return figure

    tables = {"": [t for one in tests for t in _correlations(one)], "_spectrum": [_spectrum(one) for one in tests]}
    return Plot(draw, {end: pd.concat(some, ignore_index=True) for end, some in tables.items()})


def _tested(one: Predicted, lags: int | None) -> Tested:
    r, e, u = one.recording, one.error, one.recording.u[one.scored]
    reach = min(_LAGS, int(_SHARE * e.size)) if lags is None else lags
    if e.size < _FEWEST or not 0 < reach < e.size:
        raise InputRefused(f"{r.name}: {e.size} scored samples for {reach} lags: give fewer lags, at least one")
    rho, far = r.noise_correlation, float(norm.ppf(0.5 + 0.5 * LEVEL))
    own_lags, both = np.arange(reach + 1, dtype=np.int64), np.arange(-reach, reach + 1, dtype=np.int64)
    centre = np.zeros(reach + 1)
    known = min(rho.size, reach + 1)
    # The estimator divides by all samples, also where fewer pairs are that far apart.
    centre[:known] = rho[:known] * (1.0 - np.arange(known) / e.size)
    itself = Correlated(
        own_lags, correlation(e, e, reach)[reach:], centre, far * own_deviation(rho, e.size, reach), own_lags > 0
    )
    moved = np.full(both.size, bool(np.ptp(u) > 0.0))
    by_input = Correlated(
        both, correlation(e, u, reach), np.zeros(both.size), far * cross_deviation(rho, u, reach), moved
    )
    f, density = amplitude_density(e, r.dt)
    # One-sided: white noise of unit variance has the density 2 Δt.
    level = r.noise * np.sqrt(2.0 * r.dt * density_of(rho, f * r.dt)) if r.noise_found else np.full(f.size, np.nan)
    return Tested(r, itself, by_input, f, density, level)


def _draw_correlated(axes: Axes, pair: Correlated, label: str) -> None:
    low, high = pair.centre - pair.reach, pair.centre + pair.reach
    axes.fill_between(pair.lags, low, high, color=FAINT, linewidth=0, label=f"{100 * LEVEL:.0f} % of noise alone")
    inside = ~pair.outside
    axes.vlines(pair.lags, 0.0, pair.values, color=AFTER, linewidth=0.7, alpha=0.6)
    axes.plot(pair.lags[inside], pair.values[inside], "o", color=AFTER, markersize=2.4)
    axes.plot(pair.lags[~inside], pair.values[~inside], "D", color=BEFORE, markersize=3.4, label=pair.count)
    axes.axhline(0.0, color=INK, linewidth=0.7)
    # Lag zero of the autocorrelation is one whatever the residual: it need not fill the panel.
    shown = pair.tested if pair.tested.any() else np.ones(pair.lags.size, dtype=bool)
    largest = float(np.abs(np.concatenate([pair.values[shown], low[shown], high[shown]])).max())
    axes.set_ylim(-1.15 * largest, 1.75 * largest)
    finish(axes, "lag (samples)", f"{label} (1)", "upper right")


def _draw_spectrum(axes: Axes, one: Tested) -> None:
    unit = f"{one.recording.units.output}/√Hz"
    size, label = scaled("residual", unit, float(np.median(one.density)))
    axes.loglog(one.f, one.density / size, color=AFTER, linewidth=0.9, label="residual")
    drawn = one.density[one.density > 0.0] / size
    floor = float(np.percentile(drawn, 1.0)) if drawn.size else 1.0
    if np.isfinite(one.noise).all():
        axes.loglog(one.f, one.noise / size, color=INK, linewidth=1.3, dashes=(4, 2), label="noise of the recording")
        floor = min(floor, float(one.noise.min()) / size)
    if drawn.size:
        axes.set_ylim(0.5 * floor, 6.0 * max(float(drawn.max()), floor))
    finish(axes, "frequency (Hz)", label, "upper right")


def _correlations(one: Tested) -> list[pd.DataFrame]:
    return [
        pd.DataFrame(
            {
                "recording": one.recording.name,
                "with": name,
                "lag_samples": pair.lags,
                "lag_s": pair.lags * one.recording.dt,
                "correlation_1": pair.values,
                "band_low_1": pair.centre - pair.reach,
                "band_high_1": pair.centre + pair.reach,
                "outside_1": pair.outside.astype(int),
            }
        )
        for name, pair in (("residual", one.autocorrelation), ("input", one.by_input))
    ]


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
