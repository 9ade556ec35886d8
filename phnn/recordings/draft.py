"""From a table of columns to recordings on a uniform grid in SI units, each with its noise floor."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phnn.errors import InputRefused
from phnn.parameters import quantity
from phnn.recordings import checks
from phnn.recordings.channels import BRIDGED, Channel, evenly, interpolated, own_rows, select, stamped
from phnn.recordings.excitation import Excitation, excitation_of
from phnn.recordings.manifest import Column, Entry, Manifest, check_unit_of_limits
from phnn.recordings.recording import ACTUATOR, Recording, Sensor, Start, Units, drive_of, is_actuator
from phnn.recordings.table import Table, Where
from phnn.results import listed, printable
from phnn.signals.noise import FROM_PERIODS, WHITE, NoiseFloor, noise_floor
from phnn.signals.sampling import longest_run, quantisation_step, runs

Channels = Mapping[str, Channel]
# Where two steps of time differ by more than this factor, the rate changes.
_JUMP = 1.5


def segmented(entry: Entry, channels: Channels, table: Table) -> tuple[list[Entry], tuple[str, ...]]:
    """Return an entry for every recording in its file, each with its slice and, where there are several, a number; and
    a note on those between jumps of time that are too short.

    The slice of an array with axes is taken of every realisation.
    """
    size, where = next(iter(channels.values())).values.size, table.where
    one = size // table.shape[0] if table.shape else size
    first, last = entry.slice or (0, one)
    if last > one:
        cause = f"slice {[where.offset + first, where.offset + last]} reaches beyond the file: {one} samples lie in it"
        raise InputRefused(f"{where}: {cause}: correct it in recordings.yaml")
    pieces = [(i + first, i + last) for i in range(0, max(size, 1), max(one, 1))]
    counted = entry.segments is not False and not table.shape
    if counted or table.segments:
        inner = _edges(entry, channels, first, last, where) if counted else table.segments
        pieces = list(itertools.pairwise([first, *(row for row in inner if first < row < last), last]))
    if len(pieces) == 1 and not counted:
        return [replace(entry, slice=pieces[0])], ()
    notes: tuple[str, ...] = ()
    short = [piece for piece in pieces if piece[1] - piece[0] < checks.FEWEST_SAMPLES]
    if entry.segments is True and 0 < len(short) < len(pieces):
        pieces = [piece for piece in pieces if piece not in short]
        ends = listed(f"{where.row(a)} to {where.row(b - 1)}" for a, b in short)
        notes = (f"{len(short)} segments of fewer than {checks.FEWEST_SAMPLES} samples were left out: {ends}",)
    stem, digits = entry.name or printable(Path(entry.files[0]).stem), len(str(len(pieces)))
    named = [replace(entry, slice=piece, name=f"{stem}_{i:0{digits}d}") for i, piece in enumerate(pieces, start=1)]
    return named, notes


def _edges(entry: Entry, channels: Channels, first: int, last: int, where: Where) -> Sequence[int]:
    """Return where the second segment and every further one begins."""
    if entry.segments is not True:
        if (last - first) % entry.segments:
            cause = f"{last - first} samples are no whole number of segments of {entry.segments}"
            remedy = "correct `segments` in recordings.yaml, or cut the rest off with `slice`"
            raise InputRefused(f"{where}: {cause}: {remedy}")
        return range(first + entry.segments, last, entry.segments)
    if "time" not in channels:
        cause = "no time column to tell segments by"
        raise InputRefused(f"{where}: {cause}: write the number of samples of each, segments: 8192")
    steps = np.diff(channels["time"].values[first:last])
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    return (np.flatnonzero((steps < 0.0) | (steps > BRIDGED * usual)) + first + 1).tolist()


LARGEST_CLIPPED_SHARE = 0.02
SHORTEST_CLIPPED_RUN = 5


def not_clipped(u: np.ndarray, y: np.ndarray, label: str, factor: float, where: Where, sensor: Sensor) -> None:
    """Refuse an output stuck at its exact extreme while the input moves on (a sensor out of range).

    A run counts where it is 5 samples or longer, where the input moves during it, and where a parabola through
    the samples on both sides of it passes well beyond the extreme: a resolved reversal that the sensor merely
    quantises does not. A play, which comes to its plateau gently and leaves it steeply, is no clipping either, nor is
    dry friction, to whose rest the motion slows down and from which it begins more slowly still.
    ``factor`` turns the file's numbers into SI. Samples at a stated limit of the sensor are data.
    """
    step = quantisation_step(y)
    known = sensor.at_limit(y)
    for extreme, name in ((float(y.max()), "largest"), (float(y.min()), "smallest")):
        if known[y == extreme].any():
            continue
        clipped = [run for run in runs(y == extreme) if _is_clipped(u, y, run.start, run.stop, step)]
        stuck = sum(run.stop - run.start for run in clipped)
        if stuck > LARGEST_CLIPPED_SHARE * y.size:
            raise InputRefused(
                f"{where}: {label}, {where.row(clipped[0].start)}: clipped, {stuck} samples ({stuck / y.size:.1%}) sit "
                f"exactly at the {name} value {extreme / factor:.6g} while the input moves on: record again within the "
                f"sensor's range, or say in recordings.yaml where it ends, sensor: {{saturates: [LEAST, LARGEST]}}"
            )


def _is_clipped(u: np.ndarray, y: np.ndarray, first: int, last: int, step: float) -> bool:
    side, reach = max(4, (last - first) // 2), float(np.ptp(y))
    if last - first < SHORTEST_CLIPPED_RUN or first < side or last + side > y.size:
        return False  # too short, or nothing on one side to judge by
    least = max(3.0 * step, 5e-4 * reach)
    inside = u[first:last]
    share = float(np.quantile(inside, 0.9) - np.quantile(inside, 0.1)) / max(float(np.ptp(u)), 1e-300)
    near = max(4, side // 4)
    arrival, departure = abs(y[first] - y[first - near]), abs(y[last + near - 1] - y[last - 1])
    if share * reach < least or arrival < 0.4 * departure:
        return False
    # Of the way beside the run, a truncated parabola makes (2f + f²)/3 in the share f next to it; a motion that slows
    # down to its rest or begins from it f², and a little more where steps of the sensor are coarse.
    quarter, before, after = max(side // 4, 1), max(first - 1, side), min(last, y.size - 1 - side)
    gentle = 0.8 * (2.0 + quarter / side) * (quarter / side) / 3.0
    parts, wholes = ((abs(y[before] - y[before - n]), abs(y[after + n] - y[after])) for n in (quarter, side))
    if all(part < gentle * whole for part, whole in zip(parts, wholes, strict=True)):
        return False
    k = np.r_[first - side : first, last : last + side]
    middle = 0.5 * (first + last - 1)
    parabola = np.polyfit(k - middle, y[k], 2)
    overshoot = np.abs(np.polyval(parabola, np.arange(first, last) - middle) - y[first])
    return float(overshoot.max()) > least


FURTHER = ("current", "charge", "force", "temperature")
_NEAR_ZERO = 0.01  # of the input's range
# Share of the rows that are stamps of one channel where two rasters were merged; by how much a stated rate may miss.
_ALL, _RATE = 0.9, 0.01
# (N,) by channel.
_Values = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Draft:
    """A recording that has not been given its parts yet."""

    recording: Recording
    floor: NoiseFloor  # of its output, which the recording takes when all are compared
    excitation: Excitation
    use: str | None  # that the manifest demands
    columns: str  # what was understood as what, in words
    notes: tuple[str, ...]


def drafts_of(entry: Entry, table: Table, manifest: Manifest, need_output: bool, home: Path) -> list[Draft]:
    """Return the recordings of a table, one for each segment and for each of several outputs.

    ``entry`` is what is said about the table, ``manifest`` about all; ``home``, where it comes from, is for messages.
    """
    named = {n: ("input", c) for n, c in entry.ports.items()} | {n: ("output", c) for n, c in entry.outputs.items()}
    if entry.slice is not None and not table.shape:
        # Rows outside are not looked at.
        table, entry = table.only(*entry.slice), replace(entry, slice=(0, entry.slice[1] - entry.slice[0]))
    channels, unusable = select(table, entry.columns, named)
    u_name, y_names = _roles(entry, channels, is_actuator(manifest.setup), table, need_output)
    pieces, short = segmented(entry, channels, table)
    size = next(iter(channels.values())).values.size
    # The channels have copies of what is needed.
    table = replace(table, columns=(), notes=(*table.notes, *unusable, *short))
    checks.not_too_many(len(pieces) * len(y_names), size * len(y_names), home)
    return [_draft(piece, table, channels, (u_name, y_name), manifest) for piece in pieces for y_name in y_names]


def _draft(entry: Entry, table: Table, channels: Channels, roles: tuple[str, str | None], manifest: Manifest) -> Draft:
    u_name, y_name = roles
    name = entry.name or printable(Path(entry.files[0]).stem)
    t, values, sampled, where, notes = _sampled(entry, table, channels)
    if t.size > _LONG:
        t, values, note = (t, values, "") if sampled else _shortened(entry, t, values, roles)
        times = t.size // _ENOUGH
        notes.append(note or f"all samples are needed: a fit takes {times} times as long as of {_ENOUGH}; see `slice`")
    if y_name is not None:
        notes += _as_sampled(t, values, sampled, u_name, y_name, channels, entry.input == "zero_order")
    u = values[u_name]
    y = values[y_name] if y_name is not None else np.full(u.size, np.nan)
    ports = {port: values[port] for port in entry.ports}
    drive = drive_of(u, ports)
    near_zero = all(abs(float(x[0])) <= _NEAR_ZERO * float(np.ptp(x)) for x in (u, *ports.values()))
    start = entry.start or Start("rest" if near_zero else "unknown")
    if entry.start is not None and start.state == "rest":
        channel = channels[u_name]
        start = replace(start, input_before=channel.factor * start.input_before + channel.offset)
    before = start.input_before if start.state == "rest" else None
    if y_name is not None:
        if entry.start is None or start.state != "unknown":
            # What is said to have begun before the first sample may go on under a constant input.
            checks.input_moves(drive, before, f"{u_name} ({channels[u_name].label})", where)
        label = f"{y_name} ({channels[y_name].label})"
        checks.output_moves(y, label, where)
        check_unit_of_limits(entry.sensor, channels[y_name].si, label, where)
        not_clipped(drive, y, label, channels[y_name].factor, where, entry.sensor)
        if is_actuator(manifest.setup):
            checks.like_an_actuator(float(np.ptp(y)), "displacement", channels[y_name].label, where)
    largest = max(float(np.abs(u).max()), abs(before or 0.0))
    if is_actuator(manifest.setup) and (largest > 0.0 or start.state != "unknown"):
        # Under no voltage what began before the first sample may go on, as it may under a constant one.
        checks.like_an_actuator(largest, "voltage", channels[u_name].label, where)
    measures = y_name if y_name in entry.outputs else None
    recording = Recording(
        name=name if measures is None else f"{name}.{measures}", t=t, u=u, y=y, start=start,
        interpolation=entry.input or "cubic", source=printable(", ".join(entry.files)),
        channels={q: values[q] for q in FURTHER if q in values and q != u_name},
        units=Units(channels[u_name].si, channels[y_name].si if y_name is not None else ACTUATOR.output),
        further=ports, measures=measures or "", sensor=entry.sensor, offset=entry.offset,
        gain=entry.columns.get(u_name, Column()).gain, seen=sampled.get(y_name or ""),
    )  # fmt: skip
    excitation = _excitation(recording, entry, table, where)
    unseen = NoiseFloor(float("nan"), "no output recorded", WHITE)
    floor = _noise(recording, excitation) if np.isfinite(y).all() else unseen
    recording = replace(recording, period=excitation.period)
    what = ", ".join(f"{q} from {c.label} in {c.unit}" for q, c in channels.items())
    labels = {channel.label for channel in channels.values()}
    spare = [n for i, n in enumerate(table.names) if n and table.label(i) not in labels]
    if spare and not table.by_name:
        notes.append(f"columns not used: {', '.join(spare)}")
    notes += [note for q in (*roles, *ports) if q is not None for note in channels[q].notes]
    sentences = tuple(f"{recording.name}: {n}." for n in (*notes, *table.notes))
    return Draft(recording, floor, excitation, entry.use, what, sentences)


# Different steps of a clock that is coarse beside the rows, and by what share of an interval it is off then.
_TICKS, _COARSE = 3, 0.05
# Samples from which on a recording is thinned and cut, and to which; what thinning may change of an input, in shares of
# its range, and of an output, over what it changes if every second sample stays, for that is noise.
_LONG, _ENOUGH = 200_000, 50_000
_INPUT_CHANGES, _OUTPUT_CHANGES = 1e-3, 1.3
# What first samples must have of the whole input: this share of its range, and at least half its share of the power in
# every octave of frequency with at least a hundredth of it.
_OF_RANGE, _OF_POWER, _LEAST_POWER = 0.8, 2.0, 0.01


def _shortened(
    entry: Entry, t: np.ndarray, values: _Values, roles: tuple[str, str | None]
) -> tuple[np.ndarray, _Values, str]:
    """Return the samples that tell the others, from the first one on, and what was done; empty where all are needed."""
    stride, notes = _stride(t, values, roles), []
    kept, channels = t[::stride], {q: x[::stride] for q, x in values.items()}
    if stride > 1:
        notes.append(f"of {t.size} samples one in {stride} is used: what lies between follows from these")
    if kept.size > _LONG:
        size = _first(drive_of(channels[roles[0]], {port: channels[port] for port in entry.ports}))
        if size < kept.size:
            kept, channels = kept[:size], {q: x[:size] for q, x in channels.items()}
            ends = f"the first {quantity(kept[-1] - kept[0], 's')} of {quantity(t[-1] - t[0], 's')} are used"
            notes.append(f"{ends}: the input has no other amplitudes and frequencies later; `slice` takes other rows")
    return kept, channels, "; ".join(notes)


def _first(u: np.ndarray) -> int:
    """Return how many first samples of an input have all its amplitudes and frequencies: ``_ENOUGH`` times 2ⁿ."""
    whole, size = _power_of_octaves(u), _ENOUGH
    needed = np.where(whole >= _LEAST_POWER, whole / _OF_POWER, 0.0)
    while size < u.size:
        octaves = _power_of_octaves(u[:size])
        lasting = np.pad(octaves, (0, whole.size - octaves.size))
        if np.ptp(u[:size]) >= _OF_RANGE * np.ptp(u) and np.all(lasting >= needed):
            return size
        size *= 2
    return u.size


def _power_of_octaves(u: np.ndarray) -> np.ndarray:
    """Return the share of a signal's power in each octave of frequency, from half the sampling rate down."""
    power = np.abs(np.fft.rfft(u - u.mean()))[1:] ** 2
    frequency = np.arange(1, power.size + 1) / u.size
    return np.bincount(np.floor(-np.log2(frequency)).astype(int), power) / max(power.sum(), 1e-300)


