"""A fitted model with its scores, and whether it leaves anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from phnn.criteria import CRITERIA, Criteria, Noise
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.diagnose.locations import Location, Responses, locate, responses
from phnn.diagnosis.name import Naming, score
from phnn.effects import Effect, Scales
from phnn.identification.fit import Fit
from phnn.identification.refinement import NumericalError

# Level of a whole search, spent once; the default of the criterion `level`. Hypotheses are tested in order: the base
# model is complete, the model with the best element is complete, and so on. The first that is not rejected ends the
# search; the verdict on the remainder is no further test but the last of these. In such a fixed sequence every test may
# use the whole level, because the first false rejection must be that of the first true hypothesis (Maurer, Hothorn &
# Lehmacher 1995).
SIGNIFICANT = CRITERIA.selection.level


@dataclass(frozen=True)
class Scored:
    """A model with its scores: all that a verdict ``none`` needs."""

    linearised: LinearisedFit
    generic: Responses
    naming: Naming
    criteria: Criteria = CRITERIA

    @property
    def significant(self) -> bool:
        """Whether the model leaves more than chance would."""
        return self.naming.p_value < self.criteria.selection.level

    @cached_property
    def remaining(self) -> Location | None:
        """Where what it leaves seems to be; None where that is no more than chance."""
        return locate(self.linearised, self.generic, self.criteria.location) if self.significant else None


def scored(
    fitted: Fit,
    effects: Sequence[Effect],
    seed: int,
    error: NumericalError | None = None,
    terminals: bool = False,
    criteria: Criteria = CRITERIA,
    reach: Scales | None = None,
) -> Scored:
    """Score the catalogue and the generic functions on a model.

    Where it leaves a large residual that no noise explains, a few recordings that lie far apart say as well as all of
    them what may be missing; the numerical error is asked of all.

    Args:
        fitted: the base model, or one with effects.
        effects: the catalogue entries that can exist in this setup.
        seed: of the null distribution.
        error: numerical error of the simulations, where the score that it alone would have is asked.
        terminals: whether the input was measured at the port.
        criteria: for the noise, for locations and for what is significant.
        reach: scales of further recordings that a model has to predict.
    """
    large = fitted.chi2 > criteria.race.large_residual**2
    few = large and error is None
    linearised, generic, naming = _scores(fitted, tuple(effects), seed, error, terminals, criteria.noise, few, reach)
    return Scored(linearised, generic, naming, criteria)


def _scores(
    fitted: Fit,
    effects: tuple[Effect, ...],
    seed: int,
    error: NumericalError | None,
    terminals: bool,
    noise: Noise,
    few: bool,
    reach: Scales | None,
) -> tuple[LinearisedFit, Responses, Naming]:
    linearised = prepare(fitted, terminals, noise, reach)
    generic = responses(linearised)
    if few:
        subset = linearised.on_subset()
        return linearised, generic, score(subset, effects, generic if subset is linearised else responses(subset), seed)
    return linearised, generic, score(linearised, effects, generic, seed, error.error if error is not None else None)


def excess(fit: Fit) -> float:
    """Sum of squares above what noise of the stated floor leaves."""
    return fit.cost - (fit.residual.size - fit.jacobian.shape[1])
