"""``phnn bench``: make sealed cases, let a tool answer them, score answers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from phnn.commands.terminal import Config
from phnn.errors import InputRefused
from phnn.output import Origin, claim
from phnn.studies.benchmark.folders import RESULTS, write_benchmark
from phnn.studies.benchmark.run import ANSWERS, SCORES, answer_all, scores_of, write_scores
from phnn.studies.benchmark.settings import Settings

# By step: the options that it takes.
_TAKES = {"write": (), "answer": ("--cases", "--tool"), "score": ("--cases", "--answers")}


def bench(
    step: str,
    out: Path,
    config: Config,
    cases: Path | None = None,
    tool: str | None = None,
    answers: Sequence[Path] | None = None,
    executor: str = "processes",
    overwrite: bool = False,
) -> None:
    """Carry out one step of a benchmark.

    Args:
        step: ``write`` makes and seals cases in ``out``; ``answer`` lets ``tool`` answer ``cases``; ``score`` opens
            the seals of ``cases`` and scores ``answers``.
        config: settings of ``write``.
        executor: where cases are made and a tool works, see `phnn.ensemble.executor`.

    Raises:
        InputRefused: an argument that a step does not take, or lacks.
    """
    given = {"--cases": cases, "--tool": tool, "--answers": answers}
    for name, value in given.items():
        if (name in _TAKES[step]) is (value is None):
            raise InputRefused(f"phnn bench {step} {'needs' if value is None else 'does not take'} {name}")
    if cases is None:
        _write(Settings.from_config(config), out, executor, overwrite)
    elif tool is not None:
        with claim(out, "bench", [cases], ANSWERS, Origin({"tool": tool}, resume=True), overwrite) as place:
            answer_all(cases, tool, place, executor, _say)
        print(f"answers: {out / ANSWERS[0]}")
    else:
        _score(cases, answers or (), out, overwrite)


def _score(cases: Path, answers: Sequence[Path], out: Path, overwrite: bool) -> None:
    names = [path.resolve().name for path in answers]
    if len(set(names)) != len(names):
        raise InputRefused(f"two folders of answers are called alike, {', '.join(names)}: rename one")
    with claim(out, "bench", [cases, *answers], SCORES, overwrite=overwrite) as place:
        found = {name: scores_of(cases, path) for name, path in zip(names, answers, strict=True)}
        print(write_scores(found, place), end="")
    print(f"results: {out / SCORES[-1]}")


def _write(settings: Settings, out: Path, where: str, overwrite: bool) -> None:
    print(f"seed {settings.seed}", flush=True)
    changes = {"seed": settings.seed}
    with claim(out, "bench", (), RESULTS, Origin(changes, resume=True), overwrite) as place:
        digest = write_benchmark(settings, place, where, _say)
    print(f"SHA-256 of all that is sealed: {digest}")


def _say(line: str) -> None:
    print(line, flush=True)
