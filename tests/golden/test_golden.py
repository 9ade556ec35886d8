"""Every answer of the package is the golden one; see `golden_answers.py` for what is held and how it is renewed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from golden_answers import ANSWERS, Answers, differences, digest, fingerprint, rounded, stated_digests
from golden_files import FILES
from golden_subjects import (
    NETWORKS,
    concealed,
    fitted,
    laws_blocks_and_effects,
    manifest_of,
    recordings_of,
    scores_of,
    simulations,
)

import phnn
from phnn.criteria import Criteria

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
# Relative tolerances: what is read, estimated noise, what is simulated, what is scored.
READ, NOISE, SIMULATED, SCORED = 1e-12, 1e-3, 1e-10, 1e-4
# Shared folders whose noise takes seconds to estimate.
_LONG = ("recordings/mr-damper", "recordings/silverbox")

# --- Reading ----------------------------------------------------------------------------------------------------------


def what_was_read(campaign: phnn.recordings.Campaign) -> dict[str, Any]:
    """Return everything that later steps take from a campaign, without its notes."""
    recordings = {}
    for r in campaign.recordings:
        arrays = {"t": r.t, "u": r.u, "y": r.y} | {f"channel {n}": x for n, x in r.channels.items()}
        arrays |= {f"port {n}": x for n, x in r.further.items()}
        recordings[r.name] = {
            "samples": int(r.t.size),
            "start": [r.start.state, rounded(r.start.input_before)],
            "input": [r.interpolation, r.gain],
            "jumps": fingerprint(r.instants if r.instants is not None else [], 4),
            "units": [r.units.input, r.units.output],
            "parts": [[p.name, p.first, p.last, p.use] for p in r.parts],
            "period": None if r.period is None else rounded(r.period),
            "sensor": [repr(r.sensor.saturates), r.sensor.rectified, rounded(r.sensor.lag), r.sensor.derivative],
            "output": [r.measures, r.offset],
            "arrays": {name: fingerprint(x) for name, x in arrays.items()},
        }
    setup = {key: Path(value).name if key == "network" else value for key, value in campaign.setup.items()}
    return {
        "recordings": recordings,
        "order": list(recordings),
        "setup": {key: str(value) for key, value in setup.items()},
        "known": {n: [rounded(a.value), rounded(a.std)] for n, a in campaign.known.items()},
        "voltage": campaign.voltage,
        "held out": sorted(campaign.held_out),
    }


def noise_of(campaign: phnn.recordings.Campaign) -> dict[str, Any]:
    """Return the standard deviation of the output's noise, and whether there is any, by recording."""
    return {r.name: [rounded(float(r.noise)), r.noise_found] for r in campaign.recordings}


def hold_reading(golden: Answers, case: str, source: Path, manifest: Path | None, home: Path) -> None:
    """Hold what is read from a source, and its noise, or the text of the refusal.

    Args:
        home: a path that may stand in the text.
    """
    try:
        campaign = phnn.read(source, manifest)
    except phnn.InputRefused as refusal:
        golden.hold("read", case, {"refused": str(refusal).replace(str(home), "FOLDER")}, READ)
        return
    golden.hold("read", case, what_was_read(campaign), READ)
    golden.hold("read", f"{case}, noise", noise_of(campaign), NOISE)


def shared_folders() -> list[str]:
    """Return the folders below `SHARED` that hold files, by their names there; none where it is missing."""
    roots = [SHARED / "cases", SHARED / "recordings"]
    return sorted({p.parent.relative_to(SHARED).as_posix() for root in roots for p in root.rglob("*") if p.is_file()})


@pytest.mark.parametrize("name", FILES)
def test_read_a_small_file(golden: Answers, tmp_path: Path, name: str) -> None:
    home = tmp_path / "recordings"
    home.mkdir()
    FILES[name](home)
    hold_reading(golden, name, home, None, home)


_FOLDERS = [pytest.param(n, marks=[pytest.mark.slow] * (n in _LONG)) for n in shared_folders()]
_MISSING = pytest.param("", marks=pytest.mark.skip(f"{SHARED} is not there: its folders are not read"))


