"""The document of a diagnosis: what is missing and how it is told; ranges, rivals and fingerprints of elements."""

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
from phnn.effects import Plausible, catalogue, in_all_forms
from phnn.effects.kinds import LOCATIONS
from phnn.identification.evaluate import evaluate
from phnn.identification.plan import Plan
from phnn.models.store import load
from phnn.parameters import Parameter
from phnn.recordings.recording import Anchor, Units
from phnn.report.document import read_document
from phnn.report.missing import binned, fingerprint, sentence, variable_of
from phnn.report.result import document, evidence, no_proposal, plausible_row, supports, write
from phnn.report.verdicts import forces_known

KEYS = {
    "schema", "verdict", "test", "missing", "remainder", "location", "noise_floor", "numerical_error_sigma", "fit",
    "next_experiment", "versions", "seed", "seconds",
}  # fmt: skip
# Beyond what others rely on.
FURTHER = {"units", "kernel_residual", "rules", "criteria", "noise", "ended", "warnings", "probability"}
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
    assert content["probability"]["quadratic_drag"] == entry["probability"] > 0.95
    assert made("found").probability["quadratic_drag"] == pytest.approx(entry["probability"], abs=1e-4)
    assert content["test"]["p_value"] < 1e-6
    before, after = content["fit"]["before"], content["fit"]["after"]
    assert all(after[n]["residual_over_noise"] < before[n]["residual_over_noise"] for n in after)


def told(found: Diagnosis, **changes: Any) -> Diagnosis:
    """The diagnosis with other claims or another word."""
    return replace(found, outcome=replace(found.outcome, **changes))


@pytest.mark.parametrize("status", ["likely", "provisional"])
def test_an_element_that_is_not_proven_is_in_the_model_and_has_no_name(status: str) -> None:
    found = made("found")
    claim = replace(found.claims[0], status=status, probability=0.72)
    unproven = told(found, word="unknown", claims=(claim,))
    content = document(unproven)
    (entry,) = content["missing"]
    assert (entry["effect"], entry["status"], entry["nearest"]) == ("unknown", status, "quadratic_drag")
    assert "nothing proves" in entry["statement"] and "c_2" in entry["parameters"]
    assert "an element that acts like quadratic drag (72 % sure)" in sentence(unproven)


def test_a_class_is_told_with_its_members() -> None:
    found = made("found")
    claim = replace(found.claims[0], status="equivalent", alike=(catalogue()["coulomb_friction"],))
    tied = told(found, word="equivalent", claims=(claim,))
    (entry,) = document(tied)["missing"]
    assert (entry["effect"], entry["equivalent_to"]) == ("quadratic_drag", ["coulomb_friction"])
    assert sentence(tied).startswith(
        "The model leaves out quadratic drag or coulomb friction; these recordings cannot tell which."
    )


def test_a_named_effect_is_told_inside_an_unknown_whole() -> None:
    named, learned = made("found"), made("unknown").claims[0]
    whole = told(named, word="unknown", claims=(*named.claims, learned))
    assert sentence(whole).startswith("The model leaves out quadratic drag (more than 99 % sure). Something else is")
    assert "a learned damper" in sentence(whole)


def test_without_new_held_out_recordings_a_name_is_not_confirmed() -> None:
    found = made("found")
    outcome = conclude(found.visited, found.chosen, False, (1, 0), found.criteria)
    assert outcome.word == "equivalent"
    assert "the held-out samples bring nothing new to confirm it" in sentence(replace(found, outcome=outcome))


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
    assert "is statistically significant, but explains only" in page
    assert "significant, but immaterial" in page


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
    law = evidence(made("unknown")).curves[1]
    assert law.title.startswith("learned one-port")
    # Drag takes energy from the motion, forwards and backwards, and grows faster than the speed.
    assert np.all(law.x * law.y <= 0.0)
    assert abs(law.y[-1]) > 3.0 * abs(float(np.interp(0.5 * law.x[-1], law.x, law.y)))


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


def test_where_no_element_helps_one_entry_tells_the_place_and_the_nearest_effect() -> None:
    bare = nameless(made("found"), ())
    (entry,) = document(bare)["missing"]
    assert (entry["effect"], entry["status"], entry["nearest"]) == ("unknown", "provisional", "quadratic_drag")
    assert entry["location"] == "mechanical" and entry["parameters"] == {}
    assert "No effect or learned element describes it" in entry["statement"]
    assert "The nearest effect is quadratic drag: it would explain" in sentence(bare)


