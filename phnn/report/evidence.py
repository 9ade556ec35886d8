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
    """The picture at the location: a learned function and, where an element was named, its law.

    Raises:
        ValueError: ``y``, ``y_std`` or ``named_y`` does not have the length of ``x``.
    """

    x: np.ndarray  # (M,)
    y: np.ndarray  # (M,) learned from the recordings
    y_std: np.ndarray | None  # (M,) one standard error
    x_label: str
    y_label: str
    title: str
    named_y: np.ndarray | None = None  # (M,) law of the named element

    def __post_init__(self) -> None:
        for name in ("y", "y_std", "named_y"):
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
class CandidateRow:
    """What was tried, and why it was kept or rejected."""

    effect: str
    location: str
    score: float
    p_value: float
    refit_chi2: float | None
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
    """A rule of the verdict: whether it applied, what it compared, and the outcome where it applied.

    Attributes:
        element: what it was asked of; empty for the whole model.
    """

    rule: str
    element: str
    applies: bool
    outcome: str
    numbers: Mapping[str, float | None]


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
    symptoms: tuple[str, ...] = ()  # what the base model's residual looks like, in sentences
    rules: tuple[RuleRow, ...] = ()  # of the verdict, in the order in which they were asked
