"""Carry a proof out: make and seal all cases, diagnose them, open the seals, count.

    cases → sealed → diagnosed (score stage, or the whole command) → opened → graded → counted → shown

Everything that is finished lies in a file of its own, so that an interrupted proof goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from phnn.criteria import Criteria
from phnn.diagnose.diagnosis import available, diagnose
from phnn.diagnose.linearised import TIE, prepare
from phnn.diagnose.screen import Screen, chance
from phnn.effects import catalogue
from phnn.errors import OutputFailed, OutputRefused, PhnnError
from phnn.identification.options import Options
from phnn.identification.prepare import identification_plan
from phnn.identification.refinement import with_bounded_error
from phnn.identification.staged import fit_identified, held_by_statement
from phnn.models.actuator import from_paper
from phnn.models.store import load
from phnn.parallel import executor
from phnn.recordings import read
from phnn.report.result import write_into
from phnn.results import Origin, Place, claim, finite, write_atomic
from phnn.setup import Setup
from studies.generator import make_case, open_seal, write_seal
from studies.proof.cases import FAST, Settings, Task, tasks
from studies.proof.grade import Outcome, graded

Say = Callable[[str], None]
RESULTS = (
    "recordings", "sealed", "answers", "reports", "cases.csv", "rates.csv", "nulls.csv", "figures", "report.html",
)  # fmt: skip


@dataclass(frozen=True)
class Room:
    """The folders of a proof, all below ``place``."""

    place: Place

    def recordings(self, task: Task) -> Path:
        """Return the folder of a case's recordings, which stay until it is diagnosed."""
        return self.place.path / "recordings" / task.name

    def seal(self, task: Task) -> Path:
        """Return the file of the sealed answer."""
        return self.place.path / "sealed" / f"{task.name}.json"

    def answer(self, task: Task) -> Place:
        """Return the file with what the diagnosis said."""
        return self.place / "answers" / f"{task.name}.json"


def prove(settings: Settings, place: Place, say: Say) -> tuple[list[Outcome], str]:
    """Return all cases of a proof, graded, in order; and the hash of their seals.

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
    write_seal(make_case(task.case(), folder, write_atomic), room.seal(task), write_atomic)


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
            answer = diagnose_folder(folder, room.place / "reports" / task.name, without, options, settings.keep)
    except (OutputFailed, OutputRefused):
        raise
    except PhnnError as error:
        answer = {"failure": str(error)}
    room.answer(task).write_json(answer)
    if not settings.keep:
        shutil.rmtree(folder, ignore_errors=True)


def containing(names: Sequence[str]) -> list[str]:
    """Return effects, and those of which one of them is a special case: they say the same under another name."""
    return [n for n, e in catalogue().items() if n in names or set(names) & set(e.special_names)]


def _digest(room: Room, todo: Sequence[Task]) -> str:
    """Return one hash over those of all seals."""
    each = [hashlib.sha256(room.seal(t).read_bytes()).hexdigest() for t in todo]
    return hashlib.sha256("".join(each).encode()).hexdigest()


def score_folder(folder: Path, seed: int) -> dict[str, Any]:
    """Fit the base model from the published values and score; return as much of ``diagnosis.json`` as that gives."""
    began = time.monotonic()
    campaign = read(folder)
    options = Options(seed=seed, workers=1)
    network = from_paper().with_values({n: a.value for n, a in campaign.known.items()})
    first = fit_identified(
        Setup(network), identification_plan(campaign, 1), held_by_statement(campaign.known), max_evaluations=30
    )
    base, error = with_bounded_error(first, options.error_bound_sigma)
    linearised, criteria = prepare(base), Criteria()
    candidates = Screen(linearised, available(campaign, base.setup), criteria)(linearised)
    best = max(candidates, key=lambda c: c.score)
    members = [c.effect for c in candidates if candidates[0].fall - c.fall < TIE and c.fall > 0.0]
    missing = []
    if best.score > criteria.score and members:
        named, *others = members
        missing = [{"effect": named.name, "location": named.location, "equivalent_to": [e.name for e in others]}]
    return {
        "verdict": "named" if missing else "none",
        "test": {
            "statistic": best.score,
            "p_value": chance(best.score, candidates),
            "candidate": best.effect.name,
        },
        "missing": missing,
        "base_residual_over_noise": base.chi2**0.5,
        "numerical_error_sigma": error.sigma,
        "seconds": time.monotonic() - began,
    }


def diagnose_folder(
    folder: Path, place: Place, without: Sequence[str], settings: dict[str, Any], keep: bool
) -> dict[str, Any]:
    """Run the whole diagnosis of a folder; return ``diagnosis.json``, both models' parameters and the estimates.

    Args:
        without: catalogue entries that the diagnosis must not use.
        settings: of ``phnn diagnose``.
        keep: keep report and models.
    """
    options = Options.from_config(settings | {"without": list(without), "workers": 1})
    place.own_folder()
    diagnosis = diagnose(read(folder), options)
    write_into(diagnosis, place)
    content: dict[str, Any] = json.loads((place / "diagnosis.json").path.read_text(encoding="utf-8"))
    content["models"] = {name: load((place / name).path)[0].values() for name in ("base", "model")}
    final = diagnosis.final
    content["estimates"] = {
        n: {
            "value": final.setup.parameters[n].value,
            "std": finite(std),
            "interval_95": final.interval(n),
            "interval_95_anchors_exact": final.interval(n, anchored=False),
        }
        for n, std in final.std().items()
    }
    if not keep:
        place.remove()
    return content