def _stride(t: np.ndarray, values: Mapping[str, np.ndarray], roles: tuple[str, str | None]) -> int:
    """Return the largest n of which every n-th sample tells what lies between; 1 where none does."""

    def changes(x: np.ndarray, stride: int) -> float:
        kept = t[::stride]
        inside = slice(0, (kept.size - 1) * stride)
        return float(np.sqrt(np.mean((interpolated(kept, x[::stride], t[inside]) - x[inside]) ** 2)))

    u, y = values[roles[0]], values[roles[1]] if roles[1] is not None else values[roles[0]]
    most = _OUTPUT_CHANGES * changes(y, 2) + 1e-5 * float(np.ptp(y))
    stride = t.size // _ENOUGH
    while stride > 1:
        if changes(u, stride) <= _INPUT_CHANGES * float(np.ptp(u)) and changes(y, stride) <= most:
            return stride
        stride = stride * 3 // 4
    return 1


def _as_sampled(
    t: np.ndarray, values: _Values, sampled: _Values, u_name: str, y_name: str, channels: Channels, held: bool
) -> list[str]:
    """Take input and output where they repeat values at their own instants alone, in place; return what was done.

    ``sampled`` tells of a channel at which rows (N,) it was; a ``held`` input stays where it is between its changes.
    """
    u, y = values[u_name], values[y_name]
    mine = own_rows(t, y, u) if y_name not in sampled else None
    if mine is None:
        return []
    notes = []
    theirs = own_rows(t, u) if u_name not in sampled else None
    if theirs is not None and (mine | theirs).mean() > _ALL and not held:
        # Two rasters on the union of their stamps.
        values[u_name] = interpolated(t[theirs], u[theirs], t)
        notes.append(f"{u_name} ({channels[u_name].label}) repeats values: taken at its own {theirs.sum()} stamps")
    sampled[y_name], values[y_name] = mine, interpolated(t[mine], y[mine], t)
    every = np.median(np.diff(np.flatnonzero(mine)))
    changes = f"changes only once in {every:.3g} rows: taken at these {mine.sum()} rows"
    return [*notes, f"{y_name} ({channels[y_name].label}) {changes}"]


