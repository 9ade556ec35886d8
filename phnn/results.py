"""Results of a command: one folder for one run, whole files, names that cannot leave the folder.

    with claim(out, "predict", [recordings], ("predict.json",)) as place:
        (place / "predict.json").write_json(content)

``.phnn/manifest.json`` lists what phnn wrote into the folder, so that it replaces and removes no other file.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from numbers import Integral, Real
from pathlib import Path, PurePosixPath
from typing import Any

from filelock import FileLock, Timeout

from phnn.errors import InputRefused, OutputFailed, OutputRefused, PhnnError

NOTES, INCOMPLETE, PROGRESS = ".phnn", "INCOMPLETE.txt", "progress.json"
_LIST, _PART = f"{NOTES}/manifest.json", ".phnn.part"
_LEAST_FREE = 8 << 20  # bytes before work begins: a report with its figures has some 3 MB
_LONGEST = 180  # bytes of a file name; file systems take 255
_STEPS = 200  # lines of progress that are kept, the last ones: a diagnosis has some twenty
# Letters, digits and marks of any script stay in file names; separators, controls, quotes and wildcards do not.
_UNSAFE = re.compile(r"[^\w.+=@,()\[\] -]")
# Windows takes these for devices, whatever ending follows.
_DEVICES = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")
# Control characters (C0 without the line feed, DEL, C1), marks that reverse the direction of writing, line and
# paragraph separators, and lone surrogates, which stand for bytes of a name that is no UTF-8.
_HIDDEN = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")


def printable(text: str, lines: bool = False) -> str:
    """Return a text with every character spelled out that a terminal or a page would not show as it is.

    Escape codes lose their effect, bytes that are no UTF-8 become ``\\xff``, other characters ``\\u202e``. A name has
    one line, a text may have several ``lines``.
    """

    def spelled(match: re.Match[str]) -> str:
        code = ord(match[0])
        # Python's stand-ins for the bytes 0x80 to 0xff begin at 0xdc80.
        code -= 0xDC00 if 0xDC80 <= code <= 0xDCFF else 0
        return f"\\x{code:02x}" if code <= 0xFF else f"\\u{code:04x}"

    shown = _HIDDEN.sub(spelled, text)
    return shown if lines else shown.replace("\n", "\\x0a")


def listed(names: Iterable[str], most: int = 8) -> str:
    """Return names in a row, the first of many with the number of the others."""
    some = list(names)
    return ", ".join(some[:most]) + (f" and {len(some) - most} more" if len(some) > most else "")


def message(text: str, most: int) -> str:
    """Return a message of one printable line; of one with more characters the beginning and the end."""
    line = printable(text)
    return line if len(line) <= most else f"{line[: most // 2]} … {line[-most // 2 :]}"


def file_name(label: str, ending: str = "") -> str:
    """Return a label, and an ending such as ``.csv``, as the name of a file: one printable component of at most 180
    bytes, never empty or hidden.

    Labels that need no change stay as they are. Two different labels may give the same name, see `unique_names`.
    """
    # Surrogates are what Python makes of bytes that are no UTF-8.
    text = unicodedata.normalize("NFC", label.encode("utf-8", "replace").decode("utf-8"))
    text = _UNSAFE.sub("_", text).strip(" .")
    if _DEVICES.fullmatch(text) or not text:
        text = f"_{text}"
    if len(f"{text}{ending}".encode()) > _LONGEST:
        mark = "_" + hashlib.sha256(label.encode("utf-8", "surrogatepass")).hexdigest()[:8]
        text = text.encode()[: _LONGEST - len(f"{mark}{ending}".encode())].decode("utf-8", "ignore") + mark
    return text + ending


def unique_names(labels: Iterable[str], ending: str = "") -> dict[str, str]:
    """Return a file name for each label; the names differ even where letters' case does not count."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    for label in labels:
        name, number = file_name(label, ending), 2
        while name.casefold() in taken:
            name, number = file_name(label, f"_{number}{ending}"), number + 1
        taken.add(name.casefold())
        names[label] = name
    return names


