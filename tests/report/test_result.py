"""The document of a diagnosis: what is missing and how it is told."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import campaigns
import numpy as np
import pytest

from phnn.check import check
from phnn.criteria import Criteria
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.verdict import conclude
from phnn.effects import Plausible, catalogue
from phnn.effects.kinds import LOCATIONS
from phnn.effects.learned import learned_elements
from phnn.identification.evaluate import evaluate
from phnn.identification.plan import Plan
from phnn.models.store import load
from phnn.parameters import Parameter
from phnn.recordings.recording import Anchor, Units
from phnn.report import statements
from phnn.report.result import document, reasons, write
from phnn.report.statements import acts_like, forces_known, headline, next_recording, plausibility, summary

KEYS = {
    "schema", "verdict", "test", "missing", "remainder", "location", "noise_floor", "numerical_error_sigma", "fit",
    "next_experiment", "versions", "seed", "seconds",
}  # fmt: skip
# Beyond what others rely on.
FURTHER = {"summary", "units", "kernel_residual", "rules", "criteria", "noise", "ended", "warnings", "probability"}
MISSING = {
    "effect", "status", "held_out", "location", "equivalent_to", "p_value", "statement", "equation", "passive",
    "parameters", "share_explained", "place", "probability",
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
    # The first rule that applies is the last one asked, and gives the verdict.
    assert 1 <= len(content["rules"]) <= 10
    assert [r["applies"] for r in content["rules"][:-1]] == [False] * (len(content["rules"]) - 1)
    assert content["rules"][-1]["outcome"] in ("", content["verdict"])
    assert content["probability"]["none"] == round(made(case).probability["none"], 4)
    assert all(0.001 <= p <= 1.0 for n, p in content["probability"].items() if n != "none")
    assert content["ended"]["why"] == "nothing left" and content["ended"]["evaluations"] > 0.0
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
        assert entry["status"] in ("named", "equivalent", "likely", "described", "learned", "provisional")
        assert entry["probability"] is None or 0.0 <= entry["probability"] <= 1.0
        assert entry["held_out"] is None or set(entry["held_out"]) == {"before", "after", "p_value", "rms"}
        assert entry["location"] in LOCATIONS
        assert not re.search(r"[{}]", entry["statement"])
        assert len(entry["statement"]) > 20
        for parameter in entry["parameters"].values():
            assert set(parameter) == {"value", "unit", "std", "interval_95"}
    if content["location"] is not None:
        assert set(content["location"]) == {
            "name", "detail", "dictionary", "tied", "scores", "ranks", "recordings", "frequencies_Hz", "times_s",
            "reasons",
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
    assert content["probability"]["quadratic_drag"] == entry["probability"] > 0.95
    assert made("found").probability["quadratic_drag"] == pytest.approx(entry["probability"], abs=1e-4)
    assert content["test"]["p_value"] < 1e-6
    before, after = content["fit"]["before"], content["fit"]["after"]
    assert all(after[n]["residual_over_noise"] < before[n]["residual_over_noise"] for n in after)


def told(found: Diagnosis, **changes: Any) -> Diagnosis:
    """The diagnosis with other claims or another word."""
    return replace(found, outcome=replace(found.outcome, **changes))


@pytest.mark.parametrize("status", ["likely", "provisional"])
def test_an_element_that_is_not_proven_is_in_the_model_and_has_no_name(
    status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = made("found")
    claim = replace(found.claims[0], status=status, probability=0.72)
    unproven = told(found, word="unknown", claims=(claim,))
    content = document(unproven)
    (entry,) = content["missing"]
    assert (entry["effect"], entry["status"], entry["nearest"]) == ("unknown", status, "quadratic_drag")
    assert "nothing proves" in entry["statement"] and "c_2" in entry["parameters"]
    assert "acts like quadratic drag (mechanical, 72 %)" in summary(unproven)
    assert headline(unproven) == "A mechanical effect is missing; no name is proven"
    monkeypatch.setattr(statements, "likenesses", lambda found: [])
    drifting = replace(claim, effect=learned_elements()["learned_ratio_over_time"])
    assert headline(told(unproven, claims=(drifting,))) == "The coupling changes with time; no name is proven"


def test_without_new_held_out_recordings_a_name_is_not_confirmed() -> None:
    found = made("found")
    outcome = conclude(found.visited, found.chosen, False, (1, 0), found.criteria)
    assert outcome.word == "equivalent"
    assert headline(replace(found, outcome=outcome)) == "Quadratic drag is missing; no new recording confirms it"


def test_what_is_significant_and_immaterial_is_told_with_its_size(tmp_path: Path) -> None:
    found = made("found")
    # So much may be left that the base model, of which nothing is certain, is near enough.
    criteria = Criteria().with_values({"material": 1e3, "far": 1e3})
    base = next(m for m in found.visited.models if not m.elements)
    outcome = conclude(found.visited, found.chosen, True, (0, 0), criteria)
    assert outcome.word == "none" and outcome.claims == ()
    small = replace(
        found, outcome=outcome, criteria=criteria, chosen=base, after=found.before, location=None, gains=(),
        proposal=None, screened=(found.screened[0], found.screened[0]),
    )  # fmt: skip
    content = write(small, tmp_path)
    assert content["missing"] == [] and content["location"] is None and content["fit"]["after"] == {}
    immaterial = content["test"]["immaterial"]
    assert immaterial["candidate"] == content["test"]["candidate"]
    best = max(found.screened[0], key=lambda c: c.score)
    assert immaterial["share_of_noise"] == pytest.approx((best.fall / found.base.residual.size) ** 0.5)
    assert immaterial["rms"] == pytest.approx(
        immaterial["share_of_noise"] * found.campaign.recordings[0].noise, rel=0.2
    )
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Nothing is missing" in page and "too small to matter" in page


@pytest.mark.parametrize(("case", "place"), [("unknown", "mechanical"), ("outside", "coupling")])
def test_what_has_no_name_is_in_the_model_where_it_helps(case: str, place: str) -> None:
    found = made(case)
    content = document(found)
    assert content["verdict"] == "unknown" and content["location"]["name"] == place
    assert len(content["missing"]) == len(found.claims) > 0
    for entry in content["missing"]:
        assert entry["effect"] == "unknown" and entry["status"] in ("described", "learned") and entry["parameters"]
    assert content["fit"]["after"] and found_better(content)


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


def found_better(content: dict[str, Any]) -> bool:
    """Whether every held-out part is fitted better than before."""
    before, after = content["fit"]["before"], content["fit"]["after"]
    return all(after[n]["residual_over_noise"] < before[n]["residual_over_noise"] for n in content["fit"]["held_out"])


def nameless(found: Diagnosis, tied: tuple[str, ...]) -> Diagnosis:
    """The diagnosis where no element describes the mismatch, at one place or at several."""
    assert found.location is not None
    base = next(m for m in found.visited.models if not m.elements)
    where = replace(found.location, tied=tied)
    return replace(told(found, word="unknown", claims=()), chosen=base, location=where, gains=(), proposal=None)


def test_doubtful_recordings_come_first() -> None:
    found = made("unknown")
    high = tuple(replace(r, u=1e3 * r.u) for r in found.campaign.recordings)
    text = summary(replace(found, campaign=replace(found.campaign, recordings=high)))
    assert "Before you believe the rest, correct the recordings." in text and "probably in mV" in text
    assert "Use the model all the same" not in text and "Use the model all the same" in summary(found)


def test_where_no_element_helps_one_entry_tells_the_place_and_the_nearest_effect() -> None:
    bare = nameless(made("found"), ())
    (entry,) = document(bare)["missing"]
    assert (entry["effect"], entry["status"], entry["nearest"]) == ("unknown", "provisional", "quadratic_drag")
    assert entry["location"] == "mechanical" and entry["parameters"] == {}
    assert "No effect and no learned element is in the model" in entry["statement"]
    assert "It acts most like quadratic drag, which alone explains" in acts_like(bare)
    # Places that are tied are not claimed.
    assert headline(nameless(made("found"), ("sensor",))) == "Something is missing; no name is proven"
    # Nor is a place where the effect that explains most does not act.
    assert bare.location is not None
    elsewhere = replace(bare, location=replace(bare.location, name="sensor"))
    assert headline(elsewhere) == "Something is missing; no name is proven"


def test_a_longer_bar_that_lost_has_its_reason() -> None:
    found = made("found")
    assert found.location is not None
    longer = replace(found.location, scores=found.location.scores | {"sensor": 1.5})
    lost = "longer bar, but of the fitted models the one with quadratic drag fits best"
    assert reasons(found, longer) == {"sensor": lost}
    bare = nameless(found, ())
    told = reasons(bare, replace(longer, ranks=longer.ranks | {"sensor": 0.25}))
    assert told == {"sensor": "longer bar, but only 0.25 of it is confirmed by another recording"}


def test_effects_that_are_tied_are_told_with_a_reason_where_nothing_is_proposed() -> None:
    found = made("found")
    friction = catalogue()["coulomb_friction"]
    claim = replace(found.claims[0], status="equivalent", alike=(friction,))
    tied = replace(told(found, word="equivalent", claims=(claim,)), proposal=None)
    (entry,) = document(tied)["missing"]
    assert (entry["effect"], entry["equivalent_to"]) == ("quadratic_drag", ["coulomb_friction"])
    why = next_recording(tied)
    assert "No further recording within the range of these would decide" in why and friction.separation in why


def test_an_unknown_without_a_tie_is_told_what_its_recordings_lack() -> None:
    found = made("found")
    lacking = nameless(found, ())
    lacks = [a.record for a in check(found.campaign).abilities if not a.able]
    assert lacks
    assert all(record in next_recording(lacking) for record in lacks[:3])
    assert next_recording(told(lacking, word="none")) == ""


@pytest.mark.parametrize("case", ["none", "found"])
def test_files_are_written_and_the_model_gives_the_output_back(tmp_path: Path, case: str) -> None:
    diagnosis = made(case)
    content = write(diagnosis, tmp_path)
    assert json.loads((tmp_path / "diagnosis.json").read_text()) == content
    page = (tmp_path / "report.html").read_text()
    assert page.lstrip().lower().startswith("<!doctype html")
    assert not re.search(r"""(src|href)=["']https?:""", page)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        ".phnn", "base", "diagnosis.json", "figures", "model", "report.html",
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


