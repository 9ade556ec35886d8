"""The intake of everything that a user names: limits, readable files, plain values from json and yaml.

A file is a regular one, inside its folder, within the limits. Values are mappings, lists, texts, numbers, truth values
and nothing, every key once, every number of json finite: no tags, interpolation or code. The words of yaml are those of
YAML 1.1, but dates and times, numbers of base 8, 16, 2 and 60 stay texts, and ``1e-5`` is a number. Every alias counts
as what it stands for, so that aliases of aliases cannot multiply.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import stat
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

from rich import filesize

from phnn.errors import InputRefused
from phnn.results import printable

_KIB, _MIB, _GIB = 2**10, 2**20, 2**30
# Bytes of memory that are taken for granted where the system does not say what is available.
_UNKNOWN_MEMORY = 2 * _GIB


@dataclass(frozen=True)
class Limits:
    """What is refused beyond; docs/limits.md gives the reason of each.

    What a person records, describes or sets lies far inside; what is built to exhaust memory or time lies outside.
    """

    memory_share: float = 0.25
    file_bytes: int = 4 * _GIB  # bytes
    text_bytes: int = _GIB // 2  # bytes
    json_bytes: int = 64 * _MIB  # bytes
    unpacked_bytes: int = _GIB // 4  # bytes
    line_characters: int = 100_000
    columns: int = 64
    text_columns: int = 1024
    variables: int = 10_000
    recordings: int = 10_000
    samples: int = 50_000_000
    sample_bytes: int = 256  # bytes
    yaml_bytes: int = _MIB  # bytes
    yaml_values: int = 200_000
    depth: int = 32  # levels
    digits: int = 18
    unit_characters: int = 40
    model_bytes: int = 16 * _MIB  # bytes
    checkpoint_bytes: int = _GIB  # bytes
    elements: int = 256
    hysterons: int = 20
    units: int = 4096
    lines: int = 64
    substeps: int = 1024
    starts: int = 1000
    workers: int = 256
    message_characters: int = 2000
    name_characters: int = 200

    def most(self, count: str) -> int:
        """Return the largest value of a count among settings: its own limit, or a number of the digits accepted."""
        limited = count in ("hysterons", "starts", "workers", "substeps", "units")
        return int(getattr(self, count)) if limited else 10**self.digits - 1


LIMITS = Limits()
_TOO_DEEP = f"lists and mappings more than {LIMITS.depth} levels deep"
_TOO_LARGE = 10**LIMITS.digits


def available_memory() -> int:
    """Return the bytes of memory that may still be taken: the least of what the machine and its control group have."""
    return min(_memory_left(), default=_UNKNOWN_MEMORY)


def _memory_left() -> Iterator[int]:
    """Yield what the machine has left, and what control groups of version 2 and 1 leave, as a container sees them."""
    if known := re.search(r"^MemAvailable:\s+(\d+)", _text(Path("/proc/meminfo")), re.MULTILINE):
        yield int(known[1]) * _KIB
    else:
        with suppress(ValueError, OSError, AttributeError):
            # Systems without /proc: half of what is built in.
            yield os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    root = Path("/sys/fs/cgroup")
    for folder, most, used in (
        (root, "memory.max", "memory.current"),
        (root / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"),
    ):
        texts = _text(folder / most).strip(), _text(folder / used).strip()
        if all(text.isdecimal() for text in texts):
            # Pages of files that were read can be freed.
            freed = re.findall(r"^inactive_file (\d+)", _text(folder / "memory.stat"), re.MULTILINE)
            yield max(int(texts[0]) - int(texts[1]) + sum(map(int, freed)), 0)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except (OSError, ValueError):
        return ""


OUTSIDE = "--allow-outside"


@dataclass(frozen=True)
class Source:
    """A file that may be read: `named_file` has looked at it."""

    path: Path  # links resolved
    name: str  # as the user calls it, printable, for messages
    suffix: str  # of the name that the user gave, in small letters
    size: int  # bytes
    outside: bool = False  # parts of its content may lie in other files (links of HDF5)

    def open(self) -> BinaryIO:
        """Return the file, open for reading. Raises InputRefused where it cannot be, or is no regular file any more."""
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
        try:
            file = os.fdopen(os.open(self.path, flags), "rb")
        except OSError as error:
            raise InputRefused(f"{self.name}: cannot be opened ({error.strerror}): make it readable") from error
        # Between looking and opening another file may have taken its place.
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            file.close()
            raise InputRefused(f"{self.name}: is no file any more: leave the folder alone while it is read")
        return file

    def read(self, most: int, what: str = "a file") -> bytes:
        """Return the whole content. Raises InputRefused, which says ``what`` it is, where it is larger than ``most``
        bytes or cannot be read."""
        self.check_size(most, what)
        with self.open() as file:
            try:
                # What is asked for is set aside at once, so not more than there is; a file may have grown since.
                content = file.read(min(self.size, most) + 1)
                if len(content) > self.size:
                    content += file.read(most + 1 - len(content))
            except OSError as error:
                raise InputRefused(f"{self.name}: cannot be read ({error.strerror}): copy it again") from error
        replace(self, size=len(content)).check_size(most, what)
        return content

    def check_size(self, most: int, what: str = "a file") -> None:
        """Refuse a file of more than ``most`` bytes. Raises InputRefused."""
        if self.size > most:
            cause = f"{filesize.decimal(self.size)}, {what} may have at most {filesize.decimal(most)}"
            raise InputRefused(f"{self.name}: {cause}: split it, or export less")

    def check_memory(self, size: int, unpacked: bool = False) -> None:
        """Refuse numbers that would take more memory, ``size`` bytes once they are read, than there is for one file;
        ``unpacked`` ones lie packed in the file, which may claim any number of them."""
        most = int(LIMITS.memory_share * available_memory())
        if unpacked:
            most = min(most, LIMITS.unpacked_bytes + self.size)
        if size > most:
            limit = "of a packed file of this size" if unpacked else "with the memory that is available"
            cause = f"its numbers take {filesize.decimal(size)}, at most {filesize.decimal(most)} are accepted {limit}"
            raise InputRefused(f"{self.name}: {cause}: split it, or export fewer samples")


def reached(path: Path, before: str, kind: str, remedy: str) -> tuple[Path, os.stat_result]:
    """Return a path that a user names, links resolved, and its entry in the file system.

    Raises InputRefused where there is nothing, or it cannot be reached: with what stands ``before`` the path, which
    ``kind`` it should be, and the remedy.
    """
    shown = printable(str(path))
    try:
        real = path.resolve(strict=True)
        return real, real.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputRefused(f"{before}{shown}: there is no such {kind}: {remedy}") from error
    except (OSError, ValueError, RuntimeError) as error:
        cause = getattr(error, "strerror", None) or printable(str(error))
        shown = shown[: LIMITS.name_characters]
        raise InputRefused(f"{before}{shown}: cannot be reached ({cause}): {remedy}") from error


def named_file(
    path: Path, within: Sequence[Path] = (), where: str = "", absent: str = "check its path", outside: bool = False
) -> Source:
    """Look at a file that a user names, without opening it.

    Args:
        path: of the file.
        within: folders of which one must hold it, links resolved; none where it may lie anywhere.
        where: what names it, for the message.
        absent: the remedy where there is none.
        outside: it may lie, or lead, outside ``within``.

    Raises:
        InputRefused: it is absent, cannot be reached, is no regular file, lies outside, or is larger than any.
    """
    name = printable(path.name or str(path))
    prefix = f"{where}: " if where else ""
    real, status = reached(path, prefix, "file", absent)
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, a socket or a device"
        raise InputRefused(f"{prefix}{name}: is {kind}, not a file: copy what is to be read into a file")
    if within and not outside and not any(real.is_relative_to(os.path.realpath(folder)) for folder in within):
        cause = f"leads out of the folder {printable(str(within[0]))}"
        remedy = f"copy the file into the folder, or give the option {OUTSIDE} if you trust who made the folder"
        raise InputRefused(f"{prefix}{printable(str(path))}: {cause}: {remedy}")
    source = Source(real, name, path.suffix.lower(), status.st_size, outside or not within)
    source.check_size(LIMITS.file_bytes)
    return source


def load_json(source: Source, most: int, what: str, remedy: str) -> Any:
    """Return the content of a json file of at most so many bytes; ``what`` it is and the remedy stand in messages.

    Raises InputRefused where it is too large, no json, or holds something that is no plain value within the limits.
    """
    raw = source.read(most, what)
    try:
        content = json.loads(raw.decode("utf-8-sig"), object_pairs_hook=each_key_once)
        _check_plain(content, 0)
    except RecursionError as error:
        raise InputRefused(f"{source.name}: {_TOO_DEEP}: {remedy}") from error
    except ValueError as error:
        raise InputRefused(f"{source.name}: is not json ({error}): {remedy}") from error
    return content


def _check_plain(value: Any, depth: int) -> None:
    """Refuse values too deep in one another, and numbers too large. Raises ValueError."""
    if isinstance(value, dict | list):
        if value and depth == LIMITS.depth:
            raise ValueError(_TOO_DEEP)
        for inner in value.values() if isinstance(value, dict) else value:
            _check_plain(inner, depth + 1)
    elif isinstance(value, int | float) and not abs(value) < (math.inf if isinstance(value, float) else _TOO_LARGE):
        raise ValueError(f"{value!r:.40} is no finite number of at most {LIMITS.digits} digits")


def each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of json. Raises ValueError where a key stands twice in it."""
    content: dict[str, Any] = {}
    for key, value in pairs:
        if key in content:
            raise ValueError(f"the key {key[:40]!r} stands twice: give each value a name of its own")
        content[key] = value
    return content


