"""A sensor that drifts, straight on or to and fro."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Plausible, Scales, sensed_unit
from phnn.parameters import signed
from phnn.setup import COURSES, Block, Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = q + r t`` with the time of the recording."""
    rate = values["drift_rate"]
    parameter = signed("drift_rate", rate, f"{sensed_unit(setup)}/s", 1.0, 1e-8, "rate of the sensor's drift")
    return setup.with_block("sensor", Block("drift", ("drift_rate",)), (parameter,))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"drift_rate": scales.noise / scales.duration}]


def steady(setup: Setup) -> bool:
    """The sensor has no course of its own in every recording yet."""
    return not setup.own.courses


def build_wandering(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = q + Σ_m c_m cos(πmt/T)``, every recording with coefficients of its own."""
    return replace(setup, own=setup.own._replace(courses=COURSES))


def grid_wandering(scales: Scales) -> list[dict[str, float]]:
    """No parameters: the coefficients are the recordings' own."""
    return [{}]


def wandering(setup: Setup) -> bool:
    """The sensor neither drifts straight on nor has a course of its own in every recording yet, nor is its zero known
    to be one and the same in all recordings."""
    return steady(setup) and "drift_rate" not in setup.parameters and not setup.has_zero


_STRAIGHT = Effect(
    name="sensor_drift",
    location="sensor",
    kind="drift",
    equation=r"y = q + r\,t",
    statement="The sensor drifts by {drift_rate}, whatever the actuator does.",
    fingerprint="A ramp below the lowest excited frequency that goes on whatever the voltage does.",
    separation="A recording at zero voltage, as long as the others, after a long rest: a sensor drifts then as well, "
    "creep does not.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    passive=False,
    strength="drift_rate",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("drift_rate",),
    plausible={
        "drift_rate": Plausible(-2e-8, 2e-8, "a steel frame of 0.1 m grows by 20 nm/s where it warms by 1 K a minute")
    },
    applies=steady,
    neighbours=("creep",),
)
EFFECT = replace(
    _STRAIGHT,
    forms=(
        replace(
            _STRAIGHT,
            equation=rf"y = q + \sum_{{m=1}}^{{{COURSES}}} c_m \cos(\pi m t/T)",
            statement="The sensor wanders slowly, otherwise in every recording and whatever the actuator does.",
            grid=grid_wandering,
            build=build_wandering,
            strength=None,
            parameters=(),
            plausible={},
            applies=wandering,
        ),
    ),
)
