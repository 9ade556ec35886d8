"""Whatever a manifest, a link or a network says: no file outside the recordings and the results is opened."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from attack_tools import csv

ROOT = Path(__file__).resolve().parents[2]
HOSTILE = {
    "a path upwards": "recordings: [{file: ../secret.csv}]",
    "an absolute path": "recordings: [{file: SECRET}]",
    "a link": "recordings: [{file: link.csv}]",
    "a link among folders": "recordings: [{file: away/secret.csv}]",
    "a network": "setup: {network: ../../secret.yaml}\nrecordings: [{file: a.csv}]",
    "an absolute network": "setup: {network: SECRET}\nrecordings: [{file: a.csv}]",
    "several files": "axes: [time]\nrecordings: [{file: [a.csv, ../secret.csv]}]",
    "an interpolation": "recordings: [{file: '${oc.env:HOME}/secret.csv'}]",
    "a tag": "recordings: [{file: !!python/object/apply:open [SECRET]}]",
    "a home": "recordings: [{file: ~/secret.csv}]",
    "a list": "files: SECRET",
}
# Runs both commands on every folder and prints each file that is opened meanwhile.
WATCHED = """
import json, sys
import phnn.commands.check, phnn.commands.identify
from phnn.cli import main
seen, case = [], [""]
sys.addaudithook(lambda event, args: seen.append((case[0], str(args[0]))) if event == "open" and case[0] else None)
for folder in json.loads(sys.argv[1]):
    for command in ("check", "identify"):
        case[0] = folder
        main([command, folder, "--out", folder + "-out"])
        case[0] = ""
print(json.dumps(seen), file=open(sys.argv[2], "w"))
"""


@pytest.mark.slow
def test_nothing_outside_is_opened(tmp_path: Path) -> None:
    folders = []
    (tmp_path / "outside").mkdir()
    for name in ("secret.csv", "outside/secret.csv"):
        (tmp_path / name).write_text(csv())
    (tmp_path / "secret.yaml").write_text("{}")
    for number, manifest in enumerate(HOSTILE.values()):
        folder = tmp_path / "in" / f"{number}"
        folder.mkdir(parents=True)
        (folder / "a.csv").write_text(csv())
        (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
        (folder / "away").symlink_to(tmp_path / "outside")
        (folder / "recordings.yaml").write_text(manifest.replace("SECRET", str(tmp_path / "secret.csv")))
        folders.append(str(folder))
    (tmp_path / "in" / "secret.csv").write_text(csv())
    home = {"HOME": str(tmp_path), "PHNN_CACHE_DIR": os.environ.get("PHNN_CACHE_DIR", str(Path.home() / ".cache"))}
    command = [sys.executable, "-c", WATCHED, json.dumps(folders), str(tmp_path / "seen.json")]
    done = subprocess.run(
        command, env=os.environ | home | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True
    )
    assert done.stderr.count("phnn: ") >= len(HOSTILE), done.stderr
    opened = json.loads((tmp_path / "seen.json").read_text())
    assert len(opened) > len(HOSTILE)
    # Installed code, what it compiled, and what the system tells of itself.
    allowed = [sys.prefix, sys.base_prefix, str(ROOT), home["PHNN_CACHE_DIR"], "/dev/null", "/proc", "/sys/fs/cgroup"]
    allowed += [str(Path(p).resolve()) for p in sys.path if p]
    strange = []
    for folder, path in opened:
        real = os.path.realpath(path)
        inside = any(real == a or real.startswith(a + os.sep) for a in (*allowed, folder, folder + "-out"))
        if not inside and not path.isdigit():
            strange.append((folder, path))
    assert not strange
