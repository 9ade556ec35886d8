"""Noise of every family of the generator is told as what it is, by a fitted model and before there is one."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from phnn.check import check
from phnn.diagnose.diagnosis import score_on_all
from phnn.identification.plan import Plan
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.recordings import Campaign, read
from phnn.report.result import statements
from phnn.setup import Setup
from phnn.signals.noise_statement import NoiseStatement
from studies.generator import draw_case, make_case
from studies.generator.world import simulate_all

Made = Callable[[str | None], tuple[Campaign, dict[str, NoiseStatement]]]
SEEN = ("sine_010Hz_75V", "sine_100Hz_75V", "sine_010Hz_50V", "step_75V")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    @cache
    def one(family: str | None) -> tuple[Campaign, dict[str, NoiseStatement]]:
        folder: Path = tmp_path_factory.mktemp("case") / "r"
        sealed = make_case(draw_case(5, "none", "short", noise=family), folder)
        campaign = read(folder)
        plan = Plan(identification_plan(campaign, 2).recordings, {r.name: 2 for r in campaign.recordings}, 1)
        # From the true parameters: this is no test of the search for starts.
        fitted = fit_identified(Setup(hrc(2, dict(sealed.base)), name="phs"), plan, {"m": "held"})
        return campaign, statements(campaign.recordings, score_on_all(fitted, campaign).outputs, True)

    return one


def notes(found: NoiseStatement) -> str:
    return "; ".join(found.notes)


@pytest.mark.parametrize(("family", "colour", "told", "not_told"), [
    (None, "white", "", ("speed", "outliers")), ("pink:0.5", "spectrum", "1/f", ()),
    ("quantised:3", "white", "quantised: steps of", ("outliers",)),
])  # fmt: skip
def test_noise_is_told_as_what_it_is(
    made: Made, family: str | None, colour: str, told: str, not_told: tuple[str, ...]
) -> None:
    campaign, found = made(family)
    for statement in (*(found[n] for n in SEEN), *check(campaign).noise.values()):
        if family is None or "assumed" not in notes(statement):
            assert statement.colour == colour and told in notes(statement)
            assert not any(word in notes(statement) for word in not_told)


def test_noise_through_the_plant(made: Made) -> None:
    _, found = made("process:0.5")
    assert found["sine_100Hz_75V"].colour == "spectrum"


def test_heavy_tails(made: Made) -> None:
    campaign, found = made("heavy:3")
    assert all("outliers" in notes(found[n]) and found[n].colour == "white" for n in SEEN)
    before = [s for s in check(campaign).noise.values() if "assumed" not in notes(s)]
    assert before and all("outliers" in notes(s) for s in before)


def test_jitter_with_its_size(made: Made) -> None:
    campaign, found = made("jittered:3")
    fast = notes(found["sine_100Hz_75V"])
    assert "grows with the speed" in fast and "outliers" not in fast
    case = draw_case(5, "none", "short", noise="jittered:3")
    speeds = [
        np.gradient(q, e.dt) for q, e in zip(simulate_all(case.base, case.recordings), case.recordings, strict=True)
    ]
    fastest = max(float(np.sqrt(np.mean(v**2))) for v in speeds)
    assert fast.split()[6] == "µs"
    assert float(fast.split()[5]) == pytest.approx(3e6 * case.noise.deviation / fastest, rel=0.15)
    assert "grows with the speed" in notes(check(campaign).noise["sine_100Hz_75V"])


def test_the_text_of_a_check_and_its_document_tell_it(made: Made) -> None:
    campaign, _ = made("heavy:3")
    checked = check(campaign)
    assert "Noise:" in str(checked)
    for entry in checked.document()["recordings"].values():
        assert set(entry["noise"]) == {"rms", "source", "colour", "notes"}
        assert all(n in str(checked) for n in entry["noise"]["notes"])
