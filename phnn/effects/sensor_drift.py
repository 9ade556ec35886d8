"""A drifting sensor: a ramp, or slow wandering."""

from __future__ import annotations

from dataclasses import replace

from phnn.effects import Effect, OfEveryRecording, Placed, Scales, at_sensor, kinds, signed
from phnn.setup import DRIFT_TERMS, Setup


def wander(setup: Setup, parameters: Placed) -> Setup:
    """``y = q + Σ_m c_m cos(πmt/T)`` with coefficients for each recording."""
    return replace(setup, own=setup.own._replace(drift_terms=DRIFT_TERMS))


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"drift_rate": scales.noise / scales.duration}]


def steady(setup: Setup) -> bool:
    """Recordings have no drift of their own yet."""
    return not setup.own.drift_terms


def grid_wandering(scales: Scales) -> list[dict[str, float]]:
    """No parameters: the coefficients are nuisances of the recordings."""
    return [{}]


def wandering(setup: Setup) -> bool:
    """The sensor has no drift yet, neither a ramp nor one for each recording, and its zero is not known to be the
    same in all recordings."""
    return steady(setup) and "drift_rate" not in setup.parameters and not setup.has_zero


EFFECT = Effect(
    name="sensor_drift",
    kind=kinds.DRIFT,
    equation=r"y = q + r\,t",
    statement="The sensor drifts by {drift_rate}, independently of the actuator.",
    fingerprint="A ramp below the lowest excited frequency that does not depend on the voltage.",
    separation="A recording at zero voltage, as long as the others, after a long rest: a sensor drifts then as well, "
    "creep does not.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    declares=(
        signed("drift_rate", "{sensed}/s", "rate of the sensor's drift", 1.0, 1e-8, strength=True).plausibly(
            -2e-8, 2e-8, "a steel frame of 0.1 m grows by 20 nm/s where it warms by 1 K a minute"
        ),
    ),
    adds=at_sensor("drift"),
    grid=grid,
    applies=steady,
    neighbours=("creep",),
).or_as(
    equation=rf"y = q + \sum_{{m=1}}^{{{DRIFT_TERMS}}} c_m \cos(\pi m t/T)",
    statement="The sensor wanders slowly, in every recording differently and independently of the actuator.",
    declares=(),
    adds=OfEveryRecording(wander),
    grid=grid_wandering,
    applies=wandering,
)
