"""The strength of an effect: the change of the output that refitted base parameters cannot explain."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phnn.errors import SolverFailed
from studies.generator.actuator import Array, simulate_all
from studies.generator.base import moving
from studies.generator.concealed import Concealed, drifts
from studies.generator.disturbance import Disturbance
from studies.generator.excitation import Excitation
from studies.generator.noise import Noise

Stack = Callable[[Sequence[Array]], Array]

_STEP = 1e-2  # relative step of the differences; the solver's error of 1e-8 is far below what they resolve
_AHEAD = 5e-4  # relative step of forward differences
_FAINT = {"rho_1": 3e-2}  # steps of parameters that move the output so little that the solver's error would show
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
        stacked: joins what changes in each recording, without what its zero can take.
    """

    base: Mapping[str, float]
    plan: tuple[Excitation, ...]
    undisturbed: tuple[Array, ...]
    tangent: Array
    stacked: Stack = _stacked

    def left(self, outputs: Sequence[Array]) -> Array:
        """What the linear refit of the base model leaves of ``outputs``, (samples,)."""
        change = self.stacked([q - q_0 for q, q_0 in zip(outputs, self.undisturbed, strict=True)])
        left: Array = change - self.tangent @ (self.tangent.T @ change)
        return left

    def residual(self, effect: Concealed, strength: float) -> float:
        """Root mean square [m] of the change that is left after the linear refit of the base model."""
        return float(np.sqrt(np.mean(self.left(concealing(self.base, self.plan, [(effect, strength)])) ** 2)))


def concealing(
    base: Mapping[str, float],
    plan: Sequence[Excitation],
    effects: Sequence[tuple[Concealed, float]],
    disturbances: Sequence[Disturbance] = (),
) -> tuple[Array, ...]:
    """Outputs with effects of given strengths, one array per recording, m; ``disturbances`` as of ``simulate_all``."""
    values = dict(base)
    for effect, strength in effects:
        values.update(effect.law(strength))
    outputs = simulate_all(values, plan, disturbances)
    for effect, strength in effects:
        outputs = tuple(q + d for q, d in zip(outputs, drifts(effect, strength, plan), strict=True))
    return outputs


def ruler(base: Mapping[str, float], plan: tuple[Excitation, ...]) -> Ruler:
    """Simulates the base model and its sensitivities (central differences in each of its parameters)."""
    columns = []
    for name in moving(base):
        above = simulate_all({**base, name: base[name] * (1.0 + _STEP)}, plan)
        below = simulate_all({**base, name: base[name] * (1.0 - _STEP)}, plan)
        columns.append(_stacked([(a - b) / (2.0 * _STEP) for a, b in zip(above, below, strict=True)]))
    # One direction, the common factor of all impedances, moves nothing: its singular value is rounding.
    return Ruler(base, plan, simulate_all(base, plan), _basis(columns))


def rulers(base: Mapping[str, float], plan: tuple[Excitation, ...], noise: Noise) -> tuple[Ruler, Ruler]:
    """Rulers of displacement in m, and of displacement whitened by the noise, from one set of forward differences.

    The mass is left alone: the others span all changes, for a common factor of all impedances moves
    nothing, and forward differences would turn that nothing into a direction of their own.
    """
    undisturbed = simulate_all(base, plan)
    changes = []
    for name in (n for n in moving(base) if n != "m"):
        part = _FAINT.get(name, _AHEAD)
        ahead = simulate_all({**base, name: base[name] * (1.0 + part)}, plan)
        changes.append([(a - q) / part for a, q in zip(ahead, undisturbed, strict=True)])

    def white(paths: Sequence[Array]) -> Array:
        return np.concatenate([_without_zero(path, noise) for path in paths])

    stacks: tuple[Stack, Stack] = (_stacked, white)
    first, second = (Ruler(base, plan, undisturbed, _basis([s(c) for c in changes]), s) for s in stacks)
    return first, second


def _without_zero(path: Array, noise: Noise) -> Array:
    """The whitened path without what the (whitened) zero of its recording can take."""
    zero, white = noise.whitened(np.ones_like(path)), noise.whitened(path)
    rest: Array = white - zero * ((zero @ white) / (zero @ zero))
    return rest


def _basis(columns: Sequence[Array]) -> Array:
    basis, sizes, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    kept: Array = basis[:, sizes > 1e-6 * sizes[0]]
    return kept


def find_strength(
    residual: Callable[[float], float], guess: float, most: float, target: float, close: float = _CLOSE
) -> tuple[float, float]:
    """The strength whose residual, in m or in units of the noise, is ``target``: bracketed secants in logarithms.

    Args:
        residual: of a strength; called last with the strength that is returned.
        guess: a strength to begin with.
        most: largest strength.
        target: wanted residual.
        close: accepted relative distance from the target.

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
        if abs(value / target - 1.0) < close:
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
    raise SolverFailed(f"no strength up to {most:g} leaves what is wanted, {target:g}: draw another seed")
