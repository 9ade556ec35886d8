"""The fixed arguments of a search for missing elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from phnn.criteria import CRITERIA, Criteria
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.scored import Scored, scored
from phnn.effects import Effect, Scales
from phnn.identification.base import Progress, quiet
from phnn.identification.fit import Fit
from phnn.identification.refinement import NumericalError
from phnn.parallel import SERIAL, Executor

# Models that a search has come upon and that are kept for its end, the best ones.
_VISITED = 5


@dataclass(frozen=True)
class Visited:
    """A model that a search has come upon: its elements, in order, and a fit with them to some of the recordings."""

    findings: tuple[Finding, ...]
    fit: Fit


@dataclass(frozen=True)
class Search:
    """What a search for missing elements is made with.

    Attributes:
        effects: catalogue entries that can exist in the setup; learned: elements without a name that can.
        seed: of the null distribution of the scores.
        max_effects: how many effects may be named.
        criteria: every threshold.
        executor: where candidates are refitted.
        terminals: whether the input was measured where it acts.
        new_in_held_out: whether confirmation brings something new; without it the word is ``equivalent`` at most.
        progress: told what is tried.
        reach: scales of recordings that a model has to predict beside those it is fitted to; None where there are none.
        visited: the best models that it has come upon, for a search that ends early.
    """

    effects: Sequence[Effect]
    learned: Sequence[Effect] = ()
    seed: int = 0
    max_effects: int = 3
    criteria: Criteria = CRITERIA
    executor: Executor = SERIAL
    terminals: bool = False
    new_in_held_out: bool = False
    progress: Progress = quiet
    reach: Scales | None = None
    visited: list[Visited] = field(default_factory=list, compare=False)

    def visit(self, findings: tuple[Finding, ...], fitted: Fit) -> None:
        """Keep a model, if it is among the best ones so far."""
        self.visited.append(Visited(findings, fitted))
        self.visited.sort(key=lambda v: v.fit.chi2)
        del self.visited[_VISITED:]

    def scored(self, fitted: Fit, error: NumericalError | None = None) -> Scored:
        """Scores of the catalogue in the residual of a fit."""
        return scored(fitted, self.effects, self.seed, error, self.terminals, self.criteria)

    def scored_with_learned(self, fitted: Fit) -> Scored:
        """Scores of the catalogue and of the learned elements."""
        return self.scores_of(fitted, (*self.effects, *self.learned))

    def scores_of(self, fitted: Fit, effects: Sequence[Effect]) -> Scored:
        """Scores of some effects, whose functions span the range of all recordings that a model has to predict."""
        return scored(fitted, effects, self.seed, None, self.terminals, self.criteria, self.reach)
