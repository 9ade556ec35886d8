"""Numbers as text, and what a page says to do a run again."""

from __future__ import annotations

import hashlib
import math
import shutil
import subprocess
import sys
from pathlib import Path

import campaigns
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phnn.recordings import read
from phnn.report import formatting as f
from phnn.report.sections import command_line, provenance, traces_of, usage


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (math.nan, "–"),
        (0.0, "0"),
        (1.03, "1.03"),
        (0.0012345, "0.00123"),
        (1.11e-5, "1.11 × 10⁻⁵"),
        (-3.02e5, "−3.02 × 10⁵"),
        (9.999, "10.0"),
        (99999.0, "1.00 × 10⁵"),
    ],
)
def test_number(value: float | None, text: str) -> None:
    assert f.number(value) == text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.31, 0.02, "0.310 ± 0.020"),
        (3.11e5, 2.1e3, "(3.110 ± 0.021) × 10⁵"),
        (9210.0, 330.0, "9210 ± 330"),
        (1.11e-3, None, "0.00111"),
        (0.5, 4.0, "0.5 ± 4.0"),
        (None, 1.0, "–"),
        (1e-7, 9.96e-9, "(1.00 ± 0.10) × 10⁻⁷"),
    ],
)
def test_with_error(value: float | None, std: float | None, text: str) -> None:
    assert f.with_error(value, std) == text


@given(st.floats(1e-12, 1e12))
def test_number_keeps_three_digits(value: float) -> None:
    text = f.number(value)
    mantissa, _, power = text.partition(" × 10")
    exponent = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))) if power else 0
    assert float(mantissa) * 10.0**exponent == pytest.approx(value, rel=0.0051)


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (0.4, "p = 0.4"),
        (0.0412, "p = 0.04"),
        (1e-5, "p < 2 × 10⁻⁵"),
        (2.0 / 100_001.0, "p < 2 × 10⁻⁵"),
        (1e-9, "p < 2 × 10⁻⁵"),
        (2.1e-5, "p = 2 × 10⁻⁵"),
        (3.2e-4, "p = 3 × 10⁻⁴"),
        (9.7e-5, "p = 1 × 10⁻⁴"),
        (0.0, "p < 2 × 10⁻⁵"),
        (None, "p not computed"),
    ],
)
def test_p_value(p: float | None, text: str) -> None:
    assert f.p_value(p) == text


@given(st.floats(allow_nan=True, allow_infinity=True), st.floats(allow_nan=True, allow_infinity=True))
def test_every_float_has_a_text(value: float, std: float) -> None:
    for text in (f.number(value), f.with_error(value, std), f.p_value(value), f.plain(value)):
        assert text
        assert not {"nan", "inf"} & set(text.split())


def test_what_a_run_was_made_of_changes_with_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    shutil.copytree(campaigns.campaign().folder, folder)
    before = provenance(read(folder), command_line(["diagnose", "my recordings", "--out", "o"]))
    assert before.command == "phnn diagnose 'my recordings' --out o"
    assert set(before.files) == {"recordings.yaml", *(p.name for p in folder.glob("*.csv"))}
    assert all(hashlib.sha256((folder / n).read_bytes()).hexdigest() == h for n, h in before.files.items())
    first = next(folder / n for n in before.files if n.endswith(".csv"))
    lines = first.read_text().splitlines()
    lines[5] = lines[5].replace("1", "2")
    first.write_text("\n".join(lines))
    after = provenance(read(folder))
    changed = [n for n in before.files if before.files[n] != after.files[n]]
    assert changed == [first.name] and after.understood != before.understood and after.command == ""
    manifest = tmp_path / "other.yaml"
    manifest.write_text("voltage: command\n")
    told = provenance(read(folder, manifest), manifest=manifest).files
    assert told[str(manifest)] == hashlib.sha256(manifest.read_bytes()).hexdigest()


@pytest.mark.slow
def test_code_of_a_page_loads_the_model_and_simulates(tmp_path: Path) -> None:
    found = campaigns.diagnosis("quadratic_drag")
    found.model.save(tmp_path / "model")
    code = usage(traces_of(found), *found.campaign.recordings[0].units)
    (tmp_path / "use.py").write_text(f"{code}\nprint(y.min(), y.max())\n")
    done = subprocess.run([sys.executable, "use.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    low, high = map(float, done.stdout.split())
    largest = max(float(np.abs(r.y).max()) for r in found.campaign.recordings)
    assert low < 0.0 < high and 0.3 * largest < high - low < 4.0 * largest
