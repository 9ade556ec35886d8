"""One thing that is to be said about a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

NOTE, WARNING = "note", "warning"


@dataclass(frozen=True)
class Finding:
    """Attributes:
    kind: ``quantisation``, ``limits``, ``drift``, ``mains``, ``lead``, ``units`` or ``contaminated``.
    severity: ``note``, or ``warning`` where it may mislead a diagnosis.
    text: one sentence for a person, with what to do about a warning.
    values: its numbers, SI.
    """

    kind: str
    severity: str
    text: str
    values: Mapping[str, float] = field(default_factory=dict)