def test_places_that_are_tied_have_a_reason_where_nothing_is_proposed() -> None:
    assert "two refitted models" in no_proposal(nameless(made("found"), ("sensor",)))


def test_effects_that_are_tied_have_a_reason_where_nothing_is_proposed() -> None:
    found = made("found")
    friction = catalogue()["coulomb_friction"]
    claim = replace(found.claims[0], status="equivalent", alike=(friction,))
    why = no_proposal(replace(told(found, word="equivalent", claims=(claim,)), proposal=None))
    assert "differ once" in why and friction.separation in why


def test_an_unknown_without_a_tie_is_told_what_its_recordings_lack() -> None:
    found = made("found")
    lacking = nameless(found, ())
    lacks = [a.record for a in check(found.campaign).abilities if not a.able]
    assert lacks
    assert all(record in no_proposal(lacking) for record in lacks[:3])
    assert no_proposal(told(lacking, word="none")) == ""


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
    assert [c.fall for c in found.candidates] == sorted((c.fall for c in found.candidates), reverse=True)
    assert {c.effect for c in found.candidates} >= set(CASES[case][1:])
    shares = [m.probability for m in found.models]
    assert shares == sorted(shares, reverse=True) and sum(shares) == pytest.approx(1.0)
    assert [m.chosen for m in found.models].count(True) == 1
    assert "base model" in [m.elements for m in found.models]


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


DRAG = Plausible(0.0, 0.012, "drag in air", outside="it is not air")
TABLE = {"k": Parameter("k", 2e4, "N/m")}


@pytest.mark.parametrize(
    ("value", "unit", "known", "anchored", "actuator", "inside", "text"),
    [
        (11.6, "N s²/m²", DRAG, True, True, False,
         "above the range 0 to 0.012 N s²/m² (drag in air). If it is real, it is not air"),
        (0.01, "N s²/m²", DRAG, True, True, True, "0.01 N s²/m² is plausible"),
        (0.01, "N s²/m²", DRAG, False, True, None, "up to one common factor"),
        (11.6, "N s²/m²", DRAG, True, False, None, "no range known"),
        (11.6, "N s²/m²", Plausible(-math.inf, math.inf, ""), True, True, None, "no range known"),
        (1e3, "N/m", Plausible(0.0, 0.25, "creep", over="k"), False, True, True, "that is 0.05 × k is plausible"),
        (1e4, "N/m", Plausible(0.0, 0.25, "creep", over="k"), False, True, False, "not plausible"),
        (1e-9, "s", Plausible(1e-7, 1e-2, "lags"), True, True, False, "is below"),
    ],
)  # fmt: skip
def test_a_value_is_held_against_its_range(
    value: float, unit: str, known: Plausible, anchored: bool, actuator: bool, inside: bool | None, text: str
) -> None:
    row = plausible_row(Parameter("x", value, unit), known, TABLE, anchored, actuator)
    assert row.inside is inside
    assert text in row.sentence


def test_every_effect_has_a_variable() -> None:
    found = {e.name: variable_of(e) for e in in_all_forms(list(catalogue().values()))}
    assert found["quadratic_drag"] == found["rate_dependent_threshold"] == "velocity"
    assert found["cubic_stiffness"] == found["sensor_nonlinearity"] == found["extra_hysteron"] == "displacement"
    assert found["creep"] == found["charge_leakage"] == "time after a step"
    assert found["sensor_drift"] == found["self_heating"] == "time"
    assert found["amplifier_saturation"] == "voltage"
    assert found["delay"] == found["second_mode"] == "frequency"


def test_means_over_bins_have_the_error_of_their_visits() -> None:
    rng = np.random.default_rng(0)
    place = np.tile(np.repeat(np.arange(4), 25), 40)
    errors = []
    for _ in range(200):
        # Samples of one visit share their error: 25 of them are worth one.
        y = place + np.repeat(rng.standard_normal(160), 25)
        mean, std = binned(y, place, np.zeros_like(place), 4, False)
        errors.append((mean - np.arange(4)) / std)
    assert np.std(errors) == pytest.approx(1.0, abs=0.12)
    mean, std = binned(y, np.where(place == 2, -1, place), np.zeros_like(place), 4, False)
    assert np.isnan(mean[2]) and np.isfinite(mean[[0, 1, 3]]).all()


