"""Scores of the effects of a catalogue that appear as lines and slow drifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from phnn.diagnose.linearised import LinearisedFit, direction
from phnn.diagnose.lines import line_of_one, own_score, strongest_line
from phnn.diagnose.noise import Colour, Spectra
from phnn.effects import Effect

_RANK = 1e-9


@dataclass(frozen=True)
class LineCandidate:
    """An effect that appears as nuisances of every recording: lines or a slow drift.

    Attributes:
        effect: which; values: of its parameters.
        deviate: how far they stand out of the stated noise, as a normal deviate.
        judged: the same out of the noise as the residual has it, where that is more.
    """

    effect: Effect
    values: dict[str, float]
    deviate: float
    judged: float


@dataclass(frozen=True)
class LineScores:
    """All scores of lines and slow drifts.

    Attributes:
        candidates: effects of the catalogue.
        single: normal deviates of the strongest line in a single recording, see `line_of_one`.
        tries: how many different scores there are.
    """

    candidates: tuple[LineCandidate, ...]
    single: tuple[float, float]
    tries: int

    @property
    def statistic(self) -> float:
        """The largest deviate, out of the noise as stated."""
        return max(self.single[0], *(c.deviate for c in self.candidates), 0.0)

    @property
    def judged(self) -> float:
        """The largest deviate, out of the noise as the residual has it."""
        return max(self.single[1], *(c.judged for c in self.candidates), 0.0)

    def tail(self, deviate: float) -> float:
        """Probability that any of as many scores is above a deviate where nothing is missing; 1 for no deviate, as
        deviates below zero are not kept."""
        return -float(np.expm1(self.tries * np.log1p(-ndtr(-deviate)))) if deviate > 0.0 else 1.0


def line_scores(linearised: LinearisedFit, effects: Sequence[Effect], colour: Colour) -> LineScores:
    """Score the effects that appear as nuisances of the recordings, and lines that no effect explains."""
    spectra, setup = linearised.spectra, linearised.fit.setup
    # The strongest line of all recordings together, and that of a single one.
    line, found, tries = strongest_line(spectra), [], 2
    for effect in effects:
        points = effect.grid(linearised.scales)
        if effect.searched is not None:
            found.append(_searched(linearised, effect, effect.searched, points, line))
        elif effect.add_to(setup, points[0]).own != setup.own:
            found.append(_known(linearised, effect, points, colour, spectra))
            tries += len(points)
    return LineScores(tuple(found), line_of_one(spectra), tries)


def _known(
    linearised: LinearisedFit, effect: Effect, points: Sequence[dict[str, float]], colour: Colour, spectra: Spectra
) -> LineCandidate:
    """The best of a few given points."""
    found = [own_score(linearised, effect.add_to(linearised.fit.setup, v).own, colour, spectra) for v in points]
    best = max(range(len(points)), key=lambda i: found[i][::-1])
    return LineCandidate(effect, dict(points[best]), *found[best])


def _searched(
    linearised: LinearisedFit,
    effect: Effect,
    name: str,
    points: Sequence[dict[str, float]],
    line: tuple[float, float, float],
) -> LineCandidate:
    """The strongest line there is; the other parameters, in which the effect is linear, by least squares."""
    frequency, deviate, judged = line
    placed = [point | {name: frequency} for point in points]
    columns = linearised.project(np.column_stack([direction(linearised, effect, v) for v in placed]))
    weights = np.linalg.lstsq(columns, linearised.residual, rcond=_RANK)[0]
    values = {n: float(sum(w * v[n] for w, v in zip(weights, placed, strict=True))) for n in placed[0]}
    return LineCandidate(effect, values | {name: frequency}, deviate, judged)
