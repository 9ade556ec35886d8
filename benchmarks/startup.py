"""How long until the first result?

    python -m benchmarks.startup

A fresh process imports phnn and makes one solve and one set of derivatives, first with an empty cache of compiled code,
then with what that left behind.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

from benchmarks.table import RESULTS, machine, show, write_csv

STAGES = ("import", "first solve", "first derivatives")
_PROGRAM = """
import time
begin = time.perf_counter()
from phnn.derivatives import output_derivatives
from phnn.trajectory import simulate
imported = time.perf_counter() - begin
from benchmarks.case import NAMES, PART, TRUTH, setup_with
begin = time.perf_counter()
trajectory = simulate(setup_with(TRUTH), PART[0])
solved = time.perf_counter()
output_derivatives(trajectory, NAMES)
print(imported, solved - begin, time.perf_counter() - solved)
"""


def stages(cache: Path) -> list[float]:
    """Seconds of `STAGES` in a fresh process with this folder for compiled code.

    Raises:
        subprocess.CalledProcessError: the process failed.
    """
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM],
        cwd=Path(__file__).parent.parent,
        env=os.environ | {"PHNN_CACHE_DIR": str(cache)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [float(s) for s in done.stdout.split()]


def main() -> int:
    """Measure, print, write ``startup.csv``."""
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        cold, warm = (stages(Path(folder)) for _ in range(2))
    table = pd.DataFrame({"stage": STAGES, "cold_s": cold, "warm_s": warm})
    show(table, "a fresh process: without and with compiled code in the cache [s]")
    write_csv(table, RESULTS / "startup.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
