"""A delay of the voltage, in the amplifier or in the electronics before it."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Scales, at_amplifier, kinds, time_constant


def grid(scales: Scales) -> list[dict[str, float]]:
    """A delay that is small against the fastest line, and two finite delays, where the response is not proportional."""
    unit = 1.0 / (2.0 * np.pi * scales.fastest)
    return [{"tau_d": unit * share} for share in (1e-3, 0.03, 0.3)]


EFFECT = Effect(
    name="delay",
    kind=kinds.LAG,
    equation=r"V(t) = u(t - \tau_d)",
    statement="The voltage follows its command with a delay of {tau_d} at every frequency. The displacement alone "
    "does not tell this delay from one of the sensor.",
    fingerprint="A phase that falls in proportion to the frequency while the gain stays as it is.",
    separation="A step of the command sampled much faster than the delay: a delay shows nothing and then all of it, "
    "a low-pass or a lagging sensor responds at once.",
    references=("Åström & Wittenmark 1997, Computer-Controlled Systems",),
    declares=(
        time_constant("tau_d", "delay of the voltage", strength=True).plausibly(
            0.0, 0.01, "converters and buffers hold a signal for 10 ms at most"
        ),
    ),
    adds=at_amplifier("delay"),
    grid=grid,
    neighbours=("amplifier_lowpass", "sensor_lag"),
)
