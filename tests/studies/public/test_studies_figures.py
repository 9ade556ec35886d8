"""Figures of a study from what its commands wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from studies.public.figures import figures

PARTS = ("trajectory[identification]", "trajectory[confirmation]")


def rule(name: str, element: str, outcome: str | None = None, **numbers: float) -> dict[str, Any]:
    return {"rule": name, "element": element, "outcome": outcome, "numbers": numbers}


def scores(*rmse: float) -> dict[str, Any]:
    return {part: {"rmse": value} for part, value in zip(PARTS, rmse, strict=True)}


def write(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(content), encoding="utf-8")


def test_emps(tmp_path: Path) -> None:
    rules = [
        rule("effect_explains_too_little", "constant_load", share=0.97),
        rule("model_leaves_little", "constant_load", residual_over_noise=1e4),
        rule("effect_explains_too_little", "coulomb_friction", share=0.8),
        rule("model_leaves_little", "coulomb_friction", residual_over_noise=5e3),
        rule("effect_is_not_needed", "coulomb_friction", "withdraw", share=0.8),
        rule("first_effect_explains_enough", "constant_load", "keep", share=0.97),
    ]
    load = {"effect": "constant_load", "equivalent_to": ["sensor_drift"]}
    diagnosis = {
        "verdict": "equivalent",
        "missing": [load | {"parameters": {"F_0": {"value": 3.0, "std": 0.1}}}],
        "location": {"name": "mechanical", "tied": ["sensor"]},
        "fit": {"before": scores(0.026, 0.083), "after": scores(0.004, 0.006)},
        "noise_floor": {"trajectory": 2.5e-7},
        "rules": rules,
    }
    parameters = {n: {"value": v, "std": 0.1 * v} for n, v in {"m": 95.0, "b": 200.0, "F_c": 20.0, "F_0": 3.2}.items()}
    write(tmp_path / "diagnose" / "diagnosis.json", diagnosis)
    write(tmp_path / "identify-split" / "identify.json", {"parameters": parameters, "fit": scores(0.002, 0.008)})
    whole = {"parameters": parameters, "fit": {"trajectory": {"rmse": 0.0025}}}
    write(tmp_path / "identify-whole" / "identify.json", whole)
    found = figures("emps", tmp_path, tmp_path)
    assert found["missing"] == {"result": "constant load"}
    assert found["cannot be told from it"] == {"result": "sensor drift"}
    assert found["M [kg]"] == {"first 60 %": (95.0, 9.5), "all 25 s": (95.0, 9.5)}
    assert found["F_0 [N]"]["diagnosis"] == (3.0, 0.1)
    assert found["load and dry friction"]["held out [mm]"] == pytest.approx(8.0)
    assert found["constant load"]["left [mm]"] == pytest.approx(2.5) and found["constant load"]["decision"] == "kept"
    assert found["coulomb friction"]["decision"] == "withdrawn"


def test_a_study_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KeyError):
        figures("nothing", tmp_path, tmp_path)
