"""Whole comparisons on small recordings, rivals of a user, black boxes that begin linear."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import campaigns
import numpy as np
import pytest
import torch

from phnn.cli import main
from phnn.comparison import models
from phnn.comparison.models import MODELS, Bench, Result, Settings, _stride, _thinned, compare, register_rival
from phnn.configuration import compose
from phnn.errors import InputRefused
from phnn.learn.starts import plant_for, scales_of, unfitted
from phnn.models.actuator import hrc
from phnn.models.store import load
from phnn.network.system import PortHamiltonianSystem
from phnn.recordings import Campaign, read
from phnn.recordings.recording import Recording
from phnn.setup import Setup

NOISE = 60e-9
MANIFEST = f"""{campaigns.KNOWN}recordings:
  - {{file: sine_050Hz_75V.csv, use: identification}}
  - {{file: sine_100Hz_75V.csv, use: identification}}
  - {{file: sine_070Hz_75V.csv, use: confirmation}}
  - {{file: sine_070Hz_30V.csv, use: confirmation}}
"""
DRIVES = ((50.0, 75.0), (100.0, 75.0), (70.0, 75.0), (70.0, 30.0))
# A handful of steps of training each.
CHEAP = (
    "starts=1", "workers=1", "budget=1.0", "models=all", "phs_neural.model.width=3",
    "phs_neural.stages.whole.gauss_newton=2", "phs_neural_adjoint.model.width=3",
    "phs_neural_adjoint.stages.whole.lbfgs=2",
    *(f"{m}.model.width=3" for m in ("neural_phs", "neural_ode")),
    *(f"{m}.model.states=3" for m in ("neural_phs", "neural_ode")),
    *(f"{m}.stages.{s}.lbfgs=1" for m in ("neural_phs", "neural_ode") for s in ("short", "long")),
    *(f"{m}.stages.{s}.lbfgs_iterations=1" for m in ("neural_phs", "neural_ode") for s in ("short", "long")),
    *(f"{m}.stages.long.window=51" for m in ("neural_phs", "neural_ode")),
    *(f"{m}.{key}" for m in ("neural_phs", "neural_ode") for key in ("longest_step=0.7", "least_per_period=20")),
)  # fmt: skip


@cache
def recording(frequency: float = 50.0, amplitude: float = 75.0) -> Recording:
    """Two and a half periods of a sine."""
    t = np.arange(251) / (100 * frequency)
    u = amplitude * np.sin(2 * np.pi * frequency * t)
    name = f"sine_{frequency:03.0f}Hz_{amplitude:g}V"
    return campaigns.recorded(Setup(hrc(1, campaigns.GENTLE)), name, t, u, NOISE, int(frequency))


def written(folder: Path) -> Path:
    """The recordings as a folder."""
    return campaigns.written(folder, (recording(*drive) for drive in DRIVES), MANIFEST)


def settings(*overrides: str) -> Settings:
    """Settings of the configuration with some moved."""
    return Settings.from_config(compose("compare", [*CHEAP, *overrides]))


QUICK = ("phs", "bouc_wen", "linear", "neural_ode")
HELD = {"sine_070Hz_75V", "sine_070Hz_30V"}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return read(written(tmp_path_factory.mktemp("compare") / "recordings"))


@pytest.fixture(scope="module")
def out(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of models that are fitted quickly."""
    folder = tmp_path_factory.mktemp("compared")
    compare(campaign, folder, settings(f"models=[{','.join(QUICK)}]"))
    return folder


