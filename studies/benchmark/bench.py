"""Sealed cases for tools of diagnosis: what is concealed, the folders, and the answers of a tool.

    bench.json                          version, names of the cases, hash of cases and seals
    cases/NAME/*.csv, recordings.yaml   what is known: inputs and outputs
    cases/NAME/exam/*.csv, …            inputs whose outputs are to be predicted
    sealed/NAME/seal.json, *.csv        what was concealed, and the outputs of the examination
    sealed/settings.json                seed and numbers of cases, from which everything follows

A tool sees what is not sealed. Its answer to a case is ``answer.json``, and a table with a prediction for each
recording of the examination:

    {"schema": "phnn.answer/1", "names": {"creep": 0.8, "extra_hysteron": 0.1}, "none": 0.05, "unlisted": 0.05,
     "places": ["mechanical"], "seconds": 41.0}

``names`` holds the probability of each effect that it is missing, ``none`` that nothing is missing, ``unlisted`` that
something is missing which the list of effects does not have. Several effects may be missing at once, so that the
probabilities need not add up to one. ``places`` holds the locations of what is missing.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import count, product
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from omegaconf import OmegaConf

import phnn
from phnn.configuration import check, whole
from phnn.effects import catalogue
from phnn.effects.kinds import LOCATIONS
from phnn.errors import InputRefused, SolverFailed, meant
from phnn.intake import LIMITS, load_json, named_file
from phnn.parallel import executor
from phnn.results import Place, write_atomic
from studies.benchmark.tools import Tool, tool
from studies.generator import Case, Conditions, Sealed, draw_case, make_case, open_seal, write_seal
from studies.generator.plans import EXAM
from studies.generator.seal import MANIFEST
from studies.proof.cases import seed_of

Array = NDArray[np.float64]
Say = Callable[[str], None]

# Kinds of cases. A background is physics that acts beside what is concealed and leaves less than the noise.
GROUPS = ("none", "same", "other", "outside", "pair", "background")
# Residual over noise that the effect alone leaves beyond a refit of the base model.
STRENGTHS = {"weak": (1.5, 3.0), "medium": (3.0, 6.0), "strong": (6.0, 20.0)}
# Sets of recordings, with the names that the generator gives them: a single sweep, four recordings, twelve.
PLANS = {"one": "one", "four": "short", "twelve": "demo"}
# Distance of seeds, a prime: choices go round with the seed, and neighbours among them share an effect.
_APART = 7919
# Noise of the cases with nothing concealed.
NOISES = ("white", "first_order", "process:0.1", "pink:0.1", "heavy", "quantised", "jittered")

SCHEMA, ANSWER_SCHEMA = "phnn.bench/1", "phnn.answer/1"
RESULTS, ANSWERS = ("bench.json", "cases", "sealed"), ("answers", "tool.json")
OUTPUT = "displacement_um"
ANSWER, TOOL_CARD = "answer.json", "tool.json"
# A probability of at least this is a claim.
CLAIMED = 0.5
NONE, UNLISTED = "none", "unlisted"
_KEYS = ("schema", "names", "none", "unlisted", "places", "seconds", "failed")
_TOOL_SEED = 0  # of everything that a tool draws
_REPEAT = 1.0  # processor seconds after which an interruption that was lost comes again


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/bench.yaml``.

    Attributes:
        seed: every case follows from it and its own number.
        none: cases with nothing concealed, in turn under noise of each family.
        same, other: cases with one listed effect, in the form of the catalogue or in another form.
        outside: cases with an effect that no catalogue lists.
        pair: cases with two listed effects.
        background: cases with one listed effect beside a background.
    """

    seed: int = whole(1)
    none: int = whole(9)
    same: int = whole(27)
    other: int = whole(9)
    outside: int = whole(9)
    pair: int = whole(9)
    background: int = whole(9)

    def __post_init__(self) -> None:
        check(self)
        if not any(getattr(self, group) for group in GROUPS):
            raise InputRefused("no cases: give numbers of cases, 0 or more, not all 0")


@dataclass(frozen=True)
class Entry:
    """One case.

    Attributes:
        name: of its folders; it does not tell the group.
        group: one of `GROUPS`; seed: of the case.
        strength, plan: one of `STRENGTHS` and of `PLANS`; noise: one of `NOISES`, empty for that of the seed.
    """

    name: str
    group: str
    seed: int
    strength: str
    plan: str
    noise: str = ""

    def case(self) -> Case:
        """Draw what is concealed; everything follows from the seed."""
        stratum = "same" if self.group == "background" else self.group
        conditions = Conditions(background=self.group == "background")
        return draw_case(
            self.seed, stratum, f"{PLANS[self.plan]}_exam", STRENGTHS[self.strength], noise=self.noise or None,
            conditions=conditions,
        )  # fmt: skip


