"""Many parameter sets on many recordings: each as if it were simulated alone, wherever it is done."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import recording

from phnn.effects import catalogue
from phnn.ensemble import many
from phnn.ensemble.many import simulate_many
from phnn.errors import InputRefused
from phnn.models.actuator import from_paper
from phnn.recordings.recording import Recording, Start
from phnn.setup import Setup
from phnn.simulate import Trajectory, simulate

BASE = Setup(from_paper())
T = np.arange(201) * 1e-4


def sine(name: str, frequency: float, offset: float = 0.0) -> Recording:
    u = offset + 90.0 * np.sin(2 * np.pi * frequency * T)
    made = recording(T, u, Start("rest", offset))
    return Recording(**{field: getattr(made, field) for field in made.__dataclass_fields__} | {"name": name})


RECORDINGS = [sine("slow", 50.0), sine("fast", 200.0), sine("offset", 100.0, 5.0)]


def drawn(count: int, seed: int = 0) -> list[dict[str, float]]:
    rng = np.random.default_rng(seed)
    values = BASE.values()
    return [
        {n: values[n] * float(np.exp(0.1 * rng.standard_normal())) for n in ("k", "b", "d_1")} for _ in range(count)
    ]


@pytest.mark.parametrize(
    # Processes are started in the tests of the executor, too.
    "executor",
    ["serial", "threads", "threads:3", pytest.param("processes:2", marks=pytest.mark.slow)],
)
def test_every_member_is_what_it_is_alone(executor: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Three sets a chunk: seven are no whole number of chunks.
    monkeypatch.setattr(many, "_CHUNK", 3 * (402 + 500))
    values = drawn(7)
    found = simulate_many(BASE, values, RECORDINGS, 2, executor)
    assert [len(row) for row in found] == [3] * 7
    for chosen, row in zip(values, found, strict=True):
        for made, member in zip(RECORDINGS, row, strict=True):
            assert member.cause == ""
            # The same bits, not nearly the same numbers.
            np.testing.assert_array_equal(member.output, simulate(BASE.with_values(chosen), made, 2).y)


def test_substeps_by_name_and_values_that_leave_everything_out() -> None:
    found = simulate_many(BASE, [{}], RECORDINGS, {"slow": 3}, "serial")
    for made, steps, member in zip(RECORDINGS, (3, 1, 1), found[0], strict=True):
        np.testing.assert_array_equal(member.output, simulate(BASE, made, steps).y)


@pytest.mark.parametrize("executor", ["serial", "processes:2"])
def test_a_member_that_fails_says_why_and_stops_no_other(executor: str) -> None:
    values = [{"k": 2e4}, {"alpha": 1e300}, {"m": -1.0}, {"k": 3e4}]
    found = simulate_many(BASE, values, RECORDINGS, 1, executor)
    assert [[m.output is None for m in row] for row in found] == [[False] * 3, [True] * 3, [True] * 3, [False] * 3]
    assert found[1][0].cause.startswith("slow: no solution of the step at t = ")
    assert found[2][1].cause == "parameter m = -1 kg must be positive: check its sign and unit"
    for row, k in ((found[0], 2e4), (found[3], 3e4)):
        np.testing.assert_array_equal(row[1].output, simulate(BASE.with_values({"k": k}), RECORDINGS[1]).y)


def test_arithmetic_that_fails_fails_one_member(monkeypatch: pytest.MonkeyPatch) -> None:
    def divide(setup: Setup, *_: object) -> Trajectory:
        return simulate(setup, RECORDINGS[0], round(1.0 / (setup.values()["k"] - 1.0)))

    monkeypatch.setattr(many, "simulate", divide)
    found = simulate_many(BASE, [{"k": 1.0}, {"k": 2.0}], RECORDINGS[:1], 1, "serial")
    assert found[0][0].cause == "slow: float division by zero: a value is far from physical"
    assert found[1][0].output is not None


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_an_output_that_is_not_finite_is_a_failure() -> None:
    drifting = catalogue()["sensor_drift"].add_to(BASE, {"drift_rate": 0.0})
    long = recording(100.0 * T, np.zeros_like(T))
    found = simulate_many(drifting, [{"drift_rate": 1.7e308}, {"drift_rate": 1e-9}], [long], 1, "serial")
    assert found[0][0].cause == "made: the output is not finite: a value is far from physical"
    assert found[1][0].cause == ""


def test_a_stranger_among_the_names_is_refused_before_anything_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "simulate", None)
    with pytest.raises(InputRefused, match="no parameter called stiffness: model has m, k, b"):
        simulate_many(BASE, [{"k": 1.0}, {"stiffness": 1.0}], RECORDINGS)


def test_nothing_to_do() -> None:
    assert simulate_many(BASE, [], RECORDINGS) == []
    assert simulate_many(BASE, [{}, {}], []) == [[], []]


@settings(deadline=None)
@given(count=st.integers(0, 300), steps=st.integers(1, 10**6))
def test_chunks_cover_every_set_once(count: int, steps: int) -> None:
    pieces = list(many._ranges(count, steps))
    assert [i for piece in pieces for i in piece] == list(range(count))
    assert all(len(p) == 1 or len(p) * steps <= many._CHUNK for p in pieces)
