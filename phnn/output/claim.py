"""Claim a folder for the results of one run: no other run, no recordings in it, marked until it is whole."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from filelock import FileLock, Timeout

from phnn.errors import InputRefused, OutputFailed, OutputRefused, PhnnError
from phnn.output.files import PART, finite, refusal, write_atomic
from phnn.output.place import Place
from phnn.output.progress import PROGRESS
from phnn.output.record import FOLDER, Line, Record, foreign, is_empty
from phnn.output.sameness import same

INCOMPLETE = "INCOMPLETE.txt"
_RUN, _LOCK, _PROBE = "run.json", "lock", "probe"
# Bytes that must be free before work is begun: a report with its figures has some 3 MB.
_LEAST_FREE = 8 << 20
_PROBED = 64 << 10
_SCHEMA = "phnn.run/1"


@dataclass(frozen=True)
class Origin:
    """What the results of a run are made of, and whether the run goes on from those of an earlier one.

    Attributes:
        made_of: what decides the results, as hashes of data and settings; the version is added.
        resume: go on from what an earlier run with the same ``made_of`` has left.
        anew: how the user begins anew, for messages.
    """

    made_of: Mapping[str, Any] = field(default_factory=dict)
    resume: bool = False
    anew: str = ""


@contextmanager
def claim(
    out: Path,
    command: str,
    inputs: Sequence[Path] = (),
    results: Sequence[str] = (),
    origin: Origin | None = None,
    overwrite: bool | None = None,
) -> Iterator[Place]:
    """Claim ``out`` for one run; all that the run writes goes through the `Place` that comes back.

    While the run goes on, and after it was cut off, ``INCOMPLETE.txt`` says so. When it ends, ``results`` that an
    earlier run of the same command wrote and this one did not are removed, and the mark goes.

    Args:
        out: folder; made if absent.
        command: what runs, for people.
        inputs: folders of recordings and models; ``out`` may not be one of them, contain one or lie in one.
        results: names directly below ``out`` that the command writes, so that a stranger's file is met at the start.
        origin: what the results are made of; None where nobody can go on from them.
        overwrite: replace results of phnn even where they were changed since; None where the user cannot say so.

    Raises:
        InputRefused: the folder belongs to recordings, to another run or to a stranger, or cannot be written to.
        OutputFailed: the disk is full.
    """
    root, origin = _resolved(out), origin or Origin()
    apart(out, inputs)
    new = not root.exists()
    _prepare(root)
    with _locked(root):
        record = _entered(root, results, overwrite)
        run = {"schema": _SCHEMA, "command": command, "made_of": _complete(origin.made_of)}
        before = _before(root)
        if origin.resume:
            _go_on(out, before, run, origin.anew)
        record.compact()
        place, earlier = Place(root, overwrite=overwrite, by=command, record=record), list(record.lines())
        with _begun(place, run, before, new):
            yield place
        if not origin.resume:
            _forget(place, results, earlier, list(record.lines())[len(earlier) :])
        # A worker that was killed on the way has left half of a file.
        _clean(root)
        _mark(root, {**run, "complete": True})
        (place / INCOMPLETE).remove()


def _entered(root: Path, results: Sequence[str], overwrite: bool | None) -> Record:
    """The record of a folder in which there is room, without halves of files, and without strangers in the way."""
    _probe(root)
    _clean(root)
    record = Record(root)
    record.adopt()
    _met(root, record, results, overwrite)
    return record


@contextmanager
def _begun(place: Place, run: Mapping[str, Any], before: Mapping[str, Any] | None, new: bool) -> Iterator[None]:
    """Mark a run as begun. Where it stops the mark says what was finished, or goes where nothing was."""
    root, record, command = place.root, place.record or Record(place.root), run["command"]
    marked, earlier = (root / INCOMPLETE).exists(), len(list(record.lines()))
    _mark(root, {**run, "complete": False})
    (place / INCOMPLETE).write(_words(command, ()).encode())
    try:
        yield
    except BaseException as error:
        new_lines = list(record.lines())[earlier + 1 :]
        done = [line.name for line in new_lines if PurePosixPath(line.name).name != PROGRESS]
        if isinstance(error, InputRefused) and not done and not marked:
            _undo(place, before, new)
        else:
            _tell(place, _words(command, done))
        raise


@contextmanager
def _locked(root: Path) -> Iterator[None]:
    """Keep other runs out; the lock of a run that was killed is free."""
    lock = FileLock(root / FOLDER / _LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise OutputRefused(
            f"{root}: another run of phnn writes there: wait for its end, or choose another --out"
        ) from error
    except OSError as error:
        raise refusal(root, error) from error
    try:
        yield
    finally:
        lock.release()


def finished(out: Path, command: str, origin: Origin) -> bool:
    """Whether a run of the same command has come to its end in a folder, made of the same.

    Raises:
        InputRefused: what lies there was made of something else.
    """
    root = _resolved(out)
    before = _before(root)
    _go_on(out, before, {"command": command, "made_of": _complete(origin.made_of)}, origin.anew)
    return before is not None and before.get("complete") is True


def _complete(made_of: Mapping[str, Any]) -> dict[str, Any]:
    """With the version, as it comes back from disk."""
    found: dict[str, Any] = json.loads(json.dumps(finite(made_of)))
    return {**found, "version": version("phnn")}


def apart(out: Path, inputs: Sequence[Path]) -> None:
    """Refuse results in a folder of recordings or models.

    Raises:
        InputRefused: ``out`` is one of ``inputs``, contains one or lies in one, links resolved.
    """
    root = _resolved(out)
    for given in inputs:
        place = _resolved(given)
        whole = place.is_dir()
        folder = place if whole else place.parent
        if root == folder or (whole and (root in folder.parents or folder in root.parents)):
            relation = "is" if root == folder else "contains" if root in folder.parents else "lies in"
            raise OutputRefused(
                f"--out {out}: {relation} {folder}, from which this command reads: choose a folder apart from it"
            )


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise OutputRefused(f"{str(path)!r}: is no path that can be used ({error}): choose another") from error


def _prepare(root: Path) -> None:
    if root.exists() and not root.is_dir():
        raise OutputRefused(f"{root}: is a file: name a folder for --out")
    try:
        (root / FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise refusal(root, error) from error
    if (root / FOLDER).is_symlink():
        raise OutputRefused(f"{root / FOLDER}: is a link: remove it, or choose another folder for --out")


def _probe(root: Path) -> None:
    """Find out before the work whether there is room for its results."""
    free = shutil.disk_usage(root).free
    if free < _LEAST_FREE:
        raise OutputRefused(
            f"{root}: only {free / 2**20:.1f} MiB of disk are free, at least {_LEAST_FREE >> 20} are needed: make "
            "room, or choose another folder for --out"
        )
    probe = root / FOLDER / _PROBE
    try:
        write_atomic(probe, bytes(_PROBED))
    except OutputFailed as error:
        raise OutputRefused(str(error)) from error
    finally:
        probe.unlink(missing_ok=True)


def _clean(root: Path) -> None:
    """Remove what a run that was killed has left half written; temporary names are 16 hexadecimal digits."""
    known = Record(root).digests()
    # Folders whose whole content is phnn's stand in the record by their own names.
    folders = {root, root / FOLDER} | {(root / name).parent for name in known} | {root / name for name in known}
    for folder in folders:
        if not folder.is_dir() or folder.resolve() != folder:
            continue
        for part in folder.glob(f".{'[0-9a-f]' * 16}{PART}"):
            part.unlink(missing_ok=True)


def _met(root: Path, record: Record, results: Sequence[str], overwrite: bool | None) -> None:
    """Meet at the beginning what would refuse a result at the end.

    Raises:
        InputRefused: a file or folder with the name of a result that phnn did not write, or that was changed since.
    """
    known = record.digests()
    for result in results:
        path = root / result
        files = [n for n in known if PurePosixPath(n).parts[0] == result]
        if (path.exists() or path.is_symlink()) and not files and not is_empty(path):
            raise foreign(path)
        for name in files:
            record.check(PurePosixPath(name), overwrite, known)


def _before(root: Path) -> dict[str, Any] | None:
    """What the last run in a folder was made of; None where there was none, or its note was damaged."""
    try:
        content = json.loads((root / FOLDER / _RUN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and content.get("schema") == _SCHEMA else None


def _go_on(out: Path, before: Mapping[str, Any] | None, now: Mapping[str, Any], anew: str) -> None:
    """Refuse to go on with what was made of something else."""
    if before is None:
        return
    remedy = "take another --out" + (f", or {anew} to begin anew" if anew else "")
    if before.get("command") != now["command"]:
        raise OutputRefused(f"{out}: holds results of phnn {before.get('command')}: {remedy}")
    same(out, before.get("made_of") or {}, now["made_of"], remedy)


def _mark(root: Path, content: Mapping[str, Any]) -> None:
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    write_atomic(root / FOLDER / _RUN, text.encode())


def _words(command: str, finished: Sequence[str]) -> str:
    done = "".join(f"  {name}\n" for name in dict.fromkeys(finished) if name != INCOMPLETE)
    return (
        f"phnn {command} has begun here and not come to its end: what else lies here may be of an earlier run.\n"
        "Give the same command again.\n" + (f"Finished in this run:\n{done}" if done else "")
    )


def _tell(place: Place, text: str) -> None:
    """Write into the mark what was finished; on a full disk the mark stays as it is."""
    with suppress(PhnnError):
        (place / INCOMPLETE).write(text.encode())


def _undo(place: Place, before: Mapping[str, Any] | None, new: bool) -> None:
    """Leave a folder as it was where a run was refused before it wrote anything; files of others in it stay."""
    (place / INCOMPLETE).remove()
    if before is not None:
        _mark(place.root, before)
    else:
        (place.root / FOLDER / _RUN).unlink(missing_ok=True)
    if new:
        shutil.rmtree(place.root / FOLDER, ignore_errors=True)
        with suppress(OSError):
            place.root.rmdir()


def _forget(place: Place, results: Sequence[str], earlier: Sequence[Line], new: Sequence[Line]) -> None:
    """Remove files that this command wrote in an earlier run and not in this one, if they are as phnn wrote them."""
    kept = {line.name for line in new}
    for line in earlier:
        path = PurePosixPath(line.name)
        if line.by == place.by and line.digest and line.name not in kept and path.parts[0] in results:
            replace(place, name=path).remove()
