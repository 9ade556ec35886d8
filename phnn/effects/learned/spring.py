"""A learned spring: stops at spaced gaps on either side, and springs whose force saturates."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Placed, Scales, has_motion, kinds
from phnn.effects.learned.strengths import Within, constants, sized, starts, stiffness_of, strengths
from phnn.network.elements import Coupling, Storage
from phnn.setup import Setup

# Gaps as shares of the displacement; beyond the last one, a fifth of the motion remains to identify it.
_GAPS = {"1": 0.2, "2": 0.4, "3": 0.6, "4": 0.8}
# Displacements beyond which the force of a saturating spring no longer grows.
_REACHES = {"5": 0.2, "6": 0.55}
# A noticeable strength, and one at which the response is still proportional to it, as shares of the stiffness.
_NOTICEABLE, _SMALL = 0.05, 1e-3

_RIGHT, _LEFT = (tuple(f"k_{side}{i}" for i in _GAPS) for side in ("R", "L"))
_YIELDING = tuple(f"k_S{i}" for i in _REACHES)
_STIFFNESSES = strengths((*_RIGHT, *_LEFT, *_YIELDING), "N/m", "stiffness of the learned spring")
_PLACES = constants(
    (f"g_L{i}" for i in (*_GAPS, *_REACHES)), "m", "displacement at which a learned spring sets in or ends"
)
_STORAGES = (
    *(Storage(f"learned_stops_{i}", "stops", (f"k_R{i}", f"k_L{i}", f"g_L{i}"), "m") for i in _GAPS),
    *(Storage(f"learned_spring_{i}", "saturating_spring", (f"k_S{i}", f"g_L{i}"), "m") for i in _REACHES),
)
_PARTS = Parts(_STORAGES, couplings=tuple(Coupling(s.name, "p", 1.0) for s in _STORAGES))


def press(setup: Setup, parameters: Placed) -> Setup:
    """``F += −Σ k₊ max(q − g, 0) + Σ k₋ max(−q − g, 0) − Σ k clip(q, ±g)``, each storage with ``J[x, p] = 1``."""
    return _PARTS(setup, sized(parameters, _NOTICEABLE * stiffness_of(setup)))


def grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal; then emphasis on the stops on one side, and on the saturating springs."""
    places = {f"g_L{i}": share * scales.displacement for i, share in (_GAPS | _REACHES).items()}
    return starts(_STIFFNESSES, _SMALL * scales.stiffness, (_RIGHT, _LEFT, _YIELDING), places)


EFFECT = Effect(
    name="learned_spring",
    kind=kinds.ELASTIC,
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
    declares=(*_STIFFNESSES, *_PLACES),
    adds=press,
    grid=grid,
    applies=has_motion,
    neighbours=("contact_stop", "cubic_stiffness", "quadratic_stiffness"),
    rescale=Within(_STIFFNESSES),
)
