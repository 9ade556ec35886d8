"""The studies of rivals: what they make, write and conclude."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rival_example import recording, second_order, sweep

from phnn.comparison import models
from phnn.comparison.models import Settings
from phnn.configuration import compose
from phnn.errors import InputRefused
from phnn.recordings import Part, Start, read
from phnn.results import Place
from studies.comparison.rivals import register_rivals
from studies.generator.excitation import sine
from studies.rival_models.contest import COUNTS, Row, held_out, scarcity_page, truths, truths_page
from studies.rival_models.names import NAMES, rival
from studies.rival_models.real import FOLDERS, Scored, one_to_one, page, real
from studies.rival_models.studies import run
from studies.rival_models.truths import TRUTHS, write_truth

PLAN = ({"sine_050Hz_75V": "identification", "sine_020Hz_40V": "confirmation"}, (sine(50.0), sine(20.0, 40.0)))
QUICK = ("starts=1", "workers=1", "budget=1.5")


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "_RIVALS", {})
    register_rivals()


def settings(*overrides: str) -> Settings:
    return Settings.from_config(compose("compare", [*QUICK, *overrides]))


@pytest.mark.parametrize("truth", TRUTHS)
def test_a_truth_is_drawn_by_its_seed(truth: str, tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        write_truth(tmp_path / name, truth, seed, PLAN, 0.05)
    a, b, c = (read(tmp_path / name).recordings for name in "abc")
    assert np.array_equal(a[0].y, b[0].y)
    assert np.ptp(a[0].y - c[0].y) > 1e-7
    assert 5e-6 < 0.5 * np.ptp(a[0].y) < 500e-6
    # The loop is open, at 20 Hz far below the resonance: its area is many times what noise does to it.
    slow = next(r for r in a if "020Hz" in r.name)
    part = slow.last_periods(1.0)
    area = abs(float(np.sum(slow.u[part][1:] * np.diff(slow.y[part]))))
    noise = slow.noise * float(np.linalg.norm(np.diff(slow.u[part])))  # by parts; the input is zero at both ends
    assert area > 10.0 * noise


def test_an_unknown_truth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="jiles_atherton"):
        write_truth(tmp_path / "x", "jiles_atherton", 0, PLAN, 0.05)


def test_the_study_of_truths_writes_its_table(tmp_path: Path) -> None:
    rows = truths(Place(tmp_path), settings("models=[hammerstein,dahl]"), ["prandtl_ishlinskii"], [4], 0.05)
    assert [r.model for r in rows] == ["dahl", "hammerstein"]
    with (tmp_path / "truths.csv").open() as file:
        written = list(csv.DictReader(file))
    assert {(r["truth"], r["seed"], r["budget"]) for r in written} == {("prandtl_ishlinskii", "4", "1.5")}
    assert float(written[0]["confirmation"]) == pytest.approx(rows[0].scores["confirmation"])
    text = (tmp_path / "truths.md").read_text()
    assert "seeds 4" in text and "1.5 processor seconds" in text and "Hammerstein" in text


def row(model: str, count: int, inside: float, outside: float, seed: int = 0) -> Row:
    scores = {"identification": 1.0, "confirmation": inside, "outside": outside}
    return Row("phs", seed, count, model, scores, 3, 1.0, 60.0, "")


def test_recordings_needed_are_the_fewest_from_which_on_all_stay_near_the_noise() -> None:
    rows = [row("phs", c, v, v) for c, v in zip(COUNTS, (9.0, 1.1, 1.0, 1.0), strict=True)]
    rows += [row("narx", c, v, v) for c, v in zip(COUNTS, (1.1, 3.0, 1.1, 2.0), strict=True)]
    lines = scarcity_page(rows, settings("models=[phs]"), "").splitlines()
    assert next(x for x in lines if x.startswith("| PHS")).endswith("| 2 |")
    assert next(x for x in lines if x.startswith("| NARX")).endswith("| > 7 |")


def test_scores_held_out_are_medians_over_seeds() -> None:
    rows = [row("phs", 4, 3.0, 4.0, seed) for seed in (0, 1)] + [row("phs", 4, float("nan"), 100.0, 2)]
    assert held_out(rows) == pytest.approx(np.sqrt(12.5))
    assert held_out([row("phs", 1, float("nan"), float("nan"))]) == float("inf")
    lost = truths_page([row("narx", 4, 2.0, float("inf"))], settings("models=[phs]"), "")
    assert "| phs | held out, outside | diverged |" in lost
    lines = truths_page(rows, settings("models=[phs]"), "").splitlines()
    assert "| phs | processor seconds | 1.00 |" in lines
    assert "| phs | held out, inside | 3.00 |" in lines and "| phs | held out, outside | 4.00 |" in lines


def test_the_ratio_is_best_of_phnn_over_best_rival() -> None:
    rows = [
        Scored("tanks", "base", 6.0, 5.0, 1.0), Scored("tanks", "diagnosed", 2.0, 2.0, 1.0),
        Scored("tanks", "narx", 4.0, 4.0, 1.0, 2.0),
        Scored("tanks", "gru", float("nan"), float("nan"), 1.0, 2.0, "no time"),
    ]  # fmt: skip
    text = page(rows, settings("models=[phs]"))
    line = next(x for x in text.splitlines() if x.startswith("| tanks"))
    assert line.endswith("| NARX | 0.50 |")
    assert "tanks, gru: no time" in text
    assert "A diagnosis took 1 to 1 processor seconds, and each rival had as many" in text


@pytest.mark.parametrize(
    ("change", "needle"),
    [
        ({"study": "beauty"}, "beauty"), ({"study": "real"}, "folder"), ({"seeds": []}, "seeds"),
        ({"study": "real", "folder": "nowhere"}, "nowhere"),
        ({"study": "real", "folder": "x", "only": ["moon"]}, "moon"),
        ({"study": "real", "folder": "x", "only": "moon"}, "moon"),
        ({"study": "real", "folder": "x", "diagnoses": "no"}, "neither true nor false"),
        ({"noise_um": "x"}, "noise_um=x"), ({"noise_um": -1}, "noise_um=-1"), ({"seeds": [-1]}, "seeds=-1"),
        ({"seeds": "x"}, "seeds=x"), ({"study": "loops", "runs": "x"}, "runs=x"), ({"samples": 0.5}, "samples=0.5"),
    ],
)  # fmt: skip
def test_studies_refuse_what_they_cannot_use(change: dict[str, object], needle: str, tmp_path: Path) -> None:
    config = {
        "study": "truths", "out": str(tmp_path / "out"), "truths": ["phs"], "seeds": [0], "noise_um": 0.05,
        "folder": None, "only": [], "diagnoses": False,
        "runs": 2, "samples": 20000, "drives": 1, "compare": compose("compare", QUICK),
    }  # fmt: skip
    with pytest.raises(InputRefused, match=needle):
        run({**config, **change})


def test_names_of_rivals_are_models_of_a_comparison() -> None:
    assert settings("models=all").models[-len(NAMES) :] == NAMES
    assert settings("models=[gru]").of("gru") == {"seed": 0, "budget": 1.5}
    with pytest.raises(InputRefused, match="budget"):
        settings("budget=0")


@pytest.mark.parametrize("name", ["hammerstein", "narx", "gru", "subnet"])
def test_an_unknown_start_is_estimated(name: str) -> None:
    """The recording begins in motion: what came before is cut off."""
    made = []
    for key, drive in {"slow": (2.0, 2.0, 6.0), "fast": (2.0, 8.0, 20.0), "weak": (0.9, 4.0, 12.0)}.items():
        u = sweep(*drive)
        whole = recording(key, u, second_order(u))
        cut = replace(whole.only(slice(100, 600)), t=whole.t[:500], start=Start("unknown"))
        made.append(replace(cut, parts=(replace(whole.parts[0], last=500),)))
    budget = {"gru": 12.0, "subnet": 12.0}.get(name, 5.0)
    outputs = rival(name).fit(made, budget, 0).outputs(made)
    least = {"hammerstein": 1.1, "narx": 3.0, "gru": 40.0, "subnet": 40.0}[name]
    for r, y in zip(made, outputs, strict=True):
        assert np.sqrt(np.mean(((r.y - y)[30:] / r.noise) ** 2)) < least


@pytest.mark.parametrize("name", ["narx", "gru", "subnet"])
def test_held_out_samples_do_not_begin_a_simulation(name: str) -> None:
    """A recording that begins unknown, held out after its first 20 samples: what is measured later changes nothing."""
    u = sweep(2.0, 2.0, 20.0)
    made = [recording("r", u, second_order(u))]
    fitted = rival(name).fit(made, 2.0, 0, most=3)
    parts = (Part("head", 0, 20, "nuisance"), Part("held", 20, 600, "confirmation"))
    held = replace(made[0], start=Start("unknown"), parts=parts)
    other = replace(held, y=np.where(np.arange(600) < 20, held.y, 0.0))
    first, second = fitted.outputs([held, other])
    # Output splines near the last known sample may move the first grid value a little.
    assert np.abs(first - second).max() < 0.05


def test_public_recordings_are_read_with_one_input_and_one_output() -> None:
    home = Path(os.environ.get("PHNN_RECORDINGS", Path(__file__).parents[4] / "shared" / "recordings"))
    there = [n for n in FOLDERS if (home / n).is_dir()]
    if not there:
        pytest.skip(f"{home}: no public recordings")
    for name in there:
        campaign = one_to_one(home / name, name)
        assert not any(r.further or r.measures for r in campaign.recordings)
        uses = {p.use for r in campaign.recordings for p in r.parts}
        assert {"identification", "confirmation"} <= uses


@pytest.mark.slow
def test_rivals_and_the_base_model_on_the_tanks(tmp_path: Path) -> None:
    home = Path(os.environ.get("PHNN_RECORDINGS", Path(__file__).parents[4] / "shared" / "recordings"))
    if not (home / "tanks").is_dir():
        pytest.skip(f"{home / 'tanks'}: is not there")
    rows = real(Place(tmp_path), settings("models=[hammerstein,narx]"), home, ["tanks"], False)
    assert [r.model for r in rows] == ["base", "hammerstein", "narx"]
    assert all(np.isfinite(r.held_out) for r in rows)
    assert (tmp_path / "real.md").read_text().count("| tanks") == 1