@pytest.fixture(scope="module")
def found() -> campaigns.Diagnosis:
    return campaigns.diagnosis("quadratic_drag")


def test_the_fingerprint_of_drag_is_a_residual_that_follows_the_velocity(found: campaigns.Diagnosis) -> None:
    (support,) = supports(found)
    seen = support.seen
    assert seen is not None and seen.x_label == "velocity (mm/s)"
    assert np.mean((seen.before / seen.before_std) ** 2) > 5.0
    assert np.mean(np.abs(seen.after) < 4.0 * seen.after_std) > 0.9
    assert np.abs(seen.after).max() < 0.3 * np.abs(seen.before).max()
    # The same data over frequency: what is left is white noise.
    whole = fingerprint(found, catalogue()["delay"])
    assert whole is not None and whole.level == 1.0
    assert whole.before.max() > 3.0
    assert np.median(whole.after) == pytest.approx(1.0, abs=0.15)


def test_rivals_are_told_with_what_they_leave(found: campaigns.Diagnosis) -> None:
    (support,) = supports(found)
    assert support.leaves == pytest.approx(math.sqrt(found.final.chi2))
    rows = {r.effect: r for r in support.rivals}
    visited = {m.elements[0].name: m for m in reversed(found.visited.models) if len(m.elements) == 1}
    assert set(visited) - {"quadratic_drag"} <= set(rows)
    fitting = {n for n in catalogue()["quadratic_drag"].neighbours if n in {c.effect.name for c in found.screened[0]}}
    assert fitting <= set(rows)
    for name, row in rows.items():
        if name not in visited:
            assert row.leaves is None and row.outcome.startswith("not fitted: its score")
            continue
        assert row.leaves == pytest.approx(math.sqrt(visited[name].left)) and row.leaves > 0.99 * support.leaves
        assert "sum of squares" in row.outcome and "larger, probability" in row.outcome
    claim = replace(found.claims[0], status="equivalent", alike=(visited["slew_limit"].elements[0],))
    (tied,) = supports(replace(found, outcome=replace(found.outcome, word="equivalent", claims=(claim,))))
    assert next(r for r in tied.rivals if r.effect == "slew_limit").outcome.startswith("not excluded: ")


def test_what_speaks_for_an_element_without_a_proven_name_is_shown_too(found: campaigns.Diagnosis) -> None:
    (claim,) = found.claims
    likely = replace(found.outcome, word="unknown", claims=(replace(claim, status="likely"),))
    assert [s.effect for s in supports(replace(found, outcome=likely))] == ["quadratic_drag"]
    assert supports(replace(found, outcome=replace(found.outcome, word="unknown", claims=()))) == ()


def test_the_page_shows_it(found: campaigns.Diagnosis, tmp_path: Path) -> None:
    write(found, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    effect = catalogue()["quadratic_drag"]
    for text in (effect.fingerprint, effect.separation, effect.references[0], "What might be taken for it"):
        assert text in page
    assert list((tmp_path / "figures").glob("*fingerprint-quadratic_drag.png"))


@pytest.mark.parametrize(
    ("known", "units", "expected"),
    [
        ({"m": Anchor(1e-3, 1e-5)}, Units("V", "m"), True),
        ({"d_1": Anchor(10.0, 0.0)}, Units("V", "m"), False),
        ({}, Units("V", "m"), False),
        ({}, Units("N", "m"), True),
        ({"rho_2": Anchor(1e-4, 0.0)}, Units("V", "m"), True),
    ],
)
def test_a_stated_value_or_a_measured_force_fixes_the_common_factor(
    known: dict[str, Anchor], units: Units, expected: bool
) -> None:
    found = campaigns.diagnosis("quadratic_drag", "quadratic_drag")
    first, *others = found.campaign.recordings
    campaign = replace(found.campaign, known=known, recordings=(replace(first, units=units), *others))
    assert forces_known(replace(found, campaign=campaign)) is expected


def test_a_force_of_unknown_gain_fixes_nothing() -> None:
    found = campaigns.diagnosis("quadratic_drag", "quadratic_drag")
    recordings = tuple(replace(r, units=Units("N", "m"), gain="unknown") for r in found.campaign.recordings)
    assert not forces_known(replace(found, campaign=replace(found.campaign, known={}, recordings=recordings)))
