"""The measured tables of the documentation: with which code each was made, and what has changed since.

    python scripts/evidence.py                  # every table with its commit, and how much of its code changed since
    python scripts/evidence.py run loops        # make tables anew; all of them without a name
    python scripts/evidence.py check            # the same list; exit status 1 where a table is of older code

What a stage has finished before it was cut off stays in ``out/evidence``, and the stage goes on from there.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # studies/ is not installed

from phnn.errors import InputRefused

_DIAGNOSIS = ("phnn/diagnose", "phnn/effects", "phnn/identification", "phnn/integrate", "phnn/criteria.py")
_CASES = ("none=6", "same=19", "other=6", "outside=5", "pair=5", "background=9")
_BENCH = ("scripts/bench.py", "all", *_CASES, "--limit", "900", "--page", "docs/evidence.md")
_LOG = "out/evidence/visits.jsonl"


class Stage(NamedTuple):
    """What makes one table.

    Attributes:
        page, block: where it stands; rooms: the code that it tells of; commands: of python, one after another.
    """

    page: str
    block: str
    rooms: tuple[str, ...]
    commands: Sequence[Sequence[str]]


STAGES = {
    "study": Stage("docs/decides.md", "study", _DIAGNOSIS, (
        ("scripts/decides.py", "visit", "--seed", "820000", "--cases", "400", "--out", _LOG),
        ("scripts/decides.py", "page", _LOG),
    )),
    "bench": Stage("docs/evidence.md", "bench", (*_DIAGNOSIS, "studies/benchmark"), (
        (*_BENCH, "seed=30932", "--out", "out/evidence/bench", "--tools", "phnn", "lisdd", "sindy"),
    )),
    "parts": Stage("docs/evidence.md", "parts", (*_DIAGNOSIS, "studies/benchmark"), (
        (*_BENCH, "seed=95317", "--out", "out/evidence/parts", "--first", "20", "--table", "parts", "--tools", "phnn",
         "phnn_without_learned", "phnn_scores_only"),
    )),
    "loops": Stage("docs/evidence.md", "loops", ("phnn/integrate", "phnn/identification", "studies/rival_models"), (
        ("scripts/rivals.py", "study=loops", "seeds=[0]", "compare.budget=20", "page=docs/evidence.md",
         "out=out/evidence/loops"),
    )),
    "benchmarks": Stage("docs/benchmarks.md", "measured", ("phnn/integrate", "phnn/identification", "benchmarks"), (
        ("-m", "benchmarks"), ("-m", "benchmarks.document"),
    )),
}  # fmt: skip


def commits(stage: Stage) -> list[str]:
    """Return the commits with which a table was made; none where it does not say."""
    table = rf"<!-- begin {stage.block} -->.*\*Made with commit (.+) on .*<!-- end {stage.block} -->"
    found = re.search(table, (ROOT / stage.page).read_text(encoding="utf-8"), re.DOTALL)
    return re.findall(r"[0-9a-f]{7,}", found[1]) if found else []


def changed(stage: Stage) -> list[str] | None:
    """Return the files of a table's code that differ from those it was made with; None where nobody knows."""
    files: set[str] = set()
    for commit in (known := commits(stage)):
        words = ("git", "-C", str(ROOT), "diff", "--name-only", commit, "--", *stage.rooms)
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            return None
        files.update(done.stdout.split())
    return sorted(files) if known else None


def listed() -> int:
    """Print every table with its state; return how many are not of the present code."""
    old = 0
    for name, stage in STAGES.items():
        files, known = changed(stage), ", ".join(commits(stage)) or "no commit"
        state = "nobody knows what has changed" if files is None else f"{len(files)} files have changed since"
        print(f"{name:11} {stage.page}: {known}: {state if files or files is None else 'of the present code'}")
        old += files is None or bool(files)
    if old:
        print("make them anew by: python scripts/evidence.py run NAME ...")
    return old


def main() -> int:
    """List, check or make the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("do", nargs="?", choices=("list", "check", "run"), default="list")
    parser.add_argument("stages", nargs="*", metavar="NAME", help=", ".join(STAGES))
    given = parser.parse_args()
    try:
        if unknown := [n for n in given.stages if n not in STAGES]:
            raise InputRefused(f"{unknown[0]} is no table: give {', '.join(STAGES)}")
        if given.do != "run":
            old = listed()
            return int(given.do == "check" and old > 0)
    except InputRefused as error:
        parser.error(str(error))
    for name in given.stages or STAGES:
        for command in STAGES[name].commands:
            print(f"{name}: python {' '.join(command)}", flush=True)
            if code := subprocess.run((sys.executable, *command), cwd=ROOT, check=False).returncode:
                return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
