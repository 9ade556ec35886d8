"""A Gaussian process as the force that a model lacks, seen through the model.

    F(x) ~ GP(0, s² k(x, x')),   k = exp(−½ |x − x'|²/ℓ²),   r = g ∗ F(x(t)) + J δz + ε

``x`` are signals of the base model in units of their deviations. A linear system under a Gaussian process has a
Gaussian output (Álvarez, Luengo & Lawrence 2009, AISTATS: latent force models). Recordings have too many samples for
an exact process: it is projected onto inducing points ``x_m`` (Williams & Seeger 2001, NIPS 13: Nyström), ``F = Φ w``
with ``Φ = K_nm K_mm^{−1/2}`` and ``w ~ N(0, s² I)``. Then ``g ∗ Φ`` are the responses of the linearised base to the
features, and the marginal likelihood of the whitened residual is that of Bayesian linear regression (Rasmussen &
Williams 2006, Sec. 5.4), with the sensitivities ``J`` of the base eliminated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.benchmark.residual_force.evidence import Evidence
from studies.benchmark.residual_force.signals import relaxed
from studies.benchmark.residual_force.states import States
from studies.benchmark.residual_force.terms import Action
from studies.rivals import needed

Array = NDArray[np.float64]

# Inducing points; length scales in deviations; variances of the force over that of the base model's own; jitter.
_POINTS, _SCALES, _VARIANCES, _JITTER = 40, (0.7, 2.0), np.geomspace(1e-8, 1.0, 17), 1e-8
# Samples among which inducing points are sought.
_SAMPLES = 4000


def _slow(*taus: float) -> Callable[[States], list[Array]]:
    return lambda s: [s.q, *(relaxed(s.q, s.dt, tau) for tau in taus)]


# Signals that a force may depend on, by the name of the set.
INPUTS: Mapping[str, Callable[[States], list[Array]]] = {
    "motion": lambda s: [s.q, s.v],
    "position": lambda s: [s.q],
    "velocity": lambda s: [s.v],
    "voltage": lambda s: [s.u, s.du],
    "coupling": lambda s: [s.q, s.u],
    "hysterons": lambda s: [s.q, *s.e.T],
    "memory": _slow(0.003, 0.03, 0.3),
    "time": lambda s: [s.t, s.q],
    "joint": lambda s: [s.q, s.v, s.u, s.du],
}


@dataclass(frozen=True)
class Features:
    """Inducing points of a set of signals.

    Attributes:
        inputs: one of `INPUTS`; mean, deviation: (D,) of its signals; points: (M, D) in deviations; root: (M, M)
            ``K_mm^{−1/2}``; scale: ``ℓ``.
    """

    inputs: str
    mean: Array
    deviation: Array
    points: Array
    root: Array
    scale: float

    def __call__(self, s: States) -> Array:
        """(N, M) features ``Φ`` of a recording."""
        x = (np.column_stack(INPUTS[self.inputs](s)) - self.mean) / self.deviation
        return _kernel(x, self.points, self.scale) @ self.root


@dataclass(frozen=True)
class Posterior:
    """A latent force, as the recordings show it.

    Attributes:
        features: with the coefficients ``mean`` (M,) [N]; seen: (n, M) whitened responses to unit features.
        evidence: logarithm of the marginal likelihood over that of no force; variance: ``s²`` [N²].
    """

    features: Features
    mean: Array
    seen: Array
    evidence: float
    variance: float

    def __call__(self, s: States) -> tuple[Array, Array]:
        """(N,) mean force [N], and no change of the output."""
        return self.features(s) @ self.mean, np.zeros(s.q.size)


def _kernel(x: Array, points: Array, scale: float) -> Array:
    squares = np.sum(x**2, axis=1)[:, None] + np.sum(points**2, axis=1) - 2.0 * x @ points.T
    return np.exp(-0.5 * np.maximum(squares, 0.0) / scale**2)


def features_of(states: tuple[States, ...], inputs: str, scale: float, seed: int) -> Features:
    """Inducing points at the centres of clusters of the signals (k-means)."""
    x = np.concatenate([np.column_stack(INPUTS[inputs](s)) for s in states])
    mean, deviation = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-12 * np.abs(x).max() + 1e-300)
    rng = np.random.default_rng(seed)
    chosen = (x[rng.choice(x.shape[0], min(_SAMPLES, x.shape[0]), replace=False)] - mean) / deviation
    cluster = needed("sklearn.cluster")
    found = cluster.KMeans(_POINTS, n_init=1, max_iter=20, random_state=seed).fit(chosen)
    points = np.asarray(found.cluster_centers_)
    values, vectors = np.linalg.eigh(_kernel(points, points, scale) + _JITTER * np.eye(points.shape[0]))
    root = vectors / np.sqrt(np.maximum(values, _JITTER)) @ vectors.T
    return Features(inputs, mean, deviation, points, root, scale)


def responses_to(evidence: Evidence, features: Features) -> Array:
    """(n, M) whitened responses of the linearised base to the features."""
    return evidence.seen([[Action(force=phi) for phi in features(s).T] for s in evidence.states])


def posterior(evidence: Evidence, features: Features) -> Posterior:
    """The force under the variance of largest marginal likelihood."""
    seen = responses_to(evidence, features)
    factor = np.asarray(np.linalg.qr(np.column_stack([evidence.base, seen, evidence.target]), mode="r"))
    inner = factor[evidence.base.shape[1] :, evidence.base.shape[1] :]
    return best_of(features, seen, inner[:, :-1], inner[:, -1], force_size(evidence))


def force_size(evidence: Evidence) -> float:
    """Largest force of the base's voltage on its mass [N]."""
    return max(float(np.abs(s.alpha * s.u).max()) for s in evidence.states)


def best_of(features: Features, seen: Array, x: Array, y: Array, size: float) -> Posterior:
    """Choose the variance; ``x`` (K, M) and ``y`` (K,) are the regression with the base eliminated.

    ln p(y)/p₀(y) = ½ Σ_i [ c_i² s²d_i²/(1 + s²d_i²) − ln(1 + s²d_i²) ],   x = U diag(d) Vᵀ,   c = Uᵀ y
    """
    left, d, _ = np.linalg.svd(x, full_matrices=False)
    c = left.T @ y
    best, variance = -math.inf, 0.0
    for candidate in _VARIANCES * size**2:
        gain = candidate * d**2
        evidence = 0.5 * float(np.sum(c**2 * gain / (1.0 + gain) - np.log1p(gain)))
        if evidence > best:
            best, variance = evidence, float(candidate)
    return Posterior(features, mean_of(x, y, variance), seen, best, variance)


def mean_of(x: Array, y: Array, variance: float) -> Array:
    """(M,) posterior mean of the coefficients, ``(xᵀx + s⁻² I)⁻¹ xᵀ y``."""
    left, d, right = np.linalg.svd(x, full_matrices=False)
    return np.asarray(right.T @ (variance * d * (left.T @ y) / (1.0 + variance * d**2)))


def posteriors(evidence: Evidence, seed: int) -> list[Posterior]:
    """Of every set of signals under its better length scale, that of largest marginal likelihood first."""
    found = []
    for inputs in INPUTS:
        each = [posterior(evidence, features_of(evidence.states, inputs, scale, seed)) for scale in _SCALES]
        found.append(max(each, key=lambda p: p.evidence))
    return sorted(found, key=lambda p: -p.evidence)
