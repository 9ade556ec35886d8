"""Carry out the worked studies and measure what they take: ``python scripts/studies.py folder=DIR [out=DIR]``."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import hydra
import pandas as pd
from omegaconf import DictConfig, OmegaConf

from phnn.configuration import config_folder
from phnn.output import Place


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


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/studies")
def main(config: DictConfig) -> None:
    """Run what there are recordings for; the table is written anew after every command."""
    folder, out = Path(config.folder), Path(config.out)
    rows: list[dict[str, object]] = []
    for name, commands in OmegaConf.to_container(config.studies).items():
        if not (folder / name).is_dir():
            print(f"studies: {folder / name} is no folder: {name} is left out", file=sys.stderr)
            continue
        for command in commands:
            manifest = config_folder() / "recordings" / name / "recordings.yaml"
            target = out / name / command
            told = ["--manifest", str(manifest), "--out", str(target)]
            row = measured([sys.executable, "-m", "phnn.cli", command, str(folder / name), *told])
            rows.append({"study": name, "command": command, **row})
            (Place(out.resolve()) / "studies.csv").write(pd.DataFrame(rows).to_csv(index=False).encode())
    if not rows:
        print(f"studies: {folder} has no folder of any study", file=sys.stderr)
        sys.exit(2)
    print(pd.DataFrame(rows).to_string(index=False))
    sys.exit(max(abs(int(row["status"])) for row in rows))


if __name__ == "__main__":
    main()
