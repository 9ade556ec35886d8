"""What a page says to do a run again: methods, references, hashes of what was read, code that runs."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

import campaigns
import numpy as np
import pytest

from phnn.recordings import read
from phnn.report.methods import bibtex, command_line, methods, provenance
from phnn.report.page import usage
from phnn.report.result import evidence


def test_methods_say_what_was_fitted_held_out_and_decided() -> None:
    found = campaigns.diagnosis("quadratic_drag")
    said = methods(found)
    text = " ".join(said.sentences)
    for part in (p for r in found.campaign.recordings for p in r.parts if p.use != "nuisance"):
        assert part.name in text
    assert "Held out was sine_010Hz_50V: no model was fitted to it or weighed by it." in text
    (fitted,) = re.findall(r"parameters \(([^)]*)\) were estimated", text)
    assert set(fitted.split(", ")) == set(found.base.variables.names)
    assert "The verdict is “named”: the final model adds quadratic drag [5]" in text
    assert f"numpy {np.__version__}" in text
    assert max(int(n) for n in re.findall(r"\[(?:\d+, )*(\d+)\]", text)) == len(said.references)
    assert len(re.findall(r"^@\w+\{", said.bibtex, re.MULTILINE)) == len(said.references)
    assert said.bibtex.count("{") - said.bibtex.count(r"\{") == said.bibtex.count("}") - said.bibtex.count(r"\}")


def test_what_a_run_was_made_of_changes_with_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    shutil.copytree(campaigns.campaign().folder, folder)
    before = provenance(read(folder), command_line(["diagnose", "my recordings", "--out", "o"]))
    assert before.command == "phnn diagnose 'my recordings' --out o"
    assert {f.name for f in before.recordings} == {p.name for p in folder.glob("*.csv")}
    assert all(f.sha256 == hashlib.sha256((folder / f.name).read_bytes()).hexdigest() for f in before.recordings)
    first = folder / before.recordings[0].name
    lines = first.read_text().splitlines()
    lines[5] = lines[5].replace("1", "2")
    first.write_text("\n".join(lines))
    after = provenance(read(folder))
    changed = [a.name for a, b in zip(after.recordings, before.recordings, strict=True) if a != b]
    assert changed == [first.name] and after.understood != before.understood
    assert after.manifest == before.manifest and after.command == ""
    manifest = tmp_path / "other.yaml"
    manifest.write_text("voltage: command\n")
    said = provenance(read(folder, manifest), manifest=manifest).manifest
    assert said is not None and said.sha256 == hashlib.sha256(manifest.read_bytes()).hexdigest()


@pytest.mark.slow
def test_code_of_a_page_loads_the_model_and_simulates(tmp_path: Path) -> None:
    found = campaigns.diagnosis("quadratic_drag")
    found.model.save(tmp_path / "model")
    code = usage(evidence(found).traces, *found.campaign.recordings[0].units)
    (tmp_path / "use.py").write_text(code)
    done = subprocess.run([sys.executable, "use.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    low, high = map(float, done.stdout.split())
    largest = max(float(np.abs(r.y).max()) for r in found.campaign.recordings)
    assert low < 0.0 < high and 0.3 * largest < high - low < 4.0 * largest


@pytest.mark.parametrize("text", ["a {b} & c_d 100 % #1 $x$", "back\\slash 1999"])
def test_references_are_escaped(text: str) -> None:
    entry = bibtex([text]).rsplit("\n\n", 1)[1]
    assert not re.search(r"(?<!\\)[&%#_$]", entry.partition("note")[2])
