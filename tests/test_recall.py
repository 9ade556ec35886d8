"""What is recalled is what was computed from arguments of the same content, and nothing outside a study."""

from __future__ import annotations

from dataclasses import dataclass, replace

import campaigns
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phnn.criteria import CRITERIA
from phnn.diagnosis.diagnosis import diagnose
from phnn.effects import effect
from phnn.identification.options import Options
from phnn.recall import recalled, recalling
from phnn.report.result import document

CALLS: list[object] = []


@dataclass(frozen=True)
class Value:
    x: np.ndarray
    name: str = ""


@recalled
def doubled(value: object, *, by: float = 2.0) -> list[object]:
    CALLS.append(value)
    return [value, by]


def test_equal_content_is_computed_once_and_only_inside() -> None:
    CALLS.clear()
    a = Value(np.arange(3.0), "a")
    with recalling():
        first = doubled(a)
        assert doubled(replace(a, x=a.x.copy())) is first
        assert doubled(a, by=3.0) is not first
        assert doubled(replace(a, x=a.x + 1.0)) is not first
        assert len(CALLS) == 3
    doubled(a)
    with recalling():
        doubled(a)
    assert len(CALLS) == 5


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(0, 2) | st.floats(0.0, 2.0) | st.text("ab", max_size=2),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text("ab", max_size=1), inner, max_size=2),
    max_leaves=4,
)


@given(VALUES, VALUES)
def test_other_content_is_never_taken_for_the_same(one: object, other: object) -> None:
    with recalling():
        same = doubled(one) is doubled(other)
    assert not same or one == other


@pytest.mark.slow
def test_a_recalled_diagnosis_is_the_diagnosis() -> None:
    campaign, effects = campaigns.campaign("creep"), [effect(n) for n in ("creep", "sensor_lag", "quadratic_drag")]
    moved = Options(workers=1, starts=1, criteria={"explains": 0.25, "tie": 24.0})

    def told(options: Options) -> dict[str, object]:
        content = document(diagnose(campaign, options, effects=effects))
        return {n: v for n, v in content.items() if n not in ("seconds", "versions")}

    plain = told(moved)
    with recalling():
        told(Options(workers=1, starts=1))
        again = told(moved)
    assert again == plain
    assert plain["criteria"] == moved.criteria == CRITERIA.with_values(moved.criteria).changed()
