"""Run every benchmark, each in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

BENCHMARKS = ("startup", "forward", "gradient", "identify", "growth", "leaves")
PEERS = ("diffrax", "optimistix")


def main() -> int:
    """Exit status of the first benchmark that failed, else 0."""
    missing = [name for name in PEERS if not find_spec(name)]
    if missing:
        print(f"{', '.join(missing)} not installed: pip install -e '.[bench]'", file=sys.stderr)
        return 2
    root = Path(__file__).parent.parent
    for name in BENCHMARKS:
        print(f"\n=== {name}", flush=True)
        done = subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], cwd=root, check=False)
        if done.returncode:
            return done.returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
