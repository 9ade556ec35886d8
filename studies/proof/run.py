"""Carry a proof out: make and seal all cases, diagnose them, open the seals, count.

Everything that is finished lies in a file of its own, so that an interrupted proof goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from phnn.effects import catalogue
from phnn.errors import OutputFailed, OutputRefused, PhnnError
from phnn.parallel import executor
from phnn.results import Origin, Place, claim, write_atomic
from studies.generator import Sealed, make_case, open_seal, write_seal
from studies.proof.cases import Task, tasks
from studies.proof.fast import score_folder
from studies.proof.full import diagnose_folder
from studies.proof.outcome import Outcome, graded
from studies.proof.settings import FAST, Settings

Say = Callable[[str], None]
RESULTS = (
    "recordings", "sealed", "answers", "reports", "cases.csv", "rates.csv", "nulls.csv", "figures", "report.html",
)  # fmt: skip


@dataclass(frozen=True)
class Room:
    """The folders of a proof.

    Attributes:
        place: everything lies below it.
    """

    place: Place

    def recordings(self, task: Task) -> Path:
        """Recordings of a case, until it is diagnosed."""
        return self.place.path / "recordings" / task.name

    def seal(self, task: Task) -> Path:
        """The sealed answer."""
        return self.place.path / "sealed" / f"{task.name}.json"

    def answer(self, task: Task) -> Place:
        """What the diagnosis said."""
        return self.place / "answers" / f"{task.name}.json"

    def report(self, task: Task) -> Place:
        """The report of a case."""
        return self.place / "reports" / task.name


def prove(settings: Settings, place: Place, say: Say) -> tuple[list[Outcome], str]:
    """All cases of a proof, graded, in order; and the hash of their seals.

    Args:
        place: see `claimed`; gets recordings, seals and answers.
        say: called with a line of text: the hash of the seals before the first diagnosis, then progress.

    Raises:
        PhnnError: a seal was changed during the diagnosis.
    """
    room, todo = Room(place), tasks(settings)
    for name in ("recordings", "sealed", "answers"):
        (place / name).own_folder()
    _all(partial(_sealed, room), [t for t in todo if not room.seal(t).exists()], settings, say, "sealed")
    digest = _digest(room, todo)
    say(f"sealed {len(todo)} answers in {place / 'sealed'}; SHA-256 of their SHA-256s, in order: {digest}")
    left = [t for t in todo if not room.answer(t).path.exists()]
    _all(partial(_answered, room, settings), left, settings, say, "diagnosed")
    if not settings.keep:
        # Whoever dies while it removes the recordings of a case leaves the rest of them.
        for task in todo:
            shutil.rmtree(room.recordings(task), ignore_errors=True)
    if _digest(room, todo) != digest:
        raise PhnnError(f"{place / 'sealed'}: an answer was changed during the diagnosis; begin again in a new folder")
    answers = [json.loads(room.answer(t).path.read_text(encoding="utf-8")) for t in todo]
    return [graded(t, open_seal(room.seal(t)), a) for t, a in zip(todo, answers, strict=True)], digest


def claimed(out: Path, settings: Settings, overwrite: bool = False) -> AbstractContextManager[Place]:
    """Claim a folder for a proof; one that was begun there goes on if the same settings decide its cases."""
    return claim(out, "prove", (), RESULTS, Origin(settings.changes_cases, resume=True), overwrite)


def _all(work: Callable[[Task], None], todo: Sequence[Task], settings: Settings, say: Say, verb: str) -> None:
    for count, (index, _) in enumerate(executor(settings.executor).each(work, todo), start=1):
        say(f"{verb} {count} of {len(todo)}: {todo[index].name}")


def _sealed(room: Room, task: Task) -> None:
    """Make the recordings of a case; the seal comes last, so that it stands for both.

    A cluster may ask a second time for what a worker finished before it died: then there is nothing to do.
    """
    if room.seal(task).exists():
        return
    folder = room.recordings(task)
    shutil.rmtree(folder, ignore_errors=True)
    sealed: Sealed = make_case(task.case(), folder, write_atomic)
    write_seal(sealed, room.seal(task), write_atomic)


def _answered(room: Room, settings: Settings, task: Task) -> None:
    """Diagnose a case without a look at its answer, but for what the catalogue must not contain.

    Asked a second time, as `_sealed` may be, it leaves the answer alone: the recordings may be gone by then.
    """
    if room.answer(task).path.exists():
        return
    folder = room.recordings(task)
    try:
        if task.tier == FAST:
            answer: dict[str, Any] = score_folder(folder, settings.seed)
        else:
            options = {"seed": settings.seed, "starts": settings.starts, "max_effects": settings.max_effects}
            without = containing(open_seal(room.seal(task)).withheld)
            answer = diagnose_folder(folder, room.report(task), without, options, settings.keep)
    except (OutputFailed, OutputRefused):
        raise
    except PhnnError as error:
        answer = {"failure": str(error)}
    room.answer(task).write_json(answer)
    if not settings.keep:
        shutil.rmtree(folder, ignore_errors=True)


def containing(names: Sequence[str]) -> list[str]:
    """Effects, and those of which one of them is a special case: they would say the same under another name."""
    return [n for n, e in catalogue().items() if n in names or set(names) & set(e.special_names)]


def _digest(room: Room, todo: Sequence[Task]) -> str:
    """One hash over those of all seals."""
    each = [hashlib.sha256(room.seal(t).read_bytes()).hexdigest() for t in todo]
    return hashlib.sha256("".join(each).encode()).hexdigest()
