"""Recordings in SI units, the uses of their parts, and the set of all recordings."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.html import table, titled
from phnn.parameters import quantity
from phnn.recordings.excitation import Excitation, excitation_of, spectrum
from phnn.results import listed
from phnn.signals.noise import AS_WHITE
from phnn.signals.sampling import quantisation_step


class Units(NamedTuple):
    """SI units of what a recording has as input and as output."""

    input: str
    output: str


Array = np.ndarray
Signals = Mapping[str, Array]  # (N,) by name
ACTUATOR = Units("V", "m")
# What stands for the folder of recordings that do not come from files.
IN_MEMORY = "recordings in memory"
# Weights of further inputs, which no simple relation makes cancel; and by how much of a sample a whole number of
# periods may miss a whole number of samples.
_GOLDEN, _WHOLE = 0.618, 0.02
# Intervals between samples that differ by less, as a share of their mean, differ by rounding only.
_ROUNDING = 1e-6

# Most samples from one that shows the inputs to the next; the largest error of straight lines, over the range.
_STRIDE, _STRAIGHT = 8, 0.001

# A sample sits at a limit of the sensor within this share of the range: numbers in files are rounded.
_AT_LIMIT = 1e-4


@dataclass(frozen=True)
class Sensor:
    """What the manifest says about the sensor, SI.

    Samples at a limit say only that the true output lies at or beyond it; a limit is infinite where there is none.
    """

    saturates: tuple[float, float] = (-math.inf, math.inf)  # least and largest output that it can show
    rectified: bool = False  # it shows the size of the output without its sign
    lag: float = 0.0  # time constant [s]
    derivative: int = False  # how many times what it measures is derived from the network's output by time: 0, 1 or 2
    unit: str = ""  # SI unit of the limits

    @property
    def is_limited(self) -> bool:
        """Return whether it saturates at all."""
        return math.isfinite(self.saturates[0]) or math.isfinite(self.saturates[1])

    def at_limit(self, y: Array) -> NDArray[np.int8]:
        """Return (N,) 1 where a recorded output sits at the upper limit, -1 where at the lower one, 0 between them."""
        room = _AT_LIMIT * float(np.ptp(y))
        return (y >= self.saturates[1] - room).astype(np.int8) - (y <= self.saturates[0] + room).astype(np.int8)

    def limited(self, y: Array) -> Array:
        """Return (N,) an output as the sensor shows it."""
        return np.clip(y, *self.saturates)

    def words(self, y: Array) -> str:
        """Return what is known, and how many samples (N,) sit at a limit; empty where nothing is."""
        facts = []
        if self.is_limited:
            ends = [quantity(limit, self.unit) for limit in self.saturates if math.isfinite(limit)]
            count = int(np.sum(self.at_limit(y) != 0))
            facts.append(f"saturates at {' and '.join(ends)}, where {count} samples sit: they say no more than that")
        facts += ["shows the size without its sign"] if self.rectified else []
        facts += [f"lags by {quantity(self.lag, 's')}"] if self.lag else []
        if self.derivative:
            facts.append(f"measures the {'rate' if self.derivative == 1 else 'second derivative'} of the output")
        return "; ".join(facts)


PLAIN = Sensor()


@dataclass(frozen=True)
class Start:
    """How a recording begins."""

    state: str  # rest (in equilibrium before the first sample), unknown or periodic (steady cycle)
    input_before: float = 0.0  # the input before the first sample, SI; it has a meaning for rest only


@dataclass(frozen=True)
class Part:
    """The samples ``[first, last)`` of a recording and what they are for."""

    name: str  # shown to people; equal to the recording's name where that has one scored part
    first: int
    last: int
    use: str  # identification, confirmation or nuisance (fits zero and initial state, never scored)


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording in SI units.

    Attributes:
        name: unique in its campaign.
        t: ``(N,)`` sampling instants in s, ascending from 0; see `clock`.
        u: ``(N,)`` input, for an actuator in V.
        y: ``(N,)`` output, for an actuator in m; all NaN where none was recorded and none was asked for.
        start: how the recording begins.
        interpolation: the input between samples: ``"cubic"``, ``"band_limited"``, ``"linear"`` or ``"zero_order"``.
        parts: which samples serve as what; samples in no part are never used for scoring.
        noise: standard deviation of the output's noise, SI.
        noise_source: where that number comes from, in words.
        noise_correlation: ``(K,)`` autocorrelation of the noise at lags 0..K-1; ``[1.0]`` when white or unknown.
        period: s, where the excitation repeats at least twice.
        channels: further channels in SI: current (A), charge (C), force (N), temperature (K).
        source: the file's name.
        units: of input and output.
        further: ``(N,)`` inputs at further ports of the network, by the port's name.
        measures: the storage of the network that is measured; its ``output`` where empty.
        instants: ``(G,)`` when the input jumps, in sample intervals (0 to 1) behind the sample before the jump; jumps
            may share one (`phnn.recordings.excitation`). None where nothing is known: the samples do not tell.
        sensor: what is known of the sensor.
        offset: ``"own"``, the zero of the output belongs to the recording, or ``"shared"``: all have one.
        noise_found: False where the recording shows no noise; ``noise`` then only weights the fit.
        noise_interval: bounds that hold the deviation of the noise with 95 %, where one spectrum gave it.
        gain: ``"unknown"`` where the first input is known up to one factor that all recordings share.
        seen: ``(N,)`` bool, the samples at which the output was recorded, None for all. The others, where the input has
            a stamp of its own or a value was masked, carry an interpolated output and are never scored.
    """

    name: str
    t: Array
    u: Array
    y: Array
    start: Start
    interpolation: str
    parts: tuple[Part, ...] = ()
    noise: float = math.nan
    noise_source: str = ""
    noise_correlation: Array = field(default_factory=lambda: np.ones(1))
    period: float | None = None
    channels: Signals = field(default_factory=dict)
    source: str = ""
    units: Units = ACTUATOR
    further: Signals = field(default_factory=dict)
    measures: str = ""
    instants: Array | None = None
    sensor: Sensor = PLAIN
    offset: str = "own"
    noise_found: bool = True
    noise_interval: tuple[float, float] | None = None
    gain: str = "known"
    seen: Array | None = None

    @cached_property
    def clock(self) -> Array | None:
        """Return ``(N,)`` sampling instants in mean intervals; None where all intervals are equal."""
        steps = np.diff(self.t)
        even = steps.size == 0 or float(np.abs(steps - self.dt).max()) <= _ROUNDING * self.dt
        return None if even else self.t / self.dt

    @property
    def drive(self) -> Array:
        """Return ``(N,)`` what moves when any input does, see `drive_of`."""
        return drive_of(self.u, self.further)

    @cached_property
    def excitation(self) -> Excitation:
        """Return what the input does: its kind, band and period, and the samples in which it is at work."""
        return excitation_of(self.drive, self.dt)

    @property
    def cycle(self) -> int:
        """Return the samples of the fewest whole periods that are a whole number of samples; 0 where there are none."""
        if self.start.state != "periodic" or self.period is None or self.clock is not None:
            return 0
        size = self.period / self.dt
        cycles = (count * size for count in range(1, int(self.t.size / size + 1e-6) + 1))
        return next((round(cycle) for cycle in cycles if abs(cycle - round(cycle)) <= _WHOLE), 0)

    def last_periods(self, count: float) -> slice:
        """Return the samples of the last periods, with that at which the first of them begins; all samples where
        nothing repeats or fewer periods were recorded."""
        if self.period is None:
            return slice(0, self.t.size)
        return slice(max(0, self.t.size - 1 - round(count * self.period / self.dt)), self.t.size)

    def only(self, rows: slice) -> Recording:
        """Return some samples of every channel; the parts stay as they are, instants of jumps are unknown again."""
        channels, further = ({n: x[rows] for n, x in some.items()} for some in (self.channels, self.further))
        t, u, y = (x[rows] for x in (self.t, self.u, self.y))
        seen = None if self.seen is None else self.seen[rows]
        return replace(self, t=t, u=u, y=y, seen=seen, channels=channels, further=further, instants=None)

    @cached_property
    def stride(self) -> int:
        """Return the most samples, up to eight, between two of which straight lines show all inputs; 1 where inputs are
        held from sample to sample, jump within an interval, or repeat after no whole number of samples."""
        inputs = (self.u, *self.further.values())
        jumps = self.interpolation == "zero_order" or self.instants is not None or self.clock is not None
        if jumps or (self.start.state == "periodic" and not self.cycle):
            return 1
        return next(n for n in range(_STRIDE, 0, -1) if self.cycle % n == 0 and all(_follows(x, n) for x in inputs))

    @cached_property
    def sparse(self) -> Recording:
        """Return the recording at every `stride`-th sample."""
        return self if self.stride == 1 else self.only(slice(None, None, self.stride))

    def from_sparse(self, rows: Array) -> Array:
        """Return ``(N, …)`` values on straight lines between those at the samples of `sparse`; the last of them stands
        for what follows. Values at all samples are returned as they are."""
        return rows if rows.shape[0] == self.t.size else _on_lines(rows, self.stride)[: self.t.size]

    @property
    def dt(self) -> float:
        """Return the sampling interval in s, the mean where intervals differ."""
        return float(self.t[-1] - self.t[0]) / (self.t.size - 1)

    @cached_property
    def step(self) -> float:
        """Return the step of which all recorded outputs are multiples; 0 where there is none to be seen."""
        return quantisation_step(self.y if self.seen is None else self.y[self.seen])

    @property
    def colour_unseen(self) -> bool:
        """Return whether the noise floor is the level of a band, and nothing shows what the noise is outside it."""
        return AS_WHITE in self.noise_source and self.noise_interval is None

    @property
    def input_before(self) -> float:
        """Return the input before the first sample; the first sample itself where the start does not say."""
        return self.start.input_before if self.start.state == "rest" else float(self.u[0])

    def mask(self, use: str) -> Array:
        """Return ``(N,)`` bool: the samples that serve as ``use``."""
        chosen = np.zeros(self.t.size, dtype=bool)
        for part in self.parts:
            if part.use == use:
                chosen[part.first : part.last] = True
        return chosen if self.seen is None else chosen & self.seen


