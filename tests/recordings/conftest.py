"""What tests of reading share: the noise of the same samples, which takes most of the time, is estimated once."""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import sha256
from unittest import mock

import numpy as np
import pytest

from phnn.recordings import draft
from phnn.signals.noise import NoiseFloor, noise_floor

_FLOORS: dict[tuple[object, ...], NoiseFloor] = {}


def _once(u: np.ndarray, y: np.ndarray, *others: object) -> NoiseFloor:
    key = (sha256(u.tobytes()).digest(), sha256(y.tobytes()).digest(), *others)
    if key not in _FLOORS:
        _FLOORS[key] = noise_floor(u, y, *others)  # type: ignore[arg-type]
    return _FLOORS[key]


@pytest.fixture(scope="module", autouse=True)
def _same_noise() -> Iterator[None]:
    with mock.patch.object(draft, "noise_floor", _once):
        yield
