"""Whole comparisons on small recordings: what is written, what is read back, what is refused."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import compare_example as example
import numpy as np
import pytest

from phnn.cli import main
from phnn.comparison import models, run
from phnn.comparison.run import compare
from phnn.comparison.settings import MODELS, RIVALS, Settings
from phnn.configuration import compose
from phnn.errors import InputRefused
from phnn.models.store import load
from phnn.recordings import Campaign, read

QUICK = ("phs", "bouc_wen", "linear", "neural_ode")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return read(example.written(tmp_path_factory.mktemp("compare") / "recordings"))


@pytest.fixture(scope="module")
def out(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of models that are fitted quickly."""
    folder = tmp_path_factory.mktemp("compared")
    compare(campaign, folder, example.settings(f"models=[{','.join(QUICK)}]"))
    return folder


def content(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def check_scores(found: dict[str, Any]) -> None:
    """Every recording of every model, and the exact model better than a crude one."""
    uses = {"sine_070Hz_75V": "confirmation", "sine_070Hz_30V": "outside"}
    for rows in found.values():
        assert set(rows) == {example.recording(*d).name for d in example.DRIVES}
        for name, row in rows.items():
            assert row["use"] == uses.get(name, "identification")
            assert row["held_out"] == (name in uses)
            assert np.isfinite([row["fit_percent"], row["rmse"], row["residual_over_noise"]]).all()
            assert np.isfinite([row["loop_area_error"], row["loop_area_noise"]]).all()
            assert len(row["harmonics"]["error"]) == len(row["harmonics"]["relative"]) == 5
    assert all(row["residual_over_noise"] < 1.2 for row in found["phs"].values())
    exact, crude = found["phs"]["sine_070Hz_30V"], found["linear"]["sine_070Hz_30V"]
    assert abs(exact["loop_area_error"]) < 5.0 * exact["loop_area_noise"] < abs(crude["loop_area_error"])
    assert exact["harmonics"]["error"][0] < crude["harmonics"]["error"][0]


def check_facts(found: dict[str, Any]) -> None:
    """What is said of every model; those with an energy keep the power balance."""
    for model, facts in found.items():
        assert facts["seed"] == 0
        assert facts["parameters"] > 0
        assert facts["seconds"] >= 0.0
        balance, supplied = facts["passivity"]["power_balance"], facts["passivity"]["supply"]
        if model in ("bouc_wen", "neural_ode", *RIVALS):
            assert balance["violations"] is None
            assert "energy" in balance["reason"]
        else:
            assert balance["violations"] == 0
        assert supplied["inputs"] + supplied["failed"] == 20
        assert model in ("bouc_wen", "neural_ode", "neural_phs", *RIVALS) or supplied["violations"] == 0


def test_scores_and_facts_of_the_models(out: Path) -> None:
    scores, facts = content(out / "compare.json"), content(out / "models.json")
    assert tuple(scores) == tuple(facts) == QUICK
    check_scores(scores)
    check_facts(facts)


@pytest.mark.slow
def test_all_models_are_compared(campaign: Campaign, tmp_path: Path) -> None:
    compare(campaign, tmp_path, example.settings())
    scores, facts = content(tmp_path / "compare.json"), content(tmp_path / "models.json")
    assert tuple(scores) == tuple(facts) == MODELS
    check_scores(scores)
    check_facts(facts)
    assert max(row["residual_over_noise"] for row in scores["phs_neural"].values()) < 3.0
    assert load(tmp_path / "phs_neural")[0].parameters


def test_what_is_written(out: Path) -> None:
    assert {p.name for p in out.iterdir()} == {
        ".phnn", "compare.json", "models.json", "compare.csv", "compare.md", "index.html", "figures", *QUICK,
    }  # fmt: skip
    for model in ("phs", "bouc_wen", "linear"):
        setup, substeps = load(out / model)
        assert setup.parameters
        assert substeps >= 1
    lines = (out / "compare.csv").read_text().splitlines()
    assert len(lines) == 1 + 4 * len(QUICK)
    page = (out / "compare.md").read_text()
    figures = sorted(p.name for p in (out / "figures").iterdir())
    assert len(figures) == 6
    for name in figures:
        assert f"figures/{name}" in page
    assert "held out, outside" in page


def test_finished_models_are_read_back(out: Path, campaign: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (out / "compare.json").read_bytes()

    def refit(*_: object) -> None:
        raise AssertionError("a model is fitted again")

    monkeypatch.setattr(run, "draw_all", lambda *_: [])
    monkeypatch.setattr(models, "_trained", refit)
    monkeypatch.setattr(models, "_FITTED", dict.fromkeys(("phs", "bouc_wen", "linear"), refit))
    compare(campaign, out, example.settings(f"models=[{','.join(QUICK)}]"))
    assert (out / "compare.json").read_bytes() == before
    # What does not enter a result may change, and fewer models may be asked for.
    compare(campaign, out, example.settings("workers=2", "models=[linear,neural_ode]"))
    assert set(content(out / "compare.json")) == {"linear", "neural_ode"}
    for change in ("seed=1", "error_bound_sigma=0.5", "inputs=21"):
        with pytest.raises(InputRefused, match="resume=false"):
            compare(campaign, out, example.settings(change, "models=linear"))
    with pytest.raises(InputRefused, match="recipe"):
        compare(campaign, out, example.settings("neural_ode.stages.long.lbfgs=2", "models=neural_ode"))


def test_other_recordings_are_noticed(out: Path, campaign: Campaign) -> None:
    first, *others = campaign.recordings
    other = replace(campaign, recordings=(replace(first, noise=2.0 * first.noise), *others))
    with pytest.raises(InputRefused, match="other recordings"):
        compare(other, out, example.settings("models=linear"))


def test_a_stopped_comparison_keeps_what_was_finished(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "draw_all", lambda *_: [])
    fitted: Mapping[str, Any] = models._FITTED

    def stop(bench: models.Bench) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as stopped:
        stopped.setattr(models, "_FITTED", {**fitted, "linear": stop})
        with pytest.raises(KeyboardInterrupt):
            compare(campaign, tmp_path, example.settings("models=[phs,linear]"))
    assert set(content(tmp_path / "compare.json")) == {"phs"}
    written = (tmp_path / "phs" / "result.json").read_bytes()
    compare(campaign, tmp_path, example.settings("models=[phs,linear]"))
    assert set(content(tmp_path / "compare.json")) == {"phs", "linear"}
    assert (tmp_path / "phs" / "result.json").read_bytes() == written
    (tmp_path / "linear" / "outputs.npz").write_bytes(b"half")
    with pytest.raises(InputRefused, match="was changed after phnn wrote it"):
        compare(campaign, tmp_path, example.settings("models=[phs,linear]"))


@pytest.mark.slow
def test_beginning_anew_fits_every_model_once(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "draw_all", lambda *_: [])
    said: list[str] = []
    for times in (1, 2):
        compare(campaign, tmp_path, example.settings("models=[bouc_wen,linear]", "resume=false"), said.append)
        assert [line.split()[1] for line in said if line.startswith("identify")] == [
            "piezo_actuator", "bouc_wen", "linear",
        ] * times  # fmt: skip


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


def test_all_means_all_in_one_order() -> None:
    assert Settings.from_config(compose("compare", ["models=all"])).models == MODELS
    assert Settings.from_config(compose("compare", ["models=[linear,phs]"])).models == ("phs", "linear")
    assert {"phs", "bouc_wen", "linear"} <= set(Settings.from_config(compose("compare")).models)


def test_rivals_are_scored_like_the_others(campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "draw_all", lambda *_: [])
    table = compare(campaign, tmp_path, example.settings("models=[dahl,subnet]"))
    facts = content(tmp_path / "models.json")
    check_facts(facts)
    assert all(f["budget"] == 1.0 and f["processor_seconds"] < 3.0 and f["size"] for f in facts.values())
    assert table.over_noise("dahl", "identification") < table.over_noise("subnet", "identification")
    again = compare(campaign, tmp_path, example.settings("models=[dahl]"))
    assert again.entries["dahl"] == table.entries["dahl"]
    with pytest.raises(InputRefused, match="budget"):
        compare(campaign, tmp_path, example.settings("models=[dahl]", "budget=2.0"))
