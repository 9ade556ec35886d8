"""A candidate with its refit, and when two of them count as the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import SELECTION, Selection
from phnn.diagnose import formula
from phnn.diagnose.formula import own_count
from phnn.diagnose.linearised import tie
from phnn.diagnosis.name import Candidate
from phnn.identification.fit import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate with its refit.

    Attributes:
        fit: None where no start could be simulated.
        converged: it was carried to the end, with the sub-steps of the model that it was added to.
    """

    candidate: Candidate
    fit: Fit | None
    converged: bool = False

    @property
    def cost(self) -> float:
        """Weighted sum of squares, infinite where there is no fit."""
        return self.fit.cost if self.fit is not None else float("inf")

    @property
    def fair_cost(self) -> float:
        """The same, plus the reduction by noise alone along the recordings' nuisances."""
        return fair_cost(self.fit) if self.fit is not None else float("inf")


def fair_cost(fit: Fit) -> float:
    """Weighted sum of squares, and a residual variance for every coefficient of the recordings' nuisances."""
    return fit.cost + own_count(fit) * max(1.0, fit.chi2)


def criterion(trial: Trial) -> float:
    """Sum of squares with a penalty of ``ln N`` for each parameter and each nuisance of a recording (Schwarz 1978)."""
    if trial.fit is None:
        return float("inf")
    free = [n for n in trial.candidate.effect.parameters if not trial.fit.setup.parameters[n].fixed]
    count = len(free) + own_count(trial.fit)
    return trial.cost + count * max(1.0, trial.fit.chi2) * float(np.log(trial.fit.residual.size))


def class_of(trials: Sequence[Trial], unexplained: bool = False, rule: Selection = SELECTION) -> list[Trial]:
    """The trials that these recordings cannot tell from the best one.

    Two refitted models count as told apart when their sums of squares differ by more than twelve times the residual
    variance: some 3.5 standard deviations for one parameter. Where even the best leaves something real unexplained,
    that remainder may favour either, and a difference of less than a fifth decides nothing.

    What recordings add in a measure of their own counts as many residual variances as it has coefficients. An effect of
    which the best is a special case, and which did not come first, adds nothing: it is no member.

    Args:
        trials: best first.
        unexplained: whether the best refit leaves a significant remainder; a large one counts in any case.
        rule: when two refits are equally good.
    """
    best = trials[0]
    if best.fit is None:
        return list(trials[:1])
    undecided = unexplained or best.fit.chi2 > rule.small_residual**2
    reach = max(tie(best.fit, rule.tie), rule.tie_of_remainder * best.fit.beyond_noise if undecided else 0.0)
    name, most = best.candidate.effect.name, best.fair_cost + reach
    return [t for t in trials if t.fair_cost <= most and name not in t.candidate.effect.special_names]


def simplest_first(tied: Sequence[Trial]) -> list[Trial]:
    """Trials that explain as much, in the order of `phnn.diagnose.formula.simplest_first`."""
    if min(tied, key=lambda t: t.cost).fit is None:
        return list(tied)
    order = [id(fit) for fit in formula.simplest_first([t.fit for t in tied if t.fit is not None])]
    return sorted(tied, key=lambda t: order.index(id(t.fit)) if t.fit is not None else len(order))