@pytest.mark.parametrize("name", _FOLDERS or [_MISSING])
def test_read_a_shared_folder(golden: Answers, name: str) -> None:
    manifest = ROOT / "configs" / f"{name}" / "recordings.yaml"
    hold_reading(golden, f"shared: {name}", SHARED / name, manifest if manifest.is_file() else None, SHARED)


def test_read_answers_are_all_asked_for(golden: Answers) -> None:
    cases = {*FILES, *(f"shared: {n}" for n in shared_folders())}
    stored = golden.layer("read")
    if not shared_folders():
        cases |= {case.removesuffix(", noise") for case in stored if case.startswith("shared: ")}
    golden.keep_only("read", cases | {f"{case}, noise" for case in cases})


# --- Simulating -------------------------------------------------------------------------------------------------------

SIMULATIONS = simulations()


@pytest.mark.parametrize("name", SIMULATIONS)
def test_simulate(golden: Answers, name: str) -> None:
    found = SIMULATIONS[name]()
    answer = {key: fingerprint(x, 8 if key == "output" else 4) for key, x in found.items()}
    golden.hold("simulate", name, answer, SIMULATED)


def test_simulate_every_law_block_and_effect(golden: Answers) -> None:
    assert laws_blocks_and_effects() <= set(SIMULATIONS)
    golden.keep_only("simulate", set(SIMULATIONS))


# --- Scoring ----------------------------------------------------------------------------------------------------------

# Candidates are held that a search would fit: what scores less, or falls less of the best one's fall, has a strength,
# rank and fall that rounding decides, and with it the processor.
_SCORE_HELD, _FALL_HELD = Criteria().score, 1e-3


@pytest.mark.parametrize("name", concealed())
def test_scores_of_a_stored_fit(golden: Answers, name: str) -> None:
    if golden.why and name not in golden.layer("fits"):
        golden.hold("fits", name, fitted(name).setup.values(), SCORED)
    base = fitted(name, golden.layer("fits")[name])
    scores, where = scores_of(base)
    least = _FALL_HELD * max((c.fall for c in scores), default=0.0)
    held = (c for c in scores if c.score > _SCORE_HELD and c.fall > least)
    candidates = [(f"{i:02d} {c.effect.name}", c) for i, c in enumerate(held)]
    answer = {
        "chi2": base.chi2,
        "falls": {key: c.fall for key, c in candidates},
        "scores": {key: c.score for key, c in candidates},
        "values": {key: c.values for key, c in candidates},
        "location": {
            "name": where.name, "kind": where.detail, "tied": list(where.tied), "scores": where.scores,
            "kinds": where.details, "ranks": where.ranks,
        },
    }  # fmt: skip
    golden.hold("scores", name, answer, SCORED)


def test_scores_are_all_asked_for(golden: Answers) -> None:
    golden.keep_only("fits", set(concealed()))
    golden.keep_only("scores", set(concealed()))


# --- Whole diagnoses --------------------------------------------------------------------------------------------------

# Made campaigns with the model that is fitted, and shared folders, whose search ends within about a minute.
MADE: dict[str, dict[str, Any]] = {
    "complete actuator": {"model": "piezo_actuator", "hysterons": 1},
    "limited amplifier": {"model": "piezo_actuator", "hysterons": 1},
    "stiffening actuator": {"model": "piezo_actuator", "hysterons": 2},
    "kinked amplifier": {"model": "piezo_actuator", "hysterons": 1},
    "rubbing mass": {"network": "mass_spring_damper.yaml"},
}
REAL = (
    "recordings/tanks",
    "cases/02-rests-then-steps",
    "cases/06-controldesk-struct/same-numbers",
    "cases/23-voice-coil-without-inductance",
)
# Settings with which the searches of made campaigns are short.
_MADE_WITH = ("starts=2", "max_effects=2")
_WHEN = ("before", "after")


