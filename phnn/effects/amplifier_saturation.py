"""An amplifier that clips."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales
from phnn.parameters import Parameter
from phnn.setup import Block, Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V = clip(u, ±V_max)`` before the port."""
    limit = values["V_max"]
    parameter = Parameter("V_max", limit, "V", 1e-3 * limit, 1e3 * limit, positive=True, description="amplifier limit")
    return setup.with_block("amplifier", Block("saturation", ("V_max",)), (parameter,))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Limits somewhat below the largest command; there is no small strength to start from."""
    return [{"V_max": share * scales.voltage} for share in (0.995, 0.98, 0.95, 0.9, 0.8, 0.65, 0.5)]


EFFECT = Effect(
    name="amplifier_saturation",
    location="amplifier",
    kind="limit",
    equation=r"V = \mathrm{clip}(u, \pm V_{max})",
    statement="The amplifier saturates: beyond {V_max} the voltage no longer follows the command, at any frequency.",
    fingerprint="Flat tops begin at one amplitude of the command, at every frequency and on both sides.",
    separation="Sines of rising amplitude about two offsets of the voltage: a limit of the amplifier stays at its "
    "voltage, a stop at its displacement.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    passive=False,
    strength=None,
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("V_max",),
    needs_command=True,
    neighbours=("contact_stop", "cubic_stiffness"),
)
