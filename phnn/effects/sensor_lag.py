"""A sensor that lags behind the displacement."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Scales, at_sensor, kinds, time_constant


def grid(scales: Scales) -> list[dict[str, float]]:
    """A lag that is small against the fastest line, and two finite corners, where the response is not proportional."""
    unit = 1.0 / (2.0 * np.pi * scales.fastest)
    return [{"tau_y": unit * share} for share in (1e-3, 0.1, 1.0, 10.0)]


EFFECT = Effect(
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
    grid=grid,
    neighbours=("amplifier_lowpass", "delay"),
)
