"""The frequency response of a model at an amplitude, by simulation, beside that at a small amplitude.

A sine ``u = u_0 + A sin ωt`` drives the model into its steady cycle; the describing function is the ratio of the
complex amplitudes of output and input at the fundamental, ``Y_1/U_1``, and the harmonics ``|Y_k|/|Y_1|`` say what it
leaves out. Steps are halved until the response, extrapolated to steps of no size, has converged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.vocabulary import vocabulary_of
from phnn.errors import InputRefused, SolverFailed
from phnn.model import Model
from phnn.plot.panels import Array, Panels, Scaled, column, grid, network_model, scaled
from phnn.plot.points import Point, point
from phnn.recordings import Campaign, campaign_of
from phnn.recordings.recording import Start, unrecorded
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, INK, RC, log_axis, quiet_grid
from phnn.setup import Setup
from phnn.signals.harmonics import HARMONICS, harmonic_weights
from phnn.simulate import simulate
from phnn.units import quantity

Complex = NDArray[np.complex128]

# Samples of a period, and steps between two of them at most.
_SAMPLES, _FINEST = 256, 16
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
        frequencies: (F,) [Hz]; amplitude, offset: of the input.
        gain: (F,) describing function; error: (F,) by how much the last halving of the steps has changed it.
        harmonics: (F, 4) ``|Y_k|/|Y_1|`` for k = 2 … 5.
        linear: (F,) response to a small amplitude.
        units: of input and output; words: what they are called.
        measured: responses in recordings.
    """

    frequencies: Array
    amplitude: float
    offset: float
    gain: Complex
    error: Array
    harmonics: Array
    linear: Complex
    units: tuple[str, str]
    words: tuple[str, str]
    measured: tuple[Point, ...] = ()

    @property
    def gain_unit(self) -> str:
        """Unit of the response."""
        into, out = self.units
        return out if into == "1" else f"{out}/({into})" if "/" in into or " " in into else f"{out}/{into}"

    def draw(self, axes: Any = None) -> Panels:
        """(3,) axes: magnitude, phase, harmonics."""
        with rc_context(RC):
            panels = grid(axes, 3, 1, 7.2, 8.4, sharex=True, height_ratios=[1.3, 1.0, 1.0])[:, 0]
            gain = scaled(f"{self.words[1]} by {self.words[0]}", self.gain_unit, np.abs(self.gain))
            at = f"at {quantity(self.amplitude, self.units[0])}"
            _draw_response(panels[0], self, at, lambda g: gain(np.abs(g)))
            _draw_response(panels[1], self, at, _degrees)
            log_axis(panels[0], "y")
            panels[0].set_ylabel(gain.label)
            panels[1].set_ylabel("phase (degrees)")
            _draw_points(panels, self, gain)
            _draw_harmonics(panels[2], self)
            for one in panels:
                log_axis(one)
                quiet_grid(one)
            panels[0].legend(loc="best")
            panels[2].set_xlabel("frequency (Hz)")
        return panels

    def tables(self) -> dict[str, pd.DataFrame]:
        """The model's responses, and those measured where there are any."""
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
        if not self.measured:
            return {"": model}
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
        return {"": model, "_measured": pd.DataFrame(rows)}

    def at_its_amplitude(self, own: bool) -> list[Point]:
        """Measured responses at the amplitude of the model's, or those at another one."""
        return [p for p in self.measured if (abs(p.amplitude / self.amplitude - 1.0) <= _ALIKE) == own]

    def beside(self, point: Point) -> float:
        """Phase of a measured response [degrees], in the turn that is nearest to the model's."""
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
    axes: Any = None,
) -> Panels:
    """Draw the frequency response of a model at an amplitude, and its response to small amplitudes.

        axes = phnn.plot.bode(model, np.geomspace(1.0, 1000.0, 40), amplitude=75.0)

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        frequencies: (F,) [Hz]; between those of the campaign's sines, and a factor of two beyond, if left out.
        amplitude: of the input, SI; the largest of the campaign's sines if left out.
        offset: constant input about which it swings.
        campaign: recordings whose single sines are drawn as points.
        axes: three axes to draw into.

    Returns:
        (3,) axes: magnitude, phase, and harmonics 2 to 5 over the fundamental.

    Raises:
        InputRefused: there is no such model, frequencies or amplitude are not positive, or are left out where no sine
            was recorded.
        SolverFailed: a step has no solution, or there is no steady cycle; names the frequency.
    """
    return response(model, frequencies, amplitude, offset, campaign).draw(axes)


