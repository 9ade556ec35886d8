"""Noise of a recording in which nothing repeats and nothing rests, with an interval.

Two views of the spectrum show it: that of the output above what is excited, and that of what an autoregression with
the input (ARX) of a stated order does not predict one step ahead,

    e_k = y_k − Σ_i a_i y_{k−i} − Σ_j b_j u_{k−j},     S_n = S_e / |A|²,     A(ω) = 1 − Σ_i a_i e^{−iωi},

where the coefficients of each block of samples come from the other blocks. ``A`` removes what is smooth, ``b`` what
follows the input linearly; noise passes through ``A`` and is divided by it. In both views the noise is first-order,

    S_n(ω) = σ² (1 − a²)/(1 + a² − 2a cos ω) + t ω⁻⁴,     0 ≤ a < 1,

with a tail t that kinks of the signal leave. Whittle's (1953) likelihood over the frequencies above an edge gives σ;
the interval holds every σ that some a and t make likely enough. White noise is the case a = 0.

What depends on the input nonlinearly at all frequencies looks like noise here: the result is an upper bound there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import blackmanharris
from scipy.stats import chi2

from phnn.signals.first_order import EDGES, SMEARED, density, fits

Array = NDArray[np.float64]

# Samples of the past that predict the next one; blocks of samples, each predicted by coefficients of the others.
ORDER, BLOCKS = 24, 4
# Fewest samples of a block, over the coefficients that are estimated.
_PER_COEFFICIENT = 10
# Ridge over the mean square of a column: makes equations solvable that a noise-free signal leaves undetermined.
_RIDGE = 1e-14
# Samples that are looked at, from the middle of longer recordings.
_MOST = 2**15
# Fewest frequencies above an edge.
_FEWEST = 100
# Coefficients and tails that are tried.
_COEFFICIENTS = np.concatenate([np.arange(0.0, 0.9, 0.05), [0.9, 0.93, 0.96, 0.98]])
# How tails fall with frequency: kinks of the output, kinks of the input through a resonance, what is smooth.
_STEEP, _STEPS = (4.0, 8.0, 16.0), 300
_BANDS = 256
# Share of the power that noise has where it is seen, and share of the frequencies above the edge where it must be.
_PURE, _SEEN = 0.8, 0.95
# Largest ratio of the bounds of an estimate that says something.
_WIDEST = 3.0
# Level of the interval; gain of the log likelihood, in independent frequencies, from which noise is coloured.
LEVEL, _CLEARLY = 0.95, 6.0


@dataclass(frozen=True)
class Estimate:
    """Standard deviation of a noise and its 95 % interval, unit of the output.

    Attributes:
        value, low, high: the deviation and its bounds; coefficient: of first-order noise, 0 where it is white.
        edge: lowest frequency that was used, cycles a sample; one_step: it comes from one-step-ahead residuals.
    """

    value: float
    low: float
    high: float
    coefficient: float
    edge: float
    one_step: bool

    def words(self, dt: float) -> str:
        """Where it comes from; ``dt`` is the sampling interval [s]."""
        above = f"above {self.edge / dt:.4g} Hz"
        if self.one_step:
            return f"one-step-ahead residuals of an autoregression of order {ORDER} {above}"
        return f"the spectrum {above}"


def estimated(u: Array, y: Array) -> Estimate | None:
    """The smaller of the estimates that can be trusted; None where none can.

    An estimate is trusted where the spectrum that it whitens has no lines and one level (`first_order.fits`).

    Args:
        u: (N,) input; y: (N,) output.
    """
    first = max((y.size - _MOST) // 2, 0)
    u, y = u[first : first + _MOST], y[first : first + _MOST]
    found = [e for e in (_of_spectrum(y), _of_one_step(u, y)) if e is not None]
    best = min(found, key=lambda e: e.value, default=None)
    if best is None:
        return None
    agreeing = [e for e in found if e.low <= best.high and e.high >= best.low]
    return replace(best, low=min(e.low for e in agreeing), high=max(e.high for e in agreeing))


def _of_spectrum(y: Array) -> Estimate | None:
    """From the output's own spectrum above what is excited."""
    line = np.polynomial.Polynomial.fit(np.arange(y.size), y, 1)
    power = _periodogram(y - line(np.arange(y.size)))
    return _above_an_edge(power[None, :], False)


def _of_one_step(u: Array, y: Array) -> Estimate | None:
    """From what an ARX predictor leaves of blocks that it was not fitted to."""
    size = (y.size - ORDER) // BLOCKS
    if size < _PER_COEFFICIENT * 2 * ORDER:
        return None
    columns, target = _lagged(u, y)
    rows = [slice(i * size, (i + 1) * size) for i in range(BLOCKS)]
    normal = [columns[r].T @ columns[r] for r in rows]
    right = [columns[r].T @ target[r] for r in rows]
    powers = []
    omega = 2.0 * np.pi * np.fft.rfftfreq(size)
    for i, r in enumerate(rows):
        others = sum(m for j, m in enumerate(normal) if j != i)
        scale = np.sqrt(np.diag(others)) + 1e-300
        scaled = others / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)
        wanted = sum(m for j, m in enumerate(right) if j != i)
        c = np.linalg.solve(scaled, wanted / scale) / scale
        error = target[r] - columns[r] @ c
        filtered = np.concatenate([[1.0], -c[:ORDER]])
        gain = np.abs(np.exp(-1j * np.outer(omega, np.arange(ORDER + 1))) @ filtered) ** 2
        powers.append(_periodogram(error - error.mean()) / np.maximum(gain, 1e-12 * gain.max()))
    return _above_an_edge(np.array(powers), True)


