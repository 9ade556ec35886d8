"""Carry out the worked studies and measure what they take: ``python scripts/public.py folder=DIR [out=DIR]``.

Writes ``studies.csv`` with the times of all commands, and for each study ``NAME/figures.json`` with the figures that
its page in docs/ states. ``only=[emps]`` runs one study.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import hydra
import pandas as pd
from omegaconf import DictConfig, OmegaConf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.configuration import config_folder
from phnn.results import Place
from studies.public.figures import figures


def measured(command: list[str]) -> dict[str, float | int]:
    """Run a command: exit status, seconds of the clock and of processors, and the peak of its memory in GB."""
    began = time.monotonic()
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    # Linux counts in KiB, macOS in bytes.
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return {
        "status": os.waitstatus_to_exitcode(status),
        "seconds": round(time.monotonic() - began, 1),
        "processor_seconds": round(usage.ru_utime + usage.ru_stime, 1),
        "peak_GB": round(usage.ru_maxrss * unit / 1e9, 3),
    }


def study(name: str, commands: Sequence[str], folder: Path, out: Path) -> Iterator[dict[str, object]]:
    """Carry out the commands of a study; each is a command of phnn, perhaps the name of its manifest, and settings."""
    for command in commands:
        verb, *further = command.split()
        settings = [word for word in further if "=" in word]
        chosen = next((word for word in further if word not in settings), "")
        manifest = config_folder() / "recordings" / name / f"{chosen or 'recordings'}.yaml"
        home = out / "-".join(filter(None, (verb, chosen)))
        told = ["--manifest", str(manifest), "--out", str(home), *settings]
        row = measured([sys.executable, "-m", "phnn.cli", verb, str(folder), *told])
        yield {"study": name, "command": command, **row}


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/studies")
def main(config: DictConfig) -> None:
    """Run what there are recordings for; the table is written anew after every command, the figures after every study.

    A study whose commands have failed has no figures.
    """
    folder, out = Path(config.folder), Path(config.out)
    place = Place(out.resolve())
    rows: list[dict[str, object]] = []
    for name, commands in OmegaConf.to_container(config.studies).items():
        if config.only and name not in config.only:
            continue
        if not (folder / name).is_dir():
            print(f"studies: {folder / name} is no folder: {name} is left out", file=sys.stderr)
            continue
        own = []
        for row in study(name, commands, folder / name, out / name):
            own.append(row)
            (place / "studies.csv").write(pd.DataFrame([*rows, *own]).to_csv(index=False).encode())
        rows += own
        if all(row["status"] == 0 for row in own):
            (place / name / "figures.json").write_json(figures(name, folder / name, out / name))
    if not rows:
        print(f"studies: {folder} has no folder of any study", file=sys.stderr)
        sys.exit(2)
    print(pd.DataFrame(rows).to_string(index=False))
    sys.exit(max(abs(int(str(row["status"]))) for row in rows))


if __name__ == "__main__":
    main()
