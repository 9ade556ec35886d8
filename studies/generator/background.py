"""A background of small mismatch: a little creep and a little asymmetry of the hysteresis that no case is about."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phnn.errors import SolverFailed
from studies.generator.concealed import Concealed, draw
from studies.generator.excitation import Excitation
from studies.generator.strength import concealing, find_strength, ruler

KINDS = ("creep", "hysteresis_asymmetry")
_LEVELS = (0.3, 1.0)  # residual over noise that all of it leaves
_CLOSE = 0.05

Rng = np.random.Generator


@dataclass(frozen=True)
class Background:
    """What acts beside what is concealed.

    Attributes:
        parameters: for the simulation, SI.
        effects: canonical names.
        level: root mean square that it leaves beyond a refit of the base model, over the noise.
    """

    parameters: Mapping[str, float]
    effects: tuple[str, ...]
    level: float


NOTHING = Background({}, (), 0.0)


def draw_background(
    rng: Rng, base: Mapping[str, float], plan: Sequence[Excitation], noise: float, without: Sequence[str]
) -> Background:
    """Creep and asymmetry that together leave 0.3 to 1 × the noise, in a drawn proportion.

    Args:
        rng: random numbers of the background alone.
        base: parameters of the actuator, SI.
        plan: the recordings.
        noise: standard deviation, m.
        without: takes no part in the background: what is concealed itself, or has no meaning in this actuator.
    """
    total, angle = float(rng.uniform(*_LEVELS)), float(rng.uniform(0.1, 0.4)) * math.pi
    effects = [draw(name, rng, base, plan) for name in KINDS]
    chosen = [(e, s) for e, s in zip(effects, (math.cos(angle), math.sin(angle)), strict=True) if e.name not in without]
    measure = ruler(base, tuple(plan))
    found: list[tuple[Concealed, float]] = []
    for effect, share in chosen:
        target = total * noise * (share if len(chosen) > 1 else 1.0)
        try:
            strength, _ = find_strength(
                lambda z, of=effect: measure.residual(of, z),  # type: ignore[misc]
                effect.guess,
                effect.most,
                target,
                _CLOSE,
            )
        except SolverFailed:
            continue  # it cannot be that strong on these recordings
        found.append((effect, strength))
    left = measure.left(concealing(base, plan, found))
    parameters = {n: v for effect, strength in found for n, v in effect.law(strength).items()}
    return Background(parameters, tuple(e.name for e, _ in found), float(np.sqrt(np.mean(left**2))) / noise)
