"""An amplifier with a limited slew rate of the voltage."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Scales, at_amplifier, kinds, limit


def grid(scales: Scales) -> list[dict[str, float]]:
    """Limits below the steepest sine of the command, and decades above it, as a step is steeper than any sine. No
    small strength exists to start from."""
    steepest = 2.0 * np.pi * scales.fastest * scales.voltage
    return [{"S": share * steepest} for share in (0.5, 0.75, 0.9, 0.98, 4.0, 40.0, 400.0)]


EFFECT = Effect(
    name="slew_limit",
    kind=kinds.SLEW,
    equation=r"|\dot{V}| \leq S",
    statement="The voltage cannot change faster than {S}: the current of the amplifier is limited, so that large fast "
    "commands become triangles.",
    fingerprint="Triangles instead of sines as soon as amplitude times frequency crosses a line, and nothing below it.",
    separation="Sines of one amplitude times frequency at frequencies far apart: a slew limit acts on all of them "
    "alike, drag and a limit of the voltage do not.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    declares=(limit("S", "V/s", "largest slew rate", 1e3).plausibly(1e2, 1e9, "1 mA into 10 µF to 10 A into 10 nF"),),
    adds=at_amplifier("slew_limit"),
    grid=grid,
    neighbours=("quadratic_drag", "amplifier_saturation"),
)
