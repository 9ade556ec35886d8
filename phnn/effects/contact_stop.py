"""An elastic stop that the moving part meets on one side."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, has_motion, kinds, limit, positive
from phnn.network.elements import Coupling, Storage


def grid(scales: Scales) -> list[dict[str, float]]:
    """A weak stop at shares of the displacement on either side."""
    shares = (0.3, 0.5, 0.65, 0.8, 0.9, 0.97)
    gaps = [side * share * scales.displacement for side in (1.0, -1.0) for share in shares]
    return [{"k_c": 1e-3 * scales.stiffness, "g_c": gap} for gap in gaps]


EFFECT = Effect(
    name="contact_stop",
    kind=kinds.ELASTIC,
    equation=r"F_c = k_c \max(q - g_c, 0)",
    statement="The moving part meets an elastic stop: beyond a displacement of {g_c} a further stiffness of {k_c} acts "
    "on that side.",
    fingerprint="Nothing below one displacement, and beyond it a force that grows with the depth, on one side only.",
    separation="Sines of rising amplitude about two offsets of the voltage: a stop acts at one displacement and on one "
    "side only, a limit of the amplifier at one voltage.",
    references=("Johnson 1985, Contact Mechanics, ch. 4 (linearised)",),
    declares=(
        positive("k_c", "N/m", "stiffness of the stop", 1e8, strength=True),
        # The gap keeps its sign: a fit cannot move a stop to the other side.
        limit("g_c", "m", "gap to the stop", 1e2, signed=True),
    ),
    adds=Parts((Storage("x_c", "stop", ("k_c", "g_c"), "m"),), couplings=(Coupling("x_c", "p", 1.0),)),
    grid=grid,
    applies=has_motion,
    neighbours=("amplifier_saturation", "quadratic_stiffness", "cubic_stiffness"),
)
