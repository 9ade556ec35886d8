"""Effects of the sensor: play, drift, lag, and characteristics that are not straight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phnn.effects import kinds
from phnn.effects.additions import OfEveryRecording, Placed, at_sensor
from phnn.effects.declaration import positive, signed, time_constant
from phnn.effects.effect import Effect, Points, Scales
from phnn.setup import DRIFT_TERMS, Setup


def backlash_grid(scales: Scales) -> list[dict[str, float]]:
    """Return three half-widths, from below the noise to a few hundredths of the displacement."""
    widest = 0.03 * scales.sensed
    least = min(0.3 * scales.noise, 0.1 * widest)
    return [{"delta_b": float(width)} for width in np.geomspace(least, widest, 3)]


def measures_a_motion(setup: Setup) -> bool:
    """Return whether the sensor measures a motion, not the force that an imposed motion takes."""
    return not setup.network.senses


OUTPUT_BACKLASH = Effect(
    name="output_backlash",
    kind=kinds.LAG_OR_PLAY,
    equation=r"|q - y| \leq \delta_b, \quad \dot{y} \neq 0 \ \mathrm{only\ where}\ |q - y| = \delta_b",
    statement="There is play between the moving part and the measured point: after each reversal the output "
    "rests until the actuator has moved by twice {delta_b}.",
    fingerprint="A plateau of the output after every reversal, as wide at every amplitude and frequency.",
    separation="Small triangles whose amplitude grows from nothing: play shows no motion at all below its width, "
    "friction and a hysteron show a smaller one.",
    references=("Brokate & Sprekels 1996, Hysteresis and Phase Transitions, ch. 2 (play operator)",),
    declares=(
        positive("delta_b", "{sensed}", "half-width of the play at the output", 1e4, strength=True).plausibly(
            0.0, 1e-4, "joints have less than 0.1 mm of play"
        ),
    ),
    adds=at_sensor("play"),
    grid=backlash_grid,
    applies=measures_a_motion,
    neighbours=("coulomb_friction", "extra_hysteron"),
)


def wander(setup: Setup, parameters: Placed) -> Setup:
    """Return ``y = q + Σ_m c_m cos(πmt/T)`` with coefficients for each recording."""
    return replace(setup, own=setup.own._replace(drift_terms=DRIFT_TERMS))


def steady(setup: Setup) -> bool:
    """Return whether recordings have no drift of their own yet."""
    return not setup.own.drift_terms


def wandering(setup: Setup) -> bool:
    """Return whether the sensor has no drift yet, neither a ramp nor one for each recording, and its zero is not known
    to be the same in all recordings."""
    return steady(setup) and "drift_rate" not in setup.parameters and not setup.has_zero


SENSOR_DRIFT = Effect(
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
    grid=Points({"drift_rate": (1.0, "noise", "1/duration")}),
    applies=steady,
    neighbours=("creep",),
).or_as(
    equation=rf"y = q + \sum_{{m=1}}^{{{DRIFT_TERMS}}} c_m \cos(\pi m t/T)",
    statement="The sensor wanders slowly, in every recording differently and independently of the actuator.",
    declares=(),
    adds=OfEveryRecording(wander),
    grid=Points({}),
    applies=wandering,
)


SENSOR_LAG = Effect(
    name="sensor_lag",
    kind=kinds.LAG_OR_PLAY,
    equation=r"\tau_y \dot{y} = q - y",
    statement="The sensor lags behind the displacement: it is a low-pass with a time constant of {tau_y}.",
    fingerprint="A phase lag that grows with frequency, and noise that the same low-pass colours if it arises "
    "before the filter.",
    separation="A blow to the mass at constant voltage: a sensor lags behind that as well, an amplifier cannot; or "
    "another sensor beside this one.",
    references=("Fleming 2013, Sensors and Actuators A 190 (position sensors), sec. 2",),
    declares=(
        time_constant("tau_y", "time constant of the sensor", strength=True).plausibly(
            1e-8, 1e-2, "position sensors have bandwidths of 20 Hz to 10 MHz (Fleming 2013)"
        ),
    ),
    adds=at_sensor("lag"),
    # Small against the fastest line, and finite corners, where the response is not proportional.
    grid=Points(*({"tau_y": (share, "shortest")} for share in (1e-3, 0.1, 1.0, 10.0))),
    neighbours=("amplifier_lowpass", "delay"),
)


# Typical values for coefficients that start at zero: an error of a hundredth at a tenth of a millimetre.
_SQUARE, _CUBE = 1e2, 1e6


SENSOR_NONLINEARITY = Effect(
    name="sensor_nonlinearity",
    kind=kinds.SENSOR_NONLINEAR,
    equation=r"y = q + a_2 q^2 + a_3 q^3",
    statement="The sensor is not linear: it adds {a_2} times the square and {a_3} times the cube of the displacement "
    "to its reading, at any speed.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, the same at every frequency and "
    "across the resonance.",
    separation="The same sine once with the sensor moved along its range: the sensor's error moves with it, a "
    "nonlinearity of the actuator does not.",
    references=("Fleming 2013, Sensors and Actuators A 190 (position sensors), sec. 2.1",),
    declares=(
        signed("a_2", "1/{sensed}", "quadratic error", 1e9, _SQUARE, strength=True, own_size=True),
        signed("a_3", "1/{sensed}^2", "cubic error", 1e15, _CUBE, strength=True, own_size=True),
    ),
    adds=at_sensor("polynomial"),
    # One point for each coefficient; the law is linear in both.
    grid=Points({"a_2": (1e-3, "1/sensed"), "a_3": 0.0}, {"a_2": 0.0, "a_3": (1e-3, "1/sensed", "1/sensed")}),
    neighbours=("electrostriction", "displacement_coupling", "quadratic_stiffness"),
)


def shows_signs(setup: Setup) -> bool:
    """No block of the sensor rectifies already."""
    return all(block.kind != "rectification" for block in setup.sensor)


SENSOR_RECTIFICATION = Effect(
    name="sensor_rectification",
    kind=kinds.SENSOR_NONLINEAR,
    equation=r"y = |q|",
    statement="The sensor shows how far the output is from its zero, not on which side: it rectifies.",
    fingerprint="An output that never crosses its zero but turns back at it with a sharp corner, at twice the "
    "frequency of the drive.",
    separation="The same sine about an offset larger than its amplitude: a rectifier does not change it.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    adds=at_sensor("rectification"),
    grid=Points({}),
    applies=shows_signs,
    neighbours=("sensor_nonlinearity",),
)
