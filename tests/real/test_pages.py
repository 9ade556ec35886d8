"""The pages of the worked studies state what their commands give today."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pages import DOCS, differences, stated
from real_recordings import folder

from phnn.check import check
from phnn.configuration import config_folder
from phnn.recordings import read

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