def _noise(recording: Recording, excitation: Excitation) -> NoiseFloor:
    """Return the noise floor of an output; where a sensor saturates, samples at the limit carry no noise."""
    t, y, drive, seen = recording.t, recording.y, recording.drive, recording.seen
    dt, period, span = recording.dt, excitation.period, excitation.span
    if seen is not None or recording.clock is not None:
        # Of samples that were taken; interpolated ones have less noise.
        rows = np.arange(t.size) if seen is None else np.flatnonzero(seen)
        rows = rows[_longest_even(t[rows])]
        (dt, y), (_, drive), period, span = evenly(t[rows], y[rows]), evenly(t[rows], drive[rows]), None, (0, rows.size)
    stuck = recording.sensor.at_limit(y) != 0
    floor = noise_floor(drive, y, dt, period, span, recording.start.state == "periodic")
    if not stuck.any():
        return floor
    free = longest_run(~stuck)
    if not floor.source.startswith(FROM_PERIODS) and free.stop - free.start >= checks.FEWEST_SAMPLES:
        return noise_floor(drive[free], y[free], dt)
    return replace(floor, value=floor.value / max(1.0 - float(stuck.mean()), 1.0 / y.size) ** 0.5)


def _longest_even(t: np.ndarray) -> np.ndarray:
    """Return the rows of the longest stretch with one rate; all rows where every such stretch is short."""
    steps, every = np.diff(t), np.arange(t.size)
    edges = np.flatnonzero(np.abs(np.log(steps[1:] / steps[:-1])) > np.log(_JUMP)) + 1
    rows = max(np.split(every, edges), key=len)
    return rows if rows.size >= max(checks.FEWEST_SAMPLES, 0.1 * t.size) else every


