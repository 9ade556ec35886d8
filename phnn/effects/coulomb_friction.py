"""Coulomb friction on the moving mass, smoothed over a velocity, over a displacement, or over both."""

from __future__ import annotations

import math
from collections.abc import Mapping

from phnn.effects import Effect, Parts, Scales, constant, has_motion, kinds, positive
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.setup import Setup

_NAME = "coulomb_friction"
# Resistance at the largest velocity, as a share of the friction.
_HARDLY = 0.01
_FORCE = positive("F_c", "N", "Coulomb friction force", 1e8, strength=True)
_STIFFNESS = positive("k_f", "N/m", "stiffness of the bristles before they slip", 1e8)
_SLIP = constant("slip_f", "m/(N s)", "speed of slipping over the force beyond friction")
_BRISTLES, _BENT = Storage("z", "spring", ("k_f",), "m"), Coupling("z", "p", 1.0)
_SLIPPING = Resistor(_NAME, "bristles", {"z": 1.0}, ("slip_f", "F_c"))
_CREEPING = Resistor(f"{_NAME}_creep", "linear", {"z": 1.0}, ("rho_f",))
# Rates at which bristles creep, as shares of the fastest line.
_RATES = (0.03, 0.3, 3.0)


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


def grid_creeping(scales: Scales) -> list[dict[str, float]]:
    """The same bristles, which creep slower and faster than the fastest line."""
    rates = [2.0 * math.pi * share * scales.fastest for share in _RATES]
    return [{**v, "rho_f": rate / v["k_f"]} for v in grid_bristles(scales) for rate in rates]


def rescale_bristles(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale the force; the displacement to slip, the rate of creep and the share of the resistance do not change."""
    weight = max(factor, 1e-3)
    stiff = {n: weight * values[n] for n in ("k_f", "F_c")}
    return {**stiff, **{n: v / weight for n, v in values.items() if n in ("slip_f", "rho_f")}}


_OVER_VELOCITY = Effect(
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
)
_OVER_DISPLACEMENT = _OVER_VELOCITY.or_as(
    equation=r"F_f = k_f\,z, \quad \dot{z} = v - \varphi(k_f z)",
    statement="Dry friction acts on the moving part: bristles of {k_f} bend with it and slip as soon as they "
    "pull with {F_c}.",
    references=("Canudas de Wit, Olsson, Åström & Lischinsky 1995, IEEE Trans. Autom. Control 40",),
    declares=(_STIFFNESS, _FORCE, _SLIP),
    adds=Parts((_BRISTLES,), (_SLIPPING,), (_BENT,)),
    grid=grid_bristles,
    rescale=rescale_bristles,
)
EFFECT = _OVER_DISPLACEMENT.or_as(
    equation=r"F_f = k_f\,z, \quad \dot{z} = v - \rho_f\,k_f z - \varphi(k_f z)",
    statement="Dry friction acts on the moving part: bristles of {k_f} bend with it, creep by {rho_f} under any "
    "force, and slip as soon as they pull with {F_c}.",
    references=("Kamath & Wereley 1997, Smart Mater. Struct. 6 (nonlinear viscoelastic-plastic fluids)",),
    declares=(_STIFFNESS, _FORCE, positive("rho_f", "m/(N s)", "speed of creep over the force of the bristles"), _SLIP),
    adds=Parts((_BRISTLES,), (_SLIPPING, _CREEPING), (_BENT,)),
    grid=grid_creeping,
    rescale=rescale_bristles,
)
