"""Grades of cases beside a background, and of cases whose actuator has another hysteresis than hysterons."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from phnn.configuration import compose
from phnn.errors import InputRefused
from studies.generator import Sealed
from studies.generator.world import TABLE
from studies.proof.cases import Task, tasks
from studies.proof.grades import EXACT, IN_CLASS, WRONG, Said, expected, grade, true_places
from studies.proof.nulls import counts
from studies.proof.outcome import graded, group_error
from studies.proof.settings import Settings
from studies.proof.tally import rates

CREEP = Sealed(
    effect="creep", parameters={}, base=dict(TABLE), strength_over_noise=4.0, noise=5e-8, quantisation=1e-8, seed=1,
    plan="demo", effects=("creep",), stratum="same", location=("mechanical",),
)  # fmt: skip
NOTHING = replace(CREEP, effect="none", effects=(), stratum="none", location=())
BESIDE = replace(NOTHING, background_effects=("creep", "hysteresis_asymmetry"))
WEN = {n: TABLE[n] for n in ("m", "k", "b", "alpha")} | {"c_bouc": 1e5, "z_bouc": 5e-5, "n_bouc": 1.5, "beta_bouc": 0.7}
OTHER = replace(NOTHING, base_family="bouc_wen", base=WEN)
OTHER_CREEP = replace(CREEP, base_family="bouc_wen", base=WEN)


def said(
    verdict: str,
    *entries: tuple[str, ...],
    at: tuple[str, ...] = ("mechanical",),
    tied: tuple[str, ...] = (),
    held: tuple[float, float] = (2.0, 1.0),
) -> Said:
    """An answer; each entry is a name and those that are equivalent, ``at`` its location (the last for others)."""
    places = (*at, *[at[-1]] * len(entries))[: len(entries)]
    return Said(verdict, entries, places, at[0], tied, *held)


@pytest.mark.parametrize(
    ("answer", "wanted"),
    [
        (said("none"), EXACT),
        (said("named", ("creep",)), EXACT),
        (said("named", ("creep",), ("hysteresis_asymmetry",), at=("mechanical", "hysteron")), EXACT),
        (said("equivalent", ("charge_leakage", "creep"), at=("electrical",)), IN_CLASS),
        (said("equivalent", ("a", "b", "c", "d", "creep")), WRONG),
        (said("named", ("creep",), ("delay",)), WRONG),
        (said("named", ("delay",)), WRONG),
        (said("unknown", ("unknown",)), IN_CLASS),
        (said("unknown", ("unknown", "sensor"), held=(2.0, 1.99)), WRONG),
        (said("unknown", ("unknown",), held=(1.0, 1.2)), WRONG),
        (said("unknown", ("unknown",), held=(math.nan, math.nan)), WRONG),
        (said("failed"), WRONG),
    ],
)
def test_a_background_is_no_false_alarm(answer: Said, wanted: str) -> None:
    assert grade(BESIDE, answer) == wanted
    # Without a background all of them but silence are.
    assert grade(NOTHING, answer) == (EXACT if answer.verdict == "none" else WRONG)


@pytest.mark.parametrize(
    ("answer", "wanted"),
    [
        (said("unknown", ("unknown",), at=("hysteron",)), EXACT),
        (said("unknown", ("unknown",), at=("coupling",), tied=("hysteron",)), IN_CLASS),
        (said("unknown", ("unknown",), at=("coupling",), tied=("hysteron", "sensor", "mechanical")), WRONG),
        (said("unknown", ("unknown",), at=("mechanical",)), WRONG),
        (said("unknown", ("unknown",), at=("hysteron",), held=(2.0, 2.0)), WRONG),
        (said("named", ("extra_hysteron",), at=("hysteron",)), EXACT),
        (said("named", ("extra_hysteron",), ("hysteresis_asymmetry",), at=("hysteron", "hysteron")), EXACT),
        (said("named", ("extra_hysteron",), ("creep",), at=("hysteron", "mechanical")), WRONG),
        (said("named", ("creep",)), WRONG),
        (said("none", held=(3.0, 3.0)), WRONG),
        (said("none", held=(1.05, 1.05)), EXACT),
        (said("failed"), WRONG),
    ],
)
def test_another_hysteresis_is_graded_by_place_and_gain(answer: Said, wanted: str) -> None:
    assert grade(OTHER, answer) == wanted


@pytest.mark.parametrize(
    ("answer", "wanted"),
    [
        (said("named", ("creep",)), EXACT),
        (said("named", ("creep",), ("extra_hysteron",), at=("mechanical", "hysteron")), EXACT),
        (said("equivalent", ("charge_leakage", "creep"), at=("electrical",)), IN_CLASS),
        (said("unknown", ("unknown",)), IN_CLASS),
        (said("unknown", ("unknown",), at=("hysteron",)), IN_CLASS),
        (said("unknown", ("unknown",), at=("sensor",)), WRONG),
        (said("named", ("extra_hysteron",), at=("hysteron",)), WRONG),
        (said("named", ("creep",), ("delay",), at=("mechanical", "amplifier")), WRONG),
        (said("none"), WRONG),
    ],
)
def test_effects_in_another_hysteresis_are_graded_by_name_or_place(answer: Said, wanted: str) -> None:
    assert grade(OTHER_CREEP, answer) == wanted


def test_an_element_without_a_name_claims_nothing_beside_names() -> None:
    nameless = ("unknown", "delay", "sensor_lag", "slew_limit", "base_motion")
    assert grade(CREEP, said("named", ("creep",), nameless)) == EXACT
    assert grade(CREEP, said("equivalent", ("creep", "delay"), ("unknown",))) == IN_CLASS
    # It stands for no name, and a wrong one is no better for it.
    assert grade(CREEP, said("unknown", ("unknown", "creep"))) == WRONG
    assert grade(CREEP, said("named", ("delay",), ("unknown", "creep"))) == WRONG
    assert grade(NOTHING, said("unknown", ("unknown",))) == WRONG


def test_what_is_expected_of_another_hysteresis() -> None:
    assert expected(replace(OTHER, hysterons=3, stated_hysterons=2)) == ()
    assert (true_places(OTHER), true_places(OTHER_CREEP)) == (("hysteron",), ("mechanical", "hysteron"))
    assert true_places(CREEP) == ("mechanical",)
    withheld = replace(OTHER_CREEP, stratum="outside", withheld=("creep",))
    assert grade(withheld, said("unknown", ("unknown",), at=("hysteron",))) == EXACT


def document(answer: Said) -> dict:
    entries = [
        {"effect": c[0], "equivalent_to": list(c[1:]), "location": p}
        for c, p in zip(answer.classes, answer.locations, strict=True)
    ]
    scores = {n: {"a": {"residual_over_noise": v}} for n, v in (("before", answer.before), ("after", answer.after))}
    return {
        "verdict": answer.verdict, "missing": entries, "location": {"name": answer.place, "tied": list(answer.tied)},
        "fit": scores | {"held_out": ["a"]}, "seconds": 1.0,
    }  # fmt: skip


def test_rates_count_false_alarms_by_grade() -> None:
    task = Task("full", "none", 0, 1, "demo")
    answers = [said("none"), said("named", ("creep",)), said("unknown", ("unknown",)), said("named", ("delay",))]
    found = {r.label: r for r in rates([graded(task, BESIDE, document(a)) for a in answers])}
    assert (found["nothing missing: false alarms, whole command"].hits,) == (1,)
    assert not any("another hysteresis" in label for label in found)
    # A hysteron too few in the manifest is missing, so that to name it is no false alarm either.
    fewer = replace(NOTHING, hysterons=3, stated_hysterons=2)
    outcome = graded(task, fewer, document(said("named", ("extra_hysteron",), at=("hysteron",))))
    found = {r.label: r for r in rates([outcome])}
    assert found["nothing missing: false alarms, whole command"].cases == 0


def test_rates_of_another_hysteresis_stand_alone() -> None:
    task = Task("full", "none", 0, 1, "demo")
    here = said("unknown", ("unknown",), at=("hysteron",))
    outcomes = [graded(task, OTHER, document(here)), graded(task, OTHER, document(said("none", held=(3.0, 3.0))))]
    outcomes.append(graded(task, OTHER_CREEP, document(said("named", ("creep",)))))
    found = {r.label: r for r in rates(outcomes)}
    assert found["nothing missing: false alarms, whole command"].cases == 0
    assert found["same form: exactly right"].cases == 0
    alone, beside = (r for label, r in found.items() if label.startswith("another hysteresis"))
    assert (alone.hits, alone.cases, beside.hits, beside.cases) == (1, 2, 1, 1)
    assert [o.reason for o in outcomes] == ["", "not noticed", ""]
    assert outcomes[0].places == ("hysteron",)
    assert outcomes[2].effect_errors == ()


def test_nulls_beside_a_background_count_wrong_answers() -> None:
    task = Task("full", "nulls", 0, 1, "demo", family="white")
    answers = [said("none"), said("named", ("creep",)), said("unknown", ("unknown",)), said("named", ("delay",))]
    (count,) = counts([graded(task, BESIDE, document(a)) for a in answers])
    assert (count.cases, count.right, count.named, count.unknown, count.false) == (4, 3, 1, 0, "delay (1)")


def test_groups_of_parameters_are_compared_where_both_have_them() -> None:
    one = {n: v for n, v in TABLE.items() if not n.endswith("_2")}
    assert group_error(one, one) < 1e-12
    # Of other hysterons only mass, stiffness and damping are left.
    assert group_error(TABLE | {"d_2": 1.0, "k": 1.1 * TABLE["k"]}, one) == pytest.approx(0.1)
    assert group_error(TABLE, WEN) < 1e-12


def test_a_base_is_asked_for_in_the_settings() -> None:
    asked = {"base": "prandtl_ishlinskii", "only": ["none", "same"]}
    chosen = Settings.from_config(compose("prove") | asked)
    assert chosen.changes_cases["base"] == "prandtl_ishlinskii"
    assert all("c_play_1" in task.case().base for task in tasks(chosen)[:3])
    for wrong, needle in (
        ({"base": "preisach"}, "base = 'preisach'"),
        ({"base": "bouc_wen"}, "fast tier fits two hysterons"),
        ({"base": "bouc_wen", "only": ["nulls"], "nulls": 1}, "nothing must be missing in nulls"),
        ({"base": "bouc_wen", "only": ["same"], "wrong_order": True}, "no number of hysterons"),
    ):
        with pytest.raises(InputRefused, match=needle):
            Settings.from_config(compose("prove") | wrong)
