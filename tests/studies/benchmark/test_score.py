"""Answers and their scores, the figures over many, and the tools that answer."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import linregress

from phnn.errors import InputRefused
from phnn.results import claim
from studies.benchmark.bench import ANSWER, Answer, Entry, read_answer, write_answer
from studies.benchmark.score import Score, balanced_accuracy, by_group, compared, page, paired_interval, scored, summary
from studies.benchmark.tools import TOOLS, tool
from studies.benchmark.tools.common import orthonormal
from studies.benchmark.tools.diagnosis import as_answer
from studies.benchmark.tools.lfr import group_lasso
from studies.benchmark.tools.lisdd import f_test
from studies.generator import Sealed, generate

TRUE = Sealed(
    effect="creep", parameters={}, base={}, strength_over_noise=3.0, noise=1e-7, quantisation=1e-12, seed=1,
    plan="one_exam", effects=("creep",), location=("mechanical",),
)  # fmt: skip
NONE = replace(TRUE, effect="none", effects=(), location=(), stratum="none")
OUTSIDE = replace(TRUE, effect="wear", effects=("wear",), location=("hysteron",), stratum="outside", form="unlisted")
PAIR = replace(TRUE, effects=("creep", "delay"), stratum="pair")
BESIDE = replace(TRUE, background_effects=("creep", "delay"))
T = np.linspace(0.0, 1.0, 101)
EXAM = {"exam_a": pd.DataFrame({"time_s": T, "displacement_um": np.sin(T)})}


def score(sealed: Sealed, answer: Answer, group: str = "same") -> Score:
    return scored(Entry("case_000", group, 1, "weak", "one"), sealed, EXAM, answer)


NOTHING = Answer({}, none=0.9)


@pytest.mark.parametrize(
    ("sealed", "group", "answer", "right"),
    [
        (TRUE, "same", Answer({"creep": 0.9}), True),
        (TRUE, "same", Answer({"creep": 0.49}), False),
        (TRUE, "same", Answer({"creep": 0.9, "delay": 0.6}), False),
        (TRUE, "same", Answer({"creep": 0.9}, unlisted=0.6), False),
        (TRUE, "same", NOTHING, False),
        (NONE, "none", NOTHING, True),
        (NONE, "none", Answer({}, none=0.9, failed="no step"), False),
        (NONE, "none", Answer({"creep": 0.9}), False),
        (NONE, "none", Answer({}, unlisted=0.9), False),
        (OUTSIDE, "outside", Answer({}, unlisted=0.9), True),
        (OUTSIDE, "outside", Answer({"creep": 0.9}, unlisted=0.9), False),
        (PAIR, "pair", Answer({"creep": 0.9, "delay": 0.9}), True),
        (PAIR, "pair", Answer({"creep": 0.9}), False),
        (BESIDE, "background", Answer({"creep": 0.9, "delay": 0.9}), True),
        (BESIDE, "background", Answer({"delay": 0.9}), False),
    ],
)
def test_right_is_what_was_concealed_and_nothing_else(sealed: Sealed, group: str, answer: Answer, right: bool) -> None:
    found = score(sealed, answer, group)
    assert found.right is right
    assert found.false_alarm is (group == "none" and bool({"creep", "unlisted"} & answer.claims))


@pytest.mark.parametrize(
    ("sealed", "group", "answer", "first"),
    [
        (TRUE, "same", Answer({"creep": 0.3, "delay": 0.2}), True),
        (TRUE, "same", Answer({"creep": 0.3, "delay": 0.3}), False),
        (TRUE, "same", Answer({"creep": 0.3}, unlisted=0.4), False),
        (PAIR, "pair", Answer({"creep": 0.3, "delay": 0.2, "second_mode": 0.1}), True),
        (PAIR, "pair", Answer({"creep": 0.3, "delay": 0.2}, none=0.25), False),
        (NONE, "none", Answer({"creep": 0.2}, none=0.3), True),
        (OUTSIDE, "outside", Answer({"creep": 0.2}, unlisted=0.3), True),
        (BESIDE, "background", Answer({"delay": 0.9, "creep": 0.3}), True),
    ],
)
def test_first_is_what_is_most_probable(sealed: Sealed, group: str, answer: Answer, first: bool) -> None:
    assert score(sealed, answer, group).first is first


def test_the_brier_score_counts_everything_that_may_be_missing() -> None:
    assert score(TRUE, Answer({"creep": 1.0})).brier == 0.0
    assert score(TRUE, Answer({})).brier == 1.0
    assert score(TRUE, Answer({"creep": 0.5, "delay": 0.5}, none=0.2)).brier == pytest.approx(0.25 + 0.25 + 0.04)
    # A background may be named or not.
    assert score(BESIDE, Answer({"creep": 1.0, "delay": 0.7}), "background").brier == 0.0


def test_a_prediction_is_scored_without_its_zero() -> None:
    y = 1e-6 * np.sin(T)
    noise = np.random.default_rng(0).normal(0.0, 1e-7, T.size)
    found = score(TRUE, Answer({}, predictions={"exam_a": y + 3e-6 + noise}))
    assert found.error == pytest.approx(np.std(noise) / 1e-7)
    assert score(TRUE, Answer({})).error == np.inf
    assert score(TRUE, Answer({}, predictions={"exam_a": y * np.nan})).error == np.inf
    with pytest.raises(InputRefused, match="exam_a: 100 samples are predicted, the recording has 101"):
        score(TRUE, Answer({}, predictions={"exam_a": y[1:]}))


def test_two_tools_are_compared_case_by_case() -> None:
    right, silent = score(TRUE, Answer({"creep": 0.9})), score(TRUE, Answer({}))
    first, second = [right] * 9 + [silent], [right] * 2 + [silent] * 7 + [right]
    assert compared(first, second) == (10, 7, 1)
    low, high = paired_interval(10, 7, 1)
    row = f"| other | +60 ({100 * low:+.0f} to {100 * high:+.0f}) | 7 | 1 |"
    assert row in page({"mine": first, "other": second})
    with pytest.raises(ValueError, match="different cases"):
        compared(first, [replace(s, case="another") for s in second])


def test_the_interval_of_a_difference_has_its_closed_form_where_one_tool_is_always_wrong() -> None:
    """One case: the chance that the first alone is right is 2.5 % where it is so with probability 0.025."""
    low, high = paired_interval(1, 1, 0)
    assert (low, high) == (pytest.approx(-0.95, abs=1e-3), 1.0)
    assert paired_interval(0, 0, 0) == (-1.0, 1.0)
    with pytest.raises(ValueError, match="cannot differ"):
        paired_interval(3, 2, 2)


def test_a_tool_without_an_answer_is_right_in_nothing() -> None:
    failed = Answer({"creep": 0.9}, places=("mechanical",), failed="no time")
    found = score(TRUE, failed)
    assert not (found.right or found.first or found.placed or found.placed_within or found.confirmed)
    assert not score(NONE, Answer({}, failed="no time"), "none").confirmed
    # It is not calibrated either, and does not count.
    right = score(TRUE, Answer({"creep": 0.9}))
    figures = summary([right, found])
    assert figures["calibration error"] == pytest.approx(0.1)
    assert figures["without an answer"] == 1.0


def test_balanced_accuracy_weighs_each_kind_alike() -> None:
    creep, delay = (score(TRUE, Answer({n: 0.9})) for n in ("creep", "delay"))
    nothing = score(NONE, NOTHING, "none")
    assert balanced_accuracy([creep, delay, nothing]) == pytest.approx(0.5 * (0.5 + 1.0))
    assert np.isnan(balanced_accuracy([]))
    figures = summary([creep, delay, nothing])
    assert figures["names claimed rightly (same, other, pair)"] == 0.5
    assert figures["false alarms"] == 0.0
    # A tool that predicts nothing has no median.
    assert figures["prediction error / noise, median"] == np.inf
    table = by_group([creep, delay, nothing]).set_index(["of", "value"])
    assert tuple(table.loc[("group", "same"), ["cases", "right"]]) == (2, 1)
    assert table.loc[("strength", "weak"), "cases"] == 2
    # Clopper and Pearson: of one hit in one case the lower end is 0.025.
    assert table.loc[("group", "none"), "low"] == pytest.approx(0.025)


def test_an_answer_comes_back(tmp_path: Path) -> None:
    answer = Answer({"creep": 0.9}, 0.1, 0.2, ("mechanical",), {"exam_a": 1e-6 * np.sin(T)}, 4.0)
    with claim(tmp_path / "o", "bench", (), ("answers",)) as place:
        write_answer(answer, place / "answers", {"exam_a": T})
    again = read_answer(tmp_path / "o" / "answers")
    assert again == answer
    np.testing.assert_allclose(again.predictions["exam_a"], answer.predictions["exam_a"])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"names": {"crepe": 0.5}}, "'crepe' .did you mean creep?"),
        ({"names": {"creep": 1.5}}, "creep the probability 1.5"),
        ({"names": [0.5]}, "names must be an object"),
        ({"places": ["motor"]}, "the place 'motor'"),
        ({"nams": {}}, "unknown key 'nams' .did you mean names?"),
        ({"schema": "phnn.answer/9"}, "is no phnn.answer/1 file"),
        ({"names": {"none": 0.9}}, "an answer names 'none'"),
    ],
)
def test_what_no_answer_can_say_is_refused(content: dict[str, Any], words: str, tmp_path: Path) -> None:
    (tmp_path / ANSWER).write_text(json.dumps({"schema": "phnn.answer/1", **content}))
    with pytest.raises(InputRefused, match=words.replace("?", r"\?")):
        read_answer(tmp_path)


@pytest.mark.parametrize(
    ("verdict", "missing", "claims"),
    [
        ("named", [("creep", "named", [])], {"creep"}),
        ("equivalent", [("creep", "equivalent", ["delay", "sensor_lag"])], {"creep"}),
        ("unknown", [("learned_spring", "learned", [])], {"unlisted"}),
        ("unknown", [("creep", "likely", [])], {"unlisted"}),
        ("unknown", [("creep", "named", []), ("learned_spring", "learned", [])], {"creep"}),
        ("none", [], {"none"}),
    ],
)
def test_a_diagnosis_is_translated(verdict: str, missing: list[tuple[str, str, list[str]]], claims: set[str]) -> None:
    row = {
        "verdict": verdict, "claims": [{"effect": e, "status": s, "alike": others} for e, s, others in missing],
        "places": ["mechanical", "hysteron"],
        "probability": {"creep": 0.6, "delay": 0.2, "sensor_lag": 0.1, "none": 1.0 if verdict == "none" else 0.0},
    }  # fmt: skip
    found = as_answer(row, {})
    assert found.claims == claims
    assert found.places == ("mechanical", "hysteron")
    assert sum(found.names.values()) + found.none + found.unlisted <= 1.0


RNG = np.random.default_rng


def test_every_tool_can_be_had_and_others_are_refused() -> None:
    assert all(callable(tool(name)) for name in TOOLS)
    with pytest.raises(InputRefused, match=r"nothing is called 'lisd' .did you mean lisdd\?"):
        tool("lisd")


def sine_case(folder: Path, effect: str) -> Path:
    """A case with four recordings, one of which is the examination's input too."""
    generate(7, folder, effect, "short")
    (folder / "exam").mkdir()
    shutil.copy(folder / "sine_100Hz_75V.csv", folder / "exam")
    (folder / "exam" / "recordings.yaml").write_text("setup: {model: piezo_actuator, hysterons: 2}\n")
    return folder


