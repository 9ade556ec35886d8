"""The sampling instants of a recording, from stamps as loggers write them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline

from phnn.errors import InputRefused
from phnn.recordings import checks
from phnn.recordings.table import Where
from phnn.signals.reconstruct import find_jumps

Array = np.ndarray
_NEGLIGIBLE = 1e-4  # of the interval: moving a sample by less changes nothing that a sensor could show
_LARGEST_ROUNDING = 0.05  # of the interval
# Share of the rows that may be out of order or repeated, where sorting repairs them.
_DISORDER = 0.05
# Share of the usual interval that a row which was out of order keeps to its neighbours.
_ROOM = 0.3
# An interval of more usual ones than the first is a gap, over which an input that is not held is interpolated up to the
# second; beyond it, what drove the system is not known.
_GAP, _BRIDGED = 1.5, 12.0
# A channel is held between stamps of its own: their interval in rows, the share of the changes that fall on a raster,
# the share of its stamps that change it, and by how much of the raster a stamp may miss it.
_SLOWER, _ON_RASTER, _CHANGING, _OFF = 1.5, 0.95, 0.5, 0.05
# Levels of an input that is held on purpose; share of the changes of an encoder that are of one step.
_LEVELS, _ONE_STEP = 8, 0.5


@dataclass(frozen=True, eq=False)
class Stamped:
    """Channels at their sampling instants, in order.

    Attributes:
        t: (N,) sampling instants from 0 on, s; uniform where the stamps are, but for rounding.
        values: (N,) SI values by channel; rows: (N,) of the file, from its first one in use.
        notes: what was repaired or assumed.
    """

    t: Array
    values: dict[str, Array]
    rows: Array
    notes: tuple[str, ...] = ()


def stamped(t: Array, resolution: float, channels: Mapping[str, Array], where: Where, held: bool = False) -> Stamped:
    """Return the channels at their sampling instants, in order.

    Args:
        t: (N,) stamps, s; resolution: seconds per unit of the file's time column.
        channels: (N,) SI values.
        where: for messages.
        held: the inputs are held between rows, so that an interval may have any length.
    """
    if t.size % 2 == 0 and t.size > 2 and np.array_equal(t[::2], t[1::2]) and (np.diff(t[::2]) > 0.0).all():
        # An oscilloscope keeps the extremes of every interval.
        means = {name: 0.5 * (values[::2] + values[1::2]) for name, values in channels.items()}
        one = stamped(t[::2], resolution, means, where, held)
        pairs = "two rows with every time, least and largest value: their means are taken"
        return Stamped(one.t, one.values, 2 * one.rows, (pairs, *one.notes))
    t, rows, notes = _in_order(t, channels, where)
    values = {name: x[rows] for name, x in channels.items()}
    steps = np.diff(t)
    usual = float(np.median(steps))
    checks.interval(usual, where)
    gap = np.flatnonzero(steps > _GAP * usual)
    unknown = gap[steps[gap] > _BRIDGED * usual]
    if unknown.size and not held:
        first = int(unknown[0])
        raise InputRefused(
            f"{where}: time, {where.row(int(rows[first + 1]))}: a gap of {steps[first]:.6g} s where samples are "
            f"{usual:.6g} s apart: split the file there, or in recordings.yaml say `segments: true`, take one side of "
            f"it with `slice`, or say `input: zero_order` where the input was held"
        )
    if gap.size:
        how = "held" if held else "interpolated"
        notes += (
            f"{gap.size} intervals are longer than the usual {usual:.4g} s, up to {steps[gap].max():.4g} s, the first "
            f"before {where.row(int(rows[gap[0] + 1]))}: the input is {how} there",
        )
    k = np.arange(t.size)
    dt, start = (float(c) for c in np.polyfit(k, t - t[0], 1))
    largest = float(np.abs(t - t[0] - (start + dt * k)).max())
    if largest <= _NEGLIGIBLE * dt:
        return Stamped(dt * k, values, rows, notes)
    printed = _printed_resolution(t / resolution) * resolution
    if largest <= min(0.6 * printed, _LARGEST_ROUNDING * dt):
        notes += (f"times are rounded to {printed:.3g} s; taken as a uniform grid of {dt:.9g} s",)
        return Stamped(dt * k, values, rows, notes)
    said = f"sampling jitters by up to {largest / dt:.2%} of the interval"
    if largest > dt:
        said = f"intervals of {steps.min():.4g} to {steps.max():.4g} s"
    notes += (f"{said}; each sample keeps its own instant",)
    return Stamped(t - t[0], values, rows, notes)


def _in_order(t: Array, channels: Mapping[str, Array], where: Where) -> tuple[Array, Array, tuple[str, ...]]:
    """Return stamps in ascending order, the rows that they come from, and what was repaired."""
    steps = np.diff(t)
    if (steps > 0.0).all():
        return t, np.arange(t.size), ()
    usual, back = float(np.median(np.abs(steps))), np.flatnonzero(steps < 0.0)
    far = back.size > 0 and (back.size > _DISORDER * t.size or float(-steps.min()) > _BRIDGED * usual)
    order = np.arange(t.size) if far else np.argsort(t, kind="stable")
    if back.size and not far:
        # A row that was written late leaves room for itself; a time that is wrong comes close to another.
        moved = np.flatnonzero(order != np.arange(t.size))
        close = np.diff(t[order])[np.clip([moved - 1, moved], 0, t.size - 2)]
        far = bool((close[close > 0.0] < _ROOM * usual).any())
        order = np.arange(t.size) if far else order
    again = np.flatnonzero(np.diff(t[order]) == 0.0) + 1
    same = all(np.array_equal(x[order[again]], x[order[again - 1]]) for x in channels.values())
    if far or not same or again.size > _DISORDER * t.size:
        checks.time_advances(t if far else t[order], where, None if far else order)
    notes = []
    if back.size:
        notes.append(f"{back.size} times go back, the first at {where.row(int(back[0]) + 1)}: rows sorted by time")
    if again.size:
        row = where.row(int(order[again[0]]))
        notes.append(f"{again.size} rows repeat the one before them, the first at {row}: taken once")
    rows = np.delete(order, again)
    return t[rows], rows, tuple(notes)


def own_rows(t: Array, x: Array, drive: Array | None = None) -> Array | None:
    """Return (N,) bool, the rows at which a channel was sampled; None where that may be all.

    A channel that another rate was recorded beside, or that a data base delivers more slowly than it stores, repeats
    its last value in between: its changes lie on a raster of several rows.

    Args:
        t: (N,) instants; x: (N,) values.
        drive: (N,) an input on few levels whose changes explain those of the channel.
    """
    changed = np.flatnonzero(np.diff(x)) + 1
    if changed.size < checks.FEWEST_SAMPLES or changed.size > x.size / _SLOWER + 1:
        return None
    sizes = np.abs(np.diff(x)[changed - 1])
    if np.mean(sizes <= 1.0001 * sizes.min()) > _ONE_STEP:
        return None
    if drive is not None and np.unique(drive).size <= _LEVELS and np.mean(np.diff(drive)[changed - 1] != 0.0) > 0.9:
        return None
    steps = np.diff(t[changed])
    raster = float(np.median(steps))
    if raster < _SLOWER * float(np.median(np.diff(t))):
        return None
    whole = np.rint(steps / raster)
    raster = float(steps.sum() / max(whole.sum(), 1.0))
    on = (whole >= 1.0) & (np.abs(steps - whole * raster) <= _OFF * raster)
    if on.mean() < _ON_RASTER or changed.size < _CHANGING * (t[-1] - t[0]) / raster:
        return None
    since = (t - t[changed[0]]) / raster
    slot = np.rint(since)
    off = np.abs(since - slot)
    own = np.zeros(x.size, dtype=bool)
    # Of several rows near an instant of the raster, the first that has the new value.
    own[changed[np.append(True, on)]] = True
    missing = np.flatnonzero((off <= _OFF) & ~np.isin(slot, slot[own]))
    own[missing[np.unique(slot[missing], return_index=True)[1]]] = True
    return own


def interpolated(t: Array, values: Array, at: Array) -> Array:
    """Return a channel at other instants; where it jumps, free of overshoot. Its ends are continued as constants."""
    at = np.clip(at, t[0], t[-1])
    if find_jumps(values).size:
        return np.asarray(PchipInterpolator(t, values)(at))
    return np.asarray(make_interp_spline(t, values, k=3)(at))


def evenly(t: Array, values: Array) -> tuple[float, Array]:
    """Return an interval and a channel on a uniform grid with as many samples."""
    dt = float(t[-1] - t[0]) / (t.size - 1)
    if np.abs(t - t[0] - dt * np.arange(t.size)).max() <= _NEGLIGIBLE * dt:
        return dt, values
    return dt, interpolated(t, values, t[0] + dt * np.arange(t.size))


def merged(
    channels: Mapping[str, tuple[Array, Array]], where: Where
) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    """Return the instants of channels with clocks of their own, their values there, and which instants are theirs.

    Args:
        channels: (n,) absolute times [s] and values by name.
    """
    first, last = max(t[0] for t, _ in channels.values()), min(t[-1] for t, _ in channels.values())
    least = min(float(np.median(np.diff(t))) for t, _ in channels.values() if t.size > 1)
    if not first < last:
        said = "; ".join(f"{name} from {t[0]:.6f} s to {t[-1]:.6f} s" for name, (t, _) in channels.items())
        raise InputRefused(f"{where}: the clocks of the channels do not overlap ({said}): export one recording")
    slack = 1e-3 * least
    every = np.sort(np.concatenate([t[(t >= first - slack) & (t <= last + slack)] for t, _ in channels.values()]))
    every = every[np.append(True, np.diff(every) > slack)]
    values, own = {}, {}
    for name, (t, x) in channels.items():
        near = np.clip(np.searchsorted(t, every - slack), 0, t.size - 1)
        own[name] = np.abs(t[near] - every) <= 2.0 * slack
        values[name] = x[near] if own[name].all() else np.where(own[name], x[near], interpolated(t, x, every))
    return every, values, own


def _printed_resolution(numbers: Array) -> float:
    """Return the place value of the last digit with which numbers were written; 0 where they use full precision."""
    for digits in range(13):
        scaled = numbers * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6 + 4.0 * np.spacing(np.abs(scaled))):
            return float(10.0**-digits)
    return 0.0
