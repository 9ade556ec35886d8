"""Make sealed cases, let tools answer them, and score the answers: ``python scripts/bench.py STEP --out DIR ...``.

    write   make and seal cases                python scripts/bench.py write --out bench seed=1
    answer  let a tool answer them             python scripts/bench.py answer --cases bench --tool phnn --out answers/phnn
    score   open the seals, score answers      python scripts/bench.py score --cases bench --answers answers/phnn --out scores
    all     these three for several tools      python scripts/bench.py all --out out/bench --tools phnn base seed=1

Every step goes on where it stopped. The page of ``score`` and ``all`` is ``leaderboard.md``.
"""  # noqa: E501

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands import refusals
from phnn.errors import InputRefused, meant
from phnn.results import Origin, claim
from studies.benchmark.bench import ANSWERS, RESULTS, Settings, answer_all, card_of, write_benchmark
from studies.benchmark.score import SCORES, scores_of, write_scores
from studies.benchmark.tools import TOOLS, tool
from studies.results import fill, filled, stamped

_LONGEST = 1e7  # seconds


def write(asked: argparse.Namespace) -> None:
    """Make and seal all cases."""
    settings = _settings(asked.settings)
    print(f"seed {settings.seed}", flush=True)
    with claim(asked.out, "bench", (), RESULTS, Origin(asdict(settings), resume=True), False) as place:
        digest = write_benchmark(settings, place, asked.executor, _say)
    print(f"SHA-256 of all cases and seals: {digest}")


def answer(asked: argparse.Namespace) -> None:
    """Let a tool answer the cases."""
    _check(asked)
    tool(asked.tool)
    origin = {"tool": asked.tool, "benchmark": card_of(asked.cases)["sha256"]}
    # A case that had no answer within a shorter limit may have one within this.
    origin |= {} if asked.limit is None else {"limit": f"{asked.limit:g}"}
    with claim(asked.out, "bench", [asked.cases], ANSWERS, Origin(origin, resume=True), False) as place:
        answer_all(asked.cases, asked.tool, place, asked.executor, _say, asked.first, asked.limit)
    print(f"answers: {asked.out / ANSWERS[0]}")


def score(asked: argparse.Namespace) -> None:
    """Score the answers of tools."""
    _check(asked)
    names = [path.resolve().name for path in asked.answers]
    if len(set(names)) != len(names):
        raise InputRefused(f"two folders of answers are called alike, {', '.join(names)}: rename one")
    with claim(asked.out, "bench", [asked.cases, *asked.answers], SCORES, overwrite=asked.overwrite) as place:
        scores = {n: scores_of(asked.cases, path, asked.first) for n, path in zip(names, asked.answers, strict=True)}
        print(write_scores(scores, place), end="")
    print(f"results: {asked.out / SCORES[-1]}")


def everything(asked: argparse.Namespace) -> None:
    """Carry out all steps; bad input is refused before hours of work."""
    _check(asked)
    _settings(asked.settings)
    for name in asked.tools:
        tool(name)
    if asked.page:
        filled(asked.page, asked.table, "")
    out, given = asked.out, vars(asked)
    write(argparse.Namespace(**given | {"out": out / "benchmark"}))
    given |= {"cases": out / "benchmark", "answers": [out / name for name in asked.tools], "overwrite": True}
    for name in asked.tools:
        answer(argparse.Namespace(**given | {"tool": name, "out": out / name}))
    scores = out / ("scores" if asked.table == "bench" else asked.table)
    score(argparse.Namespace(**given | {"out": scores}))
    if asked.page:
        table = (scores / SCORES[-1]).read_text(encoding="utf-8").replace("## ", "### ")
        fill(asked.page, asked.table, stamped(table))


def _settings(words: Sequence[str]) -> Settings:
    keys = tuple(Settings.__dataclass_fields__)
    for word in words:
        key, equals, value = word.partition("=")
        if key not in keys or not equals:
            raise InputRefused(
                f"unknown setting {word!r}{meant(key, keys)}: write key=value, keys are {', '.join(keys)}"
            )
        if not value.isdecimal():
            raise InputRefused(f"setting {word}: give a whole number, 0 or more")
    return Settings(**{key: int(value) for key, _, value in (word.partition("=") for word in words)})


def _check(asked: argparse.Namespace) -> None:
    if asked.first is not None and asked.first < 1:
        raise InputRefused(f"--first {asked.first}: give a number of cases, 1 or more")
    limit = getattr(asked, "limit", None)
    if limit is not None and not 0.0 < limit <= _LONGEST:
        raise InputRefused(f"--limit {limit:g}: give processor seconds above 0 and up to {_LONGEST:g}")


def _say(line: str) -> None:
    print(line, flush=True)


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command line, or words in its place, with the function of its step as ``run``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    defaults = " ".join(f"{key}={value}" for key, value in asdict(Settings()).items())
    steps = parser.add_subparsers(required=True, metavar="STEP")
    options = {
        "cases": {"type": Path, "required": True, "metavar": "DIR", "help": "what write has written"},
        "tool": {"required": True, "metavar": "NAME", "help": ", ".join(TOOLS)},
        "tools": {"nargs": "+", "default": list(TOOLS), "metavar": "NAME", "help": "the first is compared with others"},
        "answers": {"type": Path, "required": True, "action": "append", "metavar": "DIR", "help": "may be repeated"},
        "first": {"type": int, "metavar": "N", "help": "the first N cases alone; their order is drawn"},
        "limit": {"type": float, "metavar": "S", "help": "processor seconds for a case, after which it has no answer"},
        "page": {"type": Path, "metavar": "FILE", "help": "also fill the table of this page of markdown"},
        "table": {"default": "bench", "metavar": "NAME", "help": "which table, and the folder of its scores"},
        "executor": {"default": "processes", "metavar": "WHERE", "help": "see phnn diagnose; default: %(default)s"},
    }
    takes = {
        write: ("executor",), answer: ("cases", "tool", "first", "limit", "executor"),
        score: ("cases", "answers", "first"), everything: ("tools", "first", "limit", "page", "table", "executor"),
    }  # fmt: skip
    for run, names in takes.items():
        step = steps.add_parser("all" if run is everything else run.__name__, help=run.__doc__)
        step.set_defaults(run=run)
        step.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the results")
        for name in names:
            step.add_argument(f"--{name}", **options[name])  # type: ignore[arg-type]
        if run is score:
            step.add_argument("--overwrite", action="store_true", help="replace scores that were changed since")
        if run in (write, everything):
            step.add_argument("settings", nargs="*", metavar="KEY=VALUE", help=f"numbers of cases: {defaults}")
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None) -> None:
    """Run, and refuse bad input in one line."""
    with refusals("bench"):
        asked = arguments(words)
        asked.run(asked)


if __name__ == "__main__":
    main()
