"""What every test shares: one torch thread, so that timings and results do not depend on the machine's load; a
collector of garbage that leaves alone what was there before the first test; and the noise floors of recordings."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from hashlib import sha256
from typing import Any
from unittest import mock

import pytest

_FLOORS: dict[tuple[object, ...], Any] = {}


@pytest.fixture(scope="module", autouse=True)
def _same_noise() -> Iterator[None]:
    """The noise of the same samples, which takes most of the time of a reading, is estimated once."""
    # Only where a test module has loaded the reader already.
    draft = sys.modules.get("phnn.recordings.draft")
    if draft is None:
        yield
        return
    estimated = draft.noise_floor

    def once(u: Any, y: Any, *others: object) -> Any:
        key = (sha256(u.tobytes()).digest(), sha256(y.tobytes()).digest(), *others)
        if key not in _FLOORS:
            _FLOORS[key] = estimated(u, y, *others)
        return _FLOORS[key]

    with mock.patch.object(draft, "noise_floor", once):
        yield


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    # Only where a test module has loaded torch already: the command line's tests must not pay for it.
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(1)


def pytest_collection_finish() -> None:
    # Half a million objects of libraries and tests; to look through them again and again took a twentieth of the time.
    gc.collect()
    gc.freeze()
