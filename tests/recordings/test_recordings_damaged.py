"""Damaged files are refused with one message, or read as they stand; long ones are read in blocks and little memory."""

from __future__ import annotations

import resource
import subprocess
import sys
import tracemalloc
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from damaged_files import COLUMNS, FILES, Damaged, Seen, T, agrees, seen
from recordings_example import write

from phnn.check import check
from phnn.errors import InputRefused
from phnn.intake import named_file
from phnn.recordings import read, text_files
from phnn.recordings.reader import READERS
from phnn.recordings.text_files import read_text

TEXT = [name for name in FILES if name.endswith((".csv", ".txt"))]
DISPLACEMENT = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "micron": 1e-6, "\u00b5m": 1e-6}
NO_DISPLACEMENT = ("V", "kg", "xm", "Um", "umm", "s", "mN", "in", "u", "?", "µ", "10um")
LARGEST_DISPLACEMENT = 1e-2


def outcome(folder: Path, name: str, raw: bytes) -> Seen | str:
    """A recording as read, or why it was refused."""
    for old in folder.iterdir():
        old.unlink()
    (folder / f"a{name}").write_bytes(raw)
    try:
        return seen(read(folder))
    except InputRefused as error:
        message = str(error)
        assert len(message) > 20
        assert "Traceback" not in message
        return message


@pytest.mark.parametrize(
    "name", [n for n in FILES if n not in TEXT and not n.endswith((".tsv", ".dat", ".asc", ".lvm"))]
)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.95])
def test_a_truncated_file_is_refused(tmp_path: Path, name: str, share: float) -> None:
    assert isinstance(outcome(tmp_path, name, FILES[name][: int(share * len(FILES[name]))]), str)


def test_every_format_makes_the_campaign_that_its_csv_twin_makes(tmp_path: Path) -> None:
    # A diagnosis follows from the campaign and a seed alone.
    unseen = set(READERS) - {".tdms", ".xlsx", ".parquet"} - {Path(f"a{name}").suffix for name in FILES}
    assert not unseen, f"add a file of each to FILES: {unseen}"
    twins = {}
    # Two formats round.
    for name in (n for n in FILES if n not in ("fixed.csv", ".xlsx")):
        found = outcome(tmp_path, name, FILES[name])
        assert isinstance(found, Seen) and agrees(found, Damaged(b"", "nothing")), (name, found)
        twins[name] = read(tmp_path)
    one = twins.pop(".csv")
    for name, twin in twins.items():
        assert (twin.setup, twin.known, twin.voltage) == (one.setup, one.known, one.voltage)
        (a,), (b,) = one.recordings, twin.recordings
        for field in fields(a):
            if field.name not in ("name", "source", "parts"):
                np.testing.assert_equal(getattr(b, field.name), getattr(a, field.name), f"{name}: {field.name}")
        assert [(p.first, p.last, p.use) for p in b.parts] == [(p.first, p.last, p.use) for p in a.parts]


@pytest.mark.parametrize("name", TEXT)
def test_a_unit_is_the_one_that_is_written_or_refused(name: str, tmp_path: Path) -> None:
    text = FILES[name].decode()
    for unit in (*DISPLACEMENT, *NO_DISPLACEMENT):
        changed = text.replace("\tum", f"\t{unit}") if name == ".txt" else text.replace("ment_um", f"ment_{unit}", 1)
        assert (changed == text) == (unit == "um")
        found, factor = outcome(tmp_path, name, changed.encode()), DISPLACEMENT.get(unit)
        largest = np.ptp(COLUMNS["displacement_um"]) * (factor or 0.0)
        if factor is None or largest > LARGEST_DISPLACEMENT:
            assert isinstance(found, str), (unit, "was read")
            assert "unit" in found or "displacement" in found
        else:
            assert not isinstance(found, str), (unit, found)
            np.testing.assert_allclose(found.y, factor * COLUMNS["displacement_um"], rtol=1e-9)


