"""The view of one recording in pictures: units, labels, the stretch that tells most, envelopes and spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from phnn.report.evidence import Trace
from phnn.report.formatting import Unit, display_unit, quantity


def envelope(
    y: np.ndarray,  # (N,)
    bins: int = 1500,
) -> np.ndarray:
    """Indices of the smallest and the largest sample of each of ``bins`` stretches, in order of time.

    A line through them covers the same pixels as the whole trace: no spike is lost, nothing aliases.
    Samples that are not finite are passed over. A trace of at most ``2 bins`` samples is kept as it is.
    """
    count = len(y)
    if count <= 2 * bins:
        return np.arange(count)
    width = -(-count // bins)
    rows = -(-count // width)
    padded = np.full(rows * width, np.nan)
    padded[:count] = y
    blocks = padded.reshape(rows, width)
    bad = ~np.isfinite(blocks)
    start = np.arange(rows) * width
    low = start + np.argmin(np.where(bad, np.inf, blocks), axis=1)
    high = start + np.argmax(np.where(bad, -np.inf, blocks), axis=1)
    return np.unique(np.concatenate(([0], low, high, [count - 1])))


def cycles(u: np.ndarray) -> float:
    """Number of cycles in an input, counted by crossings of its mid-range with 5 % hysteresis."""
    finite = u[np.isfinite(u)]
    if finite.size < 2 or np.ptp(finite) == 0.0:
        return 0.0
    middle = 0.5 * (finite.max() + finite.min())
    margin = 0.05 * np.ptp(finite)
    sides = np.where(finite > middle + margin, 1, np.where(finite < middle - margin, -1, 0))
    sides = sides[sides != 0]
    return 0.5 * float(np.count_nonzero(np.diff(sides)))


def telling_stretch(
    u: np.ndarray,  # (N,) input
    error: np.ndarray,  # (N,) residual of the base model
    scored: np.ndarray,  # (N,) bool
    shown: float = 4.0,
) -> slice:
    """About ``shown`` cycles where the error is largest, or the whole trace where it has no more than twice that."""
    count = len(u)
    number = cycles(u)
    if number <= 2.0 * shown or count < 100:
        return slice(0, count)
    width = min(count, max(50, round(shown * count / number)))
    square = np.where(scored & np.isfinite(error), error, 0.0) ** 2
    running = np.concatenate(([0.0], np.cumsum(square)))
    first = int(np.argmax(running[width:] - running[:-width]))
    return slice(first, first + width)


_SHORTEST = 32


@dataclass(frozen=True)
class Spectrum:
    """Amplitude spectral densities, one-sided; the zero frequency is left out."""

    frequency: np.ndarray  # (K,) Hz
    before: np.ndarray  # (K,) m/√Hz
    after: np.ndarray  # (K,) m/√Hz
    noise: float  # m/√Hz, white noise of the stated standard deviation


def longest_run(mask: np.ndarray) -> slice:
    """The longest stretch of true values (empty where there is none)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask.astype(bool), [False])).astype(np.int8)))
    if edges.size == 0:
        return slice(0, 0)
    first, last = edges[::2], edges[1::2]
    best = int(np.argmax(last - first))
    return slice(int(first[best]), int(last[best]))


def residual_spectrum(
    t: np.ndarray,  # (N,) s
    before: np.ndarray,  # (N,) residual of the base model
    after: np.ndarray,  # (N,) residual of the final model
    usable: np.ndarray,  # (N,) bool
    noise: float,
) -> Spectrum | None:
    """Welch estimate over the longest usable stretch, in segments of a third of it, so that lines stay sharp.

    White noise of standard deviation σ sampled every Δt has the one-sided density ``σ √(2 Δt)``.
    ``None`` where the stretch has fewer than 32 samples.
    """
    part = longest_run(usable & np.isfinite(before) & np.isfinite(after))
    count = part.stop - part.start
    if count < _SHORTEST:
        return None
    step = float(t[part][-1] - t[part][0]) / (count - 1)
    (f, drawn_before), (_, drawn_after) = (amplitude_density(x[part], step) for x in (before, after))
    return Spectrum(f, drawn_before, drawn_after, noise * float(np.sqrt(2.0 * step)))


