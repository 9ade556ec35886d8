"""Localised, identifiable, sparse discovery of the discrepancy (LISDD) as a tool.

After Wang (2026, arXiv 2606.23215), whose steps are: identify the known physics in a clean regime that is found
automatically; flag the regimes whose residual energy is too large; select the missing term by exhaustive hold-out over
a library; confirm it by an F-test on samples of their own. The paper's text was not at hand but for its abstract and
summaries, and its examples are static regressions. This implementation carries it over to a dynamic model:

* regimes are recordings, or eighths of a single one; the clean ones hold half of the samples;
* the library is the catalogue at every point of its grids, as responses of the output to first order; pairs are
  built on the two best single terms. The names that gain most are refitted by simulation, all where the samples are few
  and 5 otherwise, before they are ranked;
* of every recording, stretches take turns to be fitted, held out, and tested;
* base parameters move freely in both models of the F-test, so that their errors are not taken for missing physics;
  residuals are made white by an autoregression of fourth order; the level is divided by the number of names tried.

Settings were chosen on cases of a benchmark of seed 903 that was written for that purpose.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import f as fisher
from scipy.stats import false_discovery_control

from phnn.diagnose.diagnosis import available
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.refit import clamped
from phnn.effects import Effect
from phnn.errors import InputRefused, PhnnError
from phnn.identification.fit import Fit, fit, unidentified
from phnn.identification.plan import Plan
from phnn.recordings.recording import dominant_frequency
from phnn.setup import Setup
from studies.benchmark.bench import Answer
from studies.benchmark.tools.common import (
    Candidate,
    base_of,
    evaluated,
    in_turns,
    left,
    library,
    orthonormal,
    places_of,
    predictions,
    whole,
    with_parts,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# What stretches of a recording are for, in turn, and how many stretches there are.
_USES, _STRETCHES = ("identification", "held", "test"), 12
# Simulations of a refit; names that are refitted where the samples are few, and where they are not; how few they are.
_REFIT, _MOST, _FEW, _SMALL = 25, 34, 5, 10_000
# Singles to which a second effect is added where the samples are few, the share of what the base model leaves that they
# may leave, and the mean square of what is held out above which it is tried.
_PAIRED, _FIRST, _NOISE = 2, 0.85, 1.25
# Share of what the best single leaves above the noise that a pair has to explain; level of the F-test before it is
# divided by the number of names.
_SECOND, _LEVEL = 0.6, 0.01
# Mean square of what is held out, in units of the noise, beyond which a confirmed term is a substitute.
_SUBSTITUTE = 2.0
# Gains of hold-out are divided by this and by the mean square that the best model leaves, before they are
# probabilities: candidates are wrong in other ways than by noise.
_TEMPERATURE = 8.0
# Probability that nothing is missing where no term is confirmed; of a confirmed term; that the mechanism is not listed
# where the term is a substitute, and where regimes are flagged and no term is confirmed.
_NONE, _CONFIRMED, _UNLISTED, _FLAGGED = 0.85, 0.95, 0.7, 0.6
# Of regimes: stretches of a single recording; rounds of concentration; simulations of a refit; share of all samples
# that is clean at least; false discovery rate of flags; mean square over that of the clean regimes from which on a flag
# matters: noise of unknown colour stays below.
_REGIMES, _ROUNDS, _CLEAN_REFIT, _CLEAN, _RATE, _MATTERS = 8, 20, 15, 0.5, 0.05, 3.0
_RIDGE = 1e-8  # on the diagonal of normal matrices of columns of unit length
_RANK = 1e-10  # singular values below this share of the largest are no direction


@dataclass(frozen=True)
class Tried:
    """A subset of the library, refitted; ``left``: sum of squares on the held-out samples."""

    names: frozenset[str]
    fit: Fit
    left: float

    @property
    def size(self) -> int:
        """Samples that are held out."""
        return sum(int(r.mask(_USES[1]).sum()) for r in self.fit.plan.recordings)


def answer(folder: Path, seed: int) -> Answer:
    """Identify in the clean regime, select by hold-out, confirm by the F-test."""
    base = base_of(folder, seed)
    effects = available(base.campaign, base.fit.setup)
    plan = whole(base.fit.plan)
    first = evaluated(base.fit, plan)
    chosen = clean(first)
    clear = _refitted_to(base.fit, first, chosen)
    at_clean = evaluated(clear, plan)
    suspicious = _any_flagged(at_clean, chosen, clear.scatter.covariance)
    tried = _selected(at_clean, base.fit, effects)
    return _answered(tried, base.fit, plan, len({e.canonical for e in effects}), suspicious, folder)


def clean(linearised: LinearisedFit) -> list[int]:
    """Return the numbers of the clean regimes, which hold at least half of the samples.

    They are found by concentration, as for least trimmed squares (Rousseeuw & Van Driessen 2006, Data Min. Knowl.
    Discov. 12): the parameters are refitted, to first order, to a few regimes, all are ranked by what is left, and the
    best half is taken until it stays the same. Three sets to begin with compete: the smallest residuals, the smallest
    inputs and the slowest inputs.
    """
    regimes, recordings = _regimes(linearised), linearised.plan.recordings
    pieces = recordings if len(recordings) > 1 else [recordings[0].only(rows) for rows in regimes]
    orders = [np.array([np.ptp(r.u) for r in pieces]), np.array([dominant_frequency(r) for r in pieces])]
    ends = []
    for order in (_energies(linearised, range(len(regimes))), *orders):
        chosen = _least(regimes, order)
        for _ in range(_ROUNDS):
            better = _least(regimes, _energies(linearised, chosen))
            if better == chosen:
                break
            chosen = better
        ends.append(chosen)
    return min(ends, key=lambda chosen: float(np.mean(_energies(linearised, chosen)[chosen])))


def _regimes(linearised: LinearisedFit) -> list[slice]:
    """Return the rows of every regime in the stacked arrays."""
    if len(linearised.slices) > 1:
        return linearised.slices
    (rows,) = linearised.slices
    edges = np.linspace(rows.start, rows.stop, _REGIMES + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]


def _least(regimes: Sequence[slice], order: Array) -> list[int]:
    """Return the first regimes in an order, until they hold enough samples."""
    sizes = np.array([rows.stop - rows.start for rows in regimes])
    ranked = np.argsort(order, kind="stable")
    number = int(np.searchsorted(np.cumsum(sizes[ranked]), _CLEAN * sizes.sum())) + 1
    return sorted(int(i) for i in ranked[:number])


def _rows(regimes: Sequence[slice], chosen: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([np.arange(regimes[i].start, regimes[i].stop) for i in chosen])


def _energies(linearised: LinearisedFit, chosen: Sequence[int]) -> Array:
    """Return (R,) the mean square that a refit of all parameters, to first order, to some regimes leaves in each."""
    regimes, r, j = _regimes(linearised), linearised.fit.residual, linearised.fit.jacobian
    rows, sizes = _rows(regimes, chosen), np.maximum(np.linalg.norm(j, axis=0), 1e-300)
    # Directions that these regimes hardly show stay as they are.
    step = np.linalg.lstsq(j[rows] / sizes, -r[rows], rcond=1e-3)[0]
    rest = r + j / sizes @ step
    return np.array([float(np.mean(rest[own] ** 2)) for own in regimes])


def _refitted_to(base: Fit, linearised: LinearisedFit, chosen: Sequence[int]) -> Fit:
    """Identify the base model from some regimes alone; what these do not identify keeps its value."""
    regimes, recordings = _regimes(linearised), linearised.plan.recordings
    if len(recordings) > 1:
        few = tuple(recordings[i] for i in chosen)
    else:
        few = (recordings[0],)
        pieces = [with_parts(few[0], [regimes[i].start, regimes[i].stop], _USES[:1]).parts[0] for i in chosen]
        few = (replace(few[0], parts=tuple(pieces)),)
    names = base.variables.names
    columns = linearised.fit.jacobian[_rows(regimes, chosen)][:, : len(names)]
    dropped = unidentified(columns, list(names))
    plan = replace(linearised.plan, recordings=few)
    return fit(base.setup, plan, [n for n in names if n not in dropped], base.held, _CLEAN_REFIT, origin=base)


def _any_flagged(linearised: LinearisedFit, chosen: Sequence[int], covariance: Array) -> bool:
    """Whether a regime's residual energy is beyond what noise and the parameters' errors give.

    Of each, ``rᵀ(I + J C Jᵀ)⁻¹r / N`` over the mean square of the clean regimes has an F distribution where nothing is
    missing; the false discovery rate is that of Benjamini & Hochberg (1995, J. R. Stat. Soc. B 57).

    Args:
        linearised: at the estimates of the clean regimes ``chosen``; covariance: (K, K) of these, for unit noise.
    """
    regimes, r, j = _regimes(linearised), linearised.fit.residual, linearised.fit.jacobian
    floor = r[_rows(regimes, chosen)]
    freedom = max(floor.size - j.shape[1], 1)
    noise = float(floor @ floor) / freedom
    root = np.linalg.cholesky(covariance + 1e-12 * np.trace(covariance) * np.eye(covariance.shape[0]) + 1e-300)
    ratios, p_values = np.zeros(len(regimes)), np.ones(len(regimes))
    for i in (i for i in range(len(regimes)) if i not in chosen):
        own = r[regimes[i]]
        columns = j[regimes[i]] @ root
        inner = columns.T @ own
        energy = float(own @ own - inner @ np.linalg.solve(np.eye(inner.size) + columns.T @ columns, inner))
        ratios[i] = energy / own.size / noise
        p_values[i] = float(fisher.sf(ratios[i], own.size, freedom))
    return bool(((false_discovery_control(p_values) <= _RATE) & (ratios > _MATTERS)).any())


def _selected(linearised: LinearisedFit, base: Fit, effects: Sequence[Effect]) -> list[Tried]:
    """Return the names that predict what is held out best, after a refit; the base model is among them."""
    uses = in_turns(linearised.plan, _STRETCHES, _USES)
    nothing = _tried(frozenset(), base, base.setup, uses, base.variables.names)
    tried = [nothing, *_with_one_more(linearised, nothing, effects, uses)]
    small = linearised.fit.residual.size <= _SMALL
    for single in sorted(tried, key=lambda t: t.left)[: _PAIRED if small else 1]:
        if single.left <= _FIRST * nothing.left and single.left > _NOISE * single.size:
            at_single = evaluated(single.fit, linearised.plan)
            others = [e for e in effects if e.canonical not in single.names and e.can_be_added_to(single.fit.setup)]
            tried += _with_one_more(at_single, single, others, uses)
    return sorted(tried, key=lambda t: t.left)


def _with_one_more(linearised: LinearisedFit, beside: Tried, effects: Sequence[Effect], uses: Plan) -> list[Tried]:
    """Return a model with each of the effects that gain most to first order, refitted from that strength."""
    candidates, columns = library(linearised, effects)
    fitted, held = (np.concatenate([r.mask(u) for r in uses.recordings]) for u in _USES[:2])
    ranked = winners(linearised.fit.residual, linearised.fit.jacobian, columns, fitted, held, candidates)
    most, tried = _MOST if linearised.fit.residual.size <= _SMALL and not beside.names else _FEW, []
    for candidate, coefficient, _ in ranked[:most]:
        try:
            setup = clamped(candidate.effect, beside.fit.setup, candidate.scaled(coefficient))
            own = [n for n in candidate.effect.parameters if not setup.parameters[n].fixed]
            names = beside.names | {candidate.effect.canonical}
            tried.append(_tried(names, beside.fit, setup, uses, [*beside.fit.variables.names, *own]))
        except PhnnError:
            continue
    return tried


def _tried(names: frozenset[str], origin: Fit, setup: Setup, uses: Plan, free: Sequence[str]) -> Tried:
    fitted = fit(setup, uses, list(free), origin.held, _REFIT, origin=origin)
    return Tried(names, fitted, left(fitted, _USES[1]))


def winners(
    r: Array, base: Array, columns: Array, fitted: Mask, held: Mask, candidates: Sequence[Candidate]
) -> list[tuple[Candidate, float, float]]:
    """Return the best point of every name with its coefficient and its gain on the held-out samples, largest first.

    With the columns ``Z = [J X]``, ``J`` of the base model and ``X`` of the candidates, a column is fitted on the
    samples T and scored on the samples H: ``β = argmin ‖r_T − Z_T β‖²``, gain ``‖r_H − J_H β_∅‖² − ‖r_H − Z_H β‖²``.
    A strength of the wrong sign is none.

    Args:
        r: (N,) residual; base: (N, K) what moves freely; columns: (N, M) responses of the candidates.
        fitted, held: (N,) samples T and H.
    """
    joined = np.hstack([base, columns])
    sizes = np.maximum(np.linalg.norm(joined[fitted], axis=0), 1e-12 * np.linalg.norm(joined, axis=0).max())
    first, second = joined[fitted] / sizes, joined[held] / sizes
    gram, right, other, product = first.T @ first, first.T @ r[fitted], second.T @ r[held], second.T @ second

    def gain(use: NDArray[np.int64]) -> tuple[float, Array]:
        beta = np.linalg.solve(gram[np.ix_(use, use)] + _RIDGE * np.eye(use.size), right[use])
        return float(2.0 * beta @ other[use] - beta @ product[np.ix_(use, use)] @ beta), beta / sizes[use]

    free = np.arange(base.shape[1])
    alone, best = gain(free)[0], dict[str, tuple[Candidate, float, float]]()
    for candidate in candidates:
        explained, beta = gain(np.append(free, free.size + candidate.column))
        name, coefficient, gained = candidate.effect.canonical, float(beta[-1]), explained - alone
        wrong = candidate.effect.one_sided and coefficient <= 0.0
        if not wrong and (name not in best or gained > best[name][2]):
            best[name] = candidate, coefficient, gained
    return sorted(best.values(), key=lambda w: -w[2])


def _confirmed(smaller: Fit, larger: Fit, plan: Plan, tests: int) -> bool:
    """Whether an F-test, on the samples kept for it, prefers a refitted model to a smaller one.

    Both are linear in their parameters near their estimates: the larger model has its own columns and the step from
    the smaller one's residual, ``r₀ − r₁``, which is what the terms have changed.
    """
    first, second = evaluated(smaller, plan), evaluated(larger, plan)
    r0, r1, rows = first.fit.residual, second.fit.residual, second.slices
    own = [i for i, n in enumerate(larger.variables.names) if n not in smaller.variables.names]
    more = np.hstack([(r0 - r1)[:, None], second.fit.jacobian[:, own]])
    test = np.concatenate([r.mask(_USES[2]) for r in in_turns(plan, _STRETCHES, _USES).recordings])
    white = (whitened(x, rows, autoregression(r1, rows))[test] for x in (r0, first.fit.jacobian, more))
    return f_test(*white) * tests <= _LEVEL


def f_test(r: Array, smaller: Array, more: Array) -> float:
    """Return the p-value of the F-test whether further columns explain more of a vector than chance gives.

    Exact where the noise is white and normal, whatever its size (Seber & Lee 2003, Sec. 4.3); 1 where the further
    columns are no direction.

    Args:
        r: (N,) vector; smaller: (N, p) columns of the smaller model; more: (N, q) those that the larger one has beside.

    Raises:
        InputRefused: the columns leave no degree of freedom.
    """
    base = orthonormal(smaller, np.linalg.norm(smaller, axis=0), _RANK, 1.0)
    further = orthonormal(more - base @ (base.T @ more), np.linalg.norm(more, axis=0), _RANK, 1.0)
    q, freedom = further.shape[1], r.size - base.shape[1] - further.shape[1]
    if freedom < 1:
        raise InputRefused(f"f_test: {r.size} samples for {r.size - freedom} columns: give more samples")
    rest = r - base @ (base.T @ r)
    explained = float(np.sum((further.T @ rest) ** 2))
    within = max(float(rest @ rest) - explained, 1e-300)
    return float(fisher.sf(explained / q / (within / freedom), q, freedom)) if q else 1.0


def autoregression(residual: Array, rows: Sequence[slice], order: int = 4) -> Array:
    """Return the (order + 1,) filter that makes the residuals of all recordings white, by Yule and Walker."""
    total = np.zeros(order + 1)
    for own in rows:
        x = residual[own] - residual[own].mean()
        total += [float(x[lag:] @ x[: x.size - lag]) for lag in range(order + 1)]
    if not total[0] > 0.0:
        return np.append(1.0, np.zeros(order))
    # Solvable also where the residual repeats itself: a millionth of white noise beside it.
    return np.append(1.0, -solve_toeplitz(np.append(total[0] * (1.0 + 1e-6), total[1:-1]), total[1:]))


def whitened(columns: Array, rows: Sequence[slice], taps: Array) -> Array:
    """Return (N, …) columns, each recording filtered on its own."""
    return np.concatenate([lfilter(taps, [1.0], columns[own], axis=0) for own in rows])


def _answered(
    tried: Sequence[Tried], base: Fit, plan: Plan, count: int, suspicious: bool, folder: Path
) -> Answer:  # fmt: skip
    nothing = next(t for t in tried if not t.names)
    best = _best(tried, plan, count)
    names: dict[str, float] = dict.fromkeys((n for t in tried for n in t.names), 0.0)
    for one, weight in _weights(tried, best).items():
        for name in tried[one].names:
            names[name] += weight
    if best.names and _confirmed(nothing.fit, best.fit, plan, count):
        known = _CONFIRMED if best.left <= _SUBSTITUTE * best.size else 1.0 - _UNLISTED
        none, unlisted, model = 0.0, 1.0 - known, best.fit
        try:
            free = list(model.variables.names)
            model = fit(model.setup, whole(base.plan), free, base.held, _REFIT, origin=model)
        except PhnnError:
            model = best.fit
    else:
        none, unlisted = (1.0 - _FLAGGED, _FLAGGED) if suspicious else (_NONE, 0.0)
        known, model = 1.0 - none - unlisted, base
    shown = {n: min(known * w, 1.0) for n, w in names.items()}
    return Answer(shown, none, unlisted, places_of(names), predictions(model, folder))


def _best(tried: Sequence[Tried], plan: Plan, count: int) -> Tried:
    """Return the subset that predicts best; a pair has to explain much of what its best member leaves."""
    singles = [t for t in tried if len(t.names) < 2]
    first = singles[0]
    for pair in (t for t in tried if len(t.names) > 1):
        member = next((t for t in singles if t.names and t.names < pair.names), first)
        excess = first.left - first.size
        if excess > 0.0 and first.left - pair.left >= _SECOND * excess:
            return pair if _confirmed(member.fit, pair.fit, plan, count) else first
    return first


def _weights(tried: Sequence[Tried], best: Tried) -> dict[int, float]:
    """Return probabilities by the gains of hold-out, among the subsets of as many names as the best one."""
    scale = _TEMPERATURE * max(best.left / best.size, 1.0)
    alike = {i: t for i, t in enumerate(tried) if len(t.names) == max(len(best.names), 1)}
    lowest = min(t.left for t in alike.values()) if alike else 0.0
    raw = {i: math.exp(-0.5 * (t.left - lowest) / scale) for i, t in alike.items()}
    return {i: w / sum(raw.values()) for i, w in raw.items()}