def response(
    model: Any,
    frequencies: ArrayLike | None = None,
    amplitude: float | None = None,
    offset: float = 0.0,
    campaign: Campaign | str | Path | None = None,
) -> Bode:
    """What `bode` draws."""
    setup = network_model(model).setup
    recorded = () if campaign is None else campaign_of(campaign).recordings
    measured = tuple(p for r in recorded if (p := point(r)) is not None)
    f, size = _asked(frequencies, amplitude, measured)
    found = [_converged(setup, size, offset, x) for x in f]
    linear = [_converged(setup, _SMALL * size, offset, x)[0] for x in f]
    words = vocabulary_of(setup.network)
    senses = bool(setup.network.senses)
    # Behind an imposed motion the sensor sees the force.
    out = (words.effort, words.effort_unit or "1") if senses else (words.output, words.output_unit)
    return Bode(
        f, size, offset, np.array([g for g, _, _ in found]), np.array([e for _, _, e in found]),
        np.array([h for _, h, _ in found]), np.array(linear), (words.source_unit, out[1]), (words.source, out[0]),
        measured,
    )  # fmt: skip


def _asked(frequencies: ArrayLike | None, amplitude: float | None, measured: Sequence[Point]) -> tuple[Array, float]:
    """Frequencies and amplitude as given, or as recorded."""
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
    """Response ``Y_1/U_1``, harmonics (4,) over the fundamental, and the change by the last halving of the steps."""
    steps = 1
    coarse = _amplitudes(setup, amplitude, offset, frequency, steps)
    best, change = coarse, np.inf
    while steps < _FINEST:
        steps *= 2
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
    """(5,) complex amplitudes of the output's harmonics over that of the input, in the steady cycle."""
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
    """Phase [degrees] without jumps along the frequencies."""
    return np.degrees(np.unwrap(np.angle(gain)))


def _draw_response(axes: Axes, found: Bode, at: str, value: Any) -> None:
    axes.plot(found.frequencies, value(found.gain), color=AFTER, linewidth=1.6, label=at)
    axes.plot(
        found.frequencies, value(found.linear), color=INK, linewidth=1.2, dashes=(4, 2), label="at small amplitude"
    )


def _draw_points(panels: Panels, found: Bode, gain: Scaled) -> None:
    """Measured points; those of another amplitude are hollow."""
    for own, name in ((True, "measured"), (False, "measured at another amplitude")):
        some = found.at_its_amplitude(own)
        if not some:
            continue
        f = [p.frequency for p in some]
        style = {"color": BEFORE, "markersize": 5.0, "markerfacecolor": BEFORE if own else "none", "linestyle": ""}
        panels[0].plot(f, gain([abs(p.gain) for p in some]), "o", label=name, **style)
        panels[1].plot(f, [found.beside(p) for p in some], "o", **style)


def _draw_harmonics(axes: Axes, found: Bode) -> None:
    """Harmonics in percent of the fundamental."""
    for k in range(HARMONICS - 1):
        colour, mark = CATEGORIES[k], _MARKS[k]
        axes.plot(found.frequencies, 100.0 * found.harmonics[:, k], color=colour, linewidth=1.3, label=f"{k + 2}")
        for own in (True, False):
            some = found.at_its_amplitude(own)
            values = [100.0 * p.harmonics[k] for p in some]
            fill = colour if own else "none"
            axes.plot([p.frequency for p in some], values, mark, color=colour, markersize=4.5, markerfacecolor=fill)
    log_axis(axes, "y")
    largest = 100.0 * float(max([found.harmonics.max(), *(p.harmonics.max() for p in found.measured)]))
    if largest > 0.0:
        # Harmonics that symmetry forbids are rounding, and would press all others against the top.
        axes.set_ylim(_VISIBLE * largest, 3.0 * largest)
    axes.set_ylabel("harmonics over fundamental (%)")
    axes.legend(loc="best", ncols=HARMONICS - 1, title="harmonic")
