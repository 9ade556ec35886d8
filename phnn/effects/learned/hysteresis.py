"""A learned hysteresis: yielding cells at spaced displacements, with a fitted density."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Placed, Scales, constant, has_motion, kinds
from phnn.effects.learned.ladder import with_ladder
from phnn.effects.learned.strengths import Within, constants, named, starts, strengths
from phnn.setup import Setup

_CELLS = tuple(str(i) for i in range(1, 9))
# Smallest and largest displacement to slip: beyond half of the displacement's range a cell adds hardly any hysteresis.
_FIRST, _LAST = 0.02, 0.9
# A cell slips faster than the fastest line by this factor, so that its loop does not depend on the rate.
_FASTER = 30.0
# A noticeable strength, and one at which the response is still proportional to it, as shares of the stiffness.
_NOTICEABLE, _SMALL = 0.02, 1e-3

_STIFFNESSES = strengths((f"k_Y{i}" for i in _CELLS), "N/m", "stiffness of a learned yielding cell")
_TRAVELS = constants((f"x_Y{i}" for i in _CELLS), "m", "displacement after which a learned cell slips")
_STOPS = {f"learned_stop_{i}": (f"k_Y{i}", f"x_Y{i}", "tau_Y") for i in _CELLS}


def yielding(setup: Setup, parameters: Placed) -> Setup:
    """``F += −Σ kᵢ sᵢ``, ``ṡᵢ = v − (sᵢ − clip(sᵢ, ±xᵢ))/τ``: springs with a dead-zone resistor, ``J[s, p] = 1``."""
    return with_ladder(setup, _STOPS, "yielding", parameters, _NOTICEABLE)


def grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal; then emphasis on the cells that slip early, and late."""
    travels = scales.displacement * np.geomspace(_FIRST, _LAST, len(_CELLS))
    constants = dict(zip(named(_TRAVELS), map(float, travels), strict=True))
    constants["tau_Y"] = 1.0 / (2.0 * np.pi * _FASTER * scales.fastest)
    names, half = named(_STIFFNESSES), len(_CELLS) // 2
    return starts(_STIFFNESSES, _SMALL * scales.stiffness, (names[:half], names[half:]), constants)


EFFECT = Effect(
    name="learned_hysteresis",
    kind=kinds.SHAPE,
    equation=r"F = \sum_i k_{Yi}\,s_i, \quad \dot{s}_i = v - (s_i - \mathrm{clip}(s_i, \pm x_{Yi}))/\tau_Y",
    statement="The hysteresis has another shape: cells of {k_Y1}, {k_Y2}, {k_Y3}, {k_Y4}, {k_Y5}, {k_Y6}, {k_Y7} and "
    "{k_Y8} slip after {x_Y1}, {x_Y2}, {x_Y3}, {x_Y4}, {x_Y5}, {x_Y6}, {x_Y7} and {x_Y8}.",
    fingerprint="Loops whose width grows with the amplitude in another way than the hysterons of the model allow, the "
    "same at every frequency.",
    separation="Slow triangles of many amplitudes, each with a hold at its end.",
    references=("Iwan 1966, J. Appl. Mech. 33 (distributed-element model for hysteresis)",),
    declares=(*_STIFFNESSES, *_TRAVELS, constant("tau_Y", "s", "time in which a learned cell slips")),
    adds=yielding,
    grid=grid,
    applies=has_motion,
    neighbours=("extra_hysteron", "coulomb_friction"),
    rescale=Within(_STIFFNESSES),
    related_kinds=(kinds.THRESHOLD_BY_DISPLACEMENT, kinds.THRESHOLD_BY_RATE),
)
