"""A setup: amplifier → network → sensor, the thing a folder of recordings is a recording *of*.

The blocks before and behind the network are not passive and stand openly outside its passive core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import StructureViolated
from phnn.integrate.compiled import entry
from phnn.laws.namespace import absolute, exp, log1p, real, shared, where
from phnn.network.elements import Network
from phnn.parameters import Parameter, as_table, with_values

Array = NDArray[Any]


@dataclass(frozen=True)
class Block:
    """One element of the measuring chain: a kind registered in `AMPLIFIERS` or `SENSORS` and its parameters."""

    kind: str
    parameters: tuple[str, ...] = ()


@dataclass(frozen=True)
class Setup:
    """What is between the recorded input and the recorded output.

    Attributes:
        network: the passive core.
        amplifier: blocks from the recorded input to the port.
        sensor: blocks from the network's output to the recorded output.
        block_parameters: parameters of the blocks, by name.
        name: for tables and reports.
    """

    network: Network
    amplifier: tuple[Block, ...] = ()
    sensor: tuple[Block, ...] = ()
    block_parameters: Mapping[str, Parameter] | None = None
    name: str = "model"

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """All parameters, the network's first."""
        return as_table((*self.network.parameters.values(), *(self.block_parameters or {}).values()))

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that may be estimated."""
        return tuple(n for n, p in self.parameters.items() if not p.fixed)

    def values(self) -> dict[str, float]:
        """Parameter values by name, SI."""
        return {n: p.value for n, p in self.parameters.items()}

    def with_values(self, values: Mapping[str, float]) -> Setup:
        """The same setup with other parameter values."""
        blocks = self.block_parameters or {}
        unknown = sorted(set(values) - set(self.parameters))
        if unknown:
            raise StructureViolated(f"no parameter called {', '.join(unknown)} in {self.name}")
        return replace(
            self,
            network=self.network.with_values({n: v for n, v in values.items() if n not in blocks}),
            block_parameters=with_values(blocks, {n: v for n, v in values.items() if n in blocks}),
        )

    def with_block(self, stage: str, block: Block, parameters: tuple[Parameter, ...]) -> Setup:
        """The setup with one more block at the end of the ``amplifier`` or ``sensor`` stage."""
        table = as_table((*(self.block_parameters or {}).values(), *parameters))
        if stage == "amplifier":
            return replace(self, amplifier=(*self.amplifier, block), block_parameters=table)
        return replace(self, sensor=(*self.sensor, block), block_parameters=table)


def lowpass(fine: Array, h: Array, before: float, tau: Any) -> Array:
    """``τ V̇ = u − V`` exactly for an input that is linear between the points of the sub-steps."""
    z = 0.5 * h / tau
    a = exp(-z)
    mean = (1.0 - a) / z
    return np.asarray(_first_order(fine + 0.0 * tau, a, mean - a, 1.0 - mean, before + 0.0 * tau))


def _first_order_loop(fine: Any, a: Any, b0: Any, b1: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    for n in range(fine.shape[0]):
        out[n, 0] = state
        state = a[n] * state + b0[n] * fine[n, 0] + b1[n] * fine[n, 1]
        out[n, 1] = state
        state = a[n] * state + b0[n] * fine[n, 1] + b1[n] * fine[n, 2]
        out[n, 2] = state
    return out


def saturation(fine: Array, h: Array, before: float, limit: Any) -> Array:
    """``V = clip(u, ±V_max)``."""
    return np.asarray(where(absolute(real(fine)) > real(limit), np.sign(real(fine)) * limit, fine + 0.0 * limit))


def bouc_wen(fine: Array, h: Array, before: float, a: Any, beta: Any, gamma: Any, weight: Any) -> Array:
    """``V − w h`` with ``ḣ = A V̇ − β|V̇|h − γ|h|V̇`` (eq. (19)), exact for an input monotone between points."""
    # All of them complex where one is, so that the loop is compiled for two types only.
    zero = 0.0 * (a + beta + gamma)
    state = _bouc_wen_state(fine + zero, before + zero, a + zero, beta + zero, gamma + zero)
    return np.asarray(fine - weight * state)


def _bouc_wen_loop(fine: Any, last: Any, a: Any, beta: Any, gamma: Any) -> Any:
    out = np.empty_like(fine)
    state = 0.0 * last
    for n in range(fine.shape[0]):
        for i in range(3):
            rise = fine[n, i] - last
            last = fine[n, i]
            # With s = h·sign(V̇) both directions obey ds/d|V| = A − β s − γ|s|: one exponential a sign of s.
            side = where(real(rise) >= 0.0, 1.0, -1.0)
            length = absolute(rise)
            s = side * state
            if real(s) < 0.0:
                rate = beta - gamma
                # Length until s = 0; further than the step where it is not met at all.
                inside = real(1.0 - rate * s / a)
                straight = abs(real(rate * s / a)) < 1e-9
                meet = 2.0 * length + 1.0
                if straight:
                    meet = -s / a
                elif inside > 0.0:
                    meet = log1p(-rate * s / a) / rate
                if real(meet) < real(length):
                    s = 0.0 * s
                    length = length - meet
                else:
                    s = _approach(s, a, rate, length)
                    length = 0.0 * length
            s = _approach(s, a, beta + gamma, length)
            state = side * s
            out[n, i] = state
    return out


@shared
def _approach(s: Any, a: Any, rate: Any, length: Any) -> Any:
    """``ds/dL = A − rate·s`` over a length."""
    z = rate * length
    factor = 1.0 - 0.5 * z
    if abs(real(z)) > 1e-6:
        factor = (1.0 - exp(-z)) / z
    return s + (a - rate * s) * length * factor


def drift(y: Array, t: Array, rate: Any) -> Array:
    """``y + r t``: a sensor that drifts at a constant rate."""
    return np.asarray(y + rate * t)


_first_order = entry(_first_order_loop)
_bouc_wen_state = entry(_bouc_wen_loop)

AMPLIFIERS: dict[str, Callable[..., Array]] = {"lowpass": lowpass, "saturation": saturation, "bouc_wen": bouc_wen}
SENSORS: dict[str, Callable[..., Array]] = {"drift": drift}
