"""The pages of the worked studies state what their commands give today."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from phnn.check import check
from phnn.configuration import config_folder
from phnn.recordings import read

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "recordings"


def folder(name: str, file: str) -> Path:
    """The folder of a public data set; skips the test where its file is absent."""
    found = Path(os.environ.get("PHNN_RECORDINGS", _BESIDE)) / name
    if not (found / file).is_file():
        pytest.skip(f"{found / file} is not there: get it from the source named in configs/recordings/{name}")
    return found


DOCS = Path(__file__).resolve().parents[2] / "docs"
QUOTED = "published"
# A figure on a page may differ by this share from that of a run, for an optimiser stops within its tolerance; or by
# half a unit of its last digit, because it is rounded.
TOLERANCE, ROUNDED = 0.02, 0.501

_NUMBER = re.compile(r"[−-]?\d+(?:\.\d+)?")
_RULE = re.compile(r"^[|\s:-]+$")


def stated(page: Path) -> Iterator[tuple[str, str, str]]:
    """Row, column and text of every cell that states a figure."""
    heads: list[str] = []
    for line in page.read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            heads = []
            continue
        cells = [c.strip().strip("*") for c in line.strip().strip("|").split("|")]
        if not heads:
            heads = cells
        elif not _RULE.match(line) and not cells[0].startswith(QUOTED):
            yield from ((cells[0], head, c) for head, c in zip(heads[1:], cells[1:], strict=True) if c not in ("", "–"))


def differences(page: Path, figures: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What a page states otherwise than a run, in words; every cell has to be a figure of the run."""
    found = []
    for row, column, text in stated(page):
        run = figures.get(row, {}).get(column)
        if run is None:
            found.append(f"{row}, {column}: the page states {text!r}, the study has no such figure")
        elif not agrees(text, run):
            found.append(f"{row}, {column}: the page states {text!r}, the study gives {run!r}")
    return found


def agrees(text: str, run: Any) -> bool:
    """Whether a cell states a number, a number with its standard error, or a word of a run."""
    if isinstance(run, str):
        return text == run
    values = list(run) if isinstance(run, list | tuple) else [run]
    numbers = [Decimal(n.replace("−", "-")) for n in _NUMBER.findall(text)]
    return len(numbers) == len(values) and all(_near(n, float(v)) for n, v in zip(numbers, values, strict=True))


def _near(number: Decimal, value: float) -> bool:
    exponent = number.as_tuple().exponent
    unit = 10.0 ** int(exponent) if isinstance(exponent, int) else math.nan
    return abs(float(number) - value) <= max(ROUNDED * unit, TOLERANCE * abs(value))


SCRIPT = DOCS.parent / "scripts" / "public.py"
FILES = {
    "emps": "DATA_EMPS.mat",
    "silverbox": "SNLS80mV.mat",
    "piezo-stack": "Model_Vi_Do.dat",
    "steering-mirror": "u_100mV_train.npy",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_a_page_states_what_its_study_gives(name: str, tmp_path: Path) -> None:
    home = folder(name, FILES[name]).parent
    out = Path(os.environ.get("PHNN_STUDIES", tmp_path))  # of a study that was carried out before
    if not (out / name / "figures.json").is_file():
        command = [sys.executable, str(SCRIPT), f"folder={home}", f"out={out}", f"only=[{name}]"]
        subprocess.run(command, check=True, cwd=tmp_path)
    figures = json.loads((out / name / "figures.json").read_text(encoding="utf-8"))
    assert not differences(DOCS / f"{name}.md", figures)


@pytest.mark.parametrize("name", FILES)
def test_a_page_states_figures_in_tables(name: str) -> None:
    cells = list(stated(DOCS / f"{name}.md"))
    assert len(cells) > 10
    assert len({(row, column) for row, column, _ in cells}) == len(cells)


def test_what_a_page_states_otherwise_is_told(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    rows = "| x | 1.0 | – |\n| **y** | 2.0 | −3.04 ± 0.07 |\n| w | 4.2 | named |\n| published z | 9 | 9 |\n"
    page.write_text(f"| | a | b |\n|---|---|---|\n{rows}")
    good: dict[str, dict[str, object]] = {
        "x": {"a": 1.01}, "y": {"a": 2.0, "b": [-3.0398, 0.0705]}, "w": {"a": 4.26, "b": "named"},
    }  # fmt: skip
    assert differences(page, good) == []
    found = differences(page, {"x": {"a": 1.5}, "y": {"a": 2.0, "b": -3.04}, "w": {"a": 4.4, "b": "equivalent"}})
    assert len(found) == 4 and "gives 1.5" in found[0]
    assert len(differences(page, {**good, "y": {"a": 2.0}})) == 1


def test_the_contaminated_realisations_are_found_and_no_others() -> None:
    where = folder("steering-mirror", "u_100mV_train.npy")
    campaign = read(where, config_folder() / "recordings" / "steering-mirror" / "recordings.yaml")
    assert len(campaign.recordings) == 54
    findings = check(campaign).findings
    noticed = {n for n, found in findings.items() if found}
    # The second and the third of the first train.
    assert noticed == {f"100mV_{r}.y_{y}" for r in (2, 3) for y in (1, 2, 3)}
    assert {f.kind for found in findings.values() for f in found} == {"contaminated"}
