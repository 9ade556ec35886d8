"""``phnn bench``: make sealed cases, let a tool answer them, score answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from phnn.commands.terminal import Config
from phnn.errors import InputRefused
from phnn.results import Origin, claim
from studies.benchmark.fingerprints.settings import TrainSettings
from studies.benchmark.fingerprints.training import TABLE, TRAINING, VALIDATION, digest, train
from studies.benchmark.fingerprints.validation import validated
from studies.benchmark.folders import RESULTS, card_of, write_benchmark
from studies.benchmark.run import ANSWERS, SCORES, answer_all, scores_of, write_scores
from studies.benchmark.settings import Settings
from studies.benchmark.tools import tool

# By step: the options that it needs, and the settings that it takes. An answer may take a training.
_TAKES = {"write": (), "train": (), "answer": ("cases", "tool"), "score": ("cases", "answers")}
_SETTINGS = {"write": Settings.__dataclass_fields__, "train": TrainSettings.__dataclass_fields__}
_FIRST = ("answer", "score")
_LONGEST = 1e7  # seconds


def bench(step: str, out: Path, config: Config, options: Mapping[str, Any], overwrite: bool = False) -> None:
    """Carry out one step of a benchmark.

    Args:
        step: ``write`` makes and seals cases in ``out``; ``train`` makes what the tools of
            `studies.benchmark.tools.TRAINED` learn from; ``answer`` lets a tool answer cases; ``score`` opens
            their seals and scores answers.
        config: settings of ``write`` and of ``train``.
        options: ``cases``: what ``write`` has written; ``tool``: its name; ``training``: what ``train`` has written;
            ``answers``: folders with those of tools; ``first``: so many cases alone, None for all; ``limit``:
            processor seconds that a tool has for a case, None for no limit; ``executor``: see `phnn.parallel.executor`.

    Raises:
        InputRefused: an option that a step does not take, or lacks.
    """
    for name in ("cases", "tool", "answers"):
        if (name in _TAKES[step]) is (options[name] is None):
            raise InputRefused(f"phnn bench {step} {'needs' if options[name] is None else 'does not take'} --{name}")
    first = options["first"]
    if first is not None and (step not in _FIRST or first < 1):
        raise InputRefused(f"--first {first}: {' and '.join(_FIRST)} take a number of cases, 1 or more")
    limit = options["limit"]
    if limit is not None and (step != "answer" or not 0.0 < limit <= _LONGEST):
        raise InputRefused(
            f"--limit {limit:g}: answer alone takes it, processor seconds above 0 and up to {_LONGEST:g}"
        )
    if options["training"] is not None and step != "answer":
        raise InputRefused(f"phnn bench {step} does not take --training")
    _refuse_settings(step, options["typed"])
    if step == "write":
        _write(Settings.from_config(config), out, options["executor"], overwrite)
    elif step == "train":
        _train(TrainSettings.from_config(config), out, options["executor"], overwrite)
    elif step == "answer":
        _answer(options, out, overwrite)
    else:
        _score(options["cases"], options["answers"], out, first, overwrite)


def _refuse_settings(step: str, typed: Sequence[str]) -> None:
    every = {name for fields in _SETTINGS.values() for name in fields}
    for word in typed:
        name = word.partition("=")[0]
        if name in every and name not in _SETTINGS.get(step, ()):
            of = "write and train" if step not in _SETTINGS else next(s for s, f in _SETTINGS.items() if name in f)
            raise InputRefused(f"phnn bench {step} does not take {word}: settings are those of {of}")


def _answer(options: Mapping[str, Any], out: Path, overwrite: bool) -> None:
    cases, chosen, training = options["cases"], options["tool"], options["training"]
    tool(chosen, training)  # refuses an unknown one now
    origin = {"tool": chosen, "benchmark": card_of(cases)["sha256"]}
    # A case that had no answer within a shorter limit may have one within this.
    if options["limit"] is not None:
        origin["limit"] = f"{options['limit']:g}"
    if training is not None:
        origin["training"] = digest(training)
    inputs = [cases, *([training] if training is not None else [])]
    with claim(out, "bench", inputs, ANSWERS, Origin(origin, resume=True), overwrite) as place:
        answer_all(cases, chosen, place, options["executor"], _say, options["first"], training, options["limit"])
    print(f"answers: {out / ANSWERS[0]}")


def _train(settings: TrainSettings, out: Path, where: str, overwrite: bool) -> None:
    print(f"seed {settings.seed}", flush=True)
    # A larger training goes on from a smaller one.
    with claim(out, "bench", (), TRAINING, Origin({"seed": settings.seed}, resume=True), overwrite) as place:
        table = train(settings.seed, settings.size, place, where, _say)
        figures = validated(table, settings.seed)
        (place / VALIDATION).write(figures.to_csv(index=False).encode())
    print(figures[figures["of"] == "all"].to_string(index=False))
    print(f"training: {out / TABLE}")


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
