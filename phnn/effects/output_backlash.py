"""Play between the moving part and the measured point."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Scales, at_sensor, kinds, positive


def grid(scales: Scales) -> list[dict[str, float]]:
    """Three half-widths, from below the noise to a few hundredths of the displacement."""
    widest = 0.03 * scales.sensed
    least = min(0.3 * scales.noise, 0.1 * widest)
    return [{"delta_b": float(width)} for width in np.geomspace(least, widest, 3)]


EFFECT = Effect(
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
    grid=grid,
    neighbours=("coulomb_friction", "extra_hysteron"),
)
