"""How many hysterons a base model needs, on models of which only their errors are known."""

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
        ({1: 9.0, 2: 5.0, 3: 2.0, 4: 1.99}, 1e-6, (), 3),  # as long as the error falls
        ({1: 2.0, 2: 1.99, 3: 1.0, 4: 1.0}, 1e-6, (), 1),
        ({1: 6.0, 2: 2.0, 3: 1.5, 4: 1.4}, None, (), order.DEFAULT_HYSTERONS),  # no test is possible
        ({1: 2.0, 2: 6.0, 3: 6.0, 4: 6.0}, None, (), 1),
        ({}, 1e-6, ("rho_3",), 3),  # an anchor asks for it
    ],
)
def test_the_number_of_hysterons(
    left: dict[int, float], falls: float | None, known: tuple[str, ...], chosen: int
) -> None:
    def gain(fewer: tuple[int, int], more: tuple[int, int]) -> Gain:
        return a_gain(left[fewer[0]], left[more[0]], falls)

    def identify(plan: Any, anchors: Any, count: int, starts: int, seed: int) -> int:
        if not left:
            raise PhnnError("cannot be simulated")
        return count

    held = SimpleNamespace(growth=None, scores=lambda f: f, over_noise=lambda f: left[f], gain=gain)
    with mock.patch.multiple(order, leave_out=lambda p, n: held, identify_actuator=identify):
        anchors = dict.fromkeys(known, mock.Mock())
        assert order.hysterons_needed(mock.Mock(), anchors, 1, 0, lambda m: None) == chosen
