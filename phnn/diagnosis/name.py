"""The name of the mismatch: the supremum of the score over the catalogue and its shape grids, against its null.

For a candidate at one grid point the direction ``d`` is the change of the output when the effect is added, with base
parameters, zeros and initial states projected out. The score is ``dᵀr/√(dᵀRd)``, ``R`` the stated correlation of noise;
shape parameters are not identified at strength zero, hence the supremum over their grid (Davies 1987). Its null is
drawn from Gaussian scores with the correlation of the directions, no simulation needed.

Lines, which are sought at thousands of frequencies, have a null of their own. Lines get half of the significance level,
directions the other half; each p-value is therefore doubled (Bonferroni), and many directions do not hide a line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.linearised import LinearisedFit, direction
from phnn.diagnose.locations import Responses
from phnn.diagnose.noise import Colour, as_normal, by_blocks, clipped, contradicts
from phnn.diagnosis.lines import line_scores
from phnn.effects import Effect

Array = NDArray[np.float64]

_DRAWS = 100_000
_CHUNK = 10_000
# Directions and lines: each has its share of the level.
_FAMILIES = 2.0

_Ranked = TypeVar("_Ranked")


@dataclass(frozen=True)
class Candidate:
    """One effect at the grid point where its score is largest.

    Attributes:
        effect: which.
        values: parameter values at which the data ask for it, strength estimated from the score.
        others: further starting values, from other grid points.
        score: supremum over the grid, in units of the stated noise.
        p_value: of the supremum in units of the noise as the residuals have it, under the null of the supremum over all
            directions, or over all lines.
    """

    effect: Effect
    values: dict[str, float]
    others: tuple[dict[str, float], ...]
    score: float
    p_value: float


@dataclass(frozen=True)
class Naming:
    """All candidates, best first; the overall supremum, and the smaller p-value of directions and lines; the largest
    score by numerical error.

    Attributes:
        generic: largest score of what is no effect: of a generic local function (also under the null of the supremum),
            or of a line in a single recording.
        numerical: largest score that the numerical error alone has along a direction.
    """

    candidates: tuple[Candidate, ...]
    statistic: float
    p_value: float
    generic: float
    numerical: float

    @property
    def by_name(self) -> dict[str, Candidate]:
        """The best form of every effect, best first."""
        return first_by_name(self.candidates, lambda c: c.effect)


# Scores that nobody has computed.
NOT_JUDGED = Naming((), float("nan"), float("nan"), float("nan"), 0.0)


def first_by_name(ranked: Iterable[_Ranked], effect_of: Callable[[_Ranked], Effect]) -> dict[str, _Ranked]:
    """Of what has a rank and an effect, the first of every name, in order: two forms of an effect have one name."""
    found: dict[str, _Ranked] = {}
    for item in ranked:
        found.setdefault(effect_of(item).name, item)
    return found


def score(
    linearised: LinearisedFit,
    effects: Sequence[Effect],
    generic: Responses | None,
    seed: int,
    error: Array | None = None,
) -> Naming:
    """Score the effects of a catalogue on a linearised, those that can be added to its model.

    Args:
        generic: responses of local functions, which take part in the supremum: what no catalogue lists is noticed too.
        seed: of the draws from the null.
        error: (N,) weighted numerical error of the simulations.
    """
    able = [e for e in effects if e.can_be_added_to(linearised.fit.setup)]
    colour = Colour(linearised)
    lines = line_scores(linearised, able, colour)
    points, d = _directions(linearised, [e for e in able if all(e is not c.effect for c in lines.candidates)], generic)
    power = colour.stated(d)
    alive = power > 1e-16 * max(float(power.max(initial=0.0)), 1e-300)
    scale = np.where(alive, 1.0 / np.sqrt(np.maximum(power, 1e-300)), 0.0)
    along = d.T @ linearised.residual
    scores = scale * along
    sided = np.array([e.one_sided for e, _ in points] + [False] * (d.shape[1] - len(points)))
    value = np.where(sided, np.maximum(scores, 0.0), np.abs(scores))
    # Scores are in units of the stated noise; their probability is that under the noise as the residual shows it.
    colour_left = colour.left(d)
    covariance = colour_left * np.outer(scale, scale)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    null = _null_of_supremum(covariance / np.outer(spread, spread), sided, seed)
    judged_by = np.where(alive, deviates(colour, d, colour_left, power), 0.0)
    # Never more than the stated noise grants.
    judged = np.minimum(np.where(sided, np.maximum(judged_by, 0.0), np.abs(judged_by)), value)
    squares = np.einsum("ij,ij->j", d, d)
    strengths = along / np.maximum(squares, 1e-300)
    # What changes nothing saves nothing either, but there is no way from there.
    saved = np.where(alive, squares * (2.0 * strengths - 1.0), -np.inf)
    candidates = _best_of_each(points, value, judged, strengths, saved, null)
    candidates += [
        Candidate(c.effect, c.values, (), c.deviate, _shared(lines.tail(c.judged))) for c in lines.candidates
    ]
    fake = 0.0 if error is None else float(np.abs(scale * (d.T @ linearised.project(error))).max(initial=0.0))
    return Naming(
        candidates=tuple(sorted(candidates, key=lambda c: -c.score)),
        statistic=max(float(value.max(initial=0.0)), lines.statistic),
        p_value=_shared(min(tail(null, float(judged.max(initial=0.0))), lines.tail(lines.judged))),
        generic=max(float(value[len(points) :].max(initial=0.0)), lines.single[0]),
        numerical=fake,
    )


def deviates(colour: Colour, columns: Array, covariance: Array, stated: Array | None = None) -> Array:
    """(C,) normal deviates of the scores along columns (N, C), the smaller one of two: under stationary noise of
    the residual's spectrum, and as blocks show it where there are enough of them.

    Args:
        covariance: `left` of the columns; stated: their `stated` variances, where they are known already.
    """
    stated = colour.stated(columns) if stated is None else stated
    left = np.diag(covariance)
    linearised = colour.linearised
    residual = clipped(linearised.residual, linearised.slices, linearised.noise)
    spread = np.sqrt(np.maximum(left, stated))
    stationary = columns.T @ residual / np.maximum(spread, 1e-300)
    size, more = np.abs(stationary), left > stated
    known_by = colour.freedom(columns[:, more])
    contradicted = contradicts(left[more] / np.maximum(stated[more], 1e-300), known_by)
    size[more] = np.where(contradicted, as_normal(size[more], known_by), size[more])
    t, freedom = (np.abs(x) for x in by_blocks(columns, residual, linearised.slices, linearised.noise))
    blocked = as_normal(t, freedom)
    rule = linearised.noise
    believed = np.where(freedom >= rule.block_freedom, np.clip(blocked, size / rule.uneven, size), size)
    return np.asarray(np.sign(stationary) * believed)


def _directions(
    linearised: LinearisedFit, effects: Sequence[Effect], generic: Responses | None
) -> tuple[list[tuple[Effect, dict[str, float]]], Array]:
    """The points of all grids, and their directions (N, C), those of local functions last."""
    points = [(e, v) for e in effects for v in e.grid(linearised.scales)]
    directions = [direction(linearised, e, v) for e, v in points]
    return points, linearised.project(np.column_stack([*directions, *([generic.tests] if generic is not None else [])]))


def _best_of_each(
    points: Sequence[tuple[Effect, dict[str, float]]],
    value: Array,
    judged: Array,
    strengths: Array,
    saved: Array,
    null: Array,
) -> list[Candidate]:
    """The candidates; the starts of one whose strength cannot be chosen are those that save most as they are."""
    found = []
    for effect in dict.fromkeys(e for e, _ in points):
        mine = [i for i, (e, _) in enumerate(points) if e is effect]
        rank = value if effect.strength is not None else saved
        order = sorted(mine, key=lambda i: -rank[i])
        starts = [effect.scaled(points[i][1], float(strengths[i])) for i in order]
        best = float(max(value[i] for i in mine))
        p_value = _shared(tail(null, float(max(judged[i] for i in mine))))
        found.append(Candidate(effect, starts[0], tuple(starts[1:3]), best, p_value))
    return found


def _shared(p_value: float) -> float:
    """The p-value of a score of directions, or of lines, where both together have one level; at most 1."""
    return min(_FAMILIES * p_value, 1.0)


def _null_of_supremum(correlation: Array, sided: Array, seed: int) -> Array:
    """(draws,) sorted suprema of Gaussian scores with the given correlation."""
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # Those that count on either side come last.
    order, both = np.argsort(np.logical_not(sided), kind="stable"), int(sided.sum())
    root = root[order][:, values > 1e-10 * max(values.max(initial=0.0), 1e-300)]
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(_DRAWS // _CHUNK):
        z = root @ rng.standard_normal((root.shape[1], _CHUNK))
        found.append(np.maximum(z.max(axis=0, initial=0.0), -z[both:].min(axis=0, initial=0.0)))
    return np.sort(np.concatenate(found))


def tail(null: Array, value: float) -> float:
    """Share of the null at or above a value, never below one over the number of draws."""
    above = null.size - int(np.searchsorted(null, value, side="left"))
    return (above + 1.0) / (null.size + 1.0)
