"""A formula in the place of a learned element as a model that predicts new recordings, to first order.

Around the fit with the element a formula's forces ``f`` predict

    y = y_fit + B z + R (f − f_element)

with the responses ``R`` of the output to forces on the moving part, the sensitivities ``B`` of all other variables, and
their shift ``z`` with which the formula fits the recordings at hand best.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.proposal import FAR, Bench, Predicted, Rival, bounded, everything
from phnn.diagnosis.distil.response import Target, element_force, pushed
from phnn.diagnosis.distil.search import Formula, forces_of, in_slopes
from phnn.effects import Effect, Scales

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FormulaRival(Rival):
    """A formula that stands for a learned element.

    Attributes:
        element: which it replaces; formula: what replaces it; scales: of its reference displacement and speed.
        kept: variables of the fit that do not belong to the element; shift: (K',) by which they move.
    """

    element: Effect
    formula: Formula
    scales: Scales
    kept: tuple[int, ...]
    shift: Array

    def predicted(self, bench: Bench) -> Predicted:
        """See `phnn.diagnose.proposal.Rival.predicted`; coordinates are the kept variables, sizes and free shapes."""
        trajectory, moved = bench.simulated(self.fit, self.variables)
        base = moved[:, list(self.kept)]
        setup, element = self.fit.setup, self.element
        learned = pushed(trajectory, lambda q, v: element_force(setup, element, q, v)[:, None])[:, 0]
        units = pushed(trajectory, forces_of(self.scales, in_slopes(self.formula)))
        sized, slopes = _coordinates(self.formula, units)
        y = trajectory.y + base @ self.shift + sized.sum(axis=1) - learned
        return Predicted(y, np.hstack([base, sized, slopes]))


def formula_rival(goal: Target, element: Effect, formula: Formula, name: str) -> FormulaRival:
    """A formula as a rival.

    Args:
        goal: what the recordings at hand say of the element's force.
        element: of the fit around which the goal is linear.
        formula: found for it.
        name: the formula in words.
    """
    fit = goal.linearised.fit
    variables, slopes = everything(fit)
    kept = tuple(i for i in range(slopes.shape[1]) if i >= len(variables.names) or _stays(variables.names[i], element))
    # The derivatives of the residual are those of the output, with the other sign.
    base = -slopes[:, list(kept)]
    sized, shaped = _coordinates(formula, goal.columns(forces_of(goal.linearised.scales, in_slopes(formula))))
    least = np.concatenate([base, np.eye(base.shape[1]) / FAR])
    wanted = np.concatenate([goal.wanted - sized.sum(axis=1), np.zeros(base.shape[1])])
    shift = np.linalg.lstsq(least, wanted, rcond=None)[0]
    known, count = bounded(np.hstack([base, sized, shaped])), base.shape[1]
    own = tuple(range(count, known.shape[1]))
    return FormulaRival(name, fit, variables, known, own, element, formula, goal.linearised.scales, kept, shift)


def _stays(name: str, element: Effect) -> bool:
    return name not in element.parameters


def _coordinates(formula: Formula, units: Array) -> tuple[Array, Array]:
    """Derivatives by relative changes of the sizes (N, T), and by the free shapes (N, S).

    Args:
        units: (N, T + S) responses to the terms and to their slopes, as `in_slopes` lists them.
    """
    count = len(formula.terms)
    free = [i for i, fixed in enumerate(formula.fixed) if not fixed]
    owners = np.repeat(np.arange(count), [len(t.shapes) for t in formula.terms])
    slopes = units[:, count:] * formula.sizes[owners]
    return units[:, :count] * formula.sizes, slopes[:, free]
