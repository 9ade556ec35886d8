"""A learned hysteresis: yielding cells at spaced displacements, the density of which is fitted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.effects.effect import Effect, Scales, has_motion, no_range
from phnn.effects.learned.ladder import with_ladder
from phnn.effects.learned.strengths import of_any_size, starts
from phnn.parameters import constant
from phnn.setup import Setup

_CELLS = tuple(str(i) for i in range(1, 9))
# Smallest and largest displacement to slip: beyond half of the displacement's range a cell is hardly a hysteresis.
_FIRST, _LAST = 0.02, 0.9
# A cell slips faster than the fastest line by this factor, so that its loop does not depend on the rate.
_FASTER = 30.0
# A noticeable strength, and one that leaves the response proportional to it, as shares of the stiffness.
_NOTICEABLE, _SMALL = 0.02, 1e-3

_STRENGTHS = tuple(f"k_Y{i}" for i in _CELLS)
_TRAVELS = tuple(f"x_Y{i}" for i in _CELLS)


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``F += −Σ kᵢ sᵢ``, ``ṡᵢ = v − (sᵢ − clip(sᵢ, ±xᵢ))/τ``: springs with a dead-zone resistor, ``J[s, p] = 1``."""
    cells = {f"learned_stop_{i}": (f"k_Y{i}", f"x_Y{i}", "tau_Y") for i in _CELLS}
    constants = [constant(x, values[x], "m", "displacement after which a learned cell slips") for x in _TRAVELS]
    constants.append(constant("tau_Y", values["tau_Y"], "s", "time in which a learned cell slips"))
    words = "stiffness of a learned yielding cell"
    return with_ladder(setup, cells, "yielding", values, _NOTICEABLE, words, constants)


def grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal, then those of the cells that slip soon and late."""
    travels = scales.displacement * np.geomspace(_FIRST, _LAST, len(_CELLS))
    constants = dict(zip(_TRAVELS, map(float, travels), strict=True))
    constants["tau_Y"] = 1.0 / (2.0 * np.pi * _FASTER * scales.fastest)
    half = len(_CELLS) // 2
    return starts(_STRENGTHS, _SMALL * scales.stiffness, (_STRENGTHS[:half], _STRENGTHS[half:]), constants)


EFFECT = Effect(
    name="learned_hysteresis",
    location="hysteron",
    kind="shape",
    equation=r"F = \sum_i k_{Yi}\,s_i, \quad \dot{s}_i = v - (s_i - \mathrm{clip}(s_i, \pm x_{Yi}))/\tau_Y",
    statement="The hysteresis has another shape: cells of {k_Y1}, {k_Y2}, {k_Y3}, {k_Y4}, {k_Y5}, {k_Y6}, {k_Y7} and "
    "{k_Y8} slip after {x_Y1}, {x_Y2}, {x_Y3}, {x_Y4}, {x_Y5}, {x_Y6}, {x_Y7} and {x_Y8}.",
    fingerprint="Loops whose width grows with the amplitude in another way than the hysterons of the model allow, the "
    "same at every frequency.",
    separation="Slow triangles of many amplitudes, each with a hold at its end.",
    references=("Iwan 1966, J. Appl. Mech. 33 (distributed-element model for hysteresis)",),
    passive=True,
    strength=_STRENGTHS[0],
    strengths=_STRENGTHS,
    one_sided=True,
    grid=grid,
    build=build,
    rescale=of_any_size(_STRENGTHS),
    parameters=(*_STRENGTHS, *_TRAVELS, "tau_Y"),
    plausible=no_range(*_STRENGTHS, *_TRAVELS, "tau_Y"),
    applies=has_motion,
    akin=("threshold that follows the displacement", "threshold that follows the rate"),
    neighbours=("extra_hysteron", "coulomb_friction"),
)
