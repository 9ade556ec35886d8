"""Attacks on what is written: nothing but results, inside --out; a disk that is full or read-only loses nothing."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import campaigns
import numpy as np
import pandas as pd
import pytest

from phnn.cli import main
from phnn.models.store import save


def seen(folder: Path) -> dict[str, bytes]:
    """Content of all files but phnn's own notes."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file() and ".phnn" not in p.parts)
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in found}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with ``rec/`` (two short recordings without outputs) and ``model/``."""
    save(campaigns.base().setup, tmp_path / "model", 1)
    (tmp_path / "rec").mkdir()
    t = np.arange(200) * 1e-4
    for name in ("a", "b"):
        table = pd.DataFrame({"time_s": t, "voltage_V": 5.0 * np.sin(2 * np.pi * 50 * t)})
        table.to_csv(tmp_path / "rec" / f"{name}.csv", index=False)
    return tmp_path


def predict(place: Path, out: Path | str, *more: str) -> int:
    return main(["predict", str(place / "model"), str(place / "rec"), "--out", str(out), *more])


NAMES = [
    "../small/a", "/tmp/phnn_attack", "..", ".", "a/b/c", "a\\b", "con", "nul.csv", "a\x00b", "a\nb", "\x1b[2Ja", "~/a",
    "$HOME", "${oc.env:HOME}", "x" * 400, "é" * 300, "\u202egpj", ".phnn", "INCOMPLETE.txt", " ", "-rf", "a;b", "|x",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_names_of_recordings_are_labels(place: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    manifest = {"recordings": [{"file": "a.csv", "name": name}, {"file": "b.csv", "name": "b"}]}
    (place / "rec" / "recordings.yaml").write_text(json.dumps(manifest))
    before = seen(place)
    status = predict(place, place / "out")
    after = seen(place)
    assert status in (0, 2)
    assert {n: c for n, c in after.items() if not n.startswith("out/")} == before
    assert "Traceback" not in capsys.readouterr().err
    if status == 0:
        written = [n for n in after if n.startswith("out/") and n != "out/predict.json"]
        assert len(written) == 2 and all(n.count("/") == 1 and n.endswith(".csv") for n in written)


@pytest.mark.parametrize("out", ["rec", "link/new"])
def test_folders_that_are_read_stay_as_they_are(place: Path, out: str, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "link").symlink_to(place / "rec")
    before = seen(place)
    assert predict(place, place / out, "--overwrite") == 2
    assert "--out" in capsys.readouterr().err
    assert seen(place) == before


def test_a_changed_result_is_replaced_on_request_only(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert predict(place, place / "out") == 0
    first = seen(place / "out")
    (place / "out" / "b.csv").write_text("annotated")
    os.utime(place / "out" / "b.csv", (time.time() + 10.0,) * 2)
    assert predict(place, place / "out") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert predict(place, place / "out", "--overwrite") == 0
    assert seen(place / "out") == first


def test_a_proposal_of_somebody_else_stops_a_diagnosis_before_the_fit(tmp_path: Path) -> None:
    (tmp_path / "next_experiment.csv").write_text("mine")
    began = time.monotonic()
    assert main(["diagnose", str(campaigns.concealed()[0]), "--out", str(tmp_path)]) == 2
    assert time.monotonic() - began < 10.0
    assert seen(tmp_path) == {"next_experiment.csv": b"mine"}


def test_predictions_of_another_folder_stay(place: Path) -> None:
    assert predict(place, place / "out") == 0
    (place / "rec" / "b.csv").rename(place / "rec" / "c.csv")
    assert predict(place, place / "out") == 0
    assert set(seen(place / "out")) == {"a.csv", "b.csv", "c.csv", "predict.json"}


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="rights do not bind this user")
def test_a_folder_without_rights_is_met_before_the_work(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "out").mkdir()
    (place / "out").chmod(0o500)
    assert predict(place, place / "out" / "new") == 2
    assert "choose another folder" in capsys.readouterr().err


@pytest.mark.parametrize("size", [1, 4])
def test_a_disk_without_room_is_met_before_the_work(
    place: Path, disk: Callable[[str], Path], size: int, capsys: pytest.CaptureFixture[str]
) -> None:
    out = disk(f"size={size}m") / "out"
    assert predict(place, out) == 2
    assert "MiB of disk are free" in capsys.readouterr().err
    assert not out.exists() or not seen(out)


def test_a_disk_that_may_not_be_written_to_is_met_before_the_work(
    place: Path, disk: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    out = disk("size=64m") / "out"
    disk("ro")
    assert predict(place, out) == 2
    assert "choose another folder" in capsys.readouterr().err
