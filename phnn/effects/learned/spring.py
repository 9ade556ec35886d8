"""A learned spring: stops at spaced gaps on either side, and springs that give way."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, has_motion, no_range, with_network
from phnn.effects.learned.strengths import of_any_size, starts, stiffness_of, strength
from phnn.network.elements import Coupling, Storage
from phnn.parameters import constant
from phnn.setup import Setup

# Gaps as shares of the displacement; beyond the last one there is still a fifth of the motion to learn from.
_GAPS = {"1": 0.2, "2": 0.4, "3": 0.6, "4": 0.8}
# Displacements beyond which the force of a saturating spring no longer grows.
_REACHES = {"5": 0.2, "6": 0.55}
# A noticeable strength, and one that leaves the response proportional to it, as shares of the stiffness.
_NOTICEABLE, _SMALL = 0.05, 1e-3

_RIGHT, _LEFT = (tuple(f"k_{side}{i}" for i in _GAPS) for side in ("R", "L"))
_YIELDING = tuple(f"k_S{i}" for i in _REACHES)
_STRENGTHS = (*_RIGHT, *_LEFT, *_YIELDING)
_PLACES = tuple(f"g_L{i}" for i in (*_GAPS, *_REACHES))


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``F += −Σ k₊ max(q − g, 0) + Σ k₋ max(−q − g, 0) − Σ k clip(q, ±g)``, each storage with ``J[x, p] = 1``."""
    typical = _NOTICEABLE * stiffness_of(setup)
    storages = [Storage(f"learned_stops_{i}", "stops", (f"k_R{i}", f"k_L{i}", f"g_L{i}"), "m") for i in _GAPS]
    storages += [Storage(f"learned_spring_{i}", "saturating_spring", (f"k_S{i}", f"g_L{i}"), "m") for i in _REACHES]
    parameters = [strength(n, values[n], "N/m", typical, "stiffness of the learned spring") for n in _STRENGTHS]
    parameters += [constant(n, values[n], "m", "where a part of the learned spring sets in or ends") for n in _PLACES]
    couplings = tuple(Coupling(s.name, "p", 1.0) for s in storages)
    return with_network(setup, setup.network.extend(tuple(storages), couplings=couplings, parameters=tuple(parameters)))


def grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal, then those of the stops on one side, and of the springs that give way."""
    places = {f"g_L{i}": share * scales.displacement for i, share in (_GAPS | _REACHES).items()}
    return starts(_STRENGTHS, _SMALL * scales.stiffness, (_RIGHT, _LEFT, _YIELDING), places)


EFFECT = Effect(
    name="learned_spring",
    location="mechanical",
    kind="elastic",
    equation=r"F = \sum_i k_{Ri} \max(q - g_i, 0) - k_{Li} \max(-q - g_i, 0) + \sum_j k_{Sj}\,"
    r"\mathrm{clip}(q, \pm g_j)",
    statement="A further spring acts on the moving part, whose force depends on the displacement alone. Its stiffness "
    "grows by {k_R1}, {k_R2}, {k_R3} and {k_R4} beyond {g_L1}, {g_L2}, {g_L3} and {g_L4}, by {k_L1}, {k_L2}, {k_L3} "
    "and {k_L4} on the other side, and falls by {k_S5} and {k_S6} beyond {g_L5} and {g_L6}.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, at every frequency below the "
    "resonance.",
    separation="Slow sines of several amplitudes about several offsets: the force follows the displacement without a "
    "loop.",
    references=("Hastie, Tibshirani & Friedman 2009, The Elements of Statistical Learning, sec. 9.4 (hinges)",),
    passive=True,
    strength=_STRENGTHS[0],
    strengths=_STRENGTHS,
    one_sided=True,
    grid=grid,
    build=build,
    rescale=of_any_size(_STRENGTHS),
    parameters=(*_STRENGTHS, *_PLACES),
    plausible=no_range(*_STRENGTHS, *_PLACES),
    applies=has_motion,
    neighbours=("contact_stop", "cubic_stiffness", "quadratic_stiffness"),
)
