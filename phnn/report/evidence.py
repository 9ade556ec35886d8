"""The evidence that a report shows beside the document: support, traces, curves and tables, as plain values.

The diagnosis fills these; the report only reads them. Everything is in SI units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from phnn.report.formatting import listing

if TYPE_CHECKING:
    from phnn.diagnose.verdict import Applied
    from phnn.diagnose.words import Picture


@dataclass(frozen=True)
class Fingerprint:
    """Residuals against the variable on which an effect acts: means over bins with their standard errors.

    Attributes:
        x: (B,) middles of the bins; x_label: the variable with its unit; logarithmic: whether it has decades.
        before, after: (B,) of the base and of the final model; before_std, after_std: one standard error.
        y_label: what is drawn, with its unit.
        level: what noise alone would give.
    """

    x: np.ndarray
    before: np.ndarray
    before_std: np.ndarray
    after: np.ndarray
    after_std: np.ndarray
    x_label: str
    y_label: str
    logarithmic: bool
    level: float


@dataclass(frozen=True)
class RivalRow:
    """What might be taken for an effect, and what a model with it leaves [× noise]; None where it was not refitted."""

    effect: str
    leaves: float | None
    outcome: str


@dataclass(frozen=True)
class PlausibleRow:
    """A parameter and its plausible range; ``inside`` is None without a range."""

    name: str
    sentence: str
    inside: bool | None


@dataclass(frozen=True)
class Support:
    """Attributes:
    effect: which; expected: its fingerprint in words; seen: the picture in these data, None where none can be drawn.
    leaves: of the model with it [× noise]; rivals: the others; separation: the experiment that tells it from them.
    """

    effect: str
    expected: str
    seen: Fingerprint | None
    leaves: float
    rivals: tuple[RivalRow, ...]
    separation: str
    references: tuple[str, ...]
    plausible: tuple[PlausibleRow, ...]


@dataclass(frozen=True)
class Trace:
    """One part of one recording, with what the base model and the final model say of it.

    Raises:
        ValueError: the channels do not all have the length of ``t``.
    """

    name: str
    t: np.ndarray  # (N,) time [s], uniformly spaced
    u: np.ndarray  # (N,) input [V, or N for a force]
    measured: np.ndarray  # (N,) recorded output [m]
    before: np.ndarray  # (N,) output of the base model including its zero offset [m]
    after: np.ndarray  # (N,) output of the final model including its zero offset [m]
    noise: float  # standard deviation of the output noise [m]
    held_out: bool
    scored: np.ndarray  # (N,) bool: the samples that count

    def __post_init__(self) -> None:
        count = len(self.t)
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray) and value.shape != (count,):
                raise ValueError(
                    f"trace {self.name}: {field.name} has shape {value.shape}, t has ({count},): give them one length"
                )


@dataclass(frozen=True)
class ParameterRow:
    """A parameter before and after; ``note`` says "held: ...", "at its bound", "up to one common factor"."""

    name: str
    description: str
    unit: str
    before: float | None
    after: float | None
    std: float | None
    note: str
    interval_95: tuple[float, float] | None = None


@dataclass(frozen=True)
class ModelRow:
    """A model that was fitted.

    Attributes:
        elements: beyond the base model, in words; parameters: how many they have, terms of single
            recordings among them.
        left, left_held_out: mean square of the residual over that of the noise; NaN where nothing was held out.
        probability: among all models that were fitted; converged: fitted to its end; chosen: the final model.
    """

    elements: str
    left: float
    left_held_out: float
    parameters: int
    probability: float
    converged: bool
    chosen: bool


@dataclass(frozen=True)
class CandidateRow:
    """An element that may be added to the base model; ``fall`` is the predicted fall of its χ²/N."""

    effect: str
    location: str
    score: float
    fall: float
    outcome: str


@dataclass(frozen=True)
class LedgerRow:
    """Energy of one recording, in joules per cycle (or per recording); shown as fractions of ``supplied``."""

    recording: str
    supplied: float
    stored: float
    dissipated: Mapping[str, float]
    unexplained: float


@dataclass(frozen=True)
class Methods:
    """A run as the methods section of a paper describes it.

    Attributes:
        sentences: of one paragraph, with numbers of references in brackets.
        references: in the order of their numbers, from 1; bibtex: the same as entries.
    """

    sentences: tuple[str, ...]
    references: tuple[str, ...]
    bibtex: str


@dataclass(frozen=True)
class FileHash:
    """A file that was read, and the SHA-256 of its content in hexadecimal."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """What a reader needs to do a run again.

    Attributes:
        command: as it was typed, quoted for a shell; empty where the run was started from Python.
        folder: of the recordings.
        recordings: files of the recordings; manifest: None where there was none.
        understood: SHA-256 of all samples, uses and starts as they were understood; the same for the same result.
    """

    command: str
    folder: str
    recordings: tuple[FileHash, ...]
    manifest: FileHash | None
    understood: str


@dataclass(frozen=True)
class Evidence:
    """Everything that a report draws or tabulates beside the numbers of the document."""

    traces: tuple[Trace, ...]
    curves: tuple[Picture, ...]  # learned functions at the location
    parameters: tuple[ParameterRow, ...]
    candidates: tuple[CandidateRow, ...]
    ledger: tuple[LedgerRow, ...]
    notes: tuple[str, ...]
    verdict_sentence: str
    supports: tuple[Support, ...] = ()  # what speaks for each entry of ``missing``, in order
    no_proposal: str = ""  # why no recording is proposed though something is tied
    rules: tuple[Applied, ...] = ()  # of the verdict, in the order in which they were asked
    models: tuple[ModelRow, ...] = ()  # that were fitted, the most probable first
    methods: Methods | None = None
    provenance: Provenance | None = None


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
