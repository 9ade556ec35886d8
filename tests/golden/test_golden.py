"""Every answer of the package is the golden one; see `golden_answers.py` for what is held and how it is renewed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from golden_answers import ANSWERS, Answers, digest, fingerprint, rounded, stated_digests
from golden_files import FILES, in_memory
from golden_subjects import laws_blocks_and_effects, simulations

import phnn

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
# Relative tolerances: what is read, estimated noise, what is simulated, what is scored.
READ, NOISE, SIMULATED, SCORED = 1e-12, 1e-8, 1e-10, 1e-6
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
            "input": [r.interpolation, rounded(r.rise), r.gain],
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


def hold_reading(golden: Answers, case: str, source: Any, manifest: Any, home: Path | None) -> None:
    """Hold what is read from a source, and its noise, or the text of the refusal.

    Args:
        home: a path that may stand in the text.
    """
    try:
        campaign = phnn.read(source, manifest)
    except phnn.InputRefused as refusal:
        said = str(refusal) if home is None else str(refusal).replace(str(home), "FOLDER")
        golden.hold("read", case, {"refused": said}, READ)
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


@pytest.mark.parametrize("name", list(in_memory()))
def test_read_an_object(golden: Answers, name: str) -> None:
    source, manifest = in_memory()[name]
    hold_reading(golden, f"memory: {name}", source, manifest, None)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in _LONG)) for n in shared_folders()])
def test_read_a_shared_folder(golden: Answers, name: str) -> None:
    manifest = ROOT / "configs" / f"{name}" / "recordings.yaml"
    hold_reading(golden, f"shared: {name}", SHARED / name, manifest if manifest.is_file() else None, SHARED)


def test_read_shared_folders_are_present() -> None:
    if not shared_folders():
        pytest.skip(f"{SHARED} is not there: its folders are not read")


def test_read_answers_are_all_asked_for(golden: Answers) -> None:
    cases = {*FILES, *(f"memory: {n}" for n in in_memory()), *(f"shared: {n}" for n in shared_folders())}
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


# --- The answers themselves -------------------------------------------------------------------------------------------


def test_answers_are_those_that_changes_md_states(golden: Answers) -> None:
    if golden.why:
        pytest.skip("answers are being renewed")
    stored = {path.stem: digest(path.stem) for path in ANSWERS.glob("*.json")}
    assert stored == stated_digests(), "an answer changed without a sentence: renew it with --renew 'WHY'"
    assert sum(path.stat().st_size for path in ANSWERS.iterdir()) < 1_500_000
