"""Models on disk: what is read is what was written; what is no model is refused."""

from __future__ import annotations

import json
from pathlib import Path

import campaigns
import numpy as np
import pytest

from phnn.effects import catalogue
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused
from phnn.models.actuator import bouc_wen, hrc
from phnn.models.store import FILE, load, save
from phnn.setup import Setup
from phnn.trajectory import simulate

MEMBERS = {**catalogue(), **learned_elements()}


def with_effect(name: str) -> Setup:
    base = Setup(hrc(2), name="phs")
    if name == "none":
        return base
    entry = MEMBERS[name]
    return entry.add_to(base, entry.grid(campaigns.linearised().scales)[-1])


@pytest.mark.parametrize("name", ["none", *(n for n, e in MEMBERS.items() if e.can_be_added_to(Setup(hrc(2))))])
def test_round_trip(tmp_path: Path, name: str) -> None:
    setup = with_effect(name)
    save(setup, tmp_path / "model", 3)
    again, steps = load(tmp_path / "model")
    assert steps == 3
    assert again.network == setup.network
    assert again.parameters == setup.parameters
    assert (again.amplifier, again.sensor, again.name) == (setup.amplifier, setup.sensor, setup.name)
    recording = campaigns.campaign().recordings[0]
    np.testing.assert_array_equal(simulate(again, recording).y, simulate(setup, recording).y)
    assert {p.name for p in (tmp_path / "model").iterdir()} == {".phnn", FILE}


def test_bouc_wen_and_any_number_of_hysterons(tmp_path: Path) -> None:
    for i, setup in enumerate((bouc_wen(), Setup(hrc(0)), Setup(hrc(5)))):
        save(setup, tmp_path / str(i))
        again, _ = load(tmp_path / str(i) / FILE)
        assert again.parameters == setup.parameters


def written(folder: Path) -> dict[str, object]:
    save(Setup(hrc(1)), folder)
    return json.loads((folder / FILE).read_text())


@pytest.mark.parametrize("key", ["drift_terms", "courses"])
def test_drift_terms_are_read_under_the_name_of_earlier_versions_too(tmp_path: Path, key: str) -> None:
    content = {k: v for k, v in written(tmp_path).items() if k != "drift_terms"}
    (tmp_path / FILE).write_text(json.dumps({**content, key: 8}))
    assert load(tmp_path)[0].own.drift_terms == 8


def test_absent_and_unreadable_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=r"absent.*cannot be read.*model/ or base/"):
        load(tmp_path / "absent")
    (tmp_path / FILE).write_text("{nearly json")
    with pytest.raises(InputRefused, match=r"model\.json: is not json"):
        load(tmp_path)
    (tmp_path / FILE).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputRefused, match="is not json"):
        load(tmp_path)
    for content in ("[]", "3", '{"schema": "phnn.model/99"}'):
        (tmp_path / FILE).write_text(content)
        with pytest.raises(InputRefused, match=r"model\.json: .*model/ or base/ of a result of this version"):
            load(tmp_path)


@pytest.mark.parametrize("key", ["storages", "resistors", "couplings", "ports", "parameters", "substeps", "output"])
def test_a_part_that_is_missing_or_of_the_wrong_kind_is_refused(tmp_path: Path, key: str) -> None:
    content = written(tmp_path)
    for damaged in ({k: v for k, v in content.items() if k != key}, {**content, key: None}):
        (tmp_path / FILE).write_text(json.dumps(damaged))
        with pytest.raises(InputRefused, match="damaged"):
            load(tmp_path)