def _on_lines(rows: Array, stride: int) -> Array:
    """Return ``(N s, …)`` values on straight lines between rows (N, …); the last row stands for what follows."""
    share = (np.arange(stride) / stride).reshape(-1, *(1,) * (rows.ndim - 1))
    lines = rows[:-1, None] * (1.0 - share) + rows[1:, None] * share
    return np.concatenate([lines.reshape(-1, *rows.shape[1:]), np.repeat(rows[-1:], stride, axis=0)])


def _follows(x: Array, stride: int) -> bool:
    """Return whether straight lines between every ``stride``-th value follow a signal."""
    between = (x.size - 1) // stride * stride
    return bool(np.abs(_on_lines(x[::stride], stride)[: between + 1] - x[: between + 1]).max() <= _STRAIGHT * np.ptp(x))


def unrecorded(
    name: str,
    t: Array,
    u: Array,
    interpolation: str = "cubic",
    input_before: float = 0.0,
    further: Signals | None = None,
) -> Recording:
    """Return an input (N,) from rest, with ``input_before`` until its first sample, whose output nobody recorded: ``y``
    is NaN. All other arguments are those of `Recording`."""
    start, y = Start("rest", input_before), np.full(t.size, np.nan)
    return Recording(name, t, u, y, start, interpolation, noise_source="simulated", further=further or {})


