"""The whole benchmark in one command: ``python scripts/bench.py --out DIR [--tools phnn base] [--first N] [seed=2]``.

Makes the cases, lets each tool answer them, scores all answers and prints the page, ``DIR/scores/leaderboard.md``. Run
again, it goes on where it stopped; another tool is added by naming it too. ``--table NAME`` keeps the scores of some
tools, or of fewer cases, in ``DIR/NAME`` beside those of all.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from phnn.commands.bench import bench
from phnn.commands.terminal import refusals
from phnn.configuration import compose
from phnn.studies.benchmark.tools import TOOLS, TRAINED
from phnn.studies.results import fill


def run(chosen: argparse.Namespace) -> None:
    """Carry out all steps."""
    config, out = compose("bench", chosen.settings), chosen.out
    given: dict[str, Any] = dict.fromkeys(("cases", "tool", "answers", "first", "limit", "training"))
    given |= {"executor": chosen.executor, "typed": chosen.settings}
    tools = chosen.tools or [name for name in TOOLS if chosen.training or name not in TRAINED]
    bench("write", out / "benchmark", config, given)
    asked = {**given, "typed": [], "cases": out / "benchmark", "first": chosen.first}
    for tool in tools:
        began = time.monotonic()
        training = chosen.training if tool in TRAINED else None
        bench("answer", out / tool, config, {**asked, "tool": tool, "training": training, "limit": chosen.limit})
        print(f"{tool}: {time.monotonic() - began:.0f} s", flush=True)
    answers = [out / tool for tool in tools]
    scores = out / ("scores" if chosen.table == "bench" else chosen.table)
    bench("score", scores, config, {**asked, "answers": answers}, overwrite=True)
    if chosen.page:
        table = (scores / "leaderboard.md").read_text(encoding="utf-8")
        fill(chosen.page, chosen.table, table.replace("## ", "### "))


def main() -> None:
    """Run, and refuse bad input in one line."""
    parser = argparse.ArgumentParser(description="Make, answer and score a benchmark.")
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/bench"), help="default: %(default)s")
    add(
        "--tools",
        nargs="+",
        default=list(TOOLS),
        metavar="NAME",
        help="default: all; the first is compared with others",
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
    with refusals("bench"):
        run(parser.parse_args())


if __name__ == "__main__":
    main()
