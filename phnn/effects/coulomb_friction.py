"""Coulomb friction on the moving mass."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, has_motion, with_network
from phnn.network.elements import Resistor
from phnn.parameters import positive
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """One more resistor on ``p``: ``F_c tanh(v/v_s)``."""
    return with_network(
        setup,
        setup.network.extend(
            resistors=(Resistor("coulomb_friction", "coulomb", {"p": 1.0}, ("F_c", "v_s")),),
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


EFFECT = Effect(
    name="coulomb_friction",
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
    applies=has_motion,
    neighbours=("extra_hysteron",),
)
