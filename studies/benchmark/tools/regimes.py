"""Operating regimes of recordings, and the clean ones among them: those that a model without the missing physics fits.

Regimes are the recordings, or stretches of time where there is one. The clean ones are found by concentration, as for
least trimmed squares (Rousseeuw & Van Driessen 2006, Data Min. Knowl. Discov. 12): the parameters are refitted, to
first order, to a few regimes, all are ranked by what is left, and the best half is taken until it stays the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

from phnn.diagnosis.linearised_fit import LinearisedFit, prepare
from phnn.identification.fit import Fit, fit, fit_problem, unidentified, variables_from
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.recordings.recording import Part, Recording, dominant_frequency

Array = NDArray[np.float64]

# Stretches of a single recording; rounds of concentration; simulations of a refit.
_STRETCHES, _ROUNDS, _REFIT = 8, 20, 15
# Share of all samples that is clean at least, and the false discovery rate of flags.
_CLEAN, _RATE = 0.5, 0.05
# Mean square over that of the clean regimes from which on a flag matters: noise of unknown colour stays below.
_MATTERS = 3.0


def whole(plan: Plan) -> Plan:
    """The plan with every sample for identification: the method splits them itself."""
    return replace(plan, recordings=tuple(_with_parts(r, [(0, r.t.size)]) for r in plan.recordings))


def evaluated(fitted: Fit, plan: Plan) -> LinearisedFit:
    """A fitted model on other samples: residual, Jacobian and trajectories, with no step of a fit."""
    variables = variables_from(fitted.setup, plan, fitted.variables.names, fitted)
    return prepare(fit_problem(Problem(fitted.setup, plan, variables), fitted.held, 1))


def regimes(linearised: LinearisedFit) -> list[slice]:
    """Rows of every regime in the stacked arrays."""
    if len(linearised.slices) > 1:
        return linearised.slices
    (rows,) = linearised.slices
    edges = np.linspace(rows.start, rows.stop, _STRETCHES + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]


def clean(linearised: LinearisedFit) -> list[int]:
    """Places of the clean regimes, at least half of the samples, in the order of `regimes`.

    Three sets to begin with compete: the smallest residuals, the smallest inputs and the slowest inputs.
    """
    found = regimes(linearised)
    starts = [_energies(linearised, range(len(found))), *_orders(linearised, found)]
    ends = [_concentrated(linearised, found, order) for order in starts]
    return min(ends, key=lambda chosen: _share(linearised, found, chosen))


def _orders(linearised: LinearisedFit, found: Sequence[slice]) -> list[Array]:
    """(R,) amplitude and frequency of the input in every regime; where there is one recording, in its stretches."""
    recordings = linearised.plan.recordings
    if len(recordings) == 1:
        pieces = [recordings[0].only(rows) for rows in found]
    else:
        pieces = list(recordings)
    return [np.array([np.ptp(r.u) for r in pieces]), np.array([dominant_frequency(r) for r in pieces])]


def _concentrated(linearised: LinearisedFit, found: Sequence[slice], order: Array) -> list[int]:
    chosen = _best(found, order)
    for _ in range(_ROUNDS):
        better = _best(found, _energies(linearised, chosen))
        if better == chosen:
            break
        chosen = better
    return chosen


def _best(found: Sequence[slice], order: Array) -> list[int]:
    """The first regimes in an order, until they hold enough samples."""
    sizes = np.array([rows.stop - rows.start for rows in found])
    ranked = np.argsort(order, kind="stable")
    count = int(np.searchsorted(np.cumsum(sizes[ranked]), _CLEAN * sizes.sum())) + 1
    return sorted(int(i) for i in ranked[:count])


def _step(linearised: LinearisedFit, found: Sequence[slice], chosen: Sequence[int]) -> Array:
    """(N,) residual after a refit of all parameters, to first order, to some regimes."""
    r, j = linearised.fit.residual, linearised.fit.jacobian
    rows = np.concatenate([np.arange(found[i].start, found[i].stop) for i in chosen])
    sizes = np.maximum(np.linalg.norm(j, axis=0), 1e-300)
    # Directions that these regimes hardly show stay as they are.
    step = np.linalg.lstsq(j[rows] / sizes, -r[rows], rcond=1e-3)[0]
    return np.asarray(r + j / sizes @ step)


def _energies(linearised: LinearisedFit, chosen: Sequence[int]) -> Array:
    """(R,) mean square that a refit to some regimes leaves in each."""
    found = regimes(linearised)
    left = _step(linearised, found, chosen)
    return np.array([float(np.mean(left[rows] ** 2)) for rows in found])


def _share(linearised: LinearisedFit, found: Sequence[slice], chosen: Sequence[int]) -> float:
    return float(np.mean(_energies(linearised, chosen)[list(chosen)]))


def refitted(base: Fit, linearised: LinearisedFit, chosen: Sequence[int]) -> Fit:
    """The base model identified from some regimes alone; what these do not identify keeps its value."""
    found, plan = regimes(linearised), linearised.plan
    pieces: dict[int, list[tuple[int, int]]] = {}
    for i in chosen:
        place = i if len(plan.recordings) > 1 else 0
        pieces.setdefault(place, []).append(
            (0, plan.recordings[i].t.size) if len(plan.recordings) > 1 else (found[i].start, found[i].stop)
        )
    few = replace(plan, recordings=tuple(_with_parts(plan.recordings[i], p) for i, p in sorted(pieces.items())))
    names = base.variables.names
    rows = np.concatenate([np.arange(found[i].start, found[i].stop) for i in chosen])
    columns = linearised.fit.jacobian[rows][:, : len(names)]
    dropped = unidentified(columns, list(names))
    return fit(base.setup, few, [n for n in names if n not in dropped], base.held, _REFIT, origin=base)


def flagged(linearised: LinearisedFit, chosen: Sequence[int], covariance: Array) -> list[int]:
    """Regimes whose residual energy is beyond what noise and the parameters' errors give.

    Of each, ``rᵀ(I + J C Jᵀ)⁻¹r / N`` over the mean square of the clean regimes has an F distribution where nothing is
    missing; the false discovery rate is that of Benjamini & Hochberg (1995, J. R. Stat. Soc. B 57).

    Args:
        linearised: at the estimates of the clean regimes ``chosen``; covariance: (K, K) of these, for unit noise.
    """
    found, r, j = regimes(linearised), linearised.fit.residual, linearised.fit.jacobian
    floor = [r[found[i]] for i in chosen]
    size = sum(x.size for x in floor)
    noise = sum(float(x @ x) for x in floor) / max(size - j.shape[1], 1)
    root = np.linalg.cholesky(covariance + 1e-12 * np.trace(covariance) * np.eye(covariance.shape[0]) + 1e-300)
    p_values, matters = np.ones(len(found)), set[int]()
    for i, rows in enumerate(found):
        if i in chosen:
            continue
        columns = j[rows] @ root
        inner = columns.T @ r[rows]
        energy = float(r[rows] @ r[rows] - inner @ np.linalg.solve(np.eye(inner.size) + columns.T @ columns, inner))
        n = rows.stop - rows.start
        p_values[i] = float(fisher.sf(energy / n / noise, n, max(size - j.shape[1], 1)))
        if energy / n / noise > _MATTERS:
            matters.add(i)
    return [i for i in discoveries(p_values, _RATE) if i in matters]


def discoveries(p_values: Array, rate: float) -> list[int]:
    """Places of the hypotheses that the procedure of Benjamini and Hochberg rejects at a rate."""
    order = np.argsort(p_values)
    below = p_values[order] <= rate * np.arange(1, order.size + 1) / order.size
    return sorted(int(i) for i in order[: int(np.flatnonzero(below).max(initial=-1)) + 1])


def _with_parts(recording: Recording, pieces: Sequence[tuple[int, int]]) -> Recording:
    parts = tuple(Part(recording.name, first, last, "identification") for first, last in pieces)
    return replace(recording, parts=parts)
