"""Noise of every family of the generator is told as what it is, by a fitted model and before there is one."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from report_example import NOISE, make_document, make_evidence, make_trace

from phnn.check import check
from phnn.diagnose.diagnosis import score_on_all
from phnn.identification.plan import Plan
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.recordings import Campaign, read
from phnn.report.document import FitRow, Score
from phnn.report.figures import view_of
from phnn.report.gallery import binned, packed, plots
from phnn.report.result import statements
from phnn.report.write import write_report
from phnn.results import Place
from phnn.setup import Setup
from phnn.signals.noise_statement import NoiseStatement
from studies.generator import draw_case, make_case
from studies.generator.world import simulate_all

_LARGEST = 5_000_000  # bytes of a page of thirteen recordings


def unpacked(series: dict[str, object]) -> np.ndarray:
    """A trace as the script of the page reads it."""
    numbers = np.frombuffer(base64.b64decode(str(series["data"])), dtype="<u2").astype(float)
    values = float(str(series["low"])) + float(str(series["step"])) * numbers
    return np.where(numbers == 65535, np.nan, values)


@given(st.integers(1, 4000), st.integers(1, 50), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_bins_keep_the_smallest_and_the_largest_in_their_order(count: int, width: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = rng.standard_normal(count)
    y[rng.random(count) < 0.1] = np.nan
    found = binned(y, width)
    if width == 1:
        assert np.array_equal(found, y, equal_nan=True)
        return
    for place, start in enumerate(range(0, count, width)):
        block = y[start : start + width]
        known = block[np.isfinite(block)]
        pair = found[2 * place : 2 * place + 2]
        if known.size == 0:
            assert np.isnan(pair).all()
            continue
        first, last = np.flatnonzero(block == known.min())[0], np.flatnonzero(block == known.max())[0]
        assert list(pair) == [block[min(first, last)], block[max(first, last)]]


def test_packed_values_are_within_half_a_step() -> None:
    y = np.concatenate((np.random.default_rng(1).standard_normal(500), [np.nan, np.inf, -np.inf]))
    series = packed(y)
    found = unpacked(series)
    assert np.nanmax(np.abs(found[:500] - y[:500])) <= 0.51 * series["step"]
    assert series["step"] == pytest.approx(np.ptp(y[:500]) / 65534)
    assert np.isnan(found[500:]).all()


def test_plots_show_output_error_and_input_over_the_time_of_the_recording() -> None:
    trace = make_trace("sine_1Hz_75V")
    row = FitRow(trace.name, False, Score(98.0, 1e-7, 3.07), Score(99.5, 5e-8, 1.0))
    content = json.loads(plots(view_of(trace, "V", "m"), row))
    output, error, drive = content["panels"]
    assert [s["role"] for s in output["series"]] == ["measured", "before", "after"]
    assert [s["label"] for s in error["series"]] == ["base model (3.07 × noise)", "final model (1.00 × noise)"]
    points = len(unpacked(output["series"][0]))
    assert content["start"] + content["step"] * points == pytest.approx(3.0, abs=3.0 * content["width"] / 15_000)
    assert np.nanmax(unpacked(error["series"][0])) == pytest.approx(
        1e9 * (trace.measured - trace.before).max(), rel=1e-4
    )
    assert np.nanmax(unpacked(drive["series"][0])) == pytest.approx(trace.u.max(), rel=1e-4)
    assert error["band"] == pytest.approx(2e9 * NOISE)
    assert content["unscored"] == [[0.0, trace.t[299]]]


def test_without_a_second_model_there_is_one_error() -> None:
    trace = make_trace("step_50V", 400)
    content = json.loads(plots(view_of(replace(trace, after=trace.before), "N", "rad"), None))
    assert [len(p["series"]) for p in content["panels"]] == [2, 1, 1]
    assert content["panels"][2]["label"] == "force (N)"


@pytest.mark.slow
def test_a_page_of_thirteen_long_recordings_stays_small(tmp_path: Path) -> None:
    trace = make_trace("sine_1Hz_75V", 60_000)
    shown = make_evidence(("step_50V",))
    traces = tuple(replace(trace, name=f"sine {i}", held_out=i < 4) for i in range(13))
    evidence = replace(shown, traces=traces)
    write_report(make_document("named", evidence), evidence, Place(tmp_path))
    assert (tmp_path / "report.html").stat().st_size < _LARGEST


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
        return campaign, statements(campaign.recordings, score_on_all(fitted, campaign).outputs, fitted.setup, True)

    return one


def notes(found: NoiseStatement) -> str:
    return "; ".join(found.notes)


def test_white_noise(made: Made) -> None:
    campaign, found = made(None)
    for statement in (*(found[n] for n in SEEN), *check(campaign).noise.values()):
        assert statement.colour == "white"
        assert "speed" not in notes(statement) and "outliers" not in notes(statement)


@pytest.mark.parametrize("share", [0.5, pytest.param(0.1, marks=pytest.mark.slow)])
def test_noise_through_the_plant(made: Made, share: float) -> None:
    _, found = made(f"process:{share}")
    fast = found["sine_100Hz_75V"]
    assert fast.colour == "spectrum" and "resonance of the plant" in notes(fast)
    told = [f for f in (found[n] for n in SEEN) if "passes through it" in notes(f)]
    shares = [float(notes(f).partition("): ")[2].partition(" %")[0]) / 100.0 for f in told]
    assert shares == pytest.approx([share] * len(shares), abs=0.05)
    assert len(told) >= 2


def test_noise_at_low_frequencies(made: Made) -> None:
    campaign, found = made("pink:0.5")
    for statement in (*(found[n] for n in SEEN), *check(campaign).noise.values()):
        if "assumed" not in notes(statement):
            assert statement.colour == "spectrum" and "1/f" in notes(statement)


def test_heavy_tails(made: Made) -> None:
    campaign, found = made("heavy:3")
    assert all("outliers" in notes(found[n]) and found[n].colour == "white" for n in SEEN)
    before = [s for s in check(campaign).noise.values() if "assumed" not in notes(s)]
    assert before and all("outliers" in notes(s) for s in before)


def test_coarse_steps(made: Made) -> None:
    campaign, found = made("quantised:3")
    for statement in (*(found[n] for n in SEEN), *check(campaign).noise.values()):
        if "assumed" not in notes(statement):
            assert statement.colour == "white"
            assert notes(statement).startswith("quantised: steps of") and "outliers" not in notes(statement)


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
    assert "Noise:" in checked.text()
    for entry in checked.document()["recordings"].values():
        assert set(entry["noise"]) == {"rms", "source", "colour", "notes"}
        assert all(n in checked.text() for n in entry["noise"]["notes"])
