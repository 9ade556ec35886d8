"""Log the visited models of sealed cases: ``python scripts/decides.py visit --seed 1 --cases 150 --out log.jsonl``.

Cases that the log holds already are not made again. ``compare LOG`` prints the table of docs/decides.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.errors import PhnnError
from phnn.identification.options import Options
from studies.decides.visit import GROUPS, groups_in_turn, visit


def main() -> None:
    """Visit cases until there are as many as asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=150)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--plan", default="full")
    parser.add_argument("--levels", type=float, nargs=2, default=(1.5, 10.0))
    parser.add_argument("--shares", type=int, nargs=len(GROUPS), default=[1, 1, 1, 1, 6, 3, 4, 3, 1, 2, 1, 1])
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    known = set()
    if given.out.exists():
        rows = (json.loads(line) for line in given.out.read_text(encoding="utf-8").splitlines())
        known = {(row["group"], row["seed"]) for row in rows}
    options = Options(workers=given.workers)
    every = enumerate(groups_in_turn(given.shares), start=given.seed)
    for seed, group in itertools.islice(every, given.cases):
        if (group.name, seed) in known:
            continue
        try:
            row = visit(group, seed, given.plan, tuple(given.levels), options)
        except PhnnError as error:
            row = {"group": group.name, "seed": seed, "failure": str(error)}
        with given.out.open("a", encoding="utf-8") as log:
            log.write(json.dumps(row) + "\n")
        said = row.get("verdict", row.get("failure"))
        print(f"{group.name} {seed}: {'+'.join(row.get('effects', [])) or 'nothing'} -> {said} {row.get('claims', '')}")


if __name__ == "__main__":
    main()
