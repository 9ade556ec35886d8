"""Coulomb friction on the moving mass, smoothed over a velocity or over a displacement."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects import Effect, Parts, Scales, constant, has_motion, kinds, positive
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.setup import Setup

_NAME = "coulomb_friction"
# Resistance at the largest velocity, as a share of the friction.
_HARDLY = 0.01
_FORCE = positive("F_c", "N", "Coulomb friction force", 1e8, strength=True)


def slides(setup: Setup) -> bool:
    """The output is a displacement ``q`` that a momentum ``p`` moves, without a coulomb_friction yet."""
    return has_motion(setup) and all(r.name != _NAME for r in setup.network.resistors)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Smoothing velocities well below the largest velocity of the slowest and of the fastest recording."""
    force = 1e-4 * scales.stiffness * scales.displacement
    slow = 6.0 * scales.slowest * scales.displacement
    speeds = {0.01 * slow, 0.1 * slow, 0.6 * slow, 0.1 * scales.velocity}
    return [{"F_c": force, "v_s": v} for v in sorted(speeds)]


def grid_bristles(scales: Scales) -> list[dict[str, float]]:
    """Slip after shares of the displacement, with a resistance that is hardly noticeable."""
    force = 1e-4 * scales.stiffness * scales.displacement
    slip = scales.velocity / (_HARDLY * force)
    return [
        {"k_f": force / (share * scales.displacement), "F_c": force, "slip_f": slip} for share in (3e-4, 3e-3, 3e-2)
    ]


def rescale_bristles(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale the force; the displacement to slip and the share of the resistance do not change."""
    weight = max(factor, 1e-3)
    return {"k_f": weight * values["k_f"], "F_c": weight * values["F_c"], "slip_f": values["slip_f"] / weight}


EFFECT = Effect(
    name=_NAME,
    kind=kinds.DISSIPATIVE,
    equation=r"F_f = F_c \tanh(v/v_s)",
    statement="Dry friction of {F_c} acts on the moving part; its sign follows the velocity. From about {v_s} "
    "on its size does not grow with the speed.",
    fingerprint="Odd harmonics whose share of the motion falls as the amplitude grows, and the motion sticks at its "
    "turning points.",
    separation="Triangles of small amplitude at two rates: friction holds the output at every reversal by the same "
    "force, a hysteron slips after the same displacement.",
    references=("Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30",),
    declares=(
        _FORCE,
        positive("v_s", "m/s", "velocity over which friction changes sign", 1e4).plausibly(
            1e-6, 0.1, "contacts leave the Stribeck range below 0.1 m/s (Armstrong-Hélouvry et al. 1994)"
        ),
    ),
    adds=Parts(resistors=(Resistor(_NAME, "coulomb", {"p": 1.0}, ("F_c", "v_s")),)),
    grid=grid,
    applies=slides,
    neighbours=("extra_hysteron",),
).or_as(
    equation=r"F_f = k_f\,z, \quad \dot{z} = v - \varphi(k_f z)",
    statement="Dry friction acts on the moving part: bristles of {k_f} bend with it and slip as soon as they "
    "pull with {F_c}.",
    references=("Canudas de Wit, Olsson, Åström & Lischinsky 1995, IEEE Trans. Autom. Control 40",),
    declares=(
        positive("k_f", "N/m", "stiffness of the bristles before they slip", 1e8),
        _FORCE,
        constant("slip_f", "m/(N s)", "speed of slipping over the force beyond friction"),
    ),
    adds=Parts(
        (Storage("z", "spring", ("k_f",), "m"),),
        (Resistor(_NAME, "bristles", {"z": 1.0}, ("slip_f", "F_c")),),
        (Coupling("z", "p", 1.0),),
    ),
    grid=grid_bristles,
    rescale=rescale_bristles,
)
