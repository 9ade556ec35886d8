"""The recordings that the representative subset contains."""

from __future__ import annotations

import campaigns
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.identification.plan import Plan
from phnn.identification.staged import representative_subset
from phnn.models.actuator import hrc
from phnn.recordings.recording import Recording
from phnn.setup import Setup

T = np.arange(400) * 1e-4


def made(name: str, amplitude: float, frequency: float) -> Recording:
    return campaigns.recorded(Setup(hrc(0)), name, T, amplitude * np.sin(2.0 * np.pi * frequency * T), 1e-7)


def plan(*recordings: Recording) -> Plan:
    return Plan(recordings, {r.name: 2 for r in recordings})


def test_few_recordings_are_all_looked_at() -> None:
    few = plan(*(made(f"{a}", a, 100.0) for a in (10.0, 20.0, 30.0)))
    assert representative_subset(few) is few


def test_the_corners_are_looked_at() -> None:
    corners = [
        ("small slow", 1.0, 25.0),
        ("small fast", 1.0, 500.0),
        ("large slow", 99.0, 25.0),
        ("large fast", 100.0, 500.0),
    ]
    middle = [(f"middle {i}", 8.0 + i, 100.0 + 25.0 * i) for i in range(5)]
    subset = representative_subset(plan(*(made(*x) for x in [*middle, *corners])))
    assert len(subset.recordings) == 5
    assert {name for name, _, _ in corners} <= {r.name for r in subset.recordings}
    assert subset.substeps["small slow"] == 2


@settings(deadline=None, max_examples=10)
@given(st.lists(st.sampled_from([0.0, 1.0, 50.0]), min_size=6, max_size=9))
def test_recordings_alike_are_taken_once_each(amplitudes: list[float]) -> None:
    subset = representative_subset(plan(*(made(str(i), a, 100.0) for i, a in enumerate(amplitudes))))
    names = [r.name for r in subset.recordings]
    assert len(names) == len(set(names)) == 5
    assert max(np.ptp(r.u) for r in subset.recordings) == max(2.0 * a for a in amplitudes)
