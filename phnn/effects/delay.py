"""An amplifier, or the electronics before it, that passes on its command some time later."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Scales, at_amplifier, kinds, time_constant


def grid(scales: Scales) -> list[dict[str, float]]:
    """Small against the fastest line, and two finite delays where the response is no longer proportional."""
    unit = 1.0 / (2.0 * np.pi * scales.fastest)
    return [{"tau_d": unit * share} for share in (1e-3, 0.03, 0.3)]


EFFECT = Effect(
    name="delay",
    kind=kinds.LAG,
    equation=r"V(t) = u(t - \tau_d)",
    statement="The voltage follows its command {tau_d} late, at every frequency alike: a delay of the electronics, "
    "which the displacement shows as if its sensor were late.",
    fingerprint="A phase that falls in proportion to the frequency while the gain stays as it is.",
    separation="A step of the command sampled much faster than the delay: a delay holds still and then repeats it, a "
    "low-pass or a lagging sensor begins at once.",
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
