"""The limits within which files and settings of others are accepted, each with its unit and its reason."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

_KIB, _MIB, _GIB = 2**10, 2**20, 2**30
# Bytes of memory that are taken for granted where the system does not say what is available.
_UNKNOWN_MEMORY = 2 * _GIB


def _limit(value: float, unit: str, reason: str) -> Any:
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True)
class Limits:
    """What is refused beyond; `table` gives unit and reason of each.

    What a person records, describes or sets lies far inside; what is built to exhaust memory or time lies outside.
    """

    memory_share: float = _limit(0.25, "1", "share of the available memory for one file; checks keep a few copies")
    file_bytes: int = _limit(4 * _GIB, "bytes", "no recording is larger; a sparse file may claim any size")
    text_bytes: int = _limit(_GIB // 2, "bytes", "a text takes several times its size while it is read")
    json_bytes: int = _limit(
        64 * _MIB, "bytes", "a json recording is converted number by number, a few million a second"
    )
    unpacked_bytes: int = _limit(_GIB // 4, "bytes", "packed numbers may take as much beyond the size of their file")
    line_characters: int = _limit(100_000, "1", "a row of a table is shorter; a file without line ends has one line")
    columns: int = _limit(64, "1", "columns of an array; more are samples along the wrong axis")
    text_columns: int = _limit(1024, "1", "columns of a text file; each costs time to parse")
    variables: int = _limit(10_000, "1", "arrays in one file; each is looked at by name")
    groups: int = _limit(32, "levels", "groups in groups of a file; deeper ones may contain themselves")
    recordings: int = _limit(10_000, "1", "recordings of a folder; each is checked by itself")
    samples: int = _limit(50_000_000, "1", "samples of all recordings; more are not looked at in minutes")
    sample_bytes: int = _limit(256, "bytes", "memory that the checks of one sample take; that of all must be available")
    yaml_bytes: int = _limit(_MIB, "bytes", "a manifest of 10,000 recordings is smaller")
    yaml_values: int = _limit(200_000, "1", "values with every alias written out; aliases of aliases multiply")
    depth: int = _limit(32, "levels", "lists and mappings within one another, in yaml and json; recursion is finite")
    digits: int = _limit(18, "1", "digits of a whole number; longer ones fit no 64 bits")
    unit_characters: int = _limit(40, "1", "a unit is shorter; its names are looked up one by one")
    model_bytes: int = _limit(16 * _MIB, "bytes", "a model of learned laws with thousands of units is smaller")
    checkpoint_bytes: int = _limit(_GIB, "bytes", "a checkpoint holds a few copies of a model's weights")
    elements: int = _limit(256, "1", "elements, bonds or parameters of a network; its equations are solved by symbols")
    hysterons: int = _limit(20, "1", "hysterons of an actuator; each has three parameters to be identified")
    units: int = _limit(4096, "1", "units of a learned law; each is evaluated in every step")
    lines: int = _limit(64, "1", "frequencies of lines that a model takes out of the output")
    substeps: int = _limit(1024, "1", "steps a sample interval; identification uses at most 64")
    starts: int = _limit(1000, "1", "starting points of a fit; each is a fit of its own")
    workers: int = _limit(256, "1", "threads or processes; each takes memory")
    message_characters: int = _limit(2000, "1", "a message shows the beginning and the end of longer lists")
    name_characters: int = _limit(200, "1", "a name is shown in tables and becomes the name of a file")

    def most(self, count: str) -> int:
        """The largest value of a count among settings: its own limit, or a number with the digits that are accepted."""
        own = count in ("hysterons", "starts", "workers", "substeps", "units")
        return int(getattr(self, count)) if own else 10**self.digits - 1

    def table(self) -> list[tuple[str, float, str, str]]:
        """Name, value, unit and reason of every limit."""
        return [(f.name, getattr(self, f.name), f.metadata["unit"], f.metadata["reason"]) for f in fields(self)]

    def memory_for_a_file(self) -> int:
        """Bytes that the numbers of one file may take."""
        return int(self.memory_share * available_memory())


LIMITS = Limits()


def available_memory() -> int:
    """Bytes of memory that may still be taken: the least of what the machine and its control group have left."""
    found = [_machine(), *_control_group()]
    known = [size for size in found if size is not None]
    return min(known, default=_UNKNOWN_MEMORY)


def _machine() -> int | None:
    for line in _text(Path("/proc/meminfo")).splitlines():
        if line.startswith("MemAvailable:"):
            return int(line.split()[1]) * _KIB
    try:
        # Systems without /proc: half of what is built in.
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    except (ValueError, OSError, AttributeError):
        return None


def _control_group() -> list[int | None]:
    """What the control groups of version 2 and 1 leave, as a container sees them; pages of read files can be freed."""
    root = Path("/sys/fs/cgroup")
    groups = (
        (root / "memory.max", root / "memory.current", root / "memory.stat"),
        (root / "memory/memory.limit_in_bytes", root / "memory/memory.usage_in_bytes", root / "memory/memory.stat"),
    )
    found: list[int | None] = []
    for most, used, stat in groups:
        texts = _text(most).strip(), _text(used).strip()
        if all(text.isdecimal() for text in texts):
            freed = sum(int(line.split()[1]) for line in _text(stat).splitlines() if line.startswith("inactive_file "))
            found.append(max(int(texts[0]) - int(texts[1]) + freed, 0))
    return found


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except (OSError, ValueError):
        return ""
