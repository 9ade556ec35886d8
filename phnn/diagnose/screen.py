"""The screen: how much χ² would fall with each candidate, from one linearisation of a fitted model.

For a candidate at a point of its grid, the direction ``d`` is the change of the output when a little of it is added to
the base model. With the sensitivities of a model projected out of ``d`` and of its residual ``r``,

    strength  s = dᵀr / dᵀd,      fall of χ² = s dᵀr,      score  |dᵀr| / √(Σ_b (d_bᵀ r_b − s d_bᵀ d_b)²)

where ``b`` are some twenty blocks of each recording: the residual itself shows how a score scatters, whatever the
colour of the noise (White 1980). A learned element has one direction for each of its strengths; these are found
together, inside their bounds.

Directions are computed once, at the base model, and used again for every larger model, whose own sensitivities are
projected out: what an element changes hardly depends on the others. One screen after the first is then one product of
matrices.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.special import ndtr, ndtri_exp
from scipy.stats import chi2

from phnn.criteria import Criteria
from phnn.diagnose.linearised import LinearisedFit, direction
from phnn.diagnose.lines import own_score, strongest_line, wavelengths
from phnn.diagnose.refit import clamped
from phnn.effects import Effect
from phnn.identification.covariance import noise_spectra
from phnn.identification.fit import variables_from
from phnn.identification.problem import Problem, without_nuisances
from phnn.recordings.recording import Recording
from phnn.rescue import attempt
from phnn.setup import Own

Array = NDArray[np.float64]

# Blocks of a recording, and the fewest samples of one.
_BLOCKS, _SAMPLES = 20, 50
# A direction of which the model leaves no more than this share of its square is explained by it.
_FREE = 1e-9


@dataclass(frozen=True)
class Candidate:
    """An element that may be added to a model.

    Attributes:
        effect: which.
        values: of its parameters, from which a refit begins.
        fall: predicted fall of χ²; score: in standard deviations of what blocks of the recordings show.
        share: predicted fall of χ² over the number of samples, mean over the recordings.
        tries: directions of which it is the best.
    """

    effect: Effect
    values: dict[str, float]
    fall: float
    score: float
    share: float
    tries: int = 1


def chance(score: float, candidates: Sequence[Candidate]) -> float:
    """Return the p-value of the largest score of candidates: that of a normal deviate, times the directions that were
    tried (Bonferroni)."""
    return min(1.0, 2.0 * sum(c.tries for c in candidates) * float(ndtr(-score)))


@dataclass(frozen=True)
class _Directions:
    """What one candidate changes: a column for each point of its grid, or for each of its strengths.

    Attributes:
        points: values of its parameters, by column; one for all columns of strengths.
        columns: (N, C) weighted changes of the output, in single precision.
        bounds: (2, C) of the strengths, from where they begin; None where columns are points.
    """

    effect: Effect
    points: tuple[dict[str, float], ...]
    columns: NDArray[np.float32]
    bounds: Array | None = None


@dataclass
class Screen:
    """All candidates with their directions at a base model.

    Attributes:
        base: the base model.
        effects: all candidates, the learned elements among them.
        criteria: what is material.
    """

    base: LinearisedFit
    effects: Sequence[Effect]
    criteria: Criteria
    _known: dict[tuple[int, float], tuple[Effect, _Directions | None]] = field(default_factory=dict)

    def __call__(self, model: LinearisedFit) -> list[Candidate]:
        """Return the candidates that can be added to a model, the largest predicted fall first."""
        setup = model.fit.setup
        able = [e for e in self.effects if e.can_be_added_to(setup)]
        # Lines and drifts have no direction that is common to all recordings.
        alone = [e for e in able if e.searched is not None or _is_of_recordings(e, model)]
        waves = [e for e in able if e.wavelength]
        candidates: list[Candidate] = attempt("scores of lines", lambda: self._of_recordings(model, alone), [])
        candidates += attempt("scores of waves", lambda: self._of_waves(model, waves), [])
        ordinary = [e for e in able if e not in alone and e not in waves]
        candidates += self._along(model, [d for d in map(self._directions, ordinary) if d is not None])
        return sorted(candidates, key=lambda c: -c.fall)

    def _of_recordings(self, model: LinearisedFit, effects: Sequence[Effect]) -> list[Candidate]:
        """Return the lines and drifts that take something material from the residual.

        A line, whose amplitude and phase each recording has of its own, is scored out of what lies beside it in the
        spectrum, and so is the line of one source whose frequency is searched there.
        """
        spectra, candidates = model.spectra, []
        for effect in effects:
            points = effect.grid(model.scales)
            if effect.searched is not None:
                frequency, stated, judged = strongest_line(spectra)
                placed = [p | {effect.searched: frequency} for p in points]
                columns = model.project(np.column_stack([direction(model, effect, v) for v in placed]))
                weights = np.linalg.lstsq(columns, model.residual, rcond=_FREE)[0]
                both = {n: float(sum(w * v[n] for w, v in zip(weights, placed, strict=True))) for n in points[0]}
                scored = [(stated, judged, both | {effect.searched: frequency})]
            else:
                each = [(v, effect.add_to(model.fit.setup, v).own) for v in points]
                each = [(v, nuisances) for v, nuisances in each if _taken(nuisances, model) > self.criteria.material**2]
                scored = [(*own_score(model, nuisances, spectra), v) for v, nuisances in each]
            if scored:
                stated, judged, values = max(scored, key=lambda s: s[:2])
                candidates.append(Candidate(effect, values, stated**2, judged, stated**2 / model.residual.size))
        return candidates

    def _of_waves(self, model: LinearisedFit, effects: Sequence[Effect]) -> list[Candidate]:
        """Return each learned wave with its most promising period of the few that stand out of the residual."""
        lengths = wavelengths(model) if effects else []
        known = [d for e in effects for length in lengths if (d := self._directions(e, length)) is not None]
        best = {c.effect: c for c in sorted(self._along(model, known), key=lambda c: c.fall)}
        return list(best.values())

    def _along(self, model: LinearisedFit, known: Sequence[_Directions]) -> list[Candidate]:
        """Return the candidates of some directions with their predicted falls."""
        if not known:
            return []
        blocks = _blocks(model.slices)
        edges = np.cumsum([0, *(d.columns.shape[1] for d in known)])
        basis, residual = model.basis, model.residual
        both = np.column_stack([basis, residual])
        each: list[tuple[Array, Array, Array]] = []
        for b in blocks:
            columns = np.concatenate([d.columns[b] for d in known], axis=1, dtype=np.float64)
            each.append((both[b].T @ columns, np.einsum("ij,ij->j", columns, columns), both[b].T @ both[b]))
        share = np.sum([inside[:-1] for inside, _, _ in each], axis=0)
        raw = np.sum([size for _, size, _ in each], axis=0)
        # Of the projected columns d − Q Qᵀd, block by block.
        along = np.array([inside[-1] - share.T @ square[:-1, -1] for inside, _, square in each])
        squares = np.array(
            [
                size - np.einsum("kj,kj->j", share, 2.0 * inside[:-1] - square[:-1, :-1] @ share)
                for inside, size, square in each
            ]
        )
        free = squares.sum(axis=0) > _FREE * np.maximum(raw, 1e-300)
        owner = _owners(blocks, model.slices)
        candidates = []
        for directions, first, last in zip(known, edges[:-1], edges[1:], strict=True):
            mine = slice(int(first), int(last))
            if directions.bounds is not None:
                candidates.append(self._together(model, directions, share[:, mine], blocks, owner))
            elif free[mine].any():
                candidates.append(_best_point(directions, along[:, mine], squares[:, mine], free[mine], owner))
        return candidates

    def _directions(self, effect: Effect, length: float = 0.0) -> _Directions | None:
        """Return the directions of a candidate, of a wave with a period ``length`` along the position; computed where
        they are not known."""
        if (key := (id(effect), length)) not in self._known:
            # A further copy changes the output as it would alone.
            alone = replace(effect, after=())
            work = self._of_strengths if len(effect.all_strengths) > 1 else self._of_points
            placed = {effect.wavelength: length} if length else {}

            def made() -> _Directions:
                return replace(work(alone, [p | placed for p in effect.grid(self.base.scales)]), effect=effect)

            able = alone.can_be_added_to(self.base.fit.setup)
            self._known[key] = effect, attempt(f"directions of {effect.name}", made, None) if able else None
        return self._known[key][1]

    def _of_points(self, effect: Effect, points: Sequence[dict[str, float]]) -> _Directions:
        columns = [direction(self.base, effect, v).astype(np.float32) for v in points]
        return _Directions(effect, tuple(points), np.column_stack(columns))

    def _of_strengths(self, effect: Effect, points: Sequence[dict[str, float]]) -> _Directions:
        fit, values = self.base.fit, points[0]
        setup = clamped(effect, fit.setup, values)
        names = [n for n in effect.all_strengths if not setup.parameters[n].fixed]
        plan = self.base.plan.coarse()
        problem = Problem(setup, plan, variables_from(setup, plan, names, fit))
        start = problem.variables.start(setup)
        columns = -problem.jacobian(start)[:, : len(names)].astype(np.float32)
        zero = np.array([setup.parameters[n].to_coordinate(setup.parameters[n].value) for n in names])
        lower, upper = (b[: len(names)] - zero for b in problem.variables.bounds(setup))
        bounds = np.array([np.minimum(lower, -1e-12), np.maximum(upper, 1e-12)])
        return _Directions(effect, (values,), columns, bounds)

    def _together(
        self, model: LinearisedFit, directions: _Directions, share: Array, blocks: Sequence[slice], owner: Array
    ) -> Candidate:
        """Return a learned element with all its strengths fitted inside their bounds."""
        bounds = directions.bounds
        assert bounds is not None
        columns = directions.columns.astype(np.float64) - model.basis @ share
        square = np.asarray(np.linalg.qr(np.column_stack([columns, model.residual]), mode="r"))
        strengths = lsq_linear(square[:, :-1], square[:, -1], (bounds[0], bounds[1]), method="bvls").x
        along, squares = _by_blocks(columns @ strengths, model.residual, blocks)
        candidate = _candidate(directions.effect, directions.points[0], along, squares, 1.0, owner)
        # Several strengths take more of pure noise than one, the more so where its colour is not known.
        tail = chi2.logsf(max(candidate.fall, 0.0) / _excess_along(model, columns @ strengths), columns.shape[1])
        return replace(candidate, score=min(candidate.score, max(0.0, float(-ndtri_exp(min(tail, -1e-12))))))


def _excess_along(model: LinearisedFit, column: Array) -> float:
    """Return the power of the noise along a column (N,) as the residual has it, over that which was stated, where no
    recording shows the colour of its noise; 1 otherwise."""
    recordings, slices = model.plan.recordings, model.slices
    if not all(r.colour_unseen for r in recordings):
        return 1.0
    spectra = noise_spectra([model.residual[rows] for rows in slices], recordings)
    power = sum(float(s.covariance(column[rows, None])[0, 0]) for s, rows in zip(spectra, slices, strict=True))
    return max(1.0, power / max(float(column @ column), 1e-300))


def _is_of_recordings(effect: Effect, model: LinearisedFit) -> bool:
    """Return whether an effect is a term that every recording has of its own."""
    setup = model.fit.setup
    return bool(effect.add_to(setup, effect.grid(model.scales)[0]).own != setup.own)


def _taken(nuisances: Own, model: LinearisedFit) -> float:
    """Return the mean square that terms of every recording take from the residual."""
    rows = zip(model.plan.recordings, model.slices, strict=True)
    cost = sum(float(np.sum(_beside(model.fit.residual[s], r, nuisances) ** 2)) for r, s in rows)
    return (model.fit.cost - cost) / model.fit.residual.size


def _beside(residual: Array, recording: Recording, nuisances: Own) -> Array:
    """Return the residual (N,) of a recording's fitted samples without the terms that are its own."""
    mask = recording.mask("identification")
    values = np.zeros(mask.size)
    values[mask] = residual
    return without_nuisances(values, mask, recording, nuisances)


