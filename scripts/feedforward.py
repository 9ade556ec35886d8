"""How well inverses make actuators follow: ``python scripts/feedforward.py [--seed N] [--draws N] [--out DIR]``.

Identifies the paper's actuator from recordings of its own making, drives other plants with the commands that follow
from it, and prints the table of docs/feedforward.md; the figure and the table are in the folder.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands import refusals, status
from studies.feedforward import run_feedforward


def main() -> None:
    """Run, and refuse bad input in one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of recordings, plants and noise")
    parser.add_argument("--draws", type=int, default=20, metavar="N", help="plants at each frequency")
    parser.add_argument("--noise", type=float, default=0.05, metavar="UM", help="of the sensor, micrometres rms")
    parser.add_argument("--out", type=Path, default=Path("out/feedforward"), metavar="DIR", help="default: %(default)s")
    given = parser.parse_args()
    with refusals("feedforward"), status() as progress:
        text = run_feedforward(given.out, given.seed, given.draws, given.noise, progress)
    print(text, end="")
    print(f"seed {given.seed}   results: {given.out / 'feedforward.md'}")


if __name__ == "__main__":
    main()