def _lagged(u: Array, y: Array) -> tuple[Array, Array]:
    """(N − p, 2p + 2) past outputs, past and present inputs and a constant beside the outputs (N − p,) they predict."""
    y, u = (x - x.mean() for x in (y, u))
    n = y.size - ORDER
    past = [y[ORDER - i : ORDER - i + n] for i in range(1, ORDER + 1)]
    driven = [u[ORDER - j : ORDER - j + n] for j in range(ORDER + 1)]
    return np.column_stack([*past, *driven, np.ones(n)]), y[ORDER:]


def _periodogram(x: Array) -> Array:
    """Power over that of white noise of unit variance, through a window that leaks nothing from afar."""
    window = blackmanharris(x.size, sym=False)
    return np.asarray(np.abs(np.fft.rfft(window * x)) ** 2 / float(window @ window))


def _above_an_edge(power: Array, one_step: bool) -> Estimate | None:
    """The estimate above the lowest edge at which it can be trusted.

    Args:
        power: (B, F) periodograms of B blocks from frequency zero to half the sampling rate.
    """
    omega = np.linspace(0.0, np.pi, power.shape[1])
    for edge in EDGES:
        band = (omega > 2.0 * np.pi * edge) & (omega < np.pi)
        # All blocks of one frequency stand side by side.
        p, w = power[:, band].T.ravel(), np.repeat(omega[band], len(power))
        if p.size < _FEWEST:
            return None
        found = _likely(p, w)
        if found is not None:
            value, low, high, a = found
            return Estimate(value, low, high, a, edge, one_step)
    return None


def _likely(power: Array, omega: Array) -> tuple[float, float, float, float] | None:
    """Deviation, its bounds and the coefficient by Whittle's likelihood; None where the spectrum has another shape,
    where tails hide the noise, or where the bounds lie so far apart that nothing is known."""
    scale = float(power.mean())
    if scale <= 0.0:
        return None
    tails = np.stack([(omega / omega[0]) ** -e for e in _STEEP])
    noises = np.stack([density(a, np.cos(omega)) for a in _COEFFICIENTS])
    # Neighbouring frequencies have nearly one expectation.
    edges = np.unique(np.linspace(0, power.size, _BANDS + 1).astype(int))
    counts = np.diff(edges)
    p, n, t = (np.add.reduceat(x, edges[:-1], axis=-1) / counts for x in (power / scale, noises, tails))
    shapes = np.concatenate([n[:, None, :], np.broadcast_to(t, (len(n), *t.shape))], axis=1)
    weights, costs, errors = _fitted(p, shapes, counts)
    free = int(costs.argmin())
    at = free if (costs[0] - costs[free]) / SMEARED > _CLEARLY else 0
    noise = weights[at, 0] * noises[at]
    shape = noise + weights[at, 1:] @ tails
    if np.mean(noise > _PURE * shape) < _SEEN or not fits(power, shape):
        return None
    # What the window smears counts once; for each a, variances ln σ² ± δ are likely enough.
    spare = chi2.ppf(LEVEL, 1) * SMEARED - 2.0 * (costs - costs[free])
    likely = (spare > 0.0) & (weights[:, 0] > 0.0)
    middle, delta = np.log(weights[likely, 0]), np.sqrt(spare[likely]) * errors[likely]
    bounds = weights[at, 0], np.exp((middle - delta).min()), np.exp((middle + delta).max())
    value, low, high = (float(np.sqrt(scale * x)) for x in bounds)
    low, high = min(low, value), max(high, value)
    return (value, low, high, float(_COEFFICIENTS[at])) if high <= _WIDEST * low else None


def _fitted(power: Array, shapes: Array, counts: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """For each coefficient the most likely weights (A, K) of noise and tails, none negative, minus the log likelihood
    (A,), and the standard error of the logarithm of the first weight (A,).

    Multiplicative steps for the Itakura–Saito divergence (Févotte & Idier 2011), which is Whittle's likelihood.

    Args:
        power: (F,) mean over each band; shapes: (A, K, F) of the noise and of the tails; counts: (F,) frequencies.
    """
    weights = power.mean() / shapes.mean(axis=2) / shapes.shape[1]
    for _ in range(_STEPS):
        total = np.einsum("ak,akf->af", weights, shapes)
        up = np.einsum("akf,af->ak", shapes, counts * power / total**2)
        weights = weights * up / np.einsum("akf,af->ak", shapes, counts / total)
    total = np.einsum("ak,akf->af", weights, shapes)
    costs = (counts * (np.log(total) + power / total)).sum(axis=1)
    # A weight of nothing counts as a little, so that every information matrix can be inverted.
    kept = np.maximum(weights, 1e-9 * weights.max(axis=1, keepdims=True))
    relative = shapes * kept[:, :, None] / total[:, None, :]
    information = np.einsum("akf,alf,f->akl", relative, relative, counts.astype(float))
    return weights, costs, np.sqrt(np.linalg.pinv(information)[:, 0, 0])
