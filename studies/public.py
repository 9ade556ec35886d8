"""Worked studies of public recordings: the named figures that the pages in docs/ state.

A page shows these figures in tables: the first cell of a row and the head of a column name a figure.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.models.store import load
from phnn.recordings import read
from phnn.recordings.recording import Campaign, Recording
from phnn.report.formatting import words
from phnn.setup import Setup
from phnn.trajectory import simulate

Array = NDArray[np.float64]

# Samples of a test that give the initial state and are not scored: stated by the benchmark.
UNSCORED = 50
# A band-limited input is simulated a little beyond the samples that give the initial state.
_BEYOND = 50
# Gauss–Newton steps for the initial state: the output is nearly linear in it.
_STEPS = 4


def official_errors(setup: Setup, substeps: int, campaign: Campaign) -> dict[str, float]:
    """Root mean square errors [V] of a model on the tests of the benchmark, by name.

    Args:
        setup: the model; substeps: its sub-steps a sample interval.
        campaign: the training samples, for identification, and the tests, for confirmation.
    """
    training = next(r for r in campaign.recordings if r.mask("identification").any())
    # How it begins is forgotten after a thousandth of the training samples.
    zero = float(np.mean((training.y - simulate(setup, training, substeps).y)[UNSCORED:]))
    return {r.name: _error(setup, substeps, r, zero) for r in campaign.recordings if r is not training}


def _error(setup: Setup, substeps: int, test: Recording, zero: float) -> float:
    begun = initial_state(setup, substeps, test, zero)
    left = test.y - zero - simulate(setup, test, substeps, initial=begun).y
    return float(np.sqrt(np.mean(left[UNSCORED:] ** 2)))


def initial_state(setup: Setup, substeps: int, test: Recording, zero: float) -> Array:
    """The initial state (N,) that fits the unscored samples of a test best, the model and its zero [V] held."""
    head = test.only(slice(UNSCORED + _BEYOND))
    state = simulate(setup, head, substeps).states[0].copy()
    for _ in range(_STEPS):
        found = simulate(setup, head, substeps, initial=state)
        columns = output_derivatives(found, (), tuple(range(state.size)))[:UNSCORED]
        size = np.linalg.norm(columns, axis=0)
        # A state that the output does not depend on stays where it is.
        scale = np.where(size > 0.0, 1.0 / np.maximum(size, np.finfo(float).tiny), 0.0)
        left = (head.y - zero - found.y)[:UNSCORED]
        state = state + scale * np.linalg.lstsq(columns * scale, left, rcond=None)[0]
    return np.asarray(state)


# By row and column: a number, a number with its standard error, or a word.
Cell = float | tuple[float, float] | str
Figures = dict[str, dict[str, Cell]]

_MILLI, _MICRO = 1e3, 1e6


def figures(name: str, folder: Path, out: Path) -> Figures:
    """The figures of a study.

    Args:
        name: of the study, such as ``"emps"``.
        folder: its recordings.
        out: where its commands wrote, each into a folder of its own.

    Raises:
        OSError: a command did not write what it should.
        KeyError: there is no such study.
    """
    return _STUDIES[name](folder, out)


def _document(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def _verdict(diagnosis: Mapping[str, Any]) -> Figures:
    """The words of a diagnosis, and what its elements leave."""
    missing = diagnosis["missing"]
    tied = [e for m in missing for e in m["equivalent_to"]]
    nearest = [words(m["nearest"]) for m in missing if m.get("nearest")]
    return {
        "verdict": {"result": diagnosis["verdict"]},
        "missing": {"result": ", ".join(words(m["effect"]) for m in missing) or "nothing"},
        "nearest": {"result": ", ".join(nearest) or "nothing"},
        "cannot be told from it": {"result": ", ".join(map(words, tied)) or "nothing"},
        "location": {"result": ", ".join([diagnosis["location"]["name"], *diagnosis["location"]["tied"]])},
    }


def _value(known: Mapping[str, Any], scale: float = 1.0) -> Cell:
    """A parameter with its standard error, where it has one."""
    value, std = scale * float(known["value"]), known.get("std")
    return value if std is None else (value, scale * float(std))


def _emps(folder: Path, out: Path) -> Figures:
    diagnosis = _document(out / "diagnose" / "diagnosis.json")
    fits = {"first 60 %": _document(out / "identify-split" / "identify.json")}
    fits["all 25 s"] = _document(out / "identify-whole" / "identify.json")
    found = _verdict(diagnosis)
    names = {"m": "M [kg]", "b": "F_v [N s/m]", "F_c": "F_c [N]", "F_0": "F_0 [N]"}
    for parameter, row in names.items():
        found[row] = {column: _value(fit["parameters"][parameter]) for column, fit in fits.items()}
    for missing in diagnosis["missing"]:
        for parameter in names.keys() & missing["parameters"].keys():
            found[names[parameter]]["diagnosis"] = _value(missing["parameters"][parameter])
    parts = {"identified [mm]": "trajectory[identification]", "held out [mm]": "trajectory[confirmation]"}
    errors = {
        "viscous friction alone (base model)": diagnosis["fit"]["before"],
        "what the diagnosis ends with": diagnosis["fit"]["after"],
        "load and dry friction": fits["first 60 %"]["fit"],
    }
    for row, scores in errors.items():
        found[row] = {column: _MILLI * scores[part]["rmse"] for column, part in parts.items()}
    whole = next(iter(fits["all 25 s"]["fit"].values()))
    found["load and dry friction, all 25 s"] = {"identified [mm]": _MILLI * whole["rmse"]}
    return found


def _silverbox(folder: Path, out: Path) -> Figures:
    home = out / "diagnose-quarter"
    diagnosis = _document(home / "diagnosis.json")
    found = _verdict(diagnosis)
    campaign = read(folder, config_folder() / "recordings" / "silverbox" / "official.yaml")
    columns = {
        "multisine": "multisine test",
        "arrow_no_extrapolation": "arrow without extrapolation",
        "arrow_full": "arrow full",
    }
    for row, model in (("linear", "base"), ("with what is named", "model")):
        errors = official_errors(*load(home / model), campaign)
        found[row] = {column: _MILLI * errors[name] for name, column in columns.items()}
    for row, scores in (("linear", "before"), ("with what is named", "after")):
        identified = diagnosis["fit"][scores]["multisine"]
        found[row] |= {"identified": _MILLI * identified["rmse"], "over noise": identified["residual_over_noise"]}
    final = load(home / "model")[0].values()
    named = {n: known for m in diagnosis["missing"] for n, known in m["parameters"].items()}
    found |= {
        "k": {"value": final["k"]},
        "m [10⁻⁶ s²]": {"value": _MICRO * final["m"]},
        "d [10⁻⁶ s]": {"value": _MICRO * final["d"]},
        "u₀ [mV]": {"value": _MILLI * final["u_0"]},
    }
    if {"kappa_3", "q_0"} <= set(named):
        scale = 1.0 / named["q_0"]["value"] ** 2
        found["κ₃/q₀² [V⁻²]"] = {"value": _value(named["kappa_3"], scale)}
    if "c_2" in named:
        found["c₂ [10⁻⁸ s²/V]"] = {"value": _value(named["c_2"], 1e8)}
    found["noise floor [mV]"] = {"value": _MILLI * diagnosis["noise_floor"]["multisine"]}
    return found


def _piezo_stack(folder: Path, out: Path) -> Figures:
    diagnosis = _document(out / "diagnose" / "diagnosis.json")
    found, parts = _verdict(diagnosis), {"identified": "loops[identification]", "held out": "loops[confirmation]"}
    compared = _document(out / "compare" / "compare.json")
    rows = {
        "linear": compared["linear"],
        "Bouc–Wen": compared["bouc_wen"],
        "two hysterons (base model)": diagnosis["fit"]["before"],
        "what the diagnosis ends with": diagnosis["fit"]["after"],
    }
    for row, scores in rows.items():
        found[row] = {column: scores[part]["residual_over_noise"] for column, part in parts.items()}
    found["noise floor [nm]"] = {"result": 1e9 * diagnosis["noise_floor"]["loops"]}
    return found


def _steering_mirror(folder: Path, out: Path) -> Figures:
    study, checked = _document(out / "modes" / "modes.json"), _document(out / "check" / "check.json")
    found: Figures = {
        "final model": {"result": words(study["final"])},
        "left out": {"result": ", ".join(study["left_out"])},
        "recordings": {"result": float(len(checked["recordings"]))},
    }
    levels = [f"{_MILLI * level['amplitude']:.0f} mV" for level in study["levels"]]
    found["modes at one amplitude"] = {
        column: float(len(level["linear_alone"]["frequency_Hz"]))
        for column, level in zip(levels, study["levels"], strict=True)
    }
    rows = {words(name): model["held_out"] for name, model in study["models"].items()}
    rows["linear, a model for each amplitude"] = [level["linear_alone"]["held_out"] for level in study["levels"]]
    for name, scores in rows.items():
        found[name] = {c: _MICRO * float(np.mean(s["rmse"])) for c, s in zip(levels, scores, strict=True) if s}
    return found | _contaminated(checked)


def _contaminated(checked: Mapping[str, Any]) -> Figures:
    """By realisation and output, how many times as noisy a contaminated recording is as others of its kind."""
    found: Figures = {}
    for name, recording in checked["recordings"].items():
        realisation, _, output = name.partition(".")
        for finding in recording["findings"]:
            if finding["kind"] == "contaminated":
                found.setdefault(realisation, {})[output] = finding["values"]["noise_over_others"]
    return found


_STUDIES: dict[str, Callable[[Path, Path], Figures]] = {
    "emps": _emps,
    "silverbox": _silverbox,
    "piezo-stack": _piezo_stack,
    "steering-mirror": _steering_mirror,
}
