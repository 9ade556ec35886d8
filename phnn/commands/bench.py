"""``phnn bench``: make sealed cases, let a tool answer them, score answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from phnn.commands.terminal import Config
from phnn.errors import InputRefused
from phnn.output import Origin, claim
from phnn.studies.benchmark.folders import RESULTS, card_of, write_benchmark
from phnn.studies.benchmark.run import ANSWERS, SCORES, answer_all, scores_of, write_scores
from phnn.studies.benchmark.settings import Settings
from phnn.studies.benchmark.tools import tool

# By step: the options that it takes.
_TAKES = {"write": (), "answer": ("cases", "tool"), "score": ("cases", "answers")}
_FIRST = ("answer", "score")


def bench(step: str, out: Path, config: Config, options: Mapping[str, Any], overwrite: bool = False) -> None:
    """Carry out one step of a benchmark.

    Args:
        step: ``write`` makes and seals cases in ``out``; ``answer`` lets a tool answer them; ``score`` opens their
            seals and scores answers.
        config: settings of ``write``.
        options: ``cases``: what ``write`` has written; ``tool``: its name; ``answers``: folders with those of tools;
            ``first``: so many cases alone, None for all; ``executor``: where cases are made and a tool works, see
            `phnn.ensemble.executor`.

    Raises:
        InputRefused: an option that a step does not take, or lacks.
    """
    for name in ("cases", "tool", "answers"):
        if (name in _TAKES[step]) is (options[name] is None):
            raise InputRefused(f"phnn bench {step} {'needs' if options[name] is None else 'does not take'} --{name}")
    first = options["first"]
    if first is not None and (step not in _FIRST or first < 1):
        raise InputRefused(f"--first {first}: {' and '.join(_FIRST)} take a number of cases, 1 or more")
    settings = [w for w in options["typed"] if w.partition("=")[0] in Settings.__dataclass_fields__]
    if settings and step != "write":
        raise InputRefused(f"phnn bench {step} does not take {settings[0]}: settings are those of write")
    if step == "write":
        _write(Settings.from_config(config), out, options["executor"], overwrite)
    elif step == "answer":
        cases, chosen = options["cases"], options["tool"]
        tool(chosen)  # refuses an unknown one now
        origin = Origin({"tool": chosen, "benchmark": card_of(cases)["sha256"]}, resume=True)
        with claim(out, "bench", [cases], ANSWERS, origin, overwrite) as place:
            answer_all(cases, chosen, place, options["executor"], _say, first=first)
        print(f"answers: {out / ANSWERS[0]}")
    else:
        _score(options["cases"], options["answers"], out, first, overwrite)


def _score(cases: Path, answers: Sequence[Path], out: Path, first: int | None, overwrite: bool) -> None:
    names = [path.resolve().name for path in answers]
    if len(set(names)) != len(names):
        raise InputRefused(f"two folders of answers are called alike, {', '.join(names)}: rename one")
    with claim(out, "bench", [cases, *answers], SCORES, overwrite=overwrite) as place:
        found = {name: scores_of(cases, path, first) for name, path in zip(names, answers, strict=True)}
        print(write_scores(found, place), end="")
    print(f"results: {out / SCORES[-1]}")


def _write(settings: Settings, out: Path, where: str, overwrite: bool) -> None:
    print(f"seed {settings.seed}", flush=True)
    with claim(out, "bench", (), RESULTS, Origin(asdict(settings), resume=True), overwrite) as place:
        digest = write_benchmark(settings, place, where, _say)
    print(f"SHA-256 of all cases and seals: {digest}")


def _say(line: str) -> None:
    print(line, flush=True)