def entries(settings: Settings) -> list[Entry]:
    """List all cases, in an order that does not tell their groups."""
    drawn: list[tuple[str, int, str, str, str]] = []
    for group in GROUPS:
        seeds = _seeds(settings.seed, group, getattr(settings, group))
        for number, (seed, (strength, plan)) in enumerate(zip(seeds, _mixed(settings.seed, group), strict=False)):
            drawn.append((group, seed, strength, plan, NOISES[number % len(NOISES)] if group == "none" else ""))
    order = np.random.default_rng(np.random.SeedSequence([settings.seed, 1])).permutation(len(drawn))
    return [Entry(f"case_{i:03d}", *drawn[k]) for i, k in enumerate(order)]


def _mixed(seed: int, group: str) -> Iterator[tuple[str, str]]:
    """Yield strengths and plans, each pair of them once before any comes again, in orders that are drawn."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 2, GROUPS.index(group)]))
    every = list(product(STRENGTHS, PLANS))
    while True:
        yield from (every[k] for k in rng.permutation(len(every)))


def _seeds(seed: int, group: str, number: int) -> list[int]:
    """Return seeds far apart, so that effects take turns in another order than that of their list.

    Seeds of the group outside that would withhold a name from the catalogue are left out: a tool from elsewhere has a
    list of its own, from which no name can be taken away.
    """
    first = seed_of(seed, f"bench {group}", 0)
    candidates = (s for s in count(first, _APART) if group != "outside" or not draw_case(s, group, "short").withheld)
    return [next(candidates) for _ in range(number)]


def write_benchmark(settings: Settings, place: Place, where: str, say: Say) -> str:
    """Make and seal all cases, and return the hash of all files; a case that has its seal is not made again.

    Args:
        place: claimed for the benchmark; where: see `phnn.parallel.executor`; say: called with a line of progress.
    """
    cases = entries(settings)
    for name in ("cases", "sealed"):
        (place / name).own_folder()
    todo = [e for e in cases if not (place / "sealed" / e.name / "seal.json").path.exists()]
    for number, _ in enumerate(executor(where).each(partial(_make, place), todo), start=1):
        say(f"made {number} of {len(todo)}")
    if not (place / "sealed" / "settings.json").path.exists():
        (place / "sealed" / "settings.json").write_json(asdict(settings))
    names = [e.name for e in cases]
    digest = digest_of(place.path, names)
    content = {"schema": SCHEMA, "generator": phnn.__version__, "cases": names, "sha256": digest}
    (place / "bench.json").write_json(content)
    return digest


def _make(place: Place, entry: Entry) -> None:
    """Make a case; its seal is written last, so that a seal means a whole case."""
    known, sealed = (place / "cases" / entry.name).path, (place / "sealed" / entry.name).path
    for folder in (known, sealed):
        shutil.rmtree(folder, ignore_errors=True)
    answer = make_case(entry.case(), known, write_atomic)
    exam = known / "exam"
    exam.mkdir()
    sealed.mkdir()
    for path in sorted(known.glob(f"{EXAM}*.csv")):
        table = pd.read_csv(path)
        write_atomic(sealed / path.name, table.to_csv(index=False).encode())
        write_atomic(exam / path.name, table.drop(columns=OUTPUT).to_csv(index=False).encode())
        path.unlink()
    manifest: Any = OmegaConf.to_container(OmegaConf.load(known / MANIFEST))
    for folder, is_exam in ((known, False), (exam, True)):
        recordings = [r for r in manifest["recordings"] if r["file"].startswith(EXAM) is is_exam]
        write_atomic(folder / MANIFEST, OmegaConf.to_yaml({**manifest, "recordings": recordings}).encode())
    write_atomic(sealed / "entry.json", (json.dumps(asdict(entry), indent=1) + "\n").encode())
    write_seal(answer, sealed / "seal.json", write_atomic)


def digest_of(folder: Path, names: Sequence[str]) -> str:
    """Return one hash over all files of some cases and their seals, in their order.

    Raises:
        InputRefused: the files of a case are absent.
    """
    each = []
    for home in (folder / kind / name for name in names for kind in ("cases", "sealed")):
        if not home.is_dir():
            raise InputRefused(f"{home}: there is no such folder: a case cannot be scored without all that was written")
        files = sorted(path for path in home.rglob("*") if path.is_file())
        each += [f"{path.relative_to(folder)} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files]
    return hashlib.sha256("\n".join(each).encode()).hexdigest()


def card_of(folder: Path) -> dict[str, Any]:
    """Read ``bench.json``.

    Raises:
        InputRefused: the folder is no benchmark.
    """
    remedy = "give the folder that scripts/bench.py write has written"
    return _document(folder / "bench.json", SCHEMA, "a benchmark", remedy)


def _document(path: Path, schema: str, what: str, remedy: str) -> dict[str, Any]:
    """Read a json file of a schema. Raises InputRefused where it is absent, damaged or of another schema."""
    content = load_json(named_file(path, (path.parent,), "", remedy), LIMITS.json_bytes, what, remedy)
    if not isinstance(content, dict) or content.get("schema") != schema:
        raise InputRefused(f"{path}: is no {schema} file: {remedy}")
    return content


def opened(folder: Path, name: str) -> tuple[Entry, Sealed, dict[str, pd.DataFrame]]:
    """Open a case: its entry, its seal, and the tables of its examination by recording.

    Raises:
        InputRefused: the seal is absent or damaged.
    """
    home = folder / "sealed" / name
    sealed = open_seal(home / "seal.json")
    entry = Entry(**json.loads((home / "entry.json").read_text(encoding="utf-8")))
    return entry, sealed, {path.stem: pd.read_csv(path) for path in sorted(home.glob("*.csv"))}


@dataclass(frozen=True)
class Answer:
    """The answer of a tool to a case.

    Attributes:
        names: probability of each effect that it is missing; none: that nothing is; unlisted: that something is which
            has no name.
        places: locations of what is missing, the most probable one first.
        predictions: (N,) displacement [m] by recording of the examination.
        seconds: of the processor.
        failed: why the tool has no answer; empty where it has one.
    """

    names: Mapping[str, float]
    none: float = 0.0
    unlisted: float = 0.0
    places: tuple[str, ...] = ()
    predictions: Mapping[str, Array] = field(default_factory=dict, compare=False)
    seconds: float = math.nan
    failed: str = ""

    def __post_init__(self) -> None:
        known = catalogue()
        for name in self.names:
            if name not in known:
                raise InputRefused(f"an answer names {name!r}{meant(name, known)}: the list has {', '.join(known)}")
        for name, value in self.probabilities.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise InputRefused(f"an answer gives {name} the probability {value}: give a number from 0 to 1")
        for place in self.places:
            if place not in LOCATIONS:
                raise InputRefused(f"an answer has the place {place!r}: there are {', '.join(LOCATIONS)}")

    @property
    def probabilities(self) -> dict[str, float]:
        """All that is stated: of names, and under `NONE` and `UNLISTED`."""
        return {**self.names, NONE: self.none, UNLISTED: self.unlisted}

    @property
    def claims(self) -> frozenset[str]:
        """What is claimed: names, `NONE`, `UNLISTED`."""
        return frozenset(name for name, p in self.probabilities.items() if p >= CLAIMED)

    def first(self, number: int) -> frozenset[str]:
        """Return the most probable of all that is stated; empty where that is not unique."""
        ordered = sorted(self.probabilities.items(), key=lambda item: -item[1])
        chosen = ordered[:number]
        tied = len(ordered) > number and ordered[number][1] >= chosen[-1][1]
        return frozenset() if tied or chosen[-1][1] == 0.0 else frozenset(name for name, _ in chosen)


def write_answer(answer: Answer, place: Place, times: Mapping[str, Array]) -> None:
    """Write an answer into a folder; ``answer.json`` comes last.

    Args:
        times: (N,) [s] of the recordings of the examination.
    """
    for name, y in answer.predictions.items():
        table = pd.DataFrame({"time_s": times[name], OUTPUT: 1e6 * np.asarray(y)})
        (place / f"{name}.csv").write(table.to_csv(index=False).encode())
    stated = {"names": dict(answer.names), "none": answer.none, "unlisted": answer.unlisted}
    content = {"schema": ANSWER_SCHEMA, **stated, "places": list(answer.places), "seconds": answer.seconds}
    (place / ANSWER).write_json(content | ({"failed": answer.failed} if answer.failed else {}))


def read_answer(folder: Path) -> Answer:
    """Read an answer.

    Raises:
        InputRefused: it is absent, damaged, or says what no answer can; names file and value.
    """
    path = folder / ANSWER
    content = _document(path, ANSWER_SCHEMA, "an answer", f"give a folder with an {ANSWER} for each case")
    unknown = [key for key in content if key not in _KEYS]
    if unknown:
        raise InputRefused(f"{path}: unknown key {unknown[0]!r}{meant(unknown[0], _KEYS)}")
    names, places, seconds = content.get("names", {}), content.get("places", []), content.get("seconds")
    if not isinstance(names, dict) or not isinstance(places, list):
        raise InputRefused(f"{path}: names must be an object of numbers, places a list of words")
    try:
        return Answer(
            names, content.get("none", 0.0), content.get("unlisted", 0.0), tuple(places), _predictions(folder),
            float(seconds) if isinstance(seconds, int | float) and not isinstance(seconds, bool) else math.nan,
            str(content.get("failed", "")),
        )  # fmt: skip
    except InputRefused as error:
        raise InputRefused(f"{path}: {error}") from error


def _predictions(folder: Path) -> dict[str, Array]:
    predicted = {}
    for path in sorted(folder.glob("*.csv")):
        try:
            values = pd.read_csv(named_file(path, (folder,)).path)[OUTPUT].to_numpy(dtype=float)
        except (ValueError, KeyError) as error:
            raise InputRefused(f"{path.name}: no numbers in a column {OUTPUT} ({error})") from error
        predicted[path.stem] = 1e-6 * values
    return predicted


def answer_all(
    folder: Path, name: str, place: Place, where: str, say: Say, first: int | None = None, limit: float | None = None
) -> None:
    """Let a tool answer all cases of a benchmark; what was answered before is kept.

    Args:
        folder: of the benchmark; name: of the tool.
        place: claimed for the answers; where: see `phnn.parallel.executor`; say: called with a line of progress.
        first: so many cases alone; all if left out.
        limit: processor seconds of one case, after which the tool has no answer to it; None for as many as it takes.

    Raises:
        InputRefused: no benchmark, no such tool, or an executor that cannot keep a limit.
    """
    card = card_of(folder)
    (place / TOOL_CARD).write_json({"tool": name, "seed": _TOOL_SEED, "sha256": card["sha256"], "limit": limit})
    todo = [c for c in card["cases"][:first] if not (place / "answers" / c / ANSWER).path.exists()]
    work = partial(_answered, folder, partial(tool, name), place, limit)
    for number, (index, failed) in enumerate(executor(where).each(work, todo), start=1):
        say(f"{name}: {number} of {len(todo)}, {todo[index]}" + (f": no answer, {failed}" if failed else ""))


def _answered(folder: Path, load: Callable[[], Tool], place: Place, limit: float | None, case: str) -> str:
    """Answer one case; return why the tool has no answer, empty where it has one."""
    known, answers, began = folder / "cases" / case, load(), time.process_time()
    try:
        with limited(limit):
            answer = answers(known, _TOOL_SEED)
    except SolverFailed as error:
        # Any other error is a fault of the tool's code, which ends the run.
        answer = Answer({}, failed=str(error))
    exam = sorted((known / "exam").glob("*.csv"))
    times = {path.stem: pd.read_csv(path)["time_s"].to_numpy(dtype=float) for path in exam}
    write_answer(replace(answer, seconds=time.process_time() - began), place / "answers" / case, times)
    return answer.failed


class _OutOfTime(BaseException):
    """Passes every handler that goes on after an error."""


def _out_of_time(signum: int, frame: FrameType | None) -> None:
    raise _OutOfTime


@contextmanager
def limited(seconds: float | None) -> Iterator[None]:
    """Give up what is inside after so many seconds of this process's processor time; None sets no limit.

    Compiled code is interrupted when it returns.

    Raises:
        SolverFailed: the time is over.
        InputRefused: this is a thread, or a system without such a clock (``setitimer``).
    """
    if seconds is None:
        yield
        return
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        raise InputRefused(f"limit {seconds:g} s: needs processes of their own on Linux or macOS: --executor processes")
    before = signal.signal(signal.SIGPROF, _out_of_time)
    # An exception is lost where Python cannot pass it on, in a destructor for one: it comes again.
    signal.setitimer(signal.ITIMER_PROF, seconds, _REPEAT)
    try:
        yield
    except _OutOfTime:
        raise SolverFailed(f"stopped after {seconds:g} processor seconds, the limit of a case") from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