def finite(value: Any) -> Any:
    """Return a value for json: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if isinstance(value, Real) and not isinstance(value, Integral):
        return float(value) if math.isfinite(value) else None
    return value


def sha256_of(path: Path) -> str:
    """Return the hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file so that neither a reader nor a run that is killed meets half of it. The folder must exist. Raises
    OutputRefused where it cannot be written to, OutputFailed where the disk is full."""
    # Unique and exclusive: two processes do not mix their parts, and a stranger's link is not written through.
    temporary = path.with_name(f".{secrets.token_hex(8)}{_PART}")
    try:
        try:
            with temporary.open("xb") as file:
                file.write(content)
                file.flush()
                # A rename may reach the disk before the content.
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise refusal(path, error) from error


def refusal(path: Path, error: OSError) -> OutputRefused | OutputFailed:
    """Return the error of a file or folder that cannot be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return OutputFailed(f"{path}: the disk is full ({error.strerror}): make room and run the same command again")
    return OutputRefused(f"{path}: cannot be written ({error.strerror}): choose another folder for --out")


# What hashes stand for, which say nothing to people.
_HASHES = {"recordings": "other recordings", "base": "another model to start from", "schema": "another version of phnn"}


def same(out: Path, before: Mapping[str, Any], now: Mapping[str, Any], remedy: str, free: Collection[str] = ()) -> None:
    """Refuse to continue from results in a folder or file that were made of something else ``before`` than ``now``.

    Raises OutputRefused, with the value that differs and the remedy. Keys that are ``free`` do not change the results.
    """
    for key in sorted((set(before) | set(now)) - set(free)):
        old, new = before.get(key), now.get(key)
        if old != new:
            shown = "" if key in _HASHES else f" ({key}: {old} before, {new} now)"
            raise OutputRefused(f"{out}: was made with {_HASHES.get(key, 'other settings')}{shown}: {remedy}")


@dataclass(frozen=True)
class _Manifest:
    """The list of what phnn wrote below a folder, with what the last run was and the command that wrote each file.

    Names of folders whose whole content is phnn's end with ``/``.
    """

    command: str = ""
    made_of: Mapping[str, Any] = field(default_factory=dict)
    complete: bool = False
    files: Mapping[str, str] = field(default_factory=dict)
    earlier: Mapping[str, str] = field(default_factory=dict)  # files that the last run has not written again

    @staticmethod
    def read(root: Path) -> _Manifest:
        """Return the list of a folder. A damaged one lists nothing."""
        try:
            content = json.loads((root / _LIST).read_text("utf-8"))
            files, earlier = ({str(n): str(by) for n, by in content[key].items()} for key in ("files", "earlier"))
            return _Manifest(content["command"], dict(content["made_of"]), content["complete"], files, earlier)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return _Manifest()

    def write(self, root: Path) -> None:
        """Write the list."""
        write_atomic(root / _LIST, json.dumps(asdict(self), indent=1).encode())

    def existing(self, root: Path) -> dict[str, str]:
        """Return all files that are still there."""
        return {n: by for n, by in {**self.earlier, **self.files}.items() if (root / n).exists()}

    def lists(self, name: PurePosixPath) -> bool:
        """Return whether phnn wrote a file, or the whole folder in which it lies."""
        known = self.files.keys() | self.earlier.keys()
        return str(name) in known or any(f"{part}/" in known for part in (name, *name.parents))

    def check(self, root: Path, name: PurePosixPath, overwrite: bool | None) -> None:
        """Refuse to replace what phnn did not write, or what was changed after the last run."""
        path, below = root / name, [n for n in (*self.files, *self.earlier) if name in PurePosixPath(n).parents]
        if not os.path.lexists(path) or (path.is_dir() and not path.is_symlink() and not any(path.iterdir())):
            return
        if not self.lists(name) and not below:
            raise OutputRefused(f"{path}: was not written by phnn: move it away, or choose another folder for --out")
        # The list is the last file that a run writes.
        listed = os.path.getmtime(root / _LIST) if self.complete else math.inf
        for file in (path, *(root / n for n in below)):
            if file.is_file() and not overwrite and os.path.getmtime(file) > listed:
                choice = ", choose another folder for --out" + (", or give --overwrite" if overwrite is False else "")
                raise OutputRefused(f"{file}: was changed after phnn wrote it: move it away{choice}")


