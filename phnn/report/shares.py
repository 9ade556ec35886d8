"""The energy ledger as fractions of what was supplied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phnn.report.evidence import LedgerRow

_MOST = 6  # dissipators told apart; the smallest others are joined


@dataclass(frozen=True)
class Shares:
    """One recording: the share of each kind; ``kinds`` is the same, in the same order, for every row."""

    recording: str
    parts: Mapping[str, float]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Dissipators first, then ``stored`` and ``unexplained``."""
        return tuple(self.parts)

    def share(self, kind: str) -> float:
        """Fraction of the supplied energy; zero where it is not finite."""
        value = self.parts.get(kind, 0.0)
        return value if np.isfinite(value) else 0.0


def ledger_shares(rows: Sequence[LedgerRow]) -> tuple[tuple[Shares, ...], tuple[str, ...]]:
    """Fractions for each recording, and the names of recordings that were supplied with no net energy.

    The fractions are free of the common factor that voltage and displacement leave open.
    """
    usable = [row for row in rows if np.isfinite(row.supplied) and row.supplied > 0.0]
    skipped = tuple(row.recording for row in rows if row not in usable)
    largest: dict[str, float] = {}
    for row in usable:
        for name, energy in row.dissipated.items():
            largest[name] = max(largest.get(name, 0.0), abs(energy) / row.supplied)
    kept = list(largest)
    if len(kept) > _MOST:
        chosen = set(sorted(kept, key=lambda name: -largest[name])[: _MOST - 1])
        kept = [name for name in kept if name in chosen]
    result = []
    for row in usable:
        parts = {name: row.dissipated.get(name, 0.0) / row.supplied for name in kept}
        if len(kept) < len(largest):
            parts["other losses"] = sum(e for n, e in row.dissipated.items() if n not in parts) / row.supplied
        parts["stored"] = row.stored / row.supplied
        parts["unexplained"] = row.unexplained / row.supplied
        result.append(Shares(row.recording, parts))
    return tuple(result), skipped
