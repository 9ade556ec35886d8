"""Long texts: read in blocks as if at once, and in little memory."""

from __future__ import annotations

import resource
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from phnn.check import check
from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.recordings import lines, read
from phnn.recordings.text_files import read_text


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
        monkeypatch.setattr(lines, "_BLOCK", size)
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
    for size in (lines._BLOCK, 1, 100):
        monkeypatch.setattr(lines, "_BLOCK", size)
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
