"""Coulomb friction on the moving mass, rounded over a velocity or over a displacement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Plausible, Scales, has_motion, no_range, with_network
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.parameters import constant, positive
from phnn.setup import Setup

_NAME = "coulomb_friction"
# Resistance at the largest velocity, as a share of the friction.
_HARDLY = 0.01


def slides(setup: Setup) -> bool:
    """The output is a displacement ``q`` that a momentum ``p`` moves, without a coulomb_friction yet."""
    return has_motion(setup) and all(r.name != _NAME for r in setup.network.resistors)


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """One more resistor on ``p``: ``F_c tanh(v/v_s)``."""
    return with_network(
        setup,
        setup.network.extend(
            resistors=(Resistor(_NAME, "coulomb", {"p": 1.0}, ("F_c", "v_s")),),
            parameters=(
                positive("F_c", values["F_c"], "N", "Coulomb friction force", 1e8),
                positive("v_s", values["v_s"], "m/s", "velocity over which friction changes sign", 1e4),
            ),
        ),
    )


def grid(scales: Scales) -> list[dict[str, float]]:
    """Smoothing velocities well below those met in the slowest and the fastest recording."""
    force = 1e-4 * scales.stiffness * scales.displacement
    slow = 6.0 * scales.slowest * scales.displacement
    speeds = {0.01 * slow, 0.1 * slow, 0.6 * slow, 0.1 * scales.velocity}
    return [{"F_c": force, "v_s": v} for v in sorted(speeds)]


def build_bristles(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``F += −k_f z``, ``ż = v − φ(k_f z)``: storage ``z`` with ``J[z, p] = 1``; ``φ`` is zero within ``±F_c``."""
    return with_network(
        setup,
        setup.network.extend(
            storages=(Storage("z", "spring", ("k_f",), "m"),),
            resistors=(Resistor(_NAME, "bristles", {"z": 1.0}, ("slip_f", "F_c")),),
            couplings=(Coupling("z", "p", 1.0),),
            parameters=(
                positive("k_f", values["k_f"], "N/m", "stiffness of the bristles before they slip", 1e8),
                positive("F_c", values["F_c"], "N", "Coulomb friction force", 1e8),
                constant("slip_f", values["slip_f"], "m/(N s)", "speed of slipping over the force beyond friction"),
            ),
        ),
    )


def grid_bristles(scales: Scales) -> list[dict[str, float]]:
    """Slipping after shares of the displacement, with a hardly noticeable resistance."""
    force = 1e-4 * scales.stiffness * scales.displacement
    slip = scales.velocity / (_HARDLY * force)
    return [
        {"k_f": force / (share * scales.displacement), "F_c": force, "slip_f": slip} for share in (3e-4, 3e-3, 3e-2)
    ]


def rescale_bristles(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Strength is the force; the displacement to slip and the share of the resistance stay."""
    weight = max(factor, 1e-3)
    return {"k_f": weight * values["k_f"], "F_c": weight * values["F_c"], "slip_f": values["slip_f"] / weight}


_ROUNDED = Effect(
    name=_NAME,
    location="mechanical",
    kind="dissipative",
    equation=r"F_f = F_c \tanh(v/v_s)",
    statement="Dry friction of {F_c} acts on the moving part; it turns round with the velocity and does not grow "
    "with it (smoothed over {v_s}).",
    fingerprint="Odd harmonics whose share of the motion falls as the amplitude grows, and the motion sticks at its "
    "turning points.",
    separation="Triangles of small amplitude at two rates: friction holds the output at every reversal by the same "
    "force, a hysteron slips after the same displacement.",
    references=("Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30",),
    passive=True,
    strength="F_c",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("F_c", "v_s"),
    plausible={
        "v_s": Plausible(
            1e-6,
            0.1,
            "contacts leave the Stribeck range below 0.1 m/s (Armstrong-Hélouvry et al. 1994)",
        ),
        **no_range("F_c"),
    },
    applies=slides,
    neighbours=("extra_hysteron",),
)
EFFECT = replace(
    _ROUNDED,
    forms=(
        replace(
            _ROUNDED,
            equation=r"F_f = k_f\,z, \quad \dot{z} = v - \varphi(k_f z)",
            statement="Dry friction acts on the moving part: bristles of {k_f} bend with it and slip as soon as they "
            "pull with {F_c}.",
            references=("Canudas de Wit, Olsson, Åström & Lischinsky 1995, IEEE Trans. Autom. Control 40",),
            strength="F_c",
            grid=grid_bristles,
            build=build_bristles,
            parameters=("k_f", "F_c", "slip_f"),
            plausible=no_range("k_f", "F_c", "slip_f"),
            rescale=rescale_bristles,
        ),
    ),
)