@dataclass(frozen=True)
class Place:
    """A file or folder below a folder of results; it crosses processes."""

    root: Path  # the folder of results, without links
    name: PurePosixPath = field(default_factory=PurePosixPath)  # below it, empty for the folder itself
    overwrite: bool | None = None  # replace results that were changed since; None where the user has no such option
    by: str = ""  # the command that writes

    def __truediv__(self, part: str) -> Place:
        """Return a file or folder in this one. The part is a name, never a path; see `file_name`."""
        return replace(self, name=self.name / file_name(part))

    @property
    def path(self) -> Path:
        """Return the path of the file or folder."""
        return self.root / self.name

    def __str__(self) -> str:
        return str(self.path)

    def write(self, content: bytes) -> None:
        """Write a file, whole or not at all, and list it as phnn's. Raises OutputRefused where a stranger's file has
        that name or the folder cannot be written to or leads elsewhere, OutputFailed where the disk is full."""
        path = self.path
        if path.is_symlink() or path.is_dir():
            kind = "a link" if path.is_symlink() else "a folder"
            raise OutputRefused(f"{path}: is {kind}, where a result must be written: move it away")
        self._list("")
        _make(path.parent)
        write_atomic(path, content)

    def write_json(self, content: Mapping[str, Any]) -> None:
        """Write a mapping as json; numbers that are not finite become null."""
        self.write((json.dumps(finite(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode())

    def own_folder(self) -> Path:
        """Make a folder whose whole content counts as phnn's, for writers of their own; return its path."""
        self._list("/")
        _make(self.path)
        return self.path

    def remove(self) -> None:
        """Remove a file or folder that phnn wrote; any other, and what lies behind a link, stays."""
        path, is_listed = self.path, _Manifest.read(self.root).lists(self.name)
        # The list may have been changed by hand: nothing outside the folder is removed.
        if not is_listed or path.is_symlink() or path.parent.resolve() != path.parent or self.root not in path.parents:
            return
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def _list(self, ending: str) -> None:
        """List the file before it is written, so that it counts as phnn's after a kill."""
        name, manifest = f"{self.name}{ending}", _Manifest.read(self.root)
        if name in manifest.files or any(f"{folder}/" in manifest.files for folder in self.name.parents):
            return
        manifest.check(self.root, self.name, self.overwrite)
        _make(self.root / NOTES)
        # Other processes write into the same folder.
        with FileLock(self.root / NOTES / "manifest.lock", poll_interval=0.005):
            manifest = _Manifest.read(self.root)
            earlier = {n: by for n, by in manifest.earlier.items() if n != name}
            replace(manifest, files={**manifest.files, name: self.by}, earlier=earlier).write(self.root)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        resolved = folder.resolve()
    except OSError as error:
        raise refusal(folder, error) from error
    if resolved != folder:
        raise OutputRefused(f"{folder}: is a link that leads to {resolved}: remove it, results stay inside --out")


@dataclass(frozen=True)
class Origin:
    """What the results of a run are made of."""

    made_of: Mapping[str, Any] = field(default_factory=dict)  # hashes of data and settings that decide the results
    resume: bool = False  # continue from what an earlier run with the same ``made_of`` has finished
    anew: str = ""  # how the user begins anew, for messages

    @property
    def complete(self) -> dict[str, Any]:
        """Return ``made_of`` with the version, as it comes back from disk."""
        return {**json.loads(json.dumps(finite(self.made_of))), "version": version("phnn")}


@contextmanager
def claim(
    out: Path,
    command: str,
    inputs: Sequence[Path] = (),
    results: Sequence[str] = (),
    origin: Origin | None = None,
    overwrite: bool | None = None,
) -> Iterator[Place]:
    """Claim a folder for the results of one run; all that the run writes goes through the `Place`.

    While the run writes, and after it was cut off, ``INCOMPLETE.txt`` says so. At the end ``results`` of an earlier run
    of the same command that this run did not write anew are removed, unless the run resumes.

    Args:
        out: folder; made if absent.
        command: name of the command.
        inputs: folders of recordings and models; ``out`` may not be one of them, contain one or lie in one.
        results: names directly below ``out`` that the command writes: strangers' files are refused before the work.
        origin: what the results are made of; None if no run can resume from them.
        overwrite: replace results even where they were changed since; None where the user has no such option.

    Raises:
        InputRefused: the folder belongs to recordings, to another run or to a stranger, or cannot be written to.
        OutputFailed: the disk is full.
    """
    root, origin = _resolved(out), origin or Origin()
    apart(out, inputs)
    is_new, place = not root.exists(), Place(root, overwrite=overwrite, by=command)
    mark, was_marked = place / INCOMPLETE, (root / INCOMPLETE).exists()
    _check_room(root)
    with _locked(root):
        before = _Manifest.read(root)
        if origin.resume:
            _check_origin(out, before, command, origin)
        for name in results:
            before.check(root, PurePosixPath(name), overwrite)
        _remove_parts(root)
        run = _Manifest(command, origin.complete)
        replace(run, earlier=before.existing(root)).write(root)
        mark.write(_UNFINISHED.format(command=command).encode())
        try:
            yield place
        except InputRefused:
            written = {PurePosixPath(n).name for n in _Manifest.read(root).files} - {INCOMPLETE, PROGRESS}
            if not written and not was_marked:
                mark.remove()
                before.write(root)
                if is_new:
                    shutil.rmtree(root / NOTES, ignore_errors=True)
                    with suppress(OSError):
                        root.rmdir()
            raise
        earlier = {} if origin.resume else _Manifest.read(root).earlier
        for file, by in earlier.items():
            if by == command and file.partition("/")[0] in results and not file.endswith("/"):
                replace(place, name=PurePosixPath(file)).remove()
        _remove_parts(root)
        mark.remove()
        replace(run, complete=True, files=_Manifest.read(root).existing(root)).write(root)


_UNFINISHED = """phnn {command} has begun here and not come to its end: what else lies here may be of an earlier run.
Give the same command again.
"""


def finished(out: Path, command: str, origin: Origin) -> bool:
    """Return whether a run of the same command has come to its end in a folder, made of the same. Raises OutputRefused
    where the results there were made of something else."""
    before = _Manifest.read(_resolved(out))
    _check_origin(out, before, command, origin)
    return before.complete


def _check_origin(out: Path, before: _Manifest, command: str, origin: Origin) -> None:
    remedy = "take another --out" + (f", or {origin.anew} to begin anew" if origin.anew else "")
    if before.command not in ("", command):
        raise OutputRefused(f"{out}: holds results of phnn {before.command}: {remedy}")
    if before.command:
        same(out, before.made_of, origin.complete, remedy)


def apart(out: Path, inputs: Sequence[Path]) -> None:
    """Refuse results in a folder of recordings or models: one that is, contains or lies in one of ``inputs``."""
    root = _resolved(out)
    for given in inputs:
        path = _resolved(given)
        folder = path if path.is_dir() else path.parent
        if root == folder or (path.is_dir() and (root in folder.parents or folder in root.parents)):
            relation = "is" if root == folder else "contains" if root in folder.parents else "lies in"
            cause = f"{relation} {folder}, from which this command reads"
            raise OutputRefused(f"--out {out}: {cause}: choose a folder apart from it")


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise OutputRefused(f"{str(path)!r}: is no path that can be used ({error}): choose another") from error


@contextmanager
def _locked(root: Path) -> Iterator[None]:
    """Keep other runs out of a folder; the lock of a run that was killed is free."""
    if root.exists() and not root.is_dir():
        raise OutputRefused(f"{root}: is a file: name a folder for --out")
    _make(root / NOTES)
    try:
        held = FileLock(root / NOTES / "lock").acquire(timeout=0)
    except Timeout as error:
        text = f"{root}: another run of phnn writes there: wait for its end, or choose another --out"
        raise OutputRefused(text) from error
    except OSError as error:
        raise refusal(root, error) from error
    with held:
        yield


def _check_room(root: Path) -> None:
    """Refuse a disk that is full before the work begins."""
    free = shutil.disk_usage(next(path for path in (root, *root.parents) if path.exists())).free
    if free < _LEAST_FREE:
        cause = f"only {free / 2**20:.1f} MiB of disk are free, at least {_LEAST_FREE >> 20} are needed"
        raise OutputRefused(f"{root}: {cause}: make room, or choose another folder for --out")


def _remove_parts(root: Path) -> None:
    """Remove what a run that was killed has left half written."""
    pattern, manifest = f".{'[0-9a-f]' * 16}{_PART}", _Manifest.read(root)
    names = [*manifest.files, *manifest.earlier, _LIST]
    whole, parents = {root / n for n in names if n.endswith("/")}, {(root / n).parent for n in names}
    for part in [p for f in whole for p in f.rglob(pattern)] + [p for f in parents for p in f.glob(pattern)]:
        part.unlink(missing_ok=True)


@contextmanager
def watched(place: Place, command: str, tell: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    """Pass on every line of progress, and write it to ``progress.json`` with its time.

    The file goes when the run ends, and where its input was refused. After a failure or a kill it says where the run
    stopped. A full disk stops no run here: its results will say so. The lines go to ``tell`` besides.
    """
    file, began = place / PROGRESS, _now()
    steps: list[dict[str, str]] = []

    def progress(text: str) -> None:
        tell(text)
        steps.append({"at": _now(), "text": text})
        with suppress(PhnnError):
            file.write_json({"schema": "phnn.progress/1", "command": command, "began": began, "steps": steps[-_STEPS:]})

    try:
        yield progress
    except InputRefused:
        file.remove()
        raise
    file.remove()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
