"""The paper's campaign as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from phnn.errors import InputRefused
from phnn.identification.options import Options
from phnn.recordings import read
from studies.generator.world import TABLE, simulate_all
from studies.paper.table import compare
from studies.recordings import Conditions, paper_plan, write_recordings


def test_the_campaign_is_the_papers(tmp_path: Path) -> None:
    made = write_recordings(tmp_path, Conditions(seed=3))
    assert (dict(made.parameters), made.residual) == ({}, 0.0)
    campaign = read(tmp_path)
    uses = {r.name: {p.use for p in r.parts} for r in campaign.recordings}
    identified = {n for n, u in uses.items() if u == {"identification"}}
    assert identified == {f"sine_{f:03d}Hz_75V" for f in (1, 50, 100, 150)}
    assert set(uses) - identified == {*(f"sine_{f:03d}Hz_75V" for f in (10, 25, 75)), "step_75V", "chirp_1-100Hz_75V"}
    assert campaign.known["m"].value == TABLE["m"]
    assert campaign.held_out_is_new
    _, plan = paper_plan()
    for excitation, q in zip(plan, simulate_all(TABLE, plan), strict=True):
        found = next(r for r in campaign.recordings if r.name == excitation.name)
        rest = found.y - q
        assert abs(rest.mean()) < 5.1e-6
        assert rest.std() == pytest.approx(0.05e-6, rel=0.08)
        assert found.noise == pytest.approx(0.05e-6, rel=0.15)
        assert np.abs(found.u).max() <= 75.0
        assert np.abs(found.u).max() == pytest.approx(75.0, rel=1e-3)


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_recordings(tmp_path / name, Conditions(seed=seed, noise_um=0.1))
    read_ = {n: {p.name: p.read_bytes() for p in (tmp_path / n).iterdir()} for n in "abc"}
    assert read_["a"] == read_["b"]
    # The voltage and the manifest are the same for all; noise and zeros are not.
    assert all(read_["a"][n] != read_["c"][n] for n in read_["a"] if n.endswith(".csv"))


def test_the_least_step_is_the_sensors(tmp_path: Path) -> None:
    write_recordings(tmp_path, Conditions(step_nm=20))
    steps = np.diff(np.unique(pd.read_csv(tmp_path / "sine_010Hz_75V.csv")["displacement_um"]))
    assert np.allclose(np.round(steps / 0.02), steps / 0.02, atol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "needle"),
    [
        ({"effect": "gravity"}, "gravity"),
        ({"noise_um": 0.0}, "noise_um"),
        ({"noise_um": "much"}, "noise_um"),
        ({"residual_um": float("nan")}, "residual_um"),
        ({"step_nm": 0}, "step_nm"),
        ({"step_nm": 1.5}, "step_nm"),
        ({"seed": -1}, "seed"),
    ],
)
def test_conditions_out_of_range_are_refused(wrong: dict[str, Any], needle: str) -> None:
    with pytest.raises(InputRefused, match=needle):
        Conditions(**wrong)


def test_files_of_others_are_not_mixed_with_recordings(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("time_s\n0\n")
    with pytest.raises(InputRefused, match=r"mine\.csv"):
        write_recordings(tmp_path, Conditions())


@pytest.mark.slow
def test_no_model_is_exact_where_a_second_effect_is_concealed(tmp_path: Path) -> None:
    made = write_recordings(tmp_path, Conditions(effect="creep", residual_um=0.5))
    assert made.residual == pytest.approx(0.5e-6, rel=0.02)
    assert set(made.parameters) == {"k_s", "tau_s"}
    comparison = compare(read(tmp_path), Options(starts=2))
    over = {m: s.evaluation.over_noise("confirmation") for m, s in comparison.models.items()}
    assert 1.5 < over["phs"] < over["bouc_wen"]
    assert comparison.models["phs"].evaluation.over_noise("identification") > 1.2
    # Refitted, Bouc–Wen does not fall with frequency as it does with the parameters of Table 2.
    fits = {row.line: {m: p.fit_percent for m, p in row.scores.items()} for row in comparison.rows()}
    assert fits["1 Hz"]["bouc_wen"] < fits["150 Hz"]["bouc_wen"]
    assert fits["1 Hz"]["bouc_wen_published"] > fits["150 Hz"]["bouc_wen_published"] + 10.0