def amplitude_density(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """(K,) frequencies [Hz] without zero, and the one-sided amplitude density, in the unit of ``x`` by √Hz.

    Args:
        x: (N,) samples; dt: sampling interval [s].
    """
    segment = x.size if x.size < 8 * _SHORTEST else x.size // 3
    f, power = welch(x, fs=1.0 / dt, nperseg=segment, detrend="constant")
    return f[1:], np.sqrt(power[1:])


_INPUTS = {"V": "voltage", "N": "force", "A": "current"}


@dataclass(frozen=True)
class View:
    """What all panels and plots of a recording share.

    Attributes:
        error_before, error_after: (N,) measured minus model, SI.
        stretch: samples where the base model is worst; all where the recording is short.
        output, error: display units of the output and of its errors.
        changed: the final model differs from the base model; names: of both models.
    """

    trace: Trace
    error_before: np.ndarray
    error_after: np.ndarray
    stretch: slice
    output: Unit
    error: Unit
    input_label: str
    output_label: str
    output_unit: str
    changed: bool
    names: tuple[str, str]

    @property
    def whole(self) -> bool:
        """The stretch that tells most is the whole recording."""
        return self.stretch == slice(0, len(self.trace.t))


def _largest(*arrays: np.ndarray) -> float:
    values = [float(np.max(np.abs(a[np.isfinite(a)]))) for a in arrays if np.isfinite(a).any()]
    return max(values, default=0.0)


def _spread(trace: Trace) -> float:
    """Size of an error worth an axis: its 99th percentile on scored samples, or the noise."""
    error = (trace.measured - trace.before)[trace.scored]
    error = np.abs(error[np.isfinite(error)])
    return max(float(np.percentile(error, 99.0)) if error.size else 0.0, trace.noise if trace.noise > 0.0 else 0.0)


def view_of(trace: Trace, input_unit: str, output_unit: str) -> View:
    """How a recording is shown; the units are SI units of its channels."""
    output = display_unit(_largest(trace.measured), output_unit, floor=1.0)
    changed = not np.array_equal(trace.before, trace.after, equal_nan=True)
    error_before = trace.measured - trace.before
    return View(
        trace=trace,
        error_before=error_before,
        error_after=trace.measured - trace.after,
        stretch=telling_stretch(trace.u, error_before, trace.scored),
        output=output,
        error=display_unit(_spread(trace), output_unit),
        input_label=f"{_INPUTS.get(input_unit, 'input')} ({input_unit})",
        output_label=f"{'displacement' if output_unit == 'm' else 'output'} ({output.name})",
        output_unit=output_unit,
        changed=changed,
        names=("base model", "final model") if changed else ("base model (nothing added)", ""),
    )


def error_limits(view: View) -> tuple[float, str]:
    """Half the height of the error axis, and a remark where a few lone samples would have flattened all others."""
    usable = view.trace.scored
    errors = np.abs(np.concatenate((view.error_before[usable], view.error_after[usable])))
    errors = errors[np.isfinite(errors)]
    largest = _largest(errors)
    common = float(np.percentile(errors, 99.9)) if errors.size else 0.0
    if common > 0.0 and largest > 3.0 * common:
        beyond = np.fmax(np.abs(view.error_before), np.abs(view.error_after)) > 2.0 * common
        count = int(np.count_nonzero(beyond & usable))
        limit, noun = 2.0 * common, "sample" if count == 1 else "samples"
        remark = f"{count} {noun} beyond, up to {quantity(largest, view.output_unit)}"
    else:
        limit, remark = largest, ""
    return 1.12 * max(limit, 3.0 * view.trace.noise if view.trace.noise > 0.0 else 0.0) or 1.0, remark


def unscored(scored: np.ndarray) -> list[slice]:
    """Stretches that were not scored, none where nothing was."""
    if not scored.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([True], scored, [True])).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
