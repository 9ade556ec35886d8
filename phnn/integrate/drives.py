"""Derivatives of the modulator states, factor by factor of the chain rule.

    z⁺ = advanced(z, s̄; θ),     δz⁺ = ∂z⁺/∂z δz + ∂z⁺/∂θ δθ + ∂z⁺/∂s̄ Σ δ(sources)

Each factor comes from complex steps through the functions of the integration itself. The derivative of a reducible
storage's power follows from those of its end state and mean effort, which are computed before.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.affine import current_of
from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.constants import STIFFNESS
from phnn.integrate.perturbed import CURVED, KIND, ONLY_LINK, STIFF, STORAGE, parameter, perturb, places_of, step_of
from phnn.integrate.table_access import count, mean_effort, memory_decay, memory_rate, resistor_flow
from phnn.integrate.tables import (
    FIRST_SOURCE,
    IS_LINEAR,
    LAST_SOURCE,
    LEAVES,
    MODULATOR_STATES,
    OWN_STORAGE,
    READ,
    SOURCE_EFFORT,
    SOURCE_FLOW,
    SOURCE_LEAF,
    SOURCE_PORT,
    SOURCE_RESISTOR,
    SOURCES,
    STORAGES,
)
from phnn.integrate.terms import FLOW, branch_effort, junction_flows, leaf_current, read
from phnn.laws.namespace import TINY
from phnn.laws.other import advanced


@inline
def _known_power(p: Any, d: Any, leaf: Any, current: Any, n: Any, run: Any) -> None:
    """`_leaf_power` of a linear reducible storage whose step lies within an affine piece."""
    k, stiffness = d.kinds[leaf, STORAGE], d.values[leaf, STIFF]
    start, end, mean, rate = run.states[n, k], run.states[n + 1, k], run.efforts[n, k], 1.0 / run.h[n]
    between, moved, only = 0.5 * stiffness * (start + end), end - start, d.kinds[leaf, ONLY_LINK]
    flow = d.flows[only] if only >= 0 else 0.0
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i, by_end = p.input[pair], d.by_leaf[pair]
        by_start = 1.0 if i == k else 0.0
        by_between = 0.5 * stiffness * (by_start + by_end)
        if parameter(d, i) >= 0:
            by_between += 0.5 * d.c[parameter(d, i), leaf, STIFFNESS].imag / TINY * (start + end)
        stored = by_between * moved + between * (by_end - by_start)
        by_current = d.by_current[pair] + d.by_ratio[pair] * flow
        d.by_drive[i] += by_current * mean + current * d.by_mean[pair] - stored * rate


@inline
def _leaf_power(t: Any, p: Any, d: Any, leaf: Any, n: Any, run: Any) -> None:
    """Add the derivatives of ``i ē − ΔH/h``, the power that the resistors of a reducible storage dissipate."""
    row, h = t[0, LEAVES] + leaf, run.h[n]
    k = t[row, OWN_STORAGE]
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        which, slot, act = places_of(p, d, i)
        perturb(p, d, i, TINY)
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        current, start = leaf_current(t, leaf, d.g[slot], d.a[act], d.wj), d.x[k]
        end = complex(run.states[n + 1, k], TINY * d.by_leaf[pair])
        mean = complex(run.efforts[n, k], TINY * d.by_mean[pair])
        if t[row, IS_LINEAR] > 0:
            between = 0.5 * d.c[which, leaf, STIFFNESS] * (start + end)
        else:
            between = mean_effort(t, k, start, end, d.theta)
        d.by_drive[i] += (current * mean - between * (end - start) / h).imag / TINY
        perturb(p, d, i, 0.0)


@inline
def _junction_power(t: Any, p: Any, d: Any, s: Any, h: Any) -> None:
    """Add the derivatives of the power that the junction resistor of the source in row ``s`` dissipates."""
    r, source = t[s, SOURCE_RESISTOR], s - t[0, SOURCES]
    for place in range(p.source_first[source], p.source_first[source + 1]):
        i = p.source_input[place]
        which, slot, act = places_of(p, d, i)
        perturb(p, d, i, TINY)
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        effort = branch_effort(t, r, d.g[slot], d.wj)
        q = read(t, t[r, READ], step_of(d, which, slot, act, h))
        d.by_drive[i] += (effort * resistor_flow(t, r, effort, q, d.theta)).imag / TINY
        perturb(p, d, i, 0.0)


@inline
def _signal(t: Any, p: Any, d: Any, s: Any) -> None:
    """Add the derivatives of the effort of a reducible storage, the flow of a junction or the action of a port."""
    for leaf in range(count(t, LEAVES) if t[s, SOURCE_EFFORT] >= 0 else 0):
        if t[t[0, LEAVES] + leaf, OWN_STORAGE] == t[s, SOURCE_EFFORT]:
            for pair in range(p.first[leaf], p.first[leaf + 1]):
                d.by_drive[p.input[pair]] += d.by_mean[pair]
    source = s - t[0, SOURCES]
    for place in range(p.source_first[source], p.source_first[source + 1]):
        i = p.source_input[place]
        _, _, act = places_of(p, d, i)
        if t[s, SOURCE_FLOW] >= 0:
            perturb(p, d, i, TINY)
            junction_flows(t, d.theta, d.x, d.y, d.wj)
            d.by_drive[i] += d.wj[FLOW, t[s, SOURCE_FLOW]].imag / TINY
            perturb(p, d, i, 0.0)
        else:
            d.by_drive[i] += d.a[act, t[s, SOURCE_PORT]].imag / TINY


@plain
def _end(t: Any, row: Any, z: Any, drive: Any, h: Any, theta: Any) -> Any:
    """End state of the modulator state in a row."""
    stay_outside()
    return advanced(z, h, memory_rate(t, row, z, drive, theta), memory_decay(t, row, theta))


@inline
def memories_by(t: Any, p: Any, d: Any, k: Any, n: Any, run: Any) -> None:
    """Fill the derivatives of modulator state ``k`` from those of the reducible storages."""
    row, state, out, h = t[0, MODULATOR_STATES] + k, count(t, STORAGES) + k, d.by_modulator[k], run.h[n]
    for i in range(out.shape[0]):
        d.by_drive[i] = 0.0
    for s in range(t[row, FIRST_SOURCE], t[row, LAST_SOURCE]):
        leaf = t[s, SOURCE_LEAF]
        if leaf >= 0 and not d.todo[leaf] and d.kinds[leaf, KIND] != CURVED:
            _known_power(p, d, leaf, current_of(t, d, leaf), n, run)
        elif leaf >= 0:
            _leaf_power(t, p, d, leaf, n, run)
        elif t[s, SOURCE_RESISTOR] >= 0:
            _junction_power(t, p, d, s, h)
        else:
            _signal(t, p, d, s)
    drive = complex(run.efforts[n, state], TINY)
    by = _end(t, row, d.x[state], drive, h, d.theta).imag / TINY
    drive = complex(run.efforts[n, state], 0.0)
    for i in range(out.shape[0]):
        out[i] = by * d.by_drive[i]
    for place in range(p.memory_first[k], p.memory_first[k + 1]):
        i = p.memory_input[place]
        perturb(p, d, i, TINY)
        out[i] += _end(t, row, d.x[state], drive, h, d.theta).imag / TINY
        perturb(p, d, i, 0.0)