def test_a_row_that_breaks_off_is_left_out_and_told_of(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(FILES["fixed.csv"][:-10])
    campaign = read(tmp_path)
    assert campaign.recordings[0].u.size == T.size - 1
    assert any("was left out: the file ends within it" in note for note in campaign.notes)
    # A whole row without a line end behind it is kept, also a short one.
    path.write_bytes(FILES["fixed.csv"][:-1])
    assert read(tmp_path).recordings[0].u.size == T.size
    path.write_bytes(FILES[".csv"] + b"0.3,1.0,0")
    assert read(tmp_path).recordings[0].u.size == T.size + 1
    # Of numbers with any number of digits nothing can be said, but that.
    path.write_bytes(FILES[".csv"][:-3])
    campaign = read(tmp_path)
    assert campaign.recordings[0].u.size == T.size
    assert any("has no end" in note for note in campaign.notes)
    # A row without its last cell is no row.
    path.write_bytes(FILES[".csv"] + b"0.3,1.0,")
    assert read(tmp_path).recordings[0].u.size == T.size


@pytest.mark.parametrize("name", [".tdms", ".h5"])
def test_what_a_crash_has_left_of_a_tdms_file_and_zeros_behind_an_hdf5_file_are_read(tmp_path: Path, name: str) -> None:
    pytest.importorskip("nptdms")
    raw = FILES[name]
    found = outcome(tmp_path, name, raw + bytes(500) if name == ".h5" else raw[:12] + b"\xff" * 8 + raw[20:])
    assert not isinstance(found, str), found
    assert agrees(found, Damaged(b"", "not closed, or padded"))
    assert name == ".h5" or "was not closed" in found.notes


def test_a_step_to_zero_is_no_wrong_unit(tmp_path: Path) -> None:
    t, y = T, 1e-6 * np.exp(-T / 0.1) + 1e-9 * np.random.default_rng(0).standard_normal(T.size)
    write(tmp_path / "a.csv", t, np.zeros(T.size), y)
    (tmp_path / "recordings.yaml").write_text("start: {state: rest, input_before: 100.0}\n")
    assert read(tmp_path).recordings[0].start.input_before == 100.0


def _table(path: Path, text: str) -> list[np.ndarray]:
    path.write_bytes(text.encode())
    table = read_text(named_file(path))
    return [table.numbers(i) for i in range(len(table.columns))]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\x0b", "\u2028"])
def test_blocks_give_the_numbers_of_the_whole(end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [f"{i},{i * i / 7.0!r},{'' if i % 11 == 3 else -i}" for i in range(200)]
    text = end.join(["# made by hand", "", "time_s,voltage_V,displacement_um", *rows]) + end
    whole = _table(tmp_path / "whole.csv", text)
    assert np.array_equal(whole[0], np.arange(200.0)) and np.isnan(whole[2]).sum() == 18
    for size in (1, 50, 333):
        monkeypatch.setattr(text_files, "_ROWS", size)
        for a, b in zip(_table(tmp_path / "blocks.csv", text), whole, strict=True):
            assert np.array_equal(a, b, equal_nan=True)


@pytest.mark.parametrize(
    ("row", "said"), [("1,2,3,4", "line 152 has 4 cells"), ("1,two,3", "line 152"), ("1,True,3", "not a number")]
)
def test_damage_far_down_is_found_at_its_line(
    row: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [f"{i},{i},{i}" for i in range(150)]
    text = "\n".join(["time_s,voltage_V,displacement_um", *rows, row, *rows]) + "\n"
    for size in (text_files._ROWS, 1, 100):
        monkeypatch.setattr(text_files, "_ROWS", size)
        with pytest.raises(InputRefused, match=said):
            _table(tmp_path / "a.csv", text)


def _sine(folder: Path, samples: int) -> int:
    """A recording of a sine in a folder; its size in bytes."""
    t = np.arange(samples) * 1e-5
    u = 50.0 * np.sin(2.0 * np.pi * 40.0 * t)
    y = 1e-6 * u + 1e-8 * np.random.default_rng(0).standard_normal(samples)
    path = folder / "a.csv"
    pd.DataFrame({"time_s": t, "voltage_V": u, "displacement_m": y}).to_csv(path, index=False)
    return path.stat().st_size


def test_a_sample_takes_little_memory(tmp_path: Path) -> None:
    size = _sine(tmp_path, 70_000)
    tracemalloc.start()
    try:
        check(read(tmp_path))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # Blocks and what is imported take the same memory whatever the size of the file.
    assert peak < 2 * size + 20e6


@pytest.mark.slow
def test_check_takes_a_gigabyte_beyond_twice_the_file(tmp_path: Path) -> None:
    size = _sine(tmp_path, 6_000_000)
    subprocess.run([sys.executable, "-m", "phnn.cli", "check", str(tmp_path)], check=True, capture_output=True)
    # KiB on Linux.
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 < 2 * size + 1e9
