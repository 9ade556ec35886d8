"""Noise that acts before the sensor: a random force on the mass, and errors of the sampling instants.

Nobody records either of them. The force passes through the plant, so that what it adds to the output has the plant's
resonance, and differs where hysterons slip. An error of an instant adds the speed times that error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.generator.concealed import stuck_stiffness
from studies.generator.disturbance import FORCE_STEP, Disturbance
from studies.generator.excitation import Excitation
from studies.generator.noise import JITTERED, PROCESS, Noise
from studies.generator.parameters import Array

Plan = Sequence[Excitation]
Outputs = tuple[Array, ...]
Simulated = Callable[[Sequence[Disturbance]], Outputs]
Streams = Callable[[str, int], np.random.Generator]


@dataclass(frozen=True, eq=False)
class Disturbed:
    """Outputs with what nobody records.

    Attributes:
        outputs: of each recording, (samples,), m.
        power: mean square of what was added, over all recordings, each without its mean, m².
    """

    outputs: Outputs
    power: float


def disturbed(
    noise: Noise, base: Mapping[str, float], plan: Plan, calm: Outputs, simulated: Simulated, streams: Streams
) -> Disturbed:
    """Simulate the recordings once more, with the disturbance of the noise's family; ``calm`` where it has none.

    Args:
        noise: decides the kind and the size.
        base: parameters of the actuator; they give the force's first guess.
        calm: outputs without disturbance.
        simulated: outputs with disturbances, one per recording.
        streams: random numbers by use and number of the recording.
    """
    if noise.family == PROCESS:
        return _pushed(noise, base, plan, calm, simulated, streams)
    if noise.family == JITTERED:
        return _late(noise, plan, calm, simulated, streams)
    return Disturbed(calm, 0.0)


def _pushed(
    noise: Noise, base: Mapping[str, float], plan: Plan, calm: Outputs, simulated: Simulated, streams: Streams
) -> Disturbed:
    """A force of white samples every 25 µs, straight in between, scaled by one pilot simulation.

    White force of variance ``a²`` and sample time ``h`` gives an oscillator the variance ``a² h/(2 b k)``.
    """
    wanted = noise.amount * noise.deviation**2
    guess = math.sqrt(2.0 * base["b"] * stuck_stiffness(base) * wanted / FORCE_STEP)
    unit = [_unit_force(excitation, streams("force", i)) for i, excitation in enumerate(plan)]

    def pushed(size: float) -> Disturbed:
        outputs = simulated([Disturbance(force=size * force) for force in unit])
        return Disturbed(outputs, added_power(outputs, calm))

    pilot = pushed(guess)
    return pushed(guess * math.sqrt(wanted / pilot.power))


def _unit_force(excitation: Excitation, rng: np.random.Generator) -> Array:
    return rng.standard_normal(math.ceil(excitation.pieces[-1].end / FORCE_STEP) + 2)


def _late(noise: Noise, plan: Plan, calm: Outputs, simulated: Simulated, streams: Streams) -> Disturbed:
    """Independent Gaussian errors of the instants, of one size in all recordings."""
    fastest = max(float(np.sqrt(np.mean(np.gradient(q, e.dt) ** 2))) for e, q in zip(plan, calm, strict=True))
    size = noise.amount * noise.deviation / fastest
    late = [Disturbance(late=size * streams("late", i).standard_normal(e.samples)) for i, e in enumerate(plan)]
    outputs = simulated(late)
    return Disturbed(outputs, added_power(outputs, calm))


def added_power(outputs: Outputs, calm: Outputs) -> float:
    """Mean square of what was added, each recording without its mean, m²."""
    added = [q - q_0 for q, q_0 in zip(outputs, calm, strict=True)]
    return float(np.mean(np.concatenate([d - d.mean() for d in added]) ** 2))
