"""Two runs side by side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from phnn.serve.runs import Run


@dataclass(frozen=True)
class ScoreRow:
    """Residual over noise of one recording, before and after in both runs; None where a run does not have it."""

    recording: str
    held_out: tuple[bool, bool]
    first: tuple[float | None, float | None]
    second: tuple[float | None, float | None]


@dataclass(frozen=True)
class ParameterRow:
    """A parameter of both final models; None where a model does not have it."""

    name: str
    unit: str
    first: float | None
    second: float | None


@dataclass(frozen=True)
class Comparison:
    """Two runs, their scores recording by recording, their parameters name by name."""

    first: Run
    second: Run
    scores: tuple[ScoreRow, ...]
    parameters: tuple[ParameterRow, ...]


def compare(first: Run, second: Run) -> Comparison:
    """Put the numbers of two runs side by side, in the order of the first."""
    recordings = _union(first.before, first.after, second.before, second.after)
    scores = (
        ScoreRow(
            name,
            (name in first.held_out, name in second.held_out),
            (first.before.get(name), first.after.get(name)),
            (second.before.get(name), second.after.get(name)),
        )
        for name in recordings
    )
    nothing = (None, "")
    parameters = []
    for name in _union(first.parameters, second.parameters):
        (a, unit_a), (b, unit_b) = first.parameters.get(name, nothing), second.parameters.get(name, nothing)
        parameters.append(ParameterRow(name, unit_a or unit_b, a, b))
    return Comparison(first, second, tuple(scores), tuple(parameters))


def _union(*groups: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(name for group in groups for name in group))
