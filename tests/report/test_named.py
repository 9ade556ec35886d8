"""What speaks for a named element: fingerprint, rivals, plausible values, known forces, and names in another form."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import campaigns
import numpy as np
import pytest

from phnn.effects import Plausible, catalogue, in_all_forms
from phnn.parameters import Parameter
from phnn.recordings.recording import Anchor, Units
from phnn.report.fingerprint import binned, fingerprint, variable_of
from phnn.report.result import plausible_row, supports, write
from phnn.report.verdicts import forces_known

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
