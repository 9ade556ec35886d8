"""The reference as the inverse takes it: checked, led in from rest, smoothed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.inverse.path import path_through, smallest_count
from phnn.recordings.checks import ACTUATORS
from phnn.signals.sampling import check_samples

Array = NDArray[np.float64]

# Order of the low-pass; applied forwards and backwards, its gain at the corner is a half.
_ORDER = 4
# Above this share of the sampling frequency a reference should have nothing: there the inverse makes of its samples
# what the interpolation between them was.
_FAST = 0.25
# Share of the command's range above that frequency from which on it is told, and from which on it is refused.
_NOTED, _REFUSED = 0.02, 0.3
# Share of the largest speed with which a reference may begin and still count as beginning at rest.
_AT_REST = 1e-2


def checked(t: Array, reference: Array, of_actuator: bool = False) -> float:
    """The sampling interval [s] of a reference (N,) at times (N,).

    Raises:
        InputRefused: too few samples, values that are not finite, steps that differ, a reference that never moves, or
            one in metres that no piezo actuator reaches where the model is that of an actuator.
    """
    check_samples(t, {"reference": reference})
    if t.size < smallest_count():
        raise InputRefused(f"the reference has {t.size} samples: give at least {smallest_count()}")
    most, largest = ACTUATORS["displacement"][1], float(np.abs(reference).max())
    if of_actuator and largest > most:
        raise InputRefused(
            f"the reference reaches {largest:.3g} m, a piezo actuator at most {most:g} m: give it in metres"
        )
    return float(t[-1] - t[0]) / (t.size - 1)


def smoothed(reference: Array, dt: float, corner: float | None) -> Array:
    """(N,) the reference behind a low-pass of fourth order that runs forwards and backwards, so that nothing is late.

    It stands still before its first sample and after its last one.

    Args:
        corner: frequency at which half of the amplitude is left [Hz]; None: as it is.

    Raises:
        InputRefused: the corner lies above half of the sampling frequency, or so low that its response is endless.
    """
    if corner is None:
        return reference
    if 2.0 * corner * dt >= 1.0:
        raise InputRefused(
            f"smooth = {corner:g} Hz, but the reference is sampled at {1.0 / dt:g} Hz: give a corner below half of that"
        )
    sections = butter(_ORDER, corner, fs=1.0 / dt, output="sos")
    # The response has died away over some periods of the corner.
    beyond = _count(4.0 * _ORDER / (2.0 * np.pi * corner * dt), f"smooth = {corner:g} Hz", "a higher corner")
    padded = np.pad(reference, beyond, mode="edge")
    return np.asarray(sosfiltfilt(sections, padded, padtype=None)[beyond : beyond + reference.size])


def led_in(reference: Array, dt: float, duration: float) -> Array:
    """(M + N,) the reference with a way into it: from rest at its first value to its first speed and acceleration.

    The way is the polynomial of fifth degree that has these at its ends.

    Args:
        duration: of the way [s]; zero: none.

    Raises:
        InputRefused: the way has too many samples.
    """
    count = _count(duration / dt, f"lead_in = {duration:g} s", "a shorter one")
    if not count:
        return reference
    start = path_through(reference, dt, 1)
    length = count * dt
    # Of s = t/T: displacement and its first two derivatives are zero at 0, and 0, v T, a T² at 1.
    speed, bend = start.velocity[0] * length, start.acceleration[0] * length**2
    s = np.arange(count) / count
    way = s**3 * (-4.0 * speed + 0.5 * bend + s * (7.0 * speed - bend + s * (-3.0 * speed + 0.5 * bend)))
    return np.concatenate([reference[0] + way, reference])


def begins_at_rest(reference: Array, dt: float) -> bool:
    """Whether the speed at the first sample is a small share of the largest one."""
    speed = np.abs(path_through(reference, dt, 1).velocity)
    return bool(speed[0] <= _AT_REST * speed.max())


def fast_share(command: Array) -> float:
    """The share of a command's (N,) variation, root mean square, that is faster than a quarter of the sampling rate."""
    if not np.ptp(command) > 0.0:
        return 0.0
    sections = butter(_ORDER, 2.0 * _FAST, btype="high", output="sos")
    padded = np.pad(command, min(command.size, 64), mode="edge")
    fast = sosfiltfilt(sections, padded, padtype=None)
    return float(np.sqrt(np.sum(fast**2)) / np.sqrt(np.sum((command - command.mean()) ** 2)))


def judged(share: float, dt: float) -> tuple[str, ...]:
    """What to say of a command of which a share is faster than a quarter of the sampling rate.

    Raises:
        InputRefused: most of it is noise of the samples.
    """
    if share < _NOTED:
        return ()
    about = (
        f"{100.0 * share:.2g} % of the command is faster than {_FAST / dt:.4g} Hz, a quarter of the sampling rate: the "
        "reference jumps, has corners, or is noisy, and its second derivative makes that large"
    )
    remedy = f"give a smoother reference, or smooth it, for example with smooth = {0.02 / dt:.3g} Hz (--smooth)"
    if share >= _REFUSED:
        raise InputRefused(f"{about}: {remedy}")
    return (f"{about}; {remedy}.",)


def _count(samples: float, said: str, remedy: str) -> int:
    if samples > LIMITS.samples:
        raise InputRefused(f"{said} takes {samples:.3g} samples, at most {LIMITS.samples} are accepted: give {remedy}")
    return math.ceil(samples - 0.5)
