"""The whole benchmark in one command: ``python scripts/bench.py [seed=2] --out DIR [--first N] [--tools phnn base]``.

Makes the cases, lets each tool answer them, scores all answers and prints the page, ``DIR/scores/leaderboard.md``. Run
again, it goes on where it stopped; another tool is added by naming it too. ``--table NAME`` keeps the scores of some
tools, or of fewer cases, in ``DIR/NAME`` beside those of all.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands.bench import bench
from phnn.commands.terminal import refusals
from phnn.configuration import compose
from studies.benchmark.tools import TOOLS, TRAINED, tool
from studies.results import fill, filled


def run(chosen: argparse.Namespace) -> None:
    """Carry out all steps."""
    config, out = compose("bench", chosen.settings), chosen.out
    given: dict[str, Any] = dict.fromkeys(("cases", "tool", "answers", "first", "limit", "training"))
    given |= {"executor": chosen.executor, "typed": chosen.settings}
    tools = chosen.tools or [name for name in TOOLS if chosen.training or name not in TRAINED]
    trainings = {name: chosen.training if name in TRAINED else None for name in tools}
    # Bad input is refused before hours of work.
    for name, training in trainings.items():
        tool(name, training)
    if chosen.page:
        filled(chosen.page, chosen.table, "")
    bench("write", out / "benchmark", config, given)
    asked = {**given, "typed": [], "cases": out / "benchmark", "first": chosen.first}
    for name, training in trainings.items():
        began = time.monotonic()
        bench("answer", out / name, config, {**asked, "tool": name, "training": training, "limit": chosen.limit})
        print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)
    answers = [out / name for name in trainings]
    scores = out / ("scores" if chosen.table == "bench" else chosen.table)
    bench("score", scores, config, {**asked, "answers": answers}, overwrite=True)
    if chosen.page:
        table = (scores / "leaderboard.md").read_text(encoding="utf-8")
        fill(chosen.page, chosen.table, table.replace("## ", "### "))


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line, or words in its place."""
    parser = argparse.ArgumentParser(description="Make, answer and score a benchmark.")
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/bench"), help="default: %(default)s")
    add(
        "--tools",
        nargs="+",
        metavar="NAME",
        help="default: all that need no training, or that have one; the first is compared with others",
    )
    add("--first", type=int, metavar="N", help="the first N cases alone")
    add("--limit", type=float, metavar="S", help="processor seconds of a tool for a case, after which it has no answer")
    add("--page", type=Path, metavar="FILE", help="also fill the table of this page of markdown, as docs/evidence.md")
    add(
        "--table",
        default="bench",
        metavar="NAME",
        help="which table of it, and the folder of its scores; default: bench",
    )
    add("--training", type=Path, metavar="DIR", help="what phnn bench train has written, for the tools that learn")
    add("--executor", default="processes", metavar="WHERE", help="see phnn diagnose; default: %(default)s")
    add("settings", nargs="*", metavar="KEY=VALUE", help="of configs/bench.yaml")
    return parser.parse_args(words)


def main() -> None:
    """Run, and refuse bad input in one line."""
    with refusals("bench"):
        run(arguments())


if __name__ == "__main__":
    main()
