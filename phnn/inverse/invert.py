"""The inverse of a complete model, chain included: its options, the reference as it takes it, its limits, its result.

The inverses of network and blocks, one after the other, are an operator ``P`` from an output to a command. It is exact
but for the discretisation, for what lies between the samples of the command, and for blocks whose inverse is
approximate. With ``G`` the complete model within its limits, the reference ``r`` is corrected by what is missed,

    u_k = P(z_k),      z_{k+1} = z_k + w (r − G(u_k)),      z_0 = r,

which converges where ``P ∘ G`` is near the identity: the error falls by the share by which it differs from it. The
weight ``w`` is zero where something is out of reach, and one elsewhere: what cannot be reached must not add up. The
command with the least error is kept. No formula of an effect occurs here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import butter, sosfiltfilt

from phnn.chain.amplifiers import slew_limit
from phnn.errors import InputRefused
from phnn.intake import LIMITS
from phnn.inverse.blocks import FEWEST, FlatNetwork, Signal, command, displacement, path_through, reachable
from phnn.recordings.checks import ACTUATORS
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.signals.sampling import check_samples
from phnn.trajectory import simulate

HOLDS = ("cubic", "zero_order")


@dataclass(frozen=True)
class InverseOptions:
    """Attributes:
        smooth: corner [Hz] of the low-pass that the reference passes, without a phase, -6 dB there; None: no low-pass.
        limits: the lowest and the highest command [V]; None: no limits.
        slew: the largest rate of the command [V/s]; None: no limit.
        hold: the command between its samples: ``"cubic"``, as `Model.simulate` takes it, or ``"zero_order"``, as a
            converter holds it.
        lead_in: how long before the first sample the motion begins [s], see `phnn.inverse.invert.led_in`.
        tolerance: largest error of the output that counts as none [m]; None: a share of the reference's range.
        iterations: at most as many simulations of the complete model.

    Raises:
        InputRefused: a value out of its range; names it.
    """

    smooth: float | None = None
    limits: tuple[float, float] | None = None
    slew: float | None = None
    hold: str = "cubic"
    lead_in: float = 0.0
    tolerance: float | None = None
    iterations: int = 20

    def __post_init__(self) -> None:
        for name, unit in (("smooth", "Hz"), ("slew", "V/s"), ("tolerance", "m")):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputRefused(f"{name} = {value:g} {unit}: give a positive, finite number, or leave it out")
        if self.limits is not None:
            low, high = self.limits
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise InputRefused(f"limits = ({low:g}, {high:g}) V: give the lowest voltage, then the highest")
        if self.hold not in HOLDS:
            raise InputRefused(f"hold = {self.hold!r}: choose one of {', '.join(HOLDS)}")
        if not (math.isfinite(self.lead_in) and self.lead_in >= 0.0):
            raise InputRefused(f"lead_in = {self.lead_in:g} s: give zero or a positive, finite time")
        if self.iterations < 1:
            raise InputRefused(f"iterations = {self.iterations}: give 1 or more")


Array = NDArray[np.float64]

# Share of a limit by which a command may exceed it in rounding.
_ROUNDING = 1e-9


def limited(command: Signal, before: float, dt: float, options: InverseOptions) -> Signal:
    """Return the command at the samples within its limits; it follows what was asked for where it can.

    Args:
        command: at the samples; before: the command before the first one [V].
        dt: interval of the samples [s].
    """
    if options.limits is not None:
        low, high = options.limits
        room = _ROUNDING * max(abs(low), abs(high))
        lost = (command.values < low - room) | (command.values > high + room)
        cause = f"the voltage limits {low:g} V and {high:g} V"
        command = command.then(np.clip(command.values, low, high), lost, cause)
    if options.slew is not None:
        last = np.concatenate([[before], command.values[:-1]])
        # The block begins every step where it ended the one before, and has its middle on the straight line.
        steps = np.column_stack([last, 0.5 * (last + command.values), command.values])
        kept = slew_limit(steps, np.full(command.values.size, dt), before, options.slew)[:, 2]
        lost = np.abs(kept - command.values) > _ROUNDING * options.slew * dt
        command = command.then(kept, lost, f"the slew limit {options.slew:g} V/s")
    return command


_FORCE = "the force that the voltage can give"


class Attempt(NamedTuple):
    """Attributes:
    command: (N,) at the samples [V], and where it is not what was asked for.
    before: the command before the first sample [V].
    output: (N,) of the complete model under it [m].
    """

    command: Signal
    before: float
    output: Array


@dataclass(frozen=True)
class Plant:
    """A model that is to follow references.

    Attributes:
        setup: the model; substeps: integration steps in an interval; dt: interval of the samples [s].
        options: limits, and what the command does between its samples.
    """

    setup: Setup
    substeps: int
    dt: float
    options: InverseOptions

    @cached_property
    def network(self) -> FlatNetwork:
        """Return the inverse of the network."""
        return FlatNetwork(self.setup)

    def backwards(self, output: Array, known: Array | None = None) -> tuple[Signal, float, Array]:
        """Return the command for an output (N,), whatever its limits.

        Args:
            known: (n+1,) port voltage at the nodes for nearly the same output.

        Returns:
            The command at the samples [V], the one before them, and the port voltage at the nodes.
        """
        q = displacement(self.setup, reachable(output), self.dt, strict=known is None)
        path = path_through(q.values, self.dt, self.substeps)
        port = self.network.voltage(path, known)
        moved = Signal(path.q, np.repeat(q.lost, self.substeps)[: path.q.size], q.causes)
        asked = command(self.setup, moved.then(port.x, port.missed != 0.0, _FORCE), path.h)
        rest = self.network.at_rest(float(q.values[0]))[0]
        # The constant command under which the amplifier gives that voltage.
        before = command(self.setup, reachable(np.full(2, rest)), 1.0)
        return self._sampled(asked), float(before.values[0]), port.x

    def forwards(self, asked: Signal, before: float) -> Attempt:
        """Simulate the model under a command within its limits."""
        if self.options.limits is not None:
            before = float(np.clip(before, *self.options.limits))
        kept = limited(asked, before, self.dt, self.options)
        t = self.dt * np.arange(kept.values.size)
        recording = unrecorded("inverse", t, kept.values, self.options.hold, before)
        return Attempt(kept, before, np.asarray(simulate(self.setup, recording, self.substeps).y))

    def _sampled(self, asked: Signal) -> Signal:
        """Return a signal at the nodes, at the samples: its value there, or its mean while a sample is held."""
        n = self.substeps
        if self.options.hold == "cubic":
            return Signal(asked.values[::n], asked.lost[::n], asked.causes)
        means = (0.5 * (asked.values[1:] + asked.values[:-1])).reshape(-1, n).mean(axis=1)
        lost = asked.lost[:-1].reshape(-1, n).any(axis=1)
        return Signal(np.append(means, asked.values[-1]), np.append(lost, asked.lost[-1]), asked.causes)


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
    """Return the sampling interval [s] of a reference (N,) at times (N,).

    Raises:
        InputRefused: too few samples, values that are not finite, steps that differ, a reference that never moves, or
            one in metres that no piezo actuator reaches where the model is that of an actuator.
    """
    check_samples(t, {"reference": reference})
    if t.size < FEWEST:
        raise InputRefused(f"the reference has {t.size} samples: give at least {FEWEST}")
    most, largest = ACTUATORS["displacement"][1], float(np.abs(reference).max())
    if of_actuator and largest > most:
        raise InputRefused(
            f"the reference reaches {largest:.3g} m, a piezo actuator at most {most:g} m: give it in metres"
        )
    return float(t[-1] - t[0]) / (t.size - 1)


def smoothed(reference: Array, dt: float, corner: float | None) -> Array:
    """Return (N,) the reference behind a zero-phase low-pass of fourth order, which runs forwards and backwards.

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
    """Return (M + N,) the reference behind a way from rest at its first value to its first speed and acceleration.

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


def judged(command: Array, dt: float) -> tuple[str, ...]:
    """Return what to say of a command (N,) of which a share is faster than a quarter of the sampling rate.

    The share is that of the command's variation, root mean square.

    Raises:
        InputRefused: most of it is noise of the samples.
    """
    if not np.ptp(command) > 0.0:
        return ()
    sections = butter(_ORDER, 2.0 * _FAST, btype="high", output="sos")
    padded = np.pad(command, min(command.size, 64), mode="edge")
    fast = sosfiltfilt(sections, padded, padtype=None)
    share = float(np.sqrt(np.sum(fast**2)) / np.sqrt(np.sum((command - command.mean()) ** 2)))
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


def _count(samples: float, what: str, remedy: str) -> int:
    if samples > LIMITS.samples:
        raise InputRefused(f"{what} takes {samples:.3g} samples, at most {LIMITS.samples} are accepted: give {remedy}")
    return math.ceil(samples - 0.5)


SCHEMA = "phnn.inverse/1"


@dataclass(frozen=True)
class Stretch:
    """A time in which the output misses the reference by more than the tolerance.

    Attributes:
        start, end: times of its first and last sample [s].
        error: the largest error in it, with its sign, output minus reference [m].
        at: when [s].
        causes: why, in words; empty where nothing was out of reach and the iteration alone did not get there.
    """

    start: float
    end: float
    error: float
    at: float
    causes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Inverse:
    """The input that makes a model follow a reference.

        found = model.inverse(t, reference)
        model.simulate(found.t, found.voltage, input_before=found.voltage_before, hold=found.options.hold)
                                                             # is found.reached

    Attributes:
        t: (N,) time [s]; it begins before the reference's where there is a way into it.
        given: (N,) the reference as it was given, after the way into it [m].
        reference: (N,) what the output was to follow: the same, smoothed if that was asked for [m].
        voltage: (N,) the command [V].
        voltage_before: the constant command before the first sample, in whose equilibrium everything begins [V].
        reached: (N,) output of the complete model under that command [m].
        tolerance: error that counts as none [m].
        iterations: simulations of the complete model.
        missed: where the error is larger than that.
        messages: what a user should know, in sentences.
        options: as asked for.
    """

    t: Array
    given: Array
    reference: Array
    voltage: Array
    voltage_before: float
    reached: Array
    tolerance: float
    iterations: int
    missed: tuple[Stretch, ...]
    messages: tuple[str, ...]
    options: InverseOptions

    @property
    def error(self) -> Array:
        """Return (N,) output minus reference [m]."""
        return self.reached - self.reference

    @property
    def error_of_given(self) -> Array:
        """Return (N,) output minus the reference as it was given, what smoothing has taken from it included [m]."""
        return self.reached - self.given

    @property
    def follows(self) -> bool:
        """Return whether the error is nowhere larger than the tolerance."""
        return not self.missed

    def document(self) -> dict[str, Any]:
        """Return the content of ``invert.json``."""
        speed = np.diff(self.voltage) / (self.t[1] - self.t[0])
        return {
            "schema": SCHEMA,
            "samples": self.t.size,
            "follows": self.follows,
            "error_max_m": float(np.abs(self.error).max()),
            "error_rms_m": float(np.sqrt(np.mean(self.error**2))),
            "error_of_given_max_m": float(np.abs(self.error_of_given).max()),
            "error_of_given_rms_m": float(np.sqrt(np.mean(self.error_of_given**2))),
            "tolerance_m": self.tolerance,
            "range_of_reference_m": float(np.ptp(self.reference)),
            "iterations": self.iterations,
            "voltage_V": [float(self.voltage.min()), float(self.voltage.max())],
            "voltage_before_V": self.voltage_before,
            "slew_V_per_s": float(np.abs(speed).max()),
            "missed": [
                {"from_s": s.start, "to_s": s.end, "error_m": s.error, "at_s": s.at, "causes": list(s.causes)}
                for s in self.missed
            ],
            "messages": list(self.messages),
            "options": {
                "smooth_Hz": self.options.smooth,
                "limits_V": None if self.options.limits is None else list(self.options.limits),
                "slew_V_per_s": self.options.slew,
                "hold": self.options.hold,
                "lead_in_s": self.options.lead_in,
            },
        }


def stretches(t: Array, error: Array, tolerance: float, lost: NDArray[np.bool_], causes: tuple[str, ...],
              least: float) -> tuple[Stretch, ...]:  # fmt: skip
    """Return the times in which an error is larger than the tolerance.

    Args:
        t: (N,) [s]; error: (N,) [m].
        lost: (N,) where something was out of reach, and causes: why.
        least: two stretches that are less than this time apart are one [s].
    """
    at = np.flatnonzero(np.abs(error) > tolerance)
    if not at.size:
        return ()
    groups = np.split(at, np.flatnonzero(np.diff(t[at]) > least) + 1)
    missed = []
    for group in groups:
        worst = int(group[np.argmax(np.abs(error[group]))])
        # An error begins no later than this after the sample that was out of reach.
        before = int(np.searchsorted(t, t[group[0]] - least))
        why = causes if lost[before : group[-1] + 1].any() else ()
        missed.append(Stretch(float(t[group[0]]), float(t[group[-1]]), float(error[worst]), float(t[worst]), why))
    return tuple(missed)


# Share of the reference's range that counts as no error where the user says nothing.
_TOLERANCE = 1e-5
# The iteration ends where this many simulations in a row have not lowered the least error by this share of it.
_PATIENCE, _PROGRESS = 4, 0.02
# Samples over which a correction fades in beside what is out of reach.
_FADE = 8
# Stretches of error closer than this share of the whole time are told as one; at most so many are told.
_CLOSE, _TOLD = 0.02, 4


def invert(setup: Setup, substeps: int, t: Array, reference: Array, options: InverseOptions) -> Inverse:
    """Find the command with which a model's output follows a reference.

    Args:
        setup: the model; substeps: its integration steps in a sample interval.
        t: (N,) time [s], equally spaced; reference: (N,) wanted output [m].
        options: smoothing, limits and the like.

    Raises:
        InputRefused: the reference or the model cannot be used; names the cause and a remedy.
        SolverFailed: a step has no solution.
    """
    volts = any(port.unit == "V" for port in setup.network.ports[:1])
    moves = any(s.name == setup.network.output and s.unit == "m" for s in setup.network.storages)
    dt = checked(t, reference, volts and moves)
    given = led_in(reference, dt, options.lead_in)
    wanted = smoothed(given, dt, options.smooth)
    times = t[0] + dt * (np.arange(wanted.size) - (wanted.size - t.size))
    tolerance = options.tolerance or _TOLERANCE * float(np.ptp(wanted))
    plant = Plant(setup, substeps, dt, options)
    first, before, port = plant.backwards(wanted)
    messages = list(judged(first.values, dt))
    speed = np.abs(path_through(wanted, dt, 1).velocity)
    if not speed[0] <= _AT_REST * speed.max():
        messages.append(
            "The reference begins in motion, and the model at rest, so that the beginning is missed: give a lead_in "
            "(--lead-in), for example of some periods."
        )
    attempt, count = _iterated(plant, wanted, tolerance, (plant.forwards(first, before), port))
    missed = stretches(
        times, attempt.output - wanted, tolerance, attempt.command.lost, attempt.command.causes,
        _CLOSE * float(times[-1] - times[0]),
    )  # fmt: skip
    return Inverse(
        times, given, wanted, attempt.command.values, attempt.before, attempt.output, tolerance, count, missed,
        (*messages, *_missed_in_words(missed, tolerance)), options,
    )  # fmt: skip


def _iterated(plant: Plant, wanted: Array, tolerance: float, begun: tuple[Attempt, Array]) -> tuple[Attempt, int]:
    """Return the attempt with the least error against the reference ``wanted`` (N,), and the number of simulations;
    ``begun`` is the first attempt, and its port voltage at the nodes."""
    attempt, port = begun
    corrected, count = wanted, 1
    best, least, latest = attempt, _size(attempt.output - wanted), count
    while count < plant.options.iterations and np.abs(best.output - wanted).max() > tolerance:
        # Not where something is out of reach, nor close to it.
        near = maximum_filter1d(attempt.command.lost.astype(float), 2 * _FADE + 1)
        corrected = corrected + (1.0 - uniform_filter1d(near, 2 * _FADE + 1)) * (wanted - attempt.output)
        asked, before, port = plant.backwards(corrected, port)
        attempt, count = plant.forwards(asked, before), count + 1
        error = _size(attempt.output - wanted)
        if error < (1.0 - _PROGRESS) * least:
            best, least, latest = attempt, error, count
        elif not np.isfinite(error) or count - latest >= _PATIENCE:
            break
    return best, count


def _size(error: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(error**2)))


def _missed_in_words(missed: tuple[Stretch, ...], tolerance: float) -> tuple[str, ...]:
    """Return the sentences on what is missed: the largest errors first."""
    ordered = sorted(missed, key=lambda s: -abs(s.error))
    sentences = [
        f"From {s.start:.6g} s to {s.end:.6g} s the reference is missed by up to {abs(s.error):.3g} m, at {s.at:.6g} s"
        + (f": it is limited by {' and '.join(s.causes)}." if s.causes else f" (tolerance {tolerance:.3g} m).")
        for s in ordered[:_TOLD]
    ]
    if len(ordered) > _TOLD:
        sentences.append(f"So it is, by less, in {len(ordered) - _TOLD} more stretches.")
    return tuple(sentences)