DRAG = Plausible(0.0, 0.012, "drag in air", outside="it is not air")
TABLE = {"k": Parameter("k", 2e4, "N/m")}


@pytest.mark.parametrize(
    ("value", "unit", "known", "anchored", "text"),
    [
        (11.6, "N s²/m²", DRAG, True,
         "above the range 0 to 0.012 N s²/m² (drag in air). If it is real, it is not air"),
        (0.01, "N s²/m²", DRAG, True, "0.01 N s²/m² is plausible"),
        (0.01, "N s²/m²", DRAG, False, ""),
        (11.6, "N s²/m²", Plausible(-math.inf, math.inf, ""), True, ""),
        (1e3, "N/m", Plausible(0.0, 0.25, "creep", over="k"), False, "that is 0.05 × k, is plausible"),
        (1e4, "N/m", Plausible(0.0, 0.25, "creep", over="k"), False, "not plausible"),
        (1e-9, "s", Plausible(1e-7, 1e-2, "lags"), True, "is below"),
    ],
)  # fmt: skip
def test_a_value_is_held_against_its_range(
    value: float, unit: str, known: Plausible, anchored: bool, text: str
) -> None:
    said = plausibility(Parameter("x", value, unit), known, TABLE, anchored)
    assert text in said and bool(text) == bool(said)


@pytest.mark.parametrize(
    ("known", "changes", "expected"),
    [
        ({"m": Anchor(1e-3, 1e-5)}, {}, True),
        ({"d_1": Anchor(10.0, 0.0)}, {}, False),
        ({}, {}, False),
        ({}, {"units": Units("N", "m")}, True),
        ({}, {"units": Units("N", "m"), "gain": "unknown"}, False),
        ({"rho_2": Anchor(1e-4, 0.0)}, {}, True),
    ],
)
def test_a_stated_value_or_a_measured_force_fixes_the_common_factor(
    known: dict[str, Anchor], changes: dict[str, Any], expected: bool
) -> None:
    found = made("found")
    recordings = tuple(replace(r, **changes) for r in found.campaign.recordings)
    campaign = replace(found.campaign, known=known, recordings=recordings)
    assert forces_known(replace(found, campaign=campaign)) is expected