def drive_of(u: Array, further: Signals) -> Array:
    """Return ``(N,)`` what moves when any input does and repeats when all do: the inputs' sum, weighted unevenly.

    With a single input it is that input. Further ones come in over their range, times that of the first.
    """
    reach, total = float(np.ptp(u)) or 1.0, u
    for k, x in enumerate(further.values(), start=1):
        span = float(np.ptp(x))
        total = total + (_GOLDEN**k * reach / span) * x if span > 0.0 else total
    return total


@dataclass(frozen=True)
class Anchor:
    """A parameter known from elsewhere, SI, with its standard deviation."""

    value: float
    std: float = 0.0
    unit: str = ""  # SI unit, where one was stated


@dataclass(frozen=True, eq=False)
class Campaign:
    """A folder of recordings, understood.

    Attributes:
        recordings: in the order of the manifest, otherwise by file name.
        setup: what was recorded, for example ``{"model": "piezo_actuator", "hysterons": 2}``.
        known: anchors by parameter name.
        voltage: ``"command"`` or ``"terminals"``.
        notes: what was understood, in sentences.
        held_out_is_new: the confirmation parts bring an amplitude or a frequency that identification lacks.
        folder: where the recordings lie, as the user calls it.
        held_out: names of the recordings that the manifest marks with ``use: confirmation``.
        in_memory: they come from objects, and ``folder`` is no path.
    """

    recordings: tuple[Recording, ...]
    setup: Mapping[str, Any]
    known: Mapping[str, Anchor]
    voltage: str
    notes: tuple[str, ...]
    held_out_is_new: bool
    folder: str
    held_out: frozenset[str] = frozenset()
    in_memory: bool = False

    def __repr__(self) -> str:
        names = listed((r.name for r in self.recordings), 4)
        return f"<Campaign {self.folder}: {len(self.recordings)} recordings ({names}); phnn.describe tells more>"

    def _repr_html_(self) -> str:
        head = ("recording", "use", "samples", "rate (Hz)", "input", "output", "noise rms")
        rows = (
            (r.name, ", ".join(dict.fromkeys(p.use for p in r.parts)), r.t.size, 1.0 / r.dt, _span(r.u, r.units.input),
             _span(r.y, r.units.output), quantity(r.noise, r.units.output) if r.noise_found else None)
            for r in self.recordings
        )  # fmt: skip
        return titled(f"Campaign {self.folder}", table(head, rows))

    @property
    def inputs(self) -> list[Path]:
        """Return the folders that results must not be written into, as they were read from."""
        return [] if self.in_memory else [Path(self.folder)]


