"""Trials of what laws promise, on points over many decades: sectors, energies with their minimum at rest, decays.

A trial finds what is wrong, or says nothing: it proves nothing between its points. The laws of the package keep their
promises by their form; this is for laws that others write.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from phnn.errors import StructureViolated
from phnn.laws.law import Law, MemoryLaw, ResistorLaw, StorageLaw
from phnn.parameters import Domain

Array = NDArray[np.float64]

# Four points a decade of both signs, denser around one, and zero.
_SIZES = np.unique(np.concatenate([np.logspace(-12, 12, 97), np.linspace(0.05, 4.0, 80)]))
POINTS = np.concatenate([-_SIZES[::-1], [0.0], _SIZES])
# States that a modulated law reads.
READ = (0.0, 1.0, -1.0, 1e-6, -1e-6, 1e3, -1e3)
# Where a law grows faster than any power, its value may overflow beyond this argument.
_ORDINARY = 1e2
# Rounding, relative to the values on both sides of zero.
_ROUNDING = 1e-9
# Finer points between the neighbours of the least conductance.
_FINER = 65
# Every so many of the points are paired with each other, and what two functions of a law may differ by.
_EVERY = 5
_AGREE = 1e-6
# Half of the distance of neighbouring points, and by how much the efforts between and at them may differ.
_NEAR, _JUMP = 1e-7, 1e-3
# What is asked of an argument where a law has no slope.
_SMOOTH = "argument, and so is its slope: write sqrt(x*x + s*s) in place of absolute(x) below a root"
_AROUND = np.array([1.0 - 1e-3, 1.0, 1.0 + 1e-3])


def check_law(law: Law, slopes: bool = True) -> None:
    """Try a law at its example and throughout the domains of its parameters.

    Raises:
        StructureViolated: it breaks its promise; names parameters, argument and value.
    """
    for values in dict.fromkeys(_samples(law.example, law.domains)):
        at = f"the law {law.name} with parameters {', '.join(f'{v:g}' for v in values)}"
        try:
            with np.errstate(all="ignore"):
                _check_at(law, values, at)
                if slopes and isinstance(law, StorageLaw | ResistorLaw):
                    _check_slope(law, values, at)
        except (TypeError, ValueError, RuntimeError) as error:
            raise StructureViolated(
                f"{at}: {error}; its functions are called with their arguments and one number for each of the "
                f"{len(values)} parameters of its example: use functions of phnn.laws.namespace, where(...) and not if"
            ) from error


def _check_at(law: Law, values: tuple[float, ...], at: str) -> None:
    if isinstance(law, ResistorLaw):
        for q in READ if _reads(law) else READ[:1]:
            check_sector(partial(_reading, law, q, values), at, _edges(law, q, values), q)
            _check_thresholds(law, q, values, at)
    elif isinstance(law, StorageLaw):
        _check_mean_effort(law, values, at)
        if law.bounded:
            check_energy(lambda x: law.energy(x, *values), at)
    elif isinstance(law, MemoryLaw) and not float(law.decay(*values)) >= 0.0:
        raise StructureViolated(f"{at} decays at {float(law.decay(*values)):g} 1/s: it must not grow by itself")


def _check_slope(law: StorageLaw | ResistorLaw, values: tuple[float, ...], at: str) -> None:
    """Try whether torch differentiates a law to finite slopes: ``sqrt(absolute(ε))`` has none at zero."""
    import torch

    x = torch.from_numpy(POINTS[np.abs(POINTS) <= _ORDINARY]).requires_grad_()
    y = law.flow(x, 0.0 * x, *values) if isinstance(law, ResistorLaw) else law.mean_effort(0.5 * x, x, *values)
    if isinstance(y, torch.Tensor) and y.requires_grad:
        (slope,) = torch.autograd.grad(y.sum(), x)
        value = "the slope of φ" if isinstance(law, ResistorLaw) else "the slope of ē"
        _check_finite(x.detach().numpy(), slope.numpy(), at, _SMOOTH, value)


def _check_mean_effort(law: StorageLaw, values: tuple[float, ...], at: str) -> None:
    """Try whether ``ē(a, b) (b − a) = b ē(0, b) − a ē(0, a)``, without which a step does not balance power.

    Where ``a = b`` the mean effort is compared with that between neighbouring points.
    """
    points = POINTS[np.abs(POINTS) <= _ORDINARY][::_EVERY]
    a, b = (x.ravel() for x in np.meshgrid(points, points))
    mean = np.broadcast_to(np.asarray(law.mean_effort(a, b, *values), dtype=np.float64), a.shape)
    _check_finite(a, mean, at, "a", "mean effort ē")
    before, after = law.energy(a, *values), law.energy(b, *values)
    given = mean * (b - a)
    # An energy that is the difference of larger numbers rounds; the step does not use it.
    rounding = _ROUNDING * (np.abs(before) + np.abs(after) + np.abs(law.energy(1.0 + 0.0 * a, *values)))
    wrong = ~(np.abs(given - (after - before)) <= _AGREE * np.abs(given) + rounding)
    if wrong.any():
        k = int(np.flatnonzero(wrong)[np.argmax(np.abs(given - (after - before))[wrong])])
        raise StructureViolated(
            f"{at}: from x = {a[k]:.6g} to {b[k]:.6g} its mean effort changes the energy by {given[k]:.6g} J, but "
            f"H changes by {after[k] - before[k]:.6g} J: mean_effort(a, b) must be (H(b) − H(a))/(b − a)"
        )
    near = law.mean_effort(points * (1.0 - _NEAR), points * (1.0 + _NEAR), *values)
    equal = law.mean_effort(points, points, *values)
    wrong = ~(np.abs(equal - near) <= _JUMP * (np.abs(equal) + np.abs(near)) + _ROUNDING * np.abs(mean).max())
    if wrong.any():
        k = int(np.flatnonzero(wrong)[0])
        raise StructureViolated(
            f"{at}: its mean effort at a = b = {points[k]:.6g} is {equal[k]:.6g}, and {near[k]:.6g} between points "
            "beside it: mean_effort(x, x) must be the effort H'(x)"
        )


def _check_thresholds(law: ResistorLaw, q: float, values: tuple[float, ...], at: str) -> None:
    """Try whether the thresholds of a piecewise linear law describe its flow."""
    if law.thresholds is None:
        return
    rho, low, high = law.thresholds(q, *values)
    described = rho * (np.maximum(POINTS - high, 0.0) + np.minimum(POINTS - low, 0.0))
    flow = _reading(law, q, values, POINTS)
    wrong = ~(np.abs(flow - described) <= _AGREE * (np.abs(flow) + np.abs(rho) * np.abs(POINTS)))
    if wrong.any():
        k = int(np.flatnonzero(wrong)[0])
        raise StructureViolated(
            f"{at}: φ({POINTS[k]:.6g}) = {flow[k]:.6g}, but its thresholds say {described[k]:.6g}: they must be "
            "(ρ, lo, hi) of φ = ρ (max(ε − hi, 0) + min(ε − lo, 0))"
        )


def check_sector(
    flow: Callable[[Array], Array], what: str, around: tuple[float, ...] = (), read: float | None = None
) -> None:
    """Try the sector condition ``ε φ(ε) ≥ 0`` of a resistor.

    Args:
        flow: ``φ``, elementwise.
        what: the law, for the message.
        around: efforts at which it changes, such as thresholds.
        read: the state that a modulated law reads, for the message.

    Raises:
        StructureViolated: outside the sector, or not finite; with the counterexample.
    """
    points = np.sort(np.concatenate([POINTS, *(edge * _AROUND for edge in around)]))
    values = _tried_sector(flow, points, what, read)
    with np.errstate(all="ignore"):
        conductance = np.where(points == 0.0, np.inf, values / points)
    # A dip between two points shows as the least conductance beside it.
    k = int(np.nanargmin(conductance))
    _tried_sector(flow, np.linspace(points[max(k - 1, 0)], points[min(k + 1, points.size - 1)], _FINER), what, read)


def check_energy(energy: Callable[[Array], Array], what: str) -> None:
    """Try whether an energy, elementwise, is finite and least at rest, ``H(x) ≥ H(0)``.

    Raises:
        StructureViolated: it is not; with the counterexample.
    """
    values = np.broadcast_to(np.asarray(energy(POINTS), dtype=np.float64), POINTS.shape)
    rest = float(values[POINTS == 0.0][0])
    _check_finite(POINTS, values, what, "x", "H")
    # An energy with an offset loses this much to rounding.
    low = values < rest - _ROUNDING * np.maximum(np.abs(values - rest), abs(rest) * 1e-3)
    if low.any():
        k = int(np.argmin(np.where(low, values - rest, np.inf)))
        raise StructureViolated(
            f"{what}: H({POINTS[k]:.6g}) = {values[k]:.6g} J lies below H(0) = {rest:.6g} J, so that it can deliver "
            "energy from rest: use an energy with its minimum at zero (ConvexEnergyMLP, or a named storage law)"
        )


def _tried_sector(flow: Callable[[Array], Array], points: Array, what: str, read: float | None) -> Array:
    values = np.broadcast_to(np.asarray(flow(points), dtype=np.float64), points.shape)
    _check_finite(points, values, what, "ε", "φ")
    # What a law loses to rounding is measured by its largest value nearer to zero than the argument.
    order = np.argsort(np.abs(points), kind="stable")
    reached = np.empty_like(values)
    reached[order] = np.maximum.accumulate(np.abs(values[order]))
    rounding = np.where(np.isfinite(reached), _ROUNDING * reached, 0.0)
    outside = np.sign(points) * values < -rounding
    if outside.any():
        k = int(order[np.flatnonzero(outside[order])[0]])
        reading = "" if read is None else f" (reading q = {read:g})"
        raise StructureViolated(
            f"{what}: φ({points[k]:.6g}) = {values[k]:.6g}{reading}, so that ε φ(ε) = {points[k] * values[k]:.3g} < 0 "
            "and it delivers power: use a law with ε φ(ε) ≥ 0 (SectorMLP, MonotoneMLP, or a named resistor law)"
        )
    return values


def _check_finite(points: Array, values: Array, what: str, argument: str, value: str) -> None:
    bad = np.isnan(values) | (np.isinf(values) & (np.abs(points) <= _ORDINARY))
    if bad.any():
        k = int(np.flatnonzero(bad)[np.argmin(np.abs(points[bad]))])
        raise StructureViolated(
            f"{what}: {value}({points[k]:.6g}) = {values[k]:g}: give a law that is finite for every {argument}"
        )


def _reading(law: ResistorLaw, q: float, values: tuple[float, ...], effort: Array) -> Array:
    return law.flow(effort, q + 0.0 * effort, *values)


def _reads(law: ResistorLaw) -> bool:
    """Return whether the flow of a law depends on the state that it may read."""
    flows = [law.flow(POINTS, q + 0.0 * POINTS, *law.example) for q in READ]
    return any(not np.array_equal(flow, flows[0]) for flow in flows[1:])


def _edges(law: ResistorLaw, q: float, values: tuple[float, ...]) -> tuple[float, ...]:
    """Thresholds of a piecewise linear law."""
    return () if law.thresholds is None else tuple(float(v) for v in law.thresholds(q, *values)[1:])


def _samples(example: tuple[float, ...], domains: tuple[Domain, ...]) -> Iterator[tuple[float, ...]]:
    """Return the example, each parameter moved far alone, and all combinations of signs."""
    yield example
    for k, domain in enumerate(domains):
        for value in (1e-3 * example[k], 1e3 * example[k], 0.0, -1e3 * example[k]):
            if value in domain:
                yield (*example[:k], value, *example[k + 1 :])
    if any(-1.0 in d for d in domains):
        yield from product(*((v, -v) if -1.0 in d else (v,) for v, d in zip(example, domains, strict=True)))