@pytest.fixture
def no_rivals(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Rivals that a test registers are gone after it."""
    monkeypatch.setattr(models, "_RIVALS", {})
    yield


def content(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def check_scores(found: dict[str, Any]) -> None:
    """Every recording of every model, with the keys of the contract, and the exact model better than a crude one."""
    for rows in found.values():
        assert set(rows) == {recording(*d).name for d in DRIVES}
        for name, row in rows.items():
            assert row["held_out"] == (name in HELD)
            assert np.isfinite([row["fit_percent"], row["rmse"], row["residual_over_noise"]]).all()
    assert all(row["residual_over_noise"] < 1.2 for row in found["phs"].values())
    assert all(row["residual_over_noise"] > 3.0 for row in found["linear"].values())


def test_scores_and_facts_of_the_models(out: Path) -> None:
    scores, facts = content(out / "compare.json"), content(out / "models.json")
    assert tuple(scores) == tuple(facts) == QUICK
    check_scores(scores)
    for found in facts.values():
        assert found["seed"] == 0 and found["parameters"] > 0 and found["seconds"] >= 0.0 and found["kind"]


@pytest.mark.slow
def test_all_models_are_compared(campaign: Campaign, tmp_path: Path, no_rivals: None) -> None:
    compare(campaign, tmp_path, settings())
    scores = content(tmp_path / "compare.json")
    assert tuple(scores) == tuple(MODELS)
    check_scores(scores)
    assert max(row["residual_over_noise"] for row in scores["phs_neural"].values()) < 3.0
    assert load(tmp_path / "phs_neural")[0].parameters


def test_what_is_written(out: Path) -> None:
    names = {".phnn", "compare.json", "models.json", "compare.csv", "compare.md", "compare.png", *QUICK}
    assert {p.name for p in out.iterdir()} >= names
    for model in ("phs", "bouc_wen", "linear"):
        setup, substeps = load(out / model)
        assert setup.parameters
        assert substeps >= 1
    page = (out / "compare.md").read_text()
    assert "(compare.png)" in page and "| sine_070Hz_30V | held out |" in page and "| PHS | Bouc–Wen | linear |" in page
    assert (out / "compare.png").read_bytes().startswith(b"\x89PNG")


def test_the_table_says_what_the_json_says(out: Path) -> None:
    scores = content(out / "compare.json")
    with (out / "compare.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(r["recording"], r["model"]) for r in rows} == {(n, m) for m, own in scores.items() for n in own}
    for row in rows:
        entry = scores[row["model"]][row["recording"]]
        numbers = [float(row[n]) for n in ("fit_percent", "rmse_m", "residual_over_noise")]
        assert numbers == [entry["fit_percent"], entry["rmse"], entry["residual_over_noise"]]
        assert (row["use"] == "confirmation") == entry["held_out"]


def test_finished_models_are_read_back(out: Path, campaign: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (out / "compare.json").read_bytes()

    def refit(*_: object) -> None:
        raise AssertionError("a model is fitted again")

    monkeypatch.setattr(models, "_FITTERS", dict.fromkeys(MODELS, refit))
    compare(campaign, out, settings(f"models=[{','.join(QUICK)}]"))
    assert (out / "compare.json").read_bytes() == before
    # What does not enter a result may change, and fewer models may be asked for.
    compare(campaign, out, settings("workers=2", "models=[linear,neural_ode]"))
    assert set(content(out / "compare.json")) == {"linear", "neural_ode"}
    for change in ("seed=1", "error_bound_sigma=0.5"):
        with pytest.raises(InputRefused, match="resume=false"):
            compare(campaign, out, settings(change, "models=linear"))
    with pytest.raises(InputRefused, match="recipe"):
        compare(campaign, out, settings("neural_ode.stages.long.lbfgs=2", "models=neural_ode"))


def test_other_recordings_are_noticed(out: Path, campaign: Campaign) -> None:
    first, *others = campaign.recordings
    other = replace(campaign, recordings=(replace(first, noise=2.0 * first.noise), *others))
    with pytest.raises(InputRefused, match="other recordings"):
        compare(other, out, settings("models=linear"))


def test_a_stopped_comparison_keeps_what_was_finished(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitters: Mapping[str, Any] = models._FITTERS

    def stop(bench: Bench, model: str) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as stopped:
        stopped.setattr(models, "_FITTERS", {**fitters, "linear": stop})
        with pytest.raises(KeyboardInterrupt):
            compare(campaign, tmp_path, settings("models=[phs,linear]"))
    assert set(content(tmp_path / "compare.json")) == {"phs"}
    kept = (tmp_path / "phs" / "result.json").read_bytes()
    compare(campaign, tmp_path, settings("models=[phs,linear]"))
    assert set(content(tmp_path / "compare.json")) == {"phs", "linear"}
    assert (tmp_path / "phs" / "result.json").read_bytes() == kept
    (tmp_path / "linear" / "outputs.npz").write_bytes(b"half")
    with pytest.raises(InputRefused, match="was changed after phnn wrote it"):
        compare(campaign, tmp_path, settings("models=[phs,linear]"))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("models=[phs,transformer]", "nothing is called 'transformer'"),
        ("models=[]", "none is named"),
        ("neural_ode.depth=3", "neural_ode.depth"),
        ("neural_ode.stages.short.lbfgs=many", "lbfgs=many"),
        ("neural_ode.stages.short.lbfgs=-1", "whole number, 0 or more"),
        ("neural_ode.longest_step=-1.0", "positive"),
    ],
)
def test_wrong_settings_are_refused(
    override: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(tmp_path), "--out", str(tmp_path / "out"), override]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def proportional(campaign: Campaign, seed: int, budget: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """The output follows the input by one gain."""
    used = [(r.u[m], r.y[m]) for r in campaign.recordings for m in [r.mask("identification")] if m.any()]
    gain = float(np.polyfit(np.concatenate([u for u, _ in used]), np.concatenate([y for _, y in used]), 1)[0])
    return {r.name: gain * r.u for r in campaign.recordings}, {"parameters": 1, "budget_was": budget, "seed_was": seed}


def test_a_registered_rival_is_scored_and_kept_like_the_others(
    campaign: Campaign, tmp_path: Path, no_rivals: None
) -> None:
    register_rival("proportional", proportional, "one gain")
    assert Settings.from_config(compose("compare", ["models=all"])).models == (*MODELS, "proportional")
    results = compare(campaign, tmp_path, settings("models=[proportional,linear]", "budget=7"))
    assert tuple(results) == ("linear", "proportional")
    found: Result = results["proportional"]
    assert found.facts["budget_was"] == 7.0 and found.facts["seed_was"] == 0
    scores = content(tmp_path / "compare.json")
    check = {r.name: r for r in campaign.recordings}["sine_070Hz_30V"]
    residual = check.y - found.evaluation.outputs[check.name]
    # The zero of a recording, from the samples before the scored ones, is not the rival's to know.
    before, scored = check.mask("nuisance"), check.mask("confirmation")
    assert abs(np.mean(residual[before])) < 1e-12
    assert scores["proportional"][check.name]["rmse"] == pytest.approx(np.sqrt(np.mean(residual[scored] ** 2)))
    assert "| one gain |" in (tmp_path / "compare.md").read_text()
    register_rival("proportional", lambda *_: pytest.fail("is fitted again"))
    again = compare(campaign, tmp_path, settings("models=proportional", "budget=7"))
    assert again["proportional"].evaluation.parts == found.evaluation.parts
    with pytest.raises(InputRefused, match="budget"):
        compare(campaign, tmp_path, settings("models=proportional", "budget=8"))


def test_rivals_that_cannot_be_used_are_refused(campaign: Campaign, tmp_path: Path, no_rivals: None) -> None:
    for name in ("phs", "all", "a/b", ""):
        with pytest.raises(InputRefused, match="choose another"):
            register_rival(name, proportional)
    register_rival("short", lambda campaign, seed, budget: ({r.name: r.u[1:] for r in campaign.recordings}, {}))
    with pytest.raises(InputRefused, match=r"rival short: sine_\d+Hz_\d+V has shape \(250,\): give 251 samples"):
        compare(campaign, tmp_path, settings("models=short"))
    register_rival("silent", lambda campaign, seed, budget: ({}, {}))
    with pytest.raises(InputRefused, match="rival silent: has no output for recording"):
        compare(campaign, tmp_path, settings("models=silent"))


def test_a_rival_that_runs_away_is_scored_as_such(campaign: Campaign, tmp_path: Path, no_rivals: None) -> None:
    register_rival(
        "wild", lambda campaign, seed, budget: ({r.name: np.inf * (1.0 + r.u**2) for r in campaign.recordings}, {})
    )
    for _ in range(2):  # fitted, and read back
        results = compare(campaign, tmp_path, settings("models=wild"))
        assert all(p.residual_over_noise == np.inf for p in results["wild"].evaluation.parts)


def test_a_learned_system_begins_with_the_modes_of_linear_hysterons(campaign: Campaign) -> None:
    plant = plant_for({"kind": "fully_neural", "states": 4, "width": 8}, campaign, 0)
    at, rest = torch.zeros(4, dtype=torch.float64), torch.zeros((), dtype=torch.float64)
    found = torch.linalg.eigvals(torch.func.jacrev(lambda x: plant.rate(x, rest))(at))
    network = hrc(2, unfitted(campaign, 2))
    for i in (1, 2):
        network = network.replace(f"hysteron_{i}", "linear", (f"rho_{i}",))
    system, both = PortHamiltonianSystem(network), torch.zeros(len(network.ports), dtype=torch.float64)
    wanted = torch.linalg.eigvals(torch.func.jacrev(lambda s: system.vector_field(s, both))(at))
    sizes = [np.sort(np.abs(v.detach().numpy())) for v in (found, wanted)]
    assert np.all(np.abs(np.log(sizes[0] / sizes[1])) < 0.3)


def test_a_thinned_recording_keeps_its_weight(campaign: Campaign) -> None:
    recipe = replace(settings().recipes["neural_ode"], longest_step=0.2)
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    found = _thinned(chosen, recipe, scales_of(chosen).time)
    assert len({f.t.size for f in found}) == 2
    for f, r in zip(found, chosen, strict=True):
        share = f.t.size / f.noise**2 / sum(x.t.size for x in found)
        assert share == pytest.approx(r.t.size / r.noise**2 / sum(x.t.size for x in chosen), rel=1e-12)
    assert _stride(chosen[0], 1.0, 20) * 20 <= chosen[0].period / chosen[0].dt
    assert _stride(chosen[0], 0.5 * chosen[0].dt, 20) == 1
