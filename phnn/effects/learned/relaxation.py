"""A learned relaxation: Maxwell cells at spaced times, so that part of the stiffness relaxes over decades of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phnn.effects import Effect, Parts, Placed, Scales, has_motion, kinds
from phnn.effects.learned.strengths import NEARLY_ZERO, Within, constants, named, sized, starts, stiffness_of, strengths
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.setup import Setup

_CELLS = tuple(str(i) for i in range(1, 7))
# Shortest time, as a share of the fastest period.
_SHORTEST = 0.3
# A noticeable strength, and one at which the response is still proportional to it, as shares of the stiffness.
_NOTICEABLE, _SMALL = 0.01, 1e-3

_STIFFNESSES = strengths((f"k_M{i}" for i in _CELLS), "N/m", "stiffness of a learned relaxing spring")
_TIMES = constants((f"tau_M{i}" for i in _CELLS), "s", "time in which a learned spring relaxes")
_MAXWELL = {f"learned_cell_{i}": (f"k_M{i}", f"tau_M{i}") for i in _CELLS}
_PARTS = Parts(
    storages=tuple(Storage(cell, "spring", names[:1], "m") for cell, names in _MAXWELL.items()),
    resistors=tuple(Resistor(cell, "maxwell", {cell: 1.0}, names) for cell, names in _MAXWELL.items()),
    couplings=tuple(Coupling(cell, "p", 1.0) for cell in _MAXWELL),
)


def relax(setup: Setup, parameters: Placed) -> Setup:
    """``F += −Σ kᵢ sᵢ``, ``ṡᵢ = v − sᵢ/τᵢ``: storages with ``J[s, p] = 1`` and a linear resistor each.

    The resistors divide by the stiffness, which therefore has a positive lower bound.
    """
    typical = _NOTICEABLE * stiffness_of(setup)
    least = NEARLY_ZERO * typical
    own = {
        n: p if p.fixed else replace(p, value=max(p.value, least), lower=least)
        for n, p in sized(parameters, typical).items()
    }
    return _PARTS(setup, own)


def grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal; then emphasis on the fast cells, and on the slow ones; times up to the longest recording."""
    times = np.geomspace(_SHORTEST / scales.fastest, scales.duration, len(_CELLS))
    constants = dict(zip(named(_TIMES), map(float, times), strict=True))
    names, half = named(_STIFFNESSES), len(_CELLS) // 2
    return starts(_STIFFNESSES, _SMALL * scales.stiffness, (names[:half], names[half:]), constants)


EFFECT = Effect(
    name="learned_relaxation",
    kind=kinds.MEMORY,
    equation=r"F = \sum_i k_{Mi}\,s_i, \quad \dot{s}_i = v - s_i/\tau_{Mi}",
    statement="Part of the stiffness relaxes over decades of time: {k_M1} with {tau_M1}, {k_M2} with {tau_M2}, {k_M3} "
    "with {tau_M3}, {k_M4} with {tau_M4}, {k_M5} with {tau_M5} and {k_M6} with {tau_M6}.",
    fingerprint="The displacement goes on growing long after a step, as the logarithm of time rather than towards an "
    "end.",
    separation="A step held as long as possible and back to zero: the recovery shows the same times again.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials, ch. 5",),
    declares=(*_STIFFNESSES, *_TIMES),
    adds=relax,
    grid=grid,
    applies=has_motion,
    neighbours=("creep", "sensor_drift"),
    rescale=Within(_STIFFNESSES),
    several_of="creep",
)
