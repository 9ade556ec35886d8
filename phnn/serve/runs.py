"""The runs below a folder: what each one was, how far it is, and its main numbers."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.intake.json_file import load_json
from phnn.intake.names import printable
from phnn.output import PROGRESS
from phnn.output.claim import INCOMPLETE
from phnn.report.formatting import finite

# A folder is a run where it holds one of these, or the progress of one.
MARKS = {
    "diagnosis.json": "diagnose",
    "identify.json": "identify",
    "predict.json": "predict",
    "compare.json": "compare",
    "modes.json": "modes",
    "rates.csv": "prove",
}
_PAGES = ("report.html", "compare.md", "predict.json", "identify.json")
# A tree that is deeper or has more runs is not searched to its end.
_DEEPEST, _MOST = 8, 500
_JSON_BYTES = 16 << 20


@dataclass(frozen=True)
class Step:
    """A line of progress and when it was said."""

    at: datetime
    text: str


@dataclass(frozen=True)
class Run:
    """Attributes:
    name: of the folder, below the one that is served; ``.`` for that one itself.
    kind: the command; complete: it has come to its end; page: what to open first, empty where there is nothing yet.
    steps: lines of progress of a run that has not come to its end.
    verdict, missing: of a diagnosis.
    before, after: residual over noise by recording; held_out: names of recordings that were held out.
    parameters: value and unit by name, of the final model.
    changed: when the folder was last written to.
    """

    name: str
    kind: str
    complete: bool
    page: str
    changed: datetime
    steps: tuple[Step, ...] = ()
    verdict: str = ""
    missing: tuple[str, ...] = ()
    before: Mapping[str, float | None] = field(default_factory=dict)
    after: Mapping[str, float | None] = field(default_factory=dict)
    held_out: tuple[str, ...] = ()
    parameters: Mapping[str, tuple[float | None, str]] = field(default_factory=dict)

    def worst(self, which: str) -> float | None:
        """Largest residual over noise ``before`` or ``after``: on held-out recordings, or on all where none was."""
        scores = self.before if which == "before" else self.after
        names = [n for n in self.held_out if n in scores] or list(scores)
        return max((v for n in names if (v := scores[n]) is not None), default=None)


def find_runs(root: Path) -> list[Run]:
    """All runs below a folder, the last one first. Links to folders and hidden folders are not followed."""
    found = []
    for folder, names, files in os.walk(root):
        here = Path(folder)
        deep = len(here.relative_to(root).parts)
        names[:] = sorted(n for n in names if not n.startswith(".")) if deep < _DEEPEST else []
        if {*MARKS, PROGRESS, INCOMPLETE} & set(files):
            # It went meanwhile, may not be read, or has a time that no calendar holds.
            with suppress(OSError, ValueError, OverflowError):
                found.append(read_run(root, here))
        if len(found) == _MOST:
            break
    return sorted(found, key=lambda run: run.changed, reverse=True)


def read_run(root: Path, folder: Path) -> Run:
    """One run; where a file cannot be read, its values are empty.

    Args:
        root: the folder that is served; folder: below it.
    """
    kind = next((k for file, k in MARKS.items() if (folder / file).is_file()), "")
    progress = _json(root, folder / PROGRESS)
    results = (
        _diagnosis(root, folder) if kind == "diagnose" else _identified(root, folder) if kind == "identify" else {}
    )
    return Run(
        name=folder.relative_to(root).as_posix(),
        kind=kind or printable(str(progress.get("command") or "")),
        complete=bool(kind) and not any((folder / mark).exists() for mark in (INCOMPLETE, PROGRESS)),
        page=next((p for p in _PAGES if (folder / p).is_file()), ""),
        changed=_changed(folder),
        steps=_steps(progress),
        **results,
    )


def _changed(folder: Path) -> datetime:
    """When the last file directly in a folder was written; a time in the future counts as now."""
    times = [folder.stat().st_mtime]
    for entry in os.scandir(folder):
        if entry.is_file(follow_symlinks=False):
            times.append(entry.stat().st_mtime)  # noqa: PERF401
    return datetime.fromtimestamp(min(max(times), time.time())).astimezone()


def _json(root: Path, path: Path) -> Mapping[str, Any]:
    """A mapping from a file below ``root``; empty where there is none, or none that can be read."""
    try:
        content = load_json(named_file(path, (root,)), _JSON_BYTES, "results", "run the command again")
    except InputRefused:
        return {}
    return content if isinstance(content, dict) else {}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _steps(progress: Mapping[str, Any]) -> tuple[Step, ...]:
    found = []
    steps = progress.get("steps")
    for entry in steps if isinstance(steps, list) else []:
        try:
            found.append(Step(datetime.fromisoformat(str(entry["at"])).astimezone(), printable(str(entry["text"]))))
        except (TypeError, KeyError, ValueError, OverflowError):
            continue
    return tuple(found)


def _scores(table: Any) -> dict[str, float | None]:
    return {printable(str(n)): finite(_mapping(s).get("residual_over_noise")) for n, s in _mapping(table).items()}


def _diagnosis(root: Path, folder: Path) -> dict[str, Any]:
    content = _json(root, folder / "diagnosis.json")
    fit, missing = _mapping(content.get("fit")), content.get("missing")
    held = fit.get("held_out")
    return {
        "verdict": printable(str(content.get("verdict") or "")),
        "missing": tuple(
            printable(str(_mapping(m).get("effect"))) for m in (missing if isinstance(missing, list) else [])
        ),
        "before": _scores(fit.get("before")),
        "after": _scores(fit.get("after")),
        "held_out": tuple(printable(str(n)) for n in (held if isinstance(held, list) else [])),
        "parameters": _parameters(_json(root, folder / "model" / "model.json")),
    }


def _identified(root: Path, folder: Path) -> dict[str, Any]:
    content = _json(root, folder / "identify.json")
    return {"before": _scores(content.get("fit")), "parameters": _parameters(content)}


def _parameters(content: Mapping[str, Any]) -> dict[str, tuple[float | None, str]]:
    """Values and units of the parameters of a stored model, of its network and of its blocks."""
    both = {**_mapping(content.get("parameters")), **_mapping(content.get("block_parameters"))}
    return {
        printable(str(n)): (finite(_mapping(p).get("value")), printable(str(_mapping(p).get("unit") or "")))
        for n, p in both.items()
    }
