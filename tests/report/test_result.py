"""From a finished diagnosis to files: the keys of diagnosis.json, the models, the report."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.check import check
from phnn.criteria import CRITERIA
from phnn.diagnosis.confirm import confirmed
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.questions import tied_members
from phnn.effects import catalogue
from phnn.effects.kinds import LOCATIONS
from phnn.identification.evaluate import evaluate
from phnn.identification.plan import Plan
from phnn.models.store import load
from phnn.report.following import no_proposal
from phnn.report.reading import read_document
from phnn.report.result import document, evidence, write
from phnn.report.sentence import sentence

KEYS = {
    "schema", "verdict", "test", "missing", "remainder", "location", "noise_floor", "numerical_error_sigma", "fit",
    "next_experiment", "versions", "seed", "seconds",
}  # fmt: skip
# Beyond what others rely on.
FURTHER = {"units", "kernel_residual", "rules", "criteria", "noise", "ended", "warnings"}
MISSING = {
    "effect", "status", "held_out", "location", "equivalent_to", "p_value", "statement", "equation", "passive",
    "parameters", "share_explained", "place",
}  # fmt: skip

CASES = {
    "none": ("none",),
    "found": ("quadratic_drag",),
    # Nothing but a drift to choose from, and drag is what is missing.
    "unknown": ("quadratic_drag", "sensor_drift"),
    "outside": ("electrostriction", "sensor_drift"),
}


def made(case: str) -> Diagnosis:
    effect, *names = CASES[case]
    return campaigns.diagnosis(effect, *names)


def walk(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [x for v in value.values() for x in walk(v)]
    if isinstance(value, list | tuple):
        return [x for v in value for x in walk(v)]
    return [value]


@pytest.mark.parametrize("case", CASES)
def test_document_has_the_keys_that_others_read(case: str) -> None:
    content = document(made(case))
    text = json.dumps(content, allow_nan=False)
    assert json.loads(text) == content
    assert KEYS <= set(content) <= KEYS | FURTHER
    assert content["schema"] == "phnn.diagnosis/1"
    assert content["criteria"] == {}
    assert all(
        {"rule", "applies", "numbers", "outcome"} <= set(r) <= {"rule", "applies", "numbers", "outcome", "element"}
        for r in content["rules"]
    )
    decided = [r["outcome"] for r in content["rules"] if r["applies"]]
    assert decided[0] == ("none" if case == "none" else "search")
    assert ("named" in decided or "equivalent" in decided) == (content["verdict"] in ("named", "equivalent"))
    assert content["verdict"] in ("named", "equivalent", "unknown", "none")
    assert set(content["test"]) == {"statistic", "p_value", "candidate"}
    assert set(content["remainder"]) - {"immaterial"} == {"verdict", "residual_over_noise", "p_value", "location"}
    assert content["remainder"]["verdict"] in ("none", "unknown")
    assert set(content["fit"]) == {"before", "after", "held_out"}
    names = {r.name for r in campaigns.campaign().recordings}
    assert set(content["noise_floor"]) == names
    assert set(content["fit"]["before"]) == names
    assert content["fit"]["held_out"] == ["sine_010Hz_50V"]
    for scores in (*content["fit"]["before"].values(), *content["fit"]["after"].values()):
        assert set(scores) == {"fit_percent", "rmse", "residual_over_noise"}
    for entry in content["missing"]:
        assert set(entry) - {"nearest", "description"} == MISSING
        assert ("description" in entry) == (entry["status"] == "described")
        assert ("nearest" in entry) == (entry["effect"] == "unknown")
        assert entry["status"] in ("named", "equivalent", "described", "provisional")
        assert entry["held_out"] is None or set(entry["held_out"]) == {"before", "after", "p_value", "rms"}
        assert entry["location"] in LOCATIONS
        assert not re.search(r"[{}]", entry["statement"])
        assert len(entry["statement"]) > 20
        for parameter in entry["parameters"].values():
            assert set(parameter) == {"value", "unit", "std", "interval_95"}
    if content["location"] is not None:
        assert set(content["location"]) == {
            "name", "detail", "dictionary", "tied", "scores", "ranks", "recordings", "frequencies_Hz", "times_s"
        }  # fmt: skip
        assert set(content["location"]["scores"]) <= set(LOCATIONS)
        for row in content["location"]["recordings"].values():
            assert set(row) == {"residual_over_noise"}
    if content["next_experiment"] is not None:
        assert set(content["next_experiment"]) == {
            "recording", "separates", "why", "separation", "needed", "menu", "aim", "groups", "kind", "duration_s",
            "sample_rate_hz", "input", "stretches",
        }  # fmt: skip
    assert {"phnn", "numpy", "torch"} <= set(content["versions"])
    assert all(not isinstance(v, float) or math.isfinite(v) for v in walk(content))
    assert 0.0 < content["numerical_error_sigma"] <= 1.0


def test_what_is_missing() -> None:
    content = document(made("found"))
    assert content["verdict"] in ("named", "equivalent")
    assert (content["verdict"] == "named") == (content["missing"][0]["equivalent_to"] == [])
    entry = content["missing"][0]
    assert (entry["effect"], entry["location"]) == ("quadratic_drag", "mechanical")
    assert entry["equation"] == catalogue()["quadratic_drag"].equation
    assert entry["passive"] is True
    true = campaigns.concealed("quadratic_drag")[1].parameters["c_2"]
    found = entry["parameters"]["c_2"]
    assert abs(found["value"] - true) < 4.0 * found["std"] + 0.02 * true
    assert content["test"]["candidate"] == "quadratic_drag"
    before, after = content["fit"]["before"], content["fit"]["after"]
    assert all(after[n]["residual_over_noise"] < before[n]["residual_over_noise"] for n in after)


def test_a_provisional_element_is_in_the_model_and_has_no_name() -> None:
    found = made("found")
    finding = replace(found.judgement.findings[0], provisional=True)
    content = document(replace(found, judgement=replace(found.judgement, findings=(finding,))))
    entry = content["missing"][0]
    assert (entry["effect"], entry["status"], entry["nearest"]) == ("unknown", "provisional", "quadratic_drag")
    assert "nothing proves" in entry["statement"] and "c_2" in entry["parameters"]


def test_with_a_high_bar_the_same_effect_is_immaterial(tmp_path: Path) -> None:
    found = made("found")
    base, campaign = found.base, found.campaign
    rule = CRITERIA.with_values({"material": 1e3, "real_gain": 1e3})
    judgement, before, after = confirmed(found.judgement, base, campaign, rule, lambda _: mock.Mock())
    assert judgement.verdict == "none" and judgement.final is base and after is before
    content = write(replace(found, judgement=judgement, after=after), tmp_path)
    held = document(found)["missing"][0]["held_out"]
    assert content["missing"] == [] and content["location"] is None and content["fit"]["after"] == {}
    small = content["test"]["immaterial"]
    assert small["candidate"] == "quadratic_drag"
    assert small["rms"] == pytest.approx(held["rms"])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "quadratic drag is statistically significant, but explains only" in page
    assert "significant, but immaterial" in page


@pytest.mark.parametrize(("case", "place"), [("unknown", "mechanical"), ("outside", "coupling")])
def test_what_has_no_name_is_in_the_model_where_it_helps(case: str, place: str) -> None:
    found = made(case)
    content = document(found)
    assert content["verdict"] == "unknown" and content["location"]["name"] == place
    assert len(content["missing"]) == max(1, len(found.judgement.findings))
    for entry in content["missing"]:
        assert entry["effect"] == "unknown"
        assert bool(entry["parameters"]) is bool(found.judgement.findings)
    assert bool(content["fit"]["after"]) is bool(found.judgement.findings)


def test_drag_that_the_catalogue_lacks_is_described_by_its_law() -> None:
    """Nothing but a drift to choose from: a learned damper takes its place, and a formula that of the damper."""
    content = document(made("unknown"))
    (entry,) = content["missing"]
    assert entry["status"] == "described" and entry["nearest"] is None
    found = entry["description"]
    assert set(found) == {"kind", "formula", "words", "parameters", "exponents", "passive", "others"}
    assert found["kind"] == "dissipative" and found["passive"]
    assert found["words"] in entry["statement"] and found["formula"] == entry["equation"]
    assert "square of the speed" in found["words"]
    ((low, high),) = found["exponents"].values()
    assert low < 2.0 < high and high - low < 0.2
    assert found_better(content)
    law = evidence(made("unknown")).curves[1]
    assert law.title.startswith("learned one-port")
    # Drag takes energy from the motion, forwards and backwards, and grows faster than the speed.
    assert np.all(law.x * law.y <= 0.0)
    assert abs(law.y[-1]) > 3.0 * abs(float(np.interp(0.5 * law.x[-1], law.x, law.y)))


def found_better(content: dict[str, Any]) -> bool:
    """Whether every held-out part is fitted better than before."""
    before, after = content["fit"]["before"], content["fit"]["after"]
    return all(after[n]["residual_over_noise"] < before[n]["residual_over_noise"] for n in content["fit"]["held_out"])


def test_a_refit_that_ended_above_the_base_model_has_failed() -> None:
    found = made("found")
    j = found.judgement
    base = j.linearised.fit
    first = j.tried[0]
    assert first.fit is not None
    for cost, outcome in ((900.0, "the refit failed"), (0.99, "explains too little")):
        residual = base.residual * np.sqrt(cost)
        stuck = replace(first, fit=replace(first.fit, residual=residual))
        shown = evidence(replace(found, judgement=replace(j, findings=(), tried=(stuck,)))).candidates
        (row,) = [c for c in shown if c.effect == first.candidate.effect.name]
        assert outcome in row.outcome
        content = document(replace(found, judgement=replace(j, verdict="unknown", findings=(), tried=(stuck,))))
        assert (content["missing"][0]["nearest"] is None) is (cost > 1.0)


def test_places_that_are_tied_have_a_proposal_or_a_reason() -> None:
    found = made("found")
    j = found.judgement
    assert j.location is not None
    nameless = replace(j, verdict="unknown", findings=(), location=replace(j.location, tied=("sensor",)))
    bare = replace(found, judgement=nameless, proposal=None)
    why = no_proposal(bare)
    assert "two refitted models" in why or "differ once" in why
    members = tied_members(nameless)
    assert all(t.cost < j.linearised.fit.cost for t in members)
    places = [t.candidate.effect.location for t in members]
    assert len(set(places)) == len(places) and set(places) <= {"mechanical", "sensor"}


def test_an_unknown_without_a_tie_is_told_what_its_recordings_lack() -> None:
    found = made("found")
    j = found.judgement
    assert j.location is not None
    nameless = replace(j, verdict="unknown", findings=(), tried=(), location=replace(j.location, tied=()))
    lacking = replace(found, judgement=nameless, proposal=None)
    lacks = [a.record for a in check(found.campaign).abilities if not a.able]
    assert lacks
    assert all(record in no_proposal(lacking) for record in lacks[:3])
    assert no_proposal(replace(lacking, judgement=replace(nameless, verdict="none"))) == ""


def test_nothing_is_held_against_a_noise_floor_that_was_not_found(tmp_path: Path) -> None:
    found = made("found")
    first, *others = found.campaign.recordings
    bare = replace(found, campaign=replace(found.campaign, recordings=(replace(first, noise_found=False), *others)))
    assert "× noise" in sentence(found)
    assert "× noise" not in sentence(bare)
    assert f"No noise floor was found in {first.name}" in sentence(bare)
    shown = read_document(document(bare))
    for row in shown.fits:
        known = not row.name.startswith(first.name)
        assert (row.before.residual_over_noise is not None) is known
        assert row.before.fit_percent is not None


@pytest.mark.parametrize("case", CASES)
def test_evidence_covers_what_was_recorded(case: str) -> None:
    found = evidence(made(case))
    assert {t.name for t in found.traces} == {r.name for r in campaigns.campaign().recordings}
    assert [t.name for t in found.traces if t.held_out] == ["sine_010Hz_50V"]
    assert {p.name for p in found.parameters} >= {"m", "k", "alpha", "C_1", "d_2"}
    assert found.verdict_sentence
    assert "nan" not in found.verdict_sentence
    assert [row.recording for row in found.ledger] == [r.name for r in made(case).base.plan.recordings]
    every = [n for n, e in catalogue().items() if e.can_be_added_to(made(case).base.setup)]
    assert len(found.candidates) == len(CASES[case][1:] or every)


@pytest.mark.parametrize("case", ["none", "found"])
def test_files_are_written_and_the_model_gives_the_output_back(tmp_path: Path, case: str) -> None:
    diagnosis = made(case)
    content = write(diagnosis, tmp_path)
    assert json.loads((tmp_path / "diagnosis.json").read_text()) == content
    page = (tmp_path / "report.html").read_text()
    assert page.lstrip().lower().startswith("<!doctype html")
    assert not re.search(r"""(src|href)=["']https?:""", page)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        ".phnn", "base", "diagnosis.json", "figures", "index.html", "model", "report.html",
    ]  # fmt: skip
    assert list((tmp_path / "figures").iterdir())
    assert not list(tmp_path.rglob("*.part"))
    for folder, scores in (("base", diagnosis.before), ("model", diagnosis.after)):
        setup, steps = load(tmp_path / folder)
        for recording in diagnosis.campaign.recordings:
            plan = Plan((recording,), {recording.name: steps}, 1)
            again = evaluate(setup, plan, {}).outputs[recording.name]
            # The stored steps are the finest of the plan: what differs is below the noise.
            np.testing.assert_allclose(again, scores.outputs[recording.name], atol=0.2 * recording.noise)
