"""What counts as right, and how it is counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from studies.generator import Sealed
from studies.generator.world import TABLE
from studies.proof.cases import Task
from studies.proof.grades import CLASS, EXACT, IN_CLASS, WRONG
from studies.proof.outcome import graded, group_error
from studies.proof.tally import Rate, confusion, detection, half_point, rates, reliability

FULL_TASK = Task("full", "same", 0, 1, "demo")
SEALED = Sealed(
    effect="creep", parameters={}, base=dict(TABLE), strength_over_noise=4.0, noise=5e-8, quantisation=1e-8, seed=1,
    plan="demo", effects=("creep",), stratum="same", form="canonical", location=("mechanical",), withheld=(),
    levels=(4.0,), delta=500.0, deltas=(500.0,),
)  # fmt: skip


def entry(name: str, *others: str, location: str = "mechanical") -> dict[str, Any]:
    return {"effect": name, "location": location, "equivalent_to": list(others)}


def answer(verdict: str, *missing: dict[str, Any], location: str = "mechanical", tied: tuple[str, ...] = ()) -> dict:
    return {
        "verdict": verdict,
        "missing": list(missing),
        "location": {"name": location, "tied": list(tied), "dictionary": [location]},
        "test": {"statistic": 30.0, "p_value": 1e-5},
        "fit": {
            "before": {"a": {"residual_over_noise": 4.0}, "b": {"residual_over_noise": 3.0}},
            "after": {"a": {"residual_over_noise": 1.0}, "b": {"residual_over_noise": 1.1}},
            "held_out": ["b"],
        },
        "remainder": {"verdict": "none"},
        "seconds": 10.0,
    }


@pytest.mark.parametrize(
    ("said", "grade"),
    [
        (answer("named", entry("creep")), EXACT),
        (answer("equivalent", entry("creep", "charge_leakage")), IN_CLASS),
        (answer("equivalent", entry("charge_leakage", "creep")), IN_CLASS),
        (answer("equivalent", entry("a", "b", "c", "d", "creep")), WRONG),
        (answer("named", entry("charge_leakage")), WRONG),
        (answer("named", entry("creep"), entry("delay")), WRONG),
        (answer("unknown", entry("unknown")), WRONG),
        (answer("none"), WRONG),
        ({"failure": "it broke"}, WRONG),
    ],
)
def test_a_single_effect_is_right_by_name_or_in_a_small_class(said: dict, grade: str) -> None:
    outcome = graded(FULL_TASK, SEALED, said)
    assert outcome.grade == grade
    assert bool(outcome.reason) == (grade == WRONG)
    assert CLASS == 4


def test_held_out_and_base_scores_are_those_of_the_document() -> None:
    outcome = graded(FULL_TASK, SEALED, answer("named", entry("creep")))
    assert (outcome.base, outcome.held_before, outcome.held_after) == (4.0, 3.0, 1.1)
    assert outcome.located == "alone"


def test_nothing_outside_and_pairs() -> None:
    nothing = replace(SEALED, effects=(), stratum="none", location=())
    assert graded(FULL_TASK, nothing, answer("none")).grade == EXACT
    assert graded(FULL_TASK, nothing, answer("unknown", entry("unknown"))).grade == WRONG
    outside = replace(SEALED, stratum="outside", withheld=("creep",))
    unknown = answer("unknown", entry("unknown"), location="hysteron", tied=("mechanical",))
    assert graded(FULL_TASK, outside, unknown).grade == EXACT
    elsewhere = answer("unknown", entry("unknown"), location="sensor")
    assert graded(FULL_TASK, outside, elsewhere).grade == WRONG
    assert graded(FULL_TASK, outside, answer("named", entry("charge_leakage"))).grade == WRONG
    pair = replace(SEALED, effects=("creep", "delay"), stratum="pair", location=("mechanical", "amplifier"))
    assert graded(FULL_TASK, pair, answer("named", entry("delay"), entry("creep"))).grade == EXACT
    both = answer("equivalent", entry("amplifier_lowpass", "delay"), entry("creep"))
    assert graded(FULL_TASK, pair, both).grade == IN_CLASS
    assert graded(FULL_TASK, pair, answer("named", entry("delay"))).grade == WRONG


def test_groups_of_parameters_ignore_the_common_factor_and_the_order_of_hysterons() -> None:
    scaled = {
        n: v * (3.0 if n in ("m", "k", "b", "alpha", "C_1", "C_2", "rho_1", "rho_2") else 1.0) for n, v in TABLE.items()
    }
    assert group_error(scaled, TABLE) < 1e-12
    swapped = {n.translate(str.maketrans("12", "21")): v for n, v in TABLE.items()}
    assert group_error(swapped, TABLE) < 1e-12
    assert group_error(TABLE | {"d_2": 1.02 * TABLE["d_2"]}, TABLE) == pytest.approx(0.02)
    assert np.isnan(group_error({}, TABLE))


def test_rates_have_exact_intervals() -> None:
    assert Rate("", 0, 400, "").interval == pytest.approx((0.0, 0.00918), abs=1e-4)
    assert np.isnan(Rate("", 0, 0, "").share)
    outcomes = [graded(FULL_TASK, SEALED, answer("named", entry(n))) for n in ("creep", "creep", "delay", "creep")]
    found = {r.label: r for r in rates(outcomes)}
    assert found["same form: exactly right"].share == 0.75
    assert found["pairs: both"].cases == 0
    assert confusion(outcomes, "same") == {"creep": {"creep": 3, "delay": 1}}


@given(st.floats(2.0, 30.0), st.integers(0, 2**31))
def test_half_point_is_where_half_the_hits_are(half: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    delta = np.exp(rng.uniform(np.log(half / 8.0), np.log(half * 8.0), 4000))
    hit = rng.random(delta.size) < 1.0 / (1.0 + (half / delta) ** 6)
    assert half_point(delta, hit.astype(float)) == pytest.approx(half, rel=0.1)
    assert np.isnan(half_point(delta, np.ones_like(delta)))


def test_detection_of_the_limit_itself_has_ratio_one() -> None:
    rng = np.random.default_rng(0)
    z = float(norm.isf(0.01))
    outcomes = []
    for number, delta in enumerate(np.exp(rng.uniform(0.0, np.log(30.0), 3000))):
        task = Task("fast", "fast_weak", number, number, "short")
        seen = bool(rng.standard_normal() + delta > z)
        said = answer("named", entry("creep")) if seen else answer("none")
        outcomes.append(graded(task, replace(SEALED, delta=float(delta)), said))
    curve = detection(outcomes)
    assert curve is not None
    assert curve.half[1] / curve.half[0] == pytest.approx(1.0, abs=0.12)
    assert np.abs(curve.found - curve.limit).max() < 0.12
    assert detection([]) is None


def test_reliability_counts_p_values() -> None:
    task = Task("fast", "fast_none", 0, 0, "short")
    nothing = replace(SEALED, effects=(), stratum="none", location=())
    outcomes = [graded(task, nothing, answer("none") | {"test": {"statistic": 1.0, "p_value": p}}) for p in (0.2, 0.6)]
    assert reliability(outcomes, [0.1, 0.3, 0.7]).tolist() == [0.0, 0.5, 1.0]