@pytest.mark.slow
def test_sindy_finds_a_concealed_cubic_spring_and_leaves_a_null_alone(tmp_path: Path) -> None:
    pytest.importorskip("pysindy")
    found = tool("sindy")(sine_case(tmp_path / "spring", "cubic_stiffness"), 0)
    assert found.claims == {"cubic_stiffness"}
    assert found.places[0] == "mechanical"
    assert found.predictions["sine_100Hz_75V"].size == 2500
    assert tool("sindy")(sine_case(tmp_path / "null", "none"), 0).claims == {"none"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lisdd", "lfr"])
def test_a_tool_finds_a_strong_effect(name: str, tmp_path: Path) -> None:
    found = tool(name)(sine_case(tmp_path / "case", "quadratic_drag"), 0)
    assert "quadratic_drag" in found.claims
    assert found.predictions["sine_100Hz_75V"].size == 2500


def test_one_slope_is_tested_as_scipy_does() -> None:
    """With a constant as the smaller model, the F-test of a slope has the p-value of its t-test."""
    rng = RNG(1)
    x = rng.normal(size=40)
    y = 3.0 + 0.4 * x + rng.normal(size=40)
    assert f_test(y, np.ones((40, 1)), x[:, None]) == pytest.approx(linregress(x, y).pvalue, rel=1e-9)


def test_orthogonal_groups_are_shrunk_as_the_closed_form_says() -> None:
    basis = orthonormal(RNG(2).normal(size=(60, 5)))
    found = [basis[:, :2], basis[:, 2:]]
    r = basis @ np.array([3.0, 4.0, 1.0, 2.0, 2.0])
    for penalty, *norms in group_lasso(r, found, steps=8, least=0.05):
        expected = [max(5.0 - penalty * 2.0**0.5, 0.0), max(3.0 - penalty * 3.0**0.5, 0.0)]
        assert norms == pytest.approx(expected, abs=1e-6)
