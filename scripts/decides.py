"""Study what a diagnosis decides: ``python scripts/decides.py visit --seed 1 --cases 150 --out log.jsonl``.

``visit`` diagnoses sealed cases and logs every model that was visited; cases that the log holds already are not made
again. ``compare LOG`` prints what different ways to weigh these models say, offline. ``page [LOG]`` writes rules,
criteria and, of a log, the tables of the study into docs/decides.md.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.errors import PhnnError
from phnn.identification.plan import Options
from studies.decides.compare import GROUPS, tasks
from studies.decides.page import markdown, study, write
from studies.sealed.grade import cases_in
from studies.sealed.run import run

PAGE = Path(__file__).resolve().parents[1] / "docs" / "decides.md"


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    visiting = commands.add_parser("visit", help="diagnose sealed cases and log every model that was visited")
    visiting.add_argument("--seed", type=int, required=True)
    visiting.add_argument("--cases", type=int, default=150)
    visiting.add_argument("--out", type=Path, required=True)
    visiting.add_argument("--plan", default="full")
    visiting.add_argument("--levels", type=float, nargs=2, default=(1.5, 10.0))
    visiting.add_argument(
        "--shares", type=int, nargs=len(GROUPS), default=[1, 1, 1, 1, 6, 3, 4, 3, 1, 2, 1, 1, *[0] * 5]
    )
    visiting.add_argument("--workers", type=int, default=1, help="threads of a fit")
    visiting.add_argument("--executor", default="serial", metavar="WHERE", help="where cases are worked on")
    visiting.set_defaults(run=visit_cases)
    comparing = commands.add_parser("compare", help="compare ways to weigh the models of a log")
    comparing.add_argument("log", type=Path)
    comparing.set_defaults(run=compare)
    writing = commands.add_parser("page", help="write the tables of docs/decides.md")
    writing.add_argument("log", type=Path, nargs="?")
    writing.set_defaults(run=lambda given: write(PAGE, given.log))
    given = parser.parse_args()
    try:
        given.run(given)
    except PhnnError as error:
        raise SystemExit(str(error)) from error


def visit_cases(given: argparse.Namespace) -> None:
    """Visit cases until the log has as many as asked for."""
    cases = tasks(given.seed, given.cases, given.shares, given.plan, tuple(given.levels))
    run(cases, given.out, Options(workers=given.workers), given.executor, partial(print, flush=True))


def compare(given: argparse.Namespace) -> None:
    """Print the tables of a log."""
    cases, failures = cases_in(given.log)
    print(f"{len(cases)} cases, {failures} without an answer")
    for title, table in study(cases).items():
        print(f"\n{title}\n\n{markdown(table)}")


if __name__ == "__main__":
    main()