def _span(x: Array, unit: str) -> str:
    """Return the range of a signal with its unit; empty where nothing was recorded."""
    known = x[np.isfinite(x)]
    return f"{quantity(float(known.min()), unit)} to {quantity(float(known.max()), unit)}" if known.size else ""


def is_actuator(setup: Mapping[str, Any]) -> bool:
    """Return whether a setup is the piezo actuator, with a voltage in and a displacement out."""
    return setup.get("model") in ("piezo_actuator", "hrc")


def dominant_frequency(recording: Recording) -> float:
    """Return the frequency of the strongest input line [Hz]."""
    if recording.period:
        return 1.0 / recording.period
    peak = int(np.argmax(spectrum(recording.u)[1:])) + 1
    return peak / (recording.t.size * recording.dt)


def digest(campaign: Campaign) -> str:
    """Return the SHA-256 of all that fits and scores see of the recordings: samples, uses, starts, anchors."""
    checksum = hashlib.sha256()
    for r in campaign.recordings:
        facts = (r.name, r.start, r.interpolation, r.parts, r.noise, r.period, r.units, r.measures)
        known = (r.sensor, r.offset, r.gain)
        checksum.update(repr((*facts, *known, sorted(r.channels), sorted(r.further))).encode())
        others = [values for _, values in (*sorted(r.channels.items()), *sorted(r.further.items()))]
        others += [values for values in (r.instants, r.seen) if values is not None]
        for values in (r.t, r.u, r.y, r.noise_correlation, *others):
            checksum.update(np.ascontiguousarray(values).tobytes())
    checksum.update(repr((sorted(campaign.setup.items()), sorted(campaign.known.items()))).encode())
    return checksum.hexdigest()