# Words of yaml, in small letters, in capitals, or with one at the beginning.
_WORDS = {"": None, "~": None, "null": None, "yes": True, "true": True, "on": True} | dict.fromkeys(
    ("no", "false", "off"), False
)
_WHOLE = re.compile(r"[-+]?(?:0|[1-9][0-9_]*)")
_REAL = re.compile(
    r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|[0-9][0-9_]*[eE][-+]?[0-9]+|\.[0-9][0-9_]*(?:[eE][-+]?[0-9]+)?"
    r"|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN)"
)


class _Refused(ValueError):
    """What is wrong at a node, and the remedy; the line comes before it."""

    def __init__(self, node: Any, text: str) -> None:
        super().__init__(text)
        self.line = node.start_mark.line + 1


def load_yaml(source: Source) -> Any:
    """Return the one document of a yaml file; None where it holds none. Raises InputRefused, with file and line, where
    it is too large, no yaml, or holds something that is no plain value within the limits."""
    raw = source.read(LIMITS.yaml_bytes, "a yaml file")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        cause = f"not readable as yaml (byte {error.start} is no UTF-8)"
        raise InputRefused(f"{source.name}: {cause}: save it as UTF-8") from error
    return plain_values(text, source.name)


def plain_values(text: str, name: str) -> Any:
    """Return the one document of a yaml text; ``name`` is that of the file. Raises InputRefused as `load_yaml`."""
    import yaml

    # Without a meaning of their own, values have the tags that somebody wrote, or say whether they stood in quotes.
    def resolve(loader: Any, kind: Any, value: Any, implicit: Any) -> str:
        return _QUOTED if isinstance(implicit, tuple) and not implicit[0] else _PLAIN

    loader = type("AsWritten", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {"resolve": resolve})
    try:
        depth = 0
        # The composer takes long for what is deep, the parser does not.
        for event in yaml.parse(text, Loader=loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > LIMITS.depth + 1:
                raise _Refused(event, f"{_TOO_DEEP}: write less")
        documents = list(yaml.compose_all(text, Loader=loader))
        if len(documents) > 1:
            raise _Refused(documents[1], "a second document begins: one file holds one")
        return _plain(documents[0], 0, itertools.count(1)) if documents else None
    except _Refused as error:
        raise InputRefused(f"{name}: line {error.line}: {error}") from error
    except (yaml.YAMLError, RecursionError) as error:
        cause = " ".join(str(error).split())
        raise InputRefused(f"{name}: not readable as yaml ({cause}): correct it at the line named") from error


_PLAIN, _QUOTED = "", "quoted"


def _plain(node: Any, depth: int, counted: Iterator[int]) -> Any:
    """Return the value of a node that lies so deep in others; an alias is the node that it stands for, again."""
    if next(counted) > LIMITS.yaml_values:
        raise _Refused(node, f"more than {LIMITS.yaml_values} values, aliases written out: write less")
    if depth > LIMITS.depth:
        raise _Refused(node, f"{_TOO_DEEP}: write less")
    if node.tag not in (_PLAIN, _QUOTED):
        raise _Refused(node, f"the tag {node.tag!r} is not accepted: write plain values without tags")
    if node.id == "scalar":
        return _scalar(node)
    if node.id == "sequence":
        return [_plain(inner, depth + 1, counted) for inner in node.value]
    content: dict[Any, Any] = {}
    merged: dict[Any, Any] = {}
    for key_node, value_node in node.value:
        key, value = (_plain(inner, depth + 1, counted) for inner in (key_node, value_node))
        if isinstance(key, list | dict):
            raise _Refused(key_node, "a list or mapping as a key: write a name")
        if key in content:
            raise _Refused(key_node, f"the key {key!r} is given twice: remove one")
        if key != "<<":
            content[key] = value
            continue
        for mapping in value if isinstance(value, list) else [value]:
            if not isinstance(mapping, dict):
                raise _Refused(key_node, "<< stands before something that is no mapping: name a mapping")
            # The first mapping that has a key wins.
            merged = mapping | merged
    return merged | content


def _scalar(node: Any) -> Any:
    text = node.value
    # What other readers of yaml would replace, from the environment for instance.
    if "${" in text:
        raise _Refused(node, f"{text[:60]!r}: nothing is put in for ${{…}} here: write the value itself")
    if node.tag == _QUOTED:
        return text
    if text.lower() in _WORDS and text in (text.lower(), text.capitalize(), text.upper()):
        return _WORDS[text.lower()]
    if _WHOLE.fullmatch(text):
        digits = sum(c.isdigit() for c in text)
        if digits > LIMITS.digits:
            cause = f"a whole number of {digits} digits, at most {LIMITS.digits} are accepted"
            raise _Refused(node, f"{cause}: write 1e{digits}")
        return int(text.replace("_", ""))
    if _REAL.fullmatch(text):
        return float(text.replace("_", "").lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text
