"""How strong an effect is: what it changes in the output that the base model could not take over."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phnn.demo.actuator import TABLE, Array, simulate_all
from phnn.demo.concealed import Concealed, drifts
from phnn.demo.excitation import Excitation
from phnn.errors import SolverFailed

_STEP = 1e-2  # relative step of the differences; the solver's error of 1e-8 is far below what they resolve
_CLOSE = 0.02  # accepted relative distance from the target


def _stacked(paths: Sequence[Array]) -> Array:
    """All recordings in one vector, (sum of samples,), each without its mean: the zero of a recording is free."""
    return np.concatenate([path - path.mean() for path in paths])


@dataclass(frozen=True)
class Ruler:
    """Measures effects against one base model.

    Attributes:
        base: parameters, SI.
        plan: the recordings.
        undisturbed: output of the base model, one array per recording, m.
        tangent: orthonormal basis of what the base parameters can change, (samples, rank).
    """

    base: Mapping[str, float]
    plan: tuple[Excitation, ...]
    undisturbed: tuple[Array, ...]
    tangent: Array

    def residual(self, effect: Concealed, strength: float) -> float:
        """Root mean square [m] of the change that is left after the linear refit of the base model."""
        moved = simulate_all({**self.base, **effect.law(strength)}, self.plan)
        ramps = drifts(effect, strength, self.plan)
        change = _stacked([q - q_0 + ramp for q, q_0, ramp in zip(moved, self.undisturbed, ramps, strict=True)])
        left = change - self.tangent @ (self.tangent.T @ change)
        return float(np.sqrt(np.mean(left**2)))


def ruler(base: Mapping[str, float], plan: tuple[Excitation, ...]) -> Ruler:
    """Simulates the base model and its sensitivities (central differences in each of its ten parameters)."""
    columns = []
    for name in TABLE:
        above = simulate_all({**base, name: base[name] * (1.0 + _STEP)}, plan)
        below = simulate_all({**base, name: base[name] * (1.0 - _STEP)}, plan)
        columns.append(_stacked([(a - b) / (2.0 * _STEP) for a, b in zip(above, below, strict=True)]))
    basis, sizes, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    # One direction, the common factor of all impedances, moves nothing: its singular value is rounding.
    return Ruler(base, plan, simulate_all(base, plan), basis[:, sizes > 1e-6 * sizes[0]])


def find_strength(residual: Callable[[float], float], guess: float, most: float, target: float) -> tuple[float, float]:
    """The strength whose residual is ``target``, by secants in logarithms inside a bracket.

    Returns:
        The strength, and the residual it has.

    Raises:
        SolverFailed: even the largest strength stays below the target.
    """
    low, high = 0.0, math.inf  # strengths known to be too weak, too strong
    strength, slope = guess, 1.0
    last: tuple[float, float] | None = None
    for _ in range(40):
        value = residual(strength)
        if abs(value / target - 1.0) < _CLOSE:
            return strength, value
        if value < target:
            low = max(low, strength)
        else:
            high = min(high, strength)
        if low >= most:
            break
        if last is not None and value > 0.0 and last[1] > 0.0 and strength != last[0]:
            slope = min(max(math.log(value / last[1]) / math.log(strength / last[0]), 0.3), 4.0)
        last = strength, value
        # A threshold can hide a weak effect altogether: then the strength has to grow before a secant exists.
        strength = min(
            strength * (min(max((target / value) ** (1.0 / slope), 0.05), 20.0) if value > 0.0 else 5.0), most
        )
        if not low < strength < high and math.isfinite(high):
            strength = math.sqrt(low * high) if low > 0.0 else 0.2 * high
    raise SolverFailed(f"no strength up to {most:g} leaves a residual of {target:g} m: draw another seed")
