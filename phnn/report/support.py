"""The support of a named element, as plain values: its fingerprint in the data, its rivals, its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
