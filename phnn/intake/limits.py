"""The limits within which files and settings of others are accepted, each with its unit."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

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
        """The largest value of a count among settings: its own limit, or a number with the digits that are accepted."""
        own = count in ("hysterons", "starts", "workers", "substeps", "units")
        return int(getattr(self, count)) if own else 10**self.digits - 1

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