def _blocks(slices: Sequence[slice]) -> list[slice]:
    """Return some twenty blocks of neighbouring samples of each recording, none of them very short."""
    blocks = []
    for rows in slices:
        count = min(_BLOCKS, max(1, (rows.stop - rows.start) // _SAMPLES))
        edges = np.linspace(rows.start, rows.stop, count + 1).round().astype(int)
        blocks += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return blocks


def _owners(blocks: Sequence[slice], slices: Sequence[slice]) -> Array:
    """Return (B, R) one where a block belongs to a recording, over the recording's number of samples."""
    starts = np.array([s.start for s in slices])
    recording = np.searchsorted(starts, [b.start for b in blocks], side="right") - 1
    lengths = np.array([s.stop - s.start for s in slices], dtype=float)
    return np.eye(len(slices))[recording] / lengths


def _by_blocks(column: Array, residual: Array, blocks: Sequence[slice]) -> tuple[Array, Array]:
    """Return (B,) products of a column with a residual, and with itself."""
    edges = [b.start for b in blocks]
    return np.add.reduceat(column * residual, edges), np.add.reduceat(column**2, edges)


def _best_point(
    directions: _Directions, along: Array, squares: Array, free: NDArray[np.bool_], owner: Array
) -> Candidate:
    """Return the candidate at the point of its grid with the largest predicted fall."""
    effect = directions.effect
    total, size = along.sum(axis=0), np.maximum(squares.sum(axis=0), 1e-300)
    strengths = total / size
    # A limit is there or not, and one that is met too early has the right direction all the same.
    positive = effect.one_sided or effect.strength is None
    falls = np.where(free & ((total > 0.0) | (not positive)), total * strengths, 0.0)
    best = int(np.argmax(falls))
    values = effect.scaled(directions.points[best], float(strengths[best]))
    strength = float(strengths[best]) if falls[best] > 0.0 else 0.0
    candidate = _candidate(effect, values, along[:, best], squares[:, best], strength, owner)
    return replace(candidate, tries=len(directions.points))


def _candidate(
    effect: Effect, values: Mapping[str, float], along: Array, squares: Array, strength: float, owner: Array
) -> Candidate:
    """Return a candidate that is added at some strength to one direction, given by its products (B,) with the
    residual and with itself, block by block."""
    falls = 2.0 * strength * along - strength**2 * squares
    fall, total = float(falls.sum()), float(along.sum())
    likeliest = total / max(float(squares.sum()), 1e-300)
    scatter = float(np.sqrt(np.sum((along - likeliest * squares) ** 2)))
    score = min(abs(total) / max(scatter, 1e-300), max(fall, 0.0) ** 0.5)
    return Candidate(effect, dict(values), fall, score, float((falls @ owner).mean()))
