"""Coverage of intervals, and grades of cases with a background or a wrong number of hysterons."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phnn.configuration import compose
from phnn.errors import InputRefused
from studies.generator import Sealed
from studies.generator.world import TABLE
from studies.proof.cases import Task, tasks
from studies.proof.coverage import base_errors, effect_errors, noise_errors
from studies.proof.grades import EXACT, WRONG
from studies.proof.outcome import graded
from studies.proof.settings import Settings
from studies.proof.tally import coverage

TASK = Task("full", "same", 0, 1, "demo")
SEALED = Sealed(
    effect="creep", parameters={"k_s": 400.0, "tau_s": 0.1}, base=dict(TABLE), strength_over_noise=4.0, noise=5e-8,
    quantisation=1e-8, seed=1, plan="demo", effects=("creep",), stratum="same", location=("mechanical",),
    stated_mass=1.01 * TABLE["m"],
)  # fmt: skip
NOTHING = replace(SEALED, effect="none", effects=(), parameters={}, stratum="none", location=())


def estimates(factor: float = 1.0, part: float = 0.01) -> dict[str, dict[str, Any]]:
    return {n: {"value": factor * v, "std": part * v} for n, v in TABLE.items()}


def entry(name: str, **parameters: tuple[float, float | None]) -> dict[str, Any]:
    return {
        "effect": name,
        "location": "mechanical",
        "parameters": {n: {"value": v, "std": s} for n, (v, s) in parameters.items()},
    }


def test_base_parameters_are_compared_hysteron_by_hysteron() -> None:
    found = base_errors(estimates(1.02), SEALED)
    # Not the mass, which is the anchor itself.
    assert found == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, 2.0))
    swapped = {n.translate(str.maketrans("12", "21")): v for n, v in estimates(1.02).items()}
    assert sorted(base_errors(swapped, SEALED).values()) == pytest.approx([2.0] * 9)
    unknown = estimates() | {"rho_1": {"value": 1.0, "std": None}, "b": {"value": 1.0, "std": float("inf")}}
    assert set(base_errors(unknown, SEALED)) == set(TABLE) - {"m", "rho_1", "b"}
    assert base_errors({}, SEALED) == {}
    fewer = {n: v for n, v in estimates().items() if not n.endswith("_2")}
    assert base_errors(fewer, SEALED) == {}


def test_the_stated_interval_is_what_is_graded() -> None:
    wide = {n: e | {"interval_95": (0.5 * e["value"], 3.0 * e["value"])} for n, e in estimates(2.0).items()}
    # The truth is the lower end, whatever the standard error says.
    assert base_errors(wide, SEALED) == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, 1.96), abs=1e-3)
    low = {n: e | {"interval_95": (0.25 * e["value"], 4.0 * e["value"])} for n, e in estimates(0.5).items()}
    assert base_errors(low, SEALED) == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, -1.96 / 3.0), abs=1e-3)


def test_errors_by_noise_alone_leave_out_that_of_the_mass() -> None:
    # All that scales with the mass is wrong by its error, and by nothing else.
    right = {
        n: {"value": v, "std": 0.01 * v, "interval_95_anchors_exact": (0.99 * v, 1.01 * v)}
        for n, v in TABLE.items()
        for v in [v if n[0] == "d" else 1.01 * v]
    }
    said = [entry("creep", k_s=(1.01 * 404.0, 4.0), tau_s=(0.1, 0.01))]
    right |= {
        "k_s": {"value": 1.01 * 404.0, "std": 4.0, "interval_95_anchors_exact": (400.0, 416.0)},
        "tau_s": {"value": 0.1, "std": 0.01, "interval_95_anchors_exact": (0.08, 0.12)},
    }
    base, effect = noise_errors(right, said, SEALED)
    assert base == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, 0.0), abs=1e-6)
    assert effect == pytest.approx({"k_s": 1.96 * 4.04 / 8.04, "tau_s": 0.0}, abs=1e-3)
    assert noise_errors(estimates(), said, SEALED) == ({}, {})
    # An exact mass says nothing of its own interval, but all of the noise.
    exact, _ = noise_errors(right, said, replace(SEALED, stated_mass=0.0))
    assert len(exact) == 9


def test_what_scales_with_an_exact_mass_is_left_out() -> None:
    exact = replace(SEALED, stated_mass=0.0)
    assert set(base_errors(estimates(), exact)) == {"d_1", "d_2"}
    said = [entry("creep", k_s=(440.0, 20.0), tau_s=(0.12, 0.01))]
    assert effect_errors(said, exact) == pytest.approx({"tau_s": 2.0})
    assert effect_errors(said, SEALED) == pytest.approx({"k_s": 2.0, "tau_s": 2.0})


def test_effects_are_compared_at_one_reference_displacement() -> None:
    cubic = replace(SEALED, effects=("cubic_stiffness",), parameters={"kappa_3": 0.1, "q_0": 1e-4})
    # κ₃ (q/q₀)² with twice the reference: four times the strength.
    said = [entry("cubic_stiffness", kappa_3=(0.42, 0.01), q_0=(2e-4, None))]
    assert effect_errors(said, cubic) == pytest.approx({"kappa_3": 2.0})
    hysteron = replace(SEALED, effects=("extra_hysteron",), parameters={"C_3": 1e-5, "rho_3": 0.1, "d_3": 3.0})
    assert effect_errors([entry("extra_hysteron", C_x=(1.1e-5, 1e-6))], hysteron) == pytest.approx({"C_x": 1.0})


def test_neither_another_form_nor_another_effect_is_compared() -> None:
    said = [entry("creep", k_s=(440.0, 20.0))]
    assert effect_errors(said, replace(SEALED, form="log_creep")) == {}
    assert effect_errors(said, replace(SEALED, effects=("delay",), parameters={"tau_d": 1e-4})) == {}
    beside = replace(
        SEALED, effects=("delay",), parameters={"tau_d": 1e-4}, background={"k_s": 400.0}, background_effects=("creep",)
    )
    assert effect_errors(said, beside) == pytest.approx({"k_s": 2.0})


def test_intervals_of_normal_errors_are_covered_as_stated() -> None:
    outcome = graded(TASK, SEALED, {"verdict": "named", "missing": [entry("creep")]})
    rng = np.random.default_rng(0)
    many = [replace(outcome, base_errors=tuple(rng.standard_normal(9)), effect_errors=(3.0,)) for _ in range(1000)]
    found = {r.label: r for r in coverage(many)}
    assert found["base parameters inside their 68 % interval"].share == pytest.approx(0.68, abs=0.02)
    assert found["base parameters inside their 95 % interval"].share == pytest.approx(0.95, abs=0.01)
    assert found["effect parameters inside their 95 % interval"].hits == 0
    assert found["effect parameters inside their 95 % interval"].cases == 1000


def test_an_answer_carries_its_errors_into_the_table() -> None:
    said = {"verdict": "named", "missing": [entry("creep", tau_s=(0.12, 0.01))], "estimates": estimates(1.02)}
    outcome = graded(TASK, SEALED, said)
    assert (len(outcome.base_errors), outcome.effect_errors) == (9, pytest.approx((2.0,)))
    assert outcome.row()["effect_errors"] == "2"


def test_a_background_may_be_named_and_need_not_be() -> None:
    beside = {"background_effects": ("creep", "hysteresis_asymmetry")}
    nothing = replace(NOTHING, **beside)
    asymmetry = entry("hysteresis_asymmetry")
    for said in (
        {"verdict": "none"},
        {"verdict": "named", "missing": [entry("creep")]},
        {"verdict": "named", "missing": [entry("creep"), asymmetry]},
    ):
        assert graded(TASK, nothing, said).grade == EXACT
    for said in (
        {"verdict": "unknown", "missing": [entry("unknown")]},
        {"verdict": "named", "missing": [entry("creep"), entry("delay")]},
    ):
        assert graded(TASK, nothing, said).grade == WRONG
    concealed = replace(SEALED, background_effects=("hysteresis_asymmetry",))
    assert graded(TASK, concealed, {"verdict": "named", "missing": [entry("creep"), asymmetry]}).grade == EXACT
    assert graded(TASK, concealed, {"verdict": "named", "missing": [asymmetry]}).grade == WRONG
    assert graded(TASK, concealed, {"verdict": "none"}).grade == WRONG


def test_a_hysteron_that_the_manifest_leaves_out_is_missing() -> None:
    fewer = replace(NOTHING, hysterons=3, stated_hysterons=2)
    named = {"verdict": "named", "missing": [entry("extra_hysteron")]}
    assert graded(TASK, fewer, named).grade == EXACT
    assert graded(TASK, fewer, {"verdict": "none"}).grade == WRONG
    more = replace(NOTHING, hysterons=2, stated_hysterons=3)
    assert graded(TASK, more, {"verdict": "none"}).grade == EXACT
    assert graded(TASK, more, named).grade == WRONG


def test_conditions_reach_every_case_and_name_another_proof() -> None:
    plain = Settings.from_config(compose("prove"))
    assert set(plain.changes_cases) == {"seed", "fast_plan", "plan", "starts", "max_effects"}
    asked = {"noise": "process:0.1", "background": True, "hysterons": 3, "anchor_error": True, "wrong_order": True}
    chosen = Settings.from_config(compose("prove") | asked | {"only": ["same", "pair", "nulls"], "nulls": 1})
    assert asked.items() <= chosen.changes_cases.items()
    for task in tasks(chosen):
        case = task.case()
        assert case.conditions == chosen.conditions
        assert case.hysterons == 3
        assert task.family or case.family == "process"
    with pytest.raises(InputRefused, match="fast tier fits two hysterons"):
        Settings.from_config(compose("prove") | {"hysterons": 3})
    with pytest.raises(InputRefused, match="noise = 'violet'"):
        Settings.from_config(compose("prove") | {"noise": "violet"})