def write_campaign(name: str, folder: Path) -> None:
    """Write a made campaign as a folder of csv files with a manifest and, where it needs one, a network."""
    case = concealed()[name]
    folder.mkdir()
    for recording, columns in recordings_of(case).items():
        rows = zip(*(x.tolist() for x in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
        (folder / f"{recording}.csv").write_text("\n".join(lines) + "\n", "utf-8")
    if "network" in MADE[name]:
        shutil.copy(NETWORKS / MADE[name]["network"], folder)
    content = manifest_of(case, "{}.csv", MADE[name])
    # All json is yaml.
    (folder / "recordings.yaml").write_text(json.dumps(content), "utf-8")


def outcome(folder: Path, out: Path, settings: Sequence[str], manifest: Path | None = None) -> dict[str, Any]:
    """Return exit status, verdict, names, locations and residuals over noise of ``phnn diagnose``."""
    said = ["--manifest", str(manifest)] if manifest is not None else []
    command = [sys.executable, "-m", "phnn.cli", "diagnose", str(folder), "--out", str(out), *said, *settings]
    status = subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode
    if status:
        return {"exit status": status}
    document = json.loads((out / "diagnosis.json").read_text("utf-8"))
    where = document["location"] or {}
    keys = ("effect", "status", "location", "place", "equivalent_to")
    fits = {when: {n: row["residual_over_noise"] for n, row in document["fit"][when].items()} for when in _WHEN}
    return {
        "exit status": status,
        "verdict": document["verdict"],
        "missing": [{k: m[k] for k in keys} | {"parameters": sorted(m["parameters"])} for m in document["missing"]],
        "candidate": document["test"]["candidate"],
        "statistic": document["test"]["statistic"],
        "location": [where.get("name"), where.get("detail"), where.get("tied")],
        "remainder": {k: document["remainder"][k] for k in ("verdict", "location", "residual_over_noise")},
        "residual over noise": fits,
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_diagnose_a_made_campaign(golden: Answers, tmp_path: Path, name: str) -> None:
    write_campaign(name, tmp_path / "recordings")
    found = outcome(tmp_path / "recordings", tmp_path / "out", _MADE_WITH)
    golden.hold("diagnoses", name, found, SCORED)


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_diagnose_a_shared_folder(golden: Answers, tmp_path: Path, name: str) -> None:
    if not (SHARED / name).is_dir():
        pytest.skip(f"{SHARED / name} is not there")
    manifest = ROOT / "configs" / name / "recordings.yaml"
    found = outcome(SHARED / name, tmp_path / "out", (), manifest if manifest.is_file() else None)
    golden.hold("diagnoses", f"shared: {name}", found, SCORED)


def test_diagnose_answers_are_all_asked_for(golden: Answers) -> None:
    golden.keep_only("diagnoses", {*MADE, *(f"shared: {name}" for name in REAL)})


# --- The answers themselves -------------------------------------------------------------------------------------------


def test_answers_differ_where_a_number_a_name_or_a_text_does() -> None:
    x = np.sin(np.arange(100.0))
    stored = {"a": {"x": fingerprint(x), "says": "as it is", "n": 3, "left": None}}
    for same in (x, x * (1.0 + 1e-13), x + 1e-13):
        assert not differences(stored, {"a": {**stored["a"], "x": fingerprint(same)}}, 1e-12)
    for other in (x * (1.0 + 1e-11), x[:-1], np.where(x == x.max(), np.nan, x), np.roll(x, 1)):
        assert differences(stored, {"a": {**stored["a"], "x": fingerprint(other)}}, 1e-12)
    for key, value in (("says", "as it was"), ("n", 4), ("n", 3.0), ("left", 0.0), ("new", 1)):
        assert differences(stored, {"a": {**stored["a"], key: value}}, 1e-12)
    assert differences(stored, {"a": {"x": stored["a"]["x"]}}, 1e-12)
    assert differences({"s": 1.0}, {"s": 1.0 + 2e-6}, 1e-6) and not differences({"s": 1.0}, {"s": 1.0 + 5e-7}, 1e-6)


def test_answers_are_those_that_changes_md_states(golden: Answers) -> None:
    if golden.why:
        pytest.skip("answers are being renewed")
    stored = {path.stem: digest(path.stem) for path in ANSWERS.glob("*.json")}
    assert stored == stated_digests(), "an answer changed without a sentence: renew it with --renew 'WHY'"
    assert sum(path.stat().st_size for path in ANSWERS.iterdir()) < 1_500_000
