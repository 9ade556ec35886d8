"""What every test shares: one torch thread, so that timings and results do not depend on the machine's load, and a
collector of garbage that leaves alone what was there before the first test."""

from __future__ import annotations

import gc
import sys

import pytest


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
