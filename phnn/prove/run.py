"""Carry a proof out: make and seal all cases, diagnose them, open the seals, count.

Everything that is finished lies in a file of its own, so that an interrupted proof goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from phnn.demo import Sealed, make_case, open_seal, write_seal
from phnn.effects import catalogue
from phnn.ensemble import executor
from phnn.errors import InputRefused, PhnnError
from phnn.prove.cases import Task, tasks
from phnn.prove.fast import score_folder
from phnn.prove.full import diagnose_folder
from phnn.prove.outcome import Outcome, graded
from phnn.prove.settings import FAST, Settings
from phnn.report.files import write_atomic, write_json

Say = Callable[[str], None]


@dataclass(frozen=True)
class Room:
    """The folders of a proof.

    Attributes:
        out: everything lies below it.
    """

    out: Path

    def recordings(self, task: Task) -> Path:
        """Recordings of a case, until it is diagnosed."""
        return self.out / "recordings" / task.name

    def seal(self, task: Task) -> Path:
        """The sealed answer."""
        return self.out / "sealed" / f"{task.name}.json"

    def answer(self, task: Task) -> Path:
        """What the diagnosis said."""
        return self.out / "answers" / f"{task.name}.json"


def prove(settings: Settings, out: Path, say: Say) -> tuple[list[Outcome], str]:
    """All cases of a proof, graded, in order; and the hash of their seals.

    Args:
        say: called with a line of text: the hash of the seals before the first diagnosis, then progress.

    Raises:
        InputRefused: the folder holds another proof.
    """
    room, todo = Room(out), tasks(settings)
    _claim(room, settings)
    _all(partial(_sealed, room), [t for t in todo if not room.seal(t).exists()], settings, say, "sealed")
    digest = _digest(room, todo)
    say(f"sealed {len(todo)} answers in {out / 'sealed'}; SHA-256 of their SHA-256s, in order: {digest}")
    left = [t for t in todo if not room.answer(t).exists()]
    _all(partial(_answered, room, settings), left, settings, say, "diagnosed")
    if _digest(room, todo) != digest:
        raise PhnnError(f"{out / 'sealed'}: an answer was changed during the diagnosis; begin again in a new folder")
    answers = [json.loads(room.answer(t).read_text(encoding="utf-8")) for t in todo]
    return [graded(t, open_seal(room.seal(t)), a) for t, a in zip(todo, answers, strict=True)], digest


def _claim(room: Room, settings: Settings) -> None:
    """A folder belongs to the settings that decide its cases."""
    room.out.mkdir(parents=True, exist_ok=True)
    path, text = room.out / "proof.json", json.dumps(settings.changes_cases, indent=1) + "\n"
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise InputRefused(f"{path}: another proof was begun here; name a new folder, or repeat its settings")
    write_atomic(path, text.encode())


def _all(work: Callable[[Task], None], todo: Sequence[Task], settings: Settings, say: Say, verb: str) -> None:
    for count, (index, _) in enumerate(executor(settings.executor).each(work, todo), start=1):
        say(f"{verb} {count} of {len(todo)}: {todo[index].name}")


def _sealed(room: Room, task: Task) -> None:
    """Make the recordings of a case; the seal comes last, so that it stands for both."""
    folder = room.recordings(task)
    shutil.rmtree(folder, ignore_errors=True)
    sealed: Sealed = make_case(task.case(), folder)
    write_seal(sealed, room.seal(task))


def _answered(room: Room, settings: Settings, task: Task) -> None:
    """Diagnose a case without a look at its answer, but for what the catalogue must not contain."""
    folder = room.recordings(task)
    try:
        if task.tier == FAST:
            answer: dict[str, Any] = score_folder(folder, settings.seed)
        else:
            options = {"seed": settings.seed, "starts": settings.starts, "max_effects": settings.max_effects}
            report = room.out / "reports" / task.name
            without = containing(open_seal(room.seal(task)).withheld)
            answer = diagnose_folder(folder, report, without, options, settings.keep)
    except PhnnError as error:
        answer = {"failure": str(error)}
    write_json(room.answer(task), answer)
    if not settings.keep:
        shutil.rmtree(folder, ignore_errors=True)


def containing(names: Sequence[str]) -> list[str]:
    """Effects, and those of which one of them is a special case: they would say the same under another name."""
    return [n for n, e in catalogue().items() if n in names or set(names) & set(e.special)]


def _digest(room: Room, todo: Sequence[Task]) -> str:
    """One hash over those of all seals."""
    each = [hashlib.sha256(room.seal(t).read_bytes()).hexdigest() for t in todo]
    return hashlib.sha256("".join(each).encode()).hexdigest()