def _roles(entry: Entry, channels: Channels, actuator: bool, table: Table, need: bool) -> tuple[str, list[str | None]]:
    """Return which channels are the first input and the outputs. A force drives only what is no piezo actuator."""
    inputs = [q for q in (["voltage"] if actuator else ["input", "voltage", "force"]) if q in channels]
    asked = list(entry.outputs) or (["displacement"] if actuator else ["output", "displacement"])
    outputs: list[str | None] = [q for q in asked if q in channels]
    if not inputs or (need and not outputs):
        raise checks.absent("displacement" if inputs else "voltage", table.names, table.where)
    return inputs[0], (outputs if entry.outputs else outputs[:1]) or [None]


def _sampled(entry: Entry, table: Table, channels: Channels) -> tuple[np.ndarray, _Values, _Values, Where, list[str]]:
    """Return the instants and the channels, cut to the slice, at which rows each was sampled, and notes."""
    assert entry.slice is not None
    first, last = entry.slice
    where = replace(table.where, offset=table.where.offset + first)
    values = {q: c.values[first:last] for q, c in channels.items() if q != "time"}
    sampled = {q: c.sampled[first:last] for q, c in channels.items() if c.sampled is not None}
    checks.enough_samples(last - first, where)
    time, rate = channels.get("time"), entry.sample_rate_hz
    if time is None or (rate is not None and _is_coarse(time.values[first:last], rate)):
        if rate is None:
            raise checks.absent("time", table.names, table.where)
        dt = 1.0 / rate
        checks.interval(dt, table.where)
        notes = [f"times are coarser than the rows: taken at the {rate:g} Hz of recordings.yaml"] if time else []
        return dt * np.arange(last - first), values, sampled, where, notes
    series = stamped(time.values[first:last], time.factor, values, where, entry.input == "zero_order")
    checks.enough_samples(series.t.size, where)
    interval = float(np.median(np.diff(series.t)))
    # Where channels have clocks of their own, their union has uneven intervals.
    notes = [] if table.sampled else list(series.notes)
    if rate is not None and abs(rate * interval - 1.0) > _RATE:
        apart = f"{interval:.6g} s apart ({1 / interval:.6g} Hz)"
        notes.append(f"sample_rate_hz {rate:g} is not used: the times are {apart}")
    sampled = {q: x[series.rows] for q, x in sampled.items()}
    if entry.input != "zero_order" and not table.sampled:
        # The rows of a file may lie unevenly in time.
        again = {q: interpolated(series.t[x], series.values[q][x], series.t) for q, x in sampled.items() if not x.all()}
        series = series._replace(values=series.values | again)
    return series.t, series.values, sampled, where, notes


def _is_coarse(t: np.ndarray, rate: float) -> bool:
    """Return whether stamps on a raster that is coarse beside a rate [Hz] lie where it says, up to this raster."""
    steps = np.diff(t)
    if not np.isfinite(steps).all() or np.unique(np.round(steps * rate, 6)).size > _TICKS:
        return False
    off = float(np.abs(t - t[0] - np.arange(t.size) / rate).max())
    return _COARSE / rate < off <= float(steps.max())


def _excitation(recording: Recording, entry: Entry, table: Table, where: Where) -> Excitation:
    dt, drive = evenly(recording.t, recording.drive)
    excitation = excitation_of(drive, dt)
    if entry.periodic is False and excitation.period is not None:
        return replace(excitation, period=None)
    if excitation.period is None and table.shape and drive.size >= table.shape[-1]:
        return replace(excitation, period=table.shape[-1] * dt, cycles=drive.size / table.shape[-1])
    if entry.periodic and excitation.period is None:
        cause = "recordings.yaml says periodic: true, but the input does not repeat (two whole periods are needed)"
        raise InputRefused(f"{where}: {cause}: correct it, or leave `periodic` out")
    return excitation
