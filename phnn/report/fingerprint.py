"""The fingerprint of an effect in the data: what a model leaves against the variable on which the effect acts.

The variable follows from the location and kind of the effect: that of the generic functions there
(`phnn.diagnose.locations`), the time after a step for slow relaxation, or the frequency where
nothing else is its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.locations import GROUPS
from phnn.diagnose.words import vocabulary_of
from phnn.effects import Effect
from phnn.effects.kinds import AFTER_A_STEP, ELAPSED
from phnn.report.evidence import Fingerprint
from phnn.report.formatting import display_unit
from phnn.trajectory import Trajectory

Array = NDArray[np.float64]

_BINS, _DECADES = 24, 18
# Fewest visits of a bin whose spread is to be believed; a change of the input over its range that is a step.
_VISITS, _STEP = 3, 0.2
_FREQUENCY = "frequency"


@dataclass(frozen=True)
class _Samples:
    """(N,) a variable and residuals over a recording; samples without a variable have NaN."""

    x: Array
    before: Array
    after: Array
    noise: float


def fingerprint(diagnosis: Diagnosis, effect: Effect) -> Fingerprint | None:
    """What the base and the final model leave, over the identification recordings; None where too little is seen."""
    variable = variable_of(effect)
    if variable == _FREQUENCY:
        return _over_frequency(diagnosis)
    found = [_samples(diagnosis, t, variable) for t in diagnosis.linearised[1].trajectories]
    picture = _over_variable(found, variable, diagnosis)
    # Without a hold there is no time after a step: the memory shows over frequency.
    return _over_frequency(diagnosis) if picture is None else picture


def variable_of(effect: Effect) -> str:
    """Name of the variable on which an effect acts."""
    axes = {g.kind: g.axis.partition(" [")[0] for g in GROUPS if g.axis}
    found = axes.get(effect.kind) or effect.kind.axis or _FREQUENCY
    # What an amplifier delays is over within samples of a step.
    return _FREQUENCY if effect.location == "amplifier" and found == AFTER_A_STEP else found


def _samples(diagnosis: Diagnosis, trajectory: Trajectory, variable: str) -> _Samples:
    r = trajectory.recording
    mask = r.mask("identification")
    steps = np.minimum(trajectory.nodes[trajectory.lead :], trajectory.h.size - 1)
    sign = np.ones(r.t.size)
    if variable == AFTER_A_STEP:
        x, sign = since_a_step(r.t, r.u)
    else:
        lengths, speeds = (1e6, 1e3) if vocabulary_of(trajectory.setup.network).mechanical else (1.0, 1.0)
        x = {
            "displacement": lengths * trajectory.mid_displacement[steps],
            "velocity": speeds * trajectory.velocity[steps],
            "voltage": r.u,
            ELAPSED: r.t,
        }[variable]
    before, after = (sign * (r.y - e.outputs[r.name]) for e in (diagnosis.before, diagnosis.after))
    return _Samples(x[mask], before[mask], after[mask], r.noise)


def since_a_step(t: Array, u: Array) -> tuple[Array, Array]:
    """(N,) time since the input last jumped, NaN where it has not or has moved since; and the sign of that jump."""
    change = np.diff(u, prepend=u[:1])
    reach = float(np.ptp(u)) or 1.0
    jumps = np.abs(change) > _STEP * reach
    last = np.maximum.accumulate(np.where(jumps, np.arange(t.size), -1))
    held = (last >= 0) & (np.abs(u - u[np.maximum(last, 0)]) < 0.01 * reach) & ~jumps
    return np.where(held, t - t[np.maximum(last, 0)], np.nan), np.sign(change[np.maximum(last, 0)])


def _over_variable(samples: list[_Samples], variable: str, diagnosis: Diagnosis) -> Fingerprint | None:
    x = np.concatenate([s.x for s in samples])
    logarithmic = variable == AFTER_A_STEP
    usable = np.isfinite(x) & ((x > 0.0) if logarithmic else True)
    if usable.sum() < _BINS or np.ptp(x[usable]) == 0.0:
        return None
    low, high = float(x[usable].min()), float(x[usable].max())
    edges = np.geomspace(low, high, _DECADES + 1) if logarithmic else np.linspace(low, high, _BINS + 1)
    # A visit ends with its recording: bins of one are numbered apart from those of the next.
    place = np.where(usable, np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2), -1)
    owner = np.repeat(np.arange(len(samples)), [s.x.size for s in samples])
    before, after = (np.concatenate([getattr(s, n) for s in samples]) for n in ("before", "after"))
    (b, b_std), (a, a_std) = (binned(y, place, owner, edges.size - 1, logarithmic) for y in (before, after))
    kept = np.isfinite(b) & np.isfinite(b_std)
    if kept.sum() < 3:
        return None
    units = diagnosis.campaign.recordings[0].units
    unit = display_unit(float(np.abs(b[kept]).max()), units.output)
    middles = np.sqrt(edges[1:] * edges[:-1]) if logarithmic else 0.5 * (edges[1:] + edges[:-1])
    own = vocabulary_of(diagnosis.base.setup.network)
    small = ("µm", "mm/s") if own.mechanical else (own.output_unit, own.rate_unit)
    labels = {
        "displacement": f"{own.output} ({small[0]})",
        "velocity": f"{own.rate} ({small[1]})",
        "voltage": f"{own.source} ({units.input})",
    }
    sizes = [v[kept] / unit.scale for v in (b, b_std, a, a_std)]
    shown = "residual, in the direction of the step" if logarithmic else "residual"
    return Fingerprint(
        middles[kept], sizes[0], sizes[1], sizes[2], sizes[3], labels.get(variable, f"{variable} (s)"),
        f"{shown} ({unit.name})", logarithmic, 0.0,
    )  # fmt: skip


def binned(y: Array, place: NDArray[np.intp], owner: NDArray[np.intp], bins: int, single: bool) -> tuple[Array, Array]:
    """(B,) means over bins, and their standard errors from the spread between visits: samples of one visit follow each
    other, and are no repetitions. NaN where a bin was visited too seldom.

    Args:
        place: (N,) bin of every sample, −1 for none; owner: (N,) its recording.
        single: bins are visited once a recording, so that samples have to stand for repetitions.
    """
    starts = np.flatnonzero(np.diff(place, prepend=-2) | np.diff(owner, prepend=-1))
    if single:
        starts = np.arange(place.size)
    sizes = np.diff(np.append(starts, place.size))
    sums, at = np.add.reduceat(y, starts), place[starts]
    sums, sizes, at = sums[at >= 0], sizes[at >= 0], at[at >= 0]
    count, total = np.bincount(at, sizes, bins), np.bincount(at, sums, bins)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count
        visits = np.bincount(at, minlength=bins)
        # Of a ratio of sums: visits of all lengths.
        rest = np.bincount(at, (sums - mean[at] * sizes) ** 2, bins)
        std = np.sqrt(rest * visits / np.maximum(visits - 1, 1)) / count
    seldom = visits < _VISITS
    return np.where(seldom, np.nan, mean), np.where(seldom, np.nan, std)


def _over_frequency(diagnosis: Diagnosis) -> Fingerprint | None:
    """Amplitude of the residuals over that of white noise, in bands of a constant ratio."""
    rows: list[tuple[Array, Array, Array]] = []
    for r in diagnosis.base.plan.recordings:
        mask = r.mask("identification")
        before, after = ((r.y - e.outputs[r.name])[mask] / r.noise for e in (diagnosis.before, diagnosis.after))
        f, p_before = periodogram(before, 1.0 / r.dt, detrend="constant")
        _, p_after = periodogram(after, 1.0 / r.dt, detrend="constant")
        # One-sided: white noise of unit variance has the density 2 Δt.
        rows.append((f[1:], p_before[1:] / (2.0 * r.dt), p_after[1:] / (2.0 * r.dt)))
    f, before, after = (np.concatenate([row[i] for row in rows]) for i in range(3))
    if f.size < _BINS:
        return None
    edges = np.geomspace(float(f.min()), float(f.max()) * (1.0 + 1e-9), _BINS + 1)
    place = np.clip(np.searchsorted(edges, f, side="right") - 1, 0, _BINS - 1)
    alone = np.arange(f.size)
    (b, b_std), (a, a_std) = (binned(p, place, alone, _BINS, True) for p in (before, after))
    kept = np.isfinite(b)
    if kept.sum() < 3:
        return None
    b, b_std, a, a_std = (v[kept] for v in (b, b_std, a, a_std))
    # Of a root: half the relative error.
    sizes = (np.sqrt(b), 0.5 * b_std / np.sqrt(b), np.sqrt(a), 0.5 * a_std / np.sqrt(a))
    middles = np.sqrt(edges[1:] * edges[:-1])[kept]
    return Fingerprint(middles, *sizes, "frequency (Hz)", "amplitude of the residual over white noise", True, 1.0)
