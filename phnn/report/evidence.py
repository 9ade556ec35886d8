"""The evidence that a report shows beside the document: traces, curves and tables, as plain values.

The diagnosis fills these; the report only reads them. Everything is in SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from phnn.report.support import Support


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
class Curve:
    """The picture at the location: a learned function.

    Raises:
        ValueError: ``y`` or ``y_std`` does not have the length of ``x``.
    """

    x: np.ndarray  # (M,)
    y: np.ndarray  # (M,) learned from the recordings
    y_std: np.ndarray | None  # (M,) one standard error
    x_label: str
    y_label: str
    title: str

    def __post_init__(self) -> None:
        for name in ("y", "y_std"):
            value = getattr(self, name)
            if value is not None and value.shape != self.x.shape:
                raise ValueError(
                    f"curve {self.title}: {name} has shape {value.shape}, x has {self.x.shape}: give them one length"
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
class RuleRow:
    """A rule of the verdict: whether it applied, what it compared, and the outcome where it applied."""

    rule: str
    applies: bool
    outcome: str
    numbers: Mapping[str, float | None]


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
    curves: tuple[Curve, ...]
    parameters: tuple[ParameterRow, ...]
    candidates: tuple[CandidateRow, ...]
    ledger: tuple[LedgerRow, ...]
    notes: tuple[str, ...]
    verdict_sentence: str
    supports: tuple[Support, ...] = ()  # what speaks for each entry of ``missing``, in order
    no_proposal: str = ""  # why no recording is proposed though something is tied
    rules: tuple[RuleRow, ...] = ()  # of the verdict, in the order in which they were asked
    models: tuple[ModelRow, ...] = ()  # that were fitted, the most probable first
    methods: Methods | None = None
    provenance: Provenance | None = None
