"""An amplifier whose voltage can change at a limited rate only."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.effects.effect import Effect, Plausible, Scales
from phnn.parameters import Parameter
from phnn.setup import Block, Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``|V̇| ≤ S`` before the port: a limited current into the capacitance of the actuator."""
    rate = values["S"]
    parameter = Parameter("S", rate, "V/s", 1e-3 * rate, 1e3 * rate, positive=True, description="largest slew rate")
    return setup.with_block("amplifier", Block("slew_limit", ("S",)), (parameter,))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Limits below the steepest of the sines there may have been, and decades above it: a step of the command is
    steeper than any. There is no small strength to start from."""
    steepest = 2.0 * np.pi * scales.fastest * scales.voltage
    return [{"S": share * steepest} for share in (0.5, 0.75, 0.9, 0.98, 4.0, 40.0, 400.0)]


EFFECT = Effect(
    name="slew_limit",
    location="amplifier",
    kind="slew",
    equation=r"|\dot{V}| \leq S",
    statement="The voltage cannot change faster than {S}: the current of the amplifier is limited, so that large fast "
    "commands become triangles.",
    fingerprint="Triangles instead of sines as soon as amplitude times frequency crosses a line, and nothing below it.",
    separation="Sines of one amplitude times frequency at frequencies far apart: a slew limit acts on all of them "
    "alike, drag and a limit of the voltage do not.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    passive=False,
    strength=None,
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("S",),
    plausible={"S": Plausible(1e2, 1e9, "1 mA into 10 µF to 10 A into 10 nF")},
    needs_command=True,
    neighbours=("quadratic_drag", "amplifier_saturation"),
)
