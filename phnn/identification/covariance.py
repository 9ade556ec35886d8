"""Covariance of least-squares estimates under noise of any colour and size, and under what the model misses.

An estimate errs by ``C Jᵀ n`` with ``C = (JᵀJ)⁻¹``, the Jacobian ``J`` and the noise ``n``. In the orthonormal basis
``Q = J T`` with ``T Tᵀ = C`` its covariance is ``T M Tᵀ`` with the covariance ``M = Qᵀ E[n nᵀ] Q``, to which every
recording adds three parts:

1. stationary noise with the spectrum ``S`` that repetitions show: ``Σ_f S(f) Q̂*(f) Q̂(f)``. Blocks of scores would
need no spectrum, but twenty of them cover too seldom where the noise is coloured: a block cuts the correlation at its
ends, and what a fit has taken out of the residual of a block is missing in its score; 2. noise of uneven size, such as
jitter of the sampling instants: ``Σ_i (u_i − ū) q_i q_iᵀ`` with ``u_i = r_i²/(1 − h_i)²``, the sample ``r_i`` of the
residual and its leverage ``h_i = |q_i|²``: the estimator of White (1980) in place of the mean variance, with the
correction HC3 of MacKinnon & White (1985); 3. lines of the residual that noise does not explain. They repeat with the
drive, so that the model misses them, and the fit has moved the estimates to take up what it could of their cause. Each
line counts as a disturbance of unknown phase with the power ``|r̂(f)|²/(1 − h(f))²``: HC3 again, which corrects for the
share that the fit took up.

The sum is an estimate itself. Its degrees of freedom follow from the variance of parts 2 and 3 (Satterthwaite 1946);
intervals take the quantile of Student's t from them. The averaged spectrum of part 1 counts as known.

Anchors bring uncertainty into a fit. It holds an anchor ``a`` at its stated value and minimises ``½|r(z, a)|²`` over
``z`` alone. At the optimum ``Jᵀr = 0`` with ``J = ∂r/∂z``, so that by the implicit function theorem (Gauss–Newton,
without second derivatives)

    dz/da = −(JᵀJ)⁻¹ Jᵀ ∂r/∂a

and an anchor of variance ``s²`` adds ``(dz/da) s² (dz/da)ᵀ`` to the covariance of ``z``. No table of exponents is
needed: where voltage and displacement leave one factor open, this gives ``d ln k / d ln m = 1`` by itself, and ratios
such as ``k/m`` keep their standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.identification.nuisances import beyond_limit, without_nuisances
from phnn.identification.problem import Problem
from phnn.identification.residual_noise import MOST_EXCESS, noise_spectra
from phnn.recordings.recording import Recording
from phnn.trajectory import Trajectory

Array = NDArray[np.float64]


def held_anchors(problem: Problem) -> dict[str, float]:
    """Standard deviations [SI] of the anchors that a problem's setup has and does not estimate; exact ones left out."""
    names = problem.template.parameters
    estimated = problem.variables.names
    return {n: s for n, s in problem.plan.anchors.items() if s > 0.0 and n in names and n not in estimated}


def residual_by_anchors(problem: Problem, z: Array, names: tuple[str, ...]) -> Array:
    """(N, A) derivatives of the weighted residual by A held parameters [1/SI unit], initial states unchanged."""
    own = problem.template.own

    def one(recording: Recording, trajectory: Trajectory, mask: Array) -> Array:
        hidden = beyond_limit(recording, trajectory.y, mask, own)
        changes = without_nuisances(output_derivatives(trajectory, names), mask, recording, own, hidden)
        return np.asarray(changes / -recording.noise)

    return np.concatenate(problem.plan.each(one, problem.trajectories(z), problem.masks))


def estimates_by_anchors(bread: Array, jacobian: Array, columns: Array) -> Array:
    """(K, A) derivatives of the estimates ``z`` by the anchors, ``−B Jᵀ ∂r/∂a`` with ``B = (JᵀJ)⁻¹``."""
    return np.asarray(-bread @ (jacobian.T @ columns))


# Directions whose information is this share of the best one's are known no better than that.
_RANK = 1e-14
# Probability that white noise shows a line anywhere in a recording.
_BY_CHANCE = 0.05
# A sample or frequency that alone fixes a parameter has a leverage of one; then its residual tells nothing.
_HIGHEST_LEVERAGE = 0.98
# Student's t does not differ from a normal variable any more.
_MOST_FREEDOM = 1e6


@dataclass(frozen=True)
class Scatter:
    """How far estimates scatter.

    Attributes:
        covariance: (K, K) of the estimates.
        freedom: (K,) degrees of freedom with which their variances are known, infinite where nothing was estimated.
    """

    covariance: Array
    freedom: Array


