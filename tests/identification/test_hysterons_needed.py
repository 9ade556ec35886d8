"""Which hysteresis a base model needs, on models of which only their errors are known."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest

from phnn.errors import PhnnError
from phnn.identification import order
from phnn.identification.gain import Gain


def a_gain(before: float, after: float, p: float | None) -> Gain:
    change = before**2 - after**2
    size = math.copysign(math.sqrt(abs(change)), change)
    return Gain(before, after, 1e-8 * size, size, 40 if p is not None else 3, p, None if p is None else 1.0 - p)


@pytest.mark.parametrize(
    ("left", "falls", "known", "chosen"),
    [
        ({1: 9.0, 2: 5.0, "bouc_wen": 1.05}, 1e-6, (), "bouc_wen"),  # which leaves nothing more to try
        ({1: 9.0, 2: 5.0, "bouc_wen": 4.0, "distributed": 2.0, 3: 1.4, 4: 1.3}, 1e-6, (), 4),
        ({1: 9.0, 2: 5.0, "bouc_wen": 1.05, 3: 1.0}, 1e-6, ("rho_1",), 3),  # an anchor asks for hysterons
        ({1: 9.0, 2: 5.0, 3: 2.0, 4: 1.99}, 1e-6, (), 3),  # as long as the error falls
        ({1: 2.0, 2: 1.99, 3: 1.0, 4: 1.0}, 1e-6, (), 1),
        ({1: 6.0, 2: 2.0, 3: 1.5, 4: 1.4}, None, (), order.DEFAULT_HYSTERONS),  # no test is possible
        ({1: 2.0, 2: 6.0, 3: 6.0, 4: 6.0}, None, (), 1),
        ({}, 1e-6, ("rho_3",), 3),  # an anchor asks for it
    ],
)
def test_the_number_of_hysterons(
    left: dict[int | str, float], falls: float | None, known: tuple[str, ...], chosen: int | str
) -> None:
    def gain(fewer: tuple[int | str, int], more: tuple[int | str, int]) -> Gain:
        return a_gain(left.get(fewer[0], 9.0), left.get(more[0], 9.0), falls)

    def identify(plan: Any, anchors: Any, count: int | str, starts: int, seed: int) -> int | str:
        if not left:
            raise PhnnError("cannot be simulated")
        return count

    held = SimpleNamespace(growth=None, scores=lambda f: f, over_noise=lambda f: left.get(f, 9.0), gain=gain)
    with mock.patch.multiple(order, leave_out=lambda p, n: held, identify_actuator=identify):
        anchors = dict.fromkeys(known, mock.Mock())
        assert order.hysteresis_needed(mock.Mock(), anchors, 1, 0, lambda m: None) == chosen
