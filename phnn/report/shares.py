"""The energy ledger as fractions of the largest flow: of what was supplied, unless something else moved more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phnn.report.evidence import LedgerRow
from phnn.report.formatting import listing

_MOST = 6  # dissipators told apart; the smallest others are joined
SUPPLIED = "supplied"
# Of the force that a located mismatch asks for: ``Σ h |f v|``. It is no part of the balance of the model.
MISSING = "work of the missing force"


@dataclass(frozen=True)
class Shares:
    """One recording: the share of each kind; ``kinds`` is the same, in the same order, for every row.

    Attributes:
        base: the flow whose energy is one: ``supplied``, ``stored``, `MISSING` or a dissipator.
    """

    recording: str
    parts: Mapping[str, float]
    base: str = SUPPLIED

    @property
    def kinds(self) -> tuple[str, ...]:
        """Dissipators first, then ``stored``, and `MISSING` where a missing force was located."""
        return tuple(self.parts)

    def share(self, kind: str) -> float:
        """Fraction of the energy of the base; zero where it is not finite."""
        value = self.parts.get(kind, 0.0)
        return value if np.isfinite(value) else 0.0


def ledger_shares(rows: Sequence[LedgerRow]) -> tuple[tuple[Shares, ...], tuple[str, ...]]:
    """Fractions for each recording, and the names of recordings in which no energy flows.

    The fractions are free of the common factor that voltage and displacement leave open. What was supplied may be the
    small difference of what flows in and back: the largest flow is the base, so that no fraction exceeds one.
    """
    bases = {id(row): _base(row) for row in rows}
    usable = [row for row in rows if bases[id(row)][1] > 0.0]
    skipped = tuple(row.recording for row in rows if row not in usable)
    largest: dict[str, float] = {}
    for row in usable:
        for name, energy in row.dissipated.items():
            largest[name] = max(largest.get(name, 0.0), abs(energy) / bases[id(row)][1])
    kept = list(largest)
    if len(kept) > _MOST:
        chosen = set(sorted(kept, key=lambda name: -largest[name])[: _MOST - 1])
        kept = [name for name in kept if name in chosen]
    result = []
    located = any(row.unexplained for row in usable)
    for row in usable:
        base, size = bases[id(row)]
        parts = {name: row.dissipated.get(name, 0.0) / size for name in kept}
        if len(kept) < len(largest):
            parts["other losses"] = sum(e for n, e in row.dissipated.items() if n not in parts) / size
        parts["stored"] = row.stored / size
        if located:
            parts[MISSING] = row.unexplained / size
        result.append(Shares(row.recording, parts, base))
    return tuple(result), skipped


def _base(row: LedgerRow) -> tuple[str, float]:
    """The largest flow of a recording and its energy; 0 where none is finite. What was supplied comes first."""
    flows = {SUPPLIED: row.supplied, **row.dissipated, "stored": row.stored, MISSING: row.unexplained}
    sizes = {name: abs(energy) for name, energy in flows.items() if np.isfinite(energy)}
    name = max(sizes, key=lambda n: sizes[n], default=SUPPLIED)
    return name, sizes.get(name, 0.0)


def base_note(shares: Sequence[Shares]) -> str:
    """Says where the fractions are not those of the energy supplied; empty where all are."""
    other = [s for s in shares if s.base != SUPPLIED]
    if not other:
        return ""
    listed = listing(f"{s.recording} ({s.base.replace('_', ' ')})" for s in other)
    return f"Fractions are those of the largest flow where that is not the energy supplied: {listed}."