@dataclass(frozen=True)
class _Share:
    """What one recording adds: to ``M`` (K, K), and to the variance of the variances (K,) of the estimates."""

    middle: Array
    doubt: Array


def bread(jacobian: Array) -> Array:
    """``(JᵀJ)⁻¹``; a direction without information keeps a huge variance, where a pseudo-inverse would call it exactly
    known."""
    root = _root(jacobian)
    return np.asarray(root @ root.T)


def _root(jacobian: Array) -> Array:
    """(K, K) ``T`` with ``T Tᵀ = (JᵀJ)⁻¹``."""
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    return np.asarray(vectors / np.sqrt(np.maximum(values, max(_RANK * values[-1], np.finfo(float).tiny))))


def scatter(residual: Array, jacobian: Array, recordings: Sequence[Recording], slices: Sequence[slice]) -> Scatter:
    """The covariance of estimates, as the module says; never below that of white noise of the stated deviation.

    Args:
        residual: (N,) weighted by the stated deviation of the noise; jacobian: (N, K) its derivatives.
        recordings: of which it consists; slices: their rows, in the same order.
    """
    count = jacobian.shape[1]
    if count == 0:
        return Scatter(np.zeros((0, 0)), np.zeros(0))
    root = _root(jacobian)
    basis = jacobian @ root
    parts = [residual[r] for r in slices]
    # Without repetitions nothing tells noise from what the model misses. All of it counts, but a line is held against
    # what noise can be.
    spectra = noise_spectra(parts, recordings, np.inf, np.inf)
    bounded = noise_spectra(parts, recordings, unseen=MOST_EXCESS)
    middle, doubt = np.zeros((count, count)), np.zeros(count)
    for part, rows, spectrum, least in zip(parts, slices, spectra, bounded, strict=True):
        q, cycles = basis[rows], np.arange(part.size // 2 + 1) / part.size
        middle += spectrum.covariance(q)
        for share in (_uneven(part, q, root), _lines(part, q, root, spectrum.at(cycles), least.at(cycles))):
            middle += share.middle
            doubt += share.doubt
    # Where the sum is below one, the noise would be smaller than what is stated: no combination is known that well.
    values, vectors = np.linalg.eigh(middle)
    spread = root @ vectors
    found = (spread * np.maximum(values, 1.0)) @ spread.T
    # Without a doubt there are endlessly many.
    with np.errstate(over="ignore"):
        freedom = 2.0 * np.diag(found) ** 2 / np.maximum(doubt, np.finfo(float).tiny)
    return Scatter(found, np.minimum(freedom, _MOST_FREEDOM))


def _uneven(residual: Array, basis: Array, root: Array) -> _Share:
    """What noise adds where its variance is not the same in all samples (part 2)."""
    leverage = np.minimum(np.einsum("ij,ij->i", basis, basis), _HIGHEST_LEVERAGE)
    squares = (residual / (1.0 - leverage)) ** 2
    middle = basis.T @ ((squares - squares.mean())[:, None] * basis)
    # The variance of a squared normal variable is two thirds of its fourth moment.
    return _Share(middle, 2.0 / 3.0 * squares**2 @ (basis @ root.T) ** 4)


def _lines(residual: Array, basis: Array, root: Array, density: Array, bounded: Array) -> _Share:
    """What lines add that exceed the noise (part 3).

    Args:
        density: (F,) of the noise at the frequencies of the recording, over that of white noise of unit variance;
        bounded: (F,) the same, at most what noise can be.
    """
    n = residual.size
    power = np.abs(np.fft.rfft(residual)) ** 2 / n
    waves = np.fft.rfft(basis, axis=0) / np.sqrt(n)
    # All frequencies but the first (and the last of an even number) stand for two.
    both = np.full(power.size, 2.0)
    both[0] = 1.0
    both[(n + 1) // 2 :] = 1.0
    kept = 1.0 - np.minimum(np.einsum("ij,ij->i", waves.conj(), waves).real, _HIGHEST_LEVERAGE)
    # Under noise the power over its density has an exponential distribution.
    seen = power / kept > bounded * np.log(power.size / _BY_CHANCE)
    excess = both[seen] * np.maximum(power[seen] / kept[seen] ** 2 - density[seen], 0.0)
    shown = waves[seen]
    middle = (shown.conj().T @ (excess[:, None] * shown)).real
    # The variance of an exponential variable is half of its second moment.
    return _Share(middle, 0.5 * excess**2 @ np.abs(shown @ root.T) ** 4)
