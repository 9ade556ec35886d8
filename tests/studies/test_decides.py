"""The study of what decides: models of a log are weighed as the product weighs them, and held against the truth."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from scripts_example import script

from phnn.criteria import Criteria
from phnn.diagnose.number import Misfit, Visited, log_weight, tolerated, weigh
from phnn.effects import Effect, effect
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused
from studies.decides import page
from studies.decides.compare import WAYS, answered, numbered, tolerance
from studies.sealed.grade import Answer, Case, calibration_error, cases_in, log_score
from studies.sealed.run import _model

ROOT = Path(__file__).resolve().parents[2]
CRITERIA = Criteria()
SAMPLES = 2000
SPRING, RELAXATION = learned_elements()["learned_spring"], learned_elements()["learned_relaxation"]
CREEP, DELAY, HYSTERON = effect("creep"), effect("delay"), effect("extra_hysteron")


def visited(*elements: Effect, left: tuple[float, float, float] = (1.0, 1.0, 1.0), nuisances: int = 0) -> Visited:
    """A model that leaves some mean squares of two fitted recordings and a held-out one."""
    parameters = {n: SimpleNamespace(fixed=n == "tau_s") for e in elements for n in e.parameters}
    fit: Any = SimpleNamespace(setup=SimpleNamespace(parameters=parameters))
    misfits = {f"r{i}": Misfit(v * SAMPLES, SAMPLES) for i, v in enumerate(left)}
    return Visited(elements, fit, {n: misfits[n] for n in ("r0", "r1")}, {"r2": misfits["r2"]}, nuisances, True)


BASE = visited(left=(9.0, 4.0, 5.0))


def row(*models: Visited, group: str = "listed", effects: tuple[str, ...] = (), **changes: Any) -> dict[str, Any]:
    """A row of the log as `visit` writes it."""
    return {
        "group": group, "seed": 1, "effects": list(effects), "withheld": [], "form": "canonical", "verdict": "unknown",
        "probability": weigh(models, CRITERIA).probability, "claims": [], "ended": "nothing left",
        "facts": {"promising": 3.0, "remaining": 0.0}, "models": [_model(m) for m in models],
    } | changes  # fmt: skip


def case(*models: Visited, **changes: Any) -> Case:
    """A case that was logged and read again."""
    return Case(json.loads(json.dumps(row(*models, **changes))))


MODELS = (
    BASE, visited(CREEP, left=(1.1, 1.0, 1.0)), visited(DELAY, left=(1.3, 1.2, 1.1), nuisances=4),
    visited(RELAXATION), visited(CREEP, SPRING), visited(HYSTERON, left=(3.0, 2.0, 2.0)),
)  # fmt: skip


def test_a_logged_model_has_the_number_of_the_model_that_was_visited() -> None:
    again = case(*MODELS).models
    rho = tolerated(MODELS, CRITERIA)
    for before, after in zip(MODELS, again, strict=True):
        assert (after.key, after.families, after.left) == (before.key, before.families, before.left)
        assert log_weight(after, rho, CRITERIA) == log_weight(before, rho, CRITERIA)
    assert tolerance(again) == rho
    own = numbered(again, rho)
    assert own.logs == pytest.approx(weigh(MODELS, CRITERIA).logs)
    assert own.probability == weigh(MODELS, CRITERIA).probability


def answer(*alternatives: tuple[tuple[str, ...], float], word: str = "unknown", **claims: str) -> Answer:
    """An answer with alternatives; claims by their status."""
    probability: dict[str, float] = {}
    for names, p in alternatives:
        for n in names or ("none",):
            probability[n] = probability.get(n, 0.0) + p
    return Answer(list(alternatives), probability, word, tuple((s, (n,)) for n, s in claims.items()))


@pytest.mark.parametrize(
    ("changes", "alternatives", "right"),
    [
        ({"group": "none"}, [((), 0.7), (("creep",), 0.3)], 0.7),
        ({"effects": ("creep",)}, [(("creep",), 0.6), (("creep", "learned_spring"), 0.4)], 0.6),
        (
            {"effects": ("creep",), "form": "log_creep", "group": "listed, another form"},
            [(("creep",), 0.6), (("creep", "learned_spring"), 0.4)], 1.0,
        ),
        (
            {"effects": ("delay",), "group": "listed, with a background"},
            [(("creep", "delay"), 0.6), (("creep",), 0.3), (("delay", "sensor_lag"), 0.1)], 0.6,
        ),
        (
            {"effects": ("delay",), "group": "listed, base of plays"},
            [(("delay", "extra_hysteron"), 0.5), (("delay", "learned_spring"), 0.2), (("creep", "delay"), 0.3)], 0.7,
        ),
        ({"effects": ("regime_damper",), "form": "unlisted"}, [(("creep",), 0.4), (("delay",), 0.6)], 0.4),
        ({"effects": ("creep",), "withheld": ["creep"]}, [(("learned_spring",), 1.0)], 1.0),
        ({"effects": ("creep",), "withheld": ["creep"]}, [((), 0.9), (("delay",), 0.1)], 0.1),
    ],
)  # fmt: skip
def test_the_probability_of_being_right(changes: dict[str, Any], alternatives: Any, right: float) -> None:
    assert case(*MODELS, **changes).right(answer(*alternatives)) == pytest.approx(right)


def test_calibration_error_and_log_score_by_hand() -> None:
    assert calibration_error([(0.9, True), (0.9, False), (0.2, False), (0.2, False)]) == pytest.approx(0.3)
    assert calibration_error([(1.0, True), (0.0, False)]) == 0.0
    # Of ten statements of 0.75, seven or eight should be true; in one bin too high and too low ones cancel.
    assert calibration_error([(0.75, k < 7) for k in range(10)] + [(0.75, k < 8) for k in range(10)]) == 0.0
    mixed = [(0.55, True), (0.55, False), (0.52, True), (0.58, False)]
    assert calibration_error(mixed) == pytest.approx(0.05)
    assert calibration_error([(0.95, True), (0.15, True)]) == pytest.approx(0.5 * (0.05 + 0.85))
    assert math.isnan(calibration_error([]))
    own = case(*MODELS, effects=("creep",))
    assert log_score(own, answer((("creep",), 0.5))) == pytest.approx(math.log(0.5))
    assert log_score(own, answer((("delay",), 1.0))) == pytest.approx(math.log(1e-3))


def test_the_verdict_is_made_anew_by_the_rules_of_the_product() -> None:
    own = case(*MODELS[:2], effects=("creep",))
    assert answered(own, weigh(own.models, CRITERIA)).word == "named"
    nothing = case(visited(), visited(CREEP), group="none")
    assert answered(nothing, weigh(nothing.models, CRITERIA)).word == "none"
    early = case(*MODELS[:2], effects=("creep",), ended="seconds")
    assert answered(early, weigh(early.models, CRITERIA)).word == "unknown"


def test_each_half_of_the_cases_is_judged_by_values_of_the_other_one() -> None:
    # A small gain that is real: the lower price is right.
    weak = [visited(left=(1.05, 1.0, 1.0)), visited(CREEP)]
    cases = [case(*weak, effects=("creep",), seed=s) for s in range(4)]
    low, default = page.Setting(price_effect=1.0), page.Setting()
    _, rows = page.halves(cases, [low, default])
    assert [r[1] for r in rows] == [low.words] * 3
    gain = log_score(cases[0], low.answer(cases[0])) - log_score(cases[0], default.answer(cases[0]))
    assert gain > 0.0
    assert rows[-1][4] == f"gain {gain:+.3f} ({gain:+.3f} to {gain:+.3f})"


def test_the_command_prints_all_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [row(*MODELS, effects=("creep",)), row(visited(), visited(CREEP), group="none", seed=2, verdict="none")]
    failed = {"group": "pair", "seed": 3, "failure": "no"}
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(r) + "\n" for r in [*rows, failed]), encoding="utf-8")
    assert cases_in(log)[0][1].answer.word == "none"
    monkeypatch.setattr(page, "SETTINGS", (page.Setting(),))
    script("decides", "compare", str(log))
    printed = capsys.readouterr().out
    assert printed.startswith("2 cases, 1 without an answer")
    assert all(f"| {name} | " in printed for name in WAYS)


def test_a_log_without_a_case_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=r"no case in it: write one"):
        cases_in(tmp_path / "log.jsonl")


@pytest.mark.parametrize("table", [page.rules(), page.criteria()])
def test_the_page_states_rules_and_criteria_as_they_are(table: page.Table) -> None:
    text = (ROOT / "docs" / "decides.md").read_text(encoding="utf-8")
    assert page.markdown(table) in text, "python scripts/decides.py page writes them anew"
