"""Frequency response of a level, and the modes in it, without starting values.

The best linear approximation of a nonlinear system under random-phase multisines is ``G = Y Uᴴ (U Uᴴ)⁻¹`` over its
realisations (Pintelon & Schoukens 2012, System Identification, ch. 4). Its poles are found by the eigensystem
realisation of its impulse response (Juang & Pappa 1985), for which python-control serves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.modal.experiment import Experiment, Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Blocks of the Hankel matrix; orders that are tried; damping ratio above which a pole is no mode.
_BLOCKS, _ORDERS, _DAMPED = 150, range(2, 61, 2), 0.2
# An order is good enough when it leaves this much more than the best one; a mode matters from this share on.
_ENOUGH, _MATTERS = 1.3, 2e-3
# Delays that are tried, in sampling intervals.
_DELAYS = np.arange(0.0, 3.01, 0.1)


class Modes(NamedTuple):
    """Modes of a response: ω (M,) rad/s, ζ (M,), directions of the ports b (M, P) of length 1, delay in samples."""

    omega: Array
    zeta: Array
    b: Array
    delay: float


def response(experiments: Sequence[Experiment]) -> Complex:
    """(N//2 + 1, O, P) best linear approximation; zero at the mean."""
    u = np.stack([np.fft.rfft(e.u, axis=0) for e in experiments], axis=-1)
    y = np.stack([np.fft.rfft(e.y, axis=0) for e in experiments], axis=-1)
    conjugate = u.conj().transpose(0, 2, 1)
    square = u @ conjugate
    size = np.trace(square, axis1=1, axis2=2).real[:, None, None] + 1e-300
    # Lines that are not excited would be divided by nothing.
    ridge = 1e-12 * size.max() * np.eye(u.shape[1])
    g = np.asarray((y @ conjugate) @ np.linalg.inv(square + ridge))
    g[0] = 0.0
    return g


def first_modes(study: Study, experiments: Sequence[Experiment]) -> Modes:
    """Modes of some experiments on the excited lines, the fewest that describe them well.

    Raises:
        InputRefused: there is no oscillation within the excited lines.
    """
    import control  # slow to load: whoever predicts with a model that is there needs none of it

    lines, dt = study.lines, study.dt
    g = response(experiments)
    scale = np.abs(g[lines]).max(axis=(0, 2))[:, None]
    impulses = _impulses(g / scale, lines, len(experiments[0].u))
    s = np.asarray(2j * np.pi * study.frequencies[lines], dtype=np.complex128)
    u, y = (np.stack([np.fft.rfft(getattr(e, n), axis=0)[lines] for e in experiments], axis=1) for n in ("u", "y"))
    y = y / scale[:, 0]
    best: list[tuple[float, Array, Complex, float]] = []
    blocks = min(_BLOCKS, impulses.shape[2] // 4)
    for order in _ORDERS:
        if order > blocks:
            break
        system, _ = control.eigensys_realization(impulses, order, m=blocks, n=blocks, dt=dt)
        poles = _oscillations(np.asarray(system.poles(), dtype=np.complex128), dt, s)
        if not poles.size:
            continue
        delays = _DELAYS if not best else np.array([min(best, key=lambda fit: fit[0])[3]])
        fits = [(*_residues(poles, float(delay) * dt, s, u, y), poles, float(delay)) for delay in delays]
        best.append(min(fits, key=lambda fit: fit[0]))
    if not best:
        raise InputRefused(
            f"no oscillation between {study.frequencies[lines[0]]:.4g} and {study.frequencies[lines[-1]]:.4g} Hz: "
            f"there are no modes to be found in these recordings"
        )
    least = min(cost for cost, *_ in best)
    _, residues, poles, delay = next(fit for fit in best if fit[0] <= _ENOUGH * least)
    size = np.linalg.norm(residues, axis=(1, 2)) / (-poles.real / np.abs(poles))
    kept = size > _MATTERS * size.max()
    b = np.array([np.linalg.svd(r)[2][0] for r in residues[kept]])
    omega = np.asarray(np.abs(poles[kept]), dtype=np.float64)
    return Modes(omega, -poles.real[kept] / omega, b, delay)


def _impulses(g: Complex, lines: NDArray[np.int64], size: int) -> Array:
    """(O, P, N) impulse response in the excited band, whose upper edge is rounded off so that it does not ring."""
    edge, top = max(3, lines.size // 40), lines[-1]
    weight = np.zeros(len(g))
    weight[: top + 1] = 1.0
    weight[top - edge + 1 : top + 1] = 0.5 * (1.0 + np.cos(np.pi * np.arange(1, edge + 1) / (edge + 1)))
    filled = g.copy()
    filled[: lines[0]] = g[lines[0]].real
    return np.fft.irfft(filled * weight[:, None, None], size, axis=0).transpose(1, 2, 0)


def _oscillations(poles: Complex, dt: float, s: Complex) -> Complex:
    """Poles of modes in the band, in continuous time, in ascending order."""
    continuous = np.log(poles[np.abs(poles) > 0.0]) / dt
    damping = -continuous.real / np.maximum(np.abs(continuous), 1e-300)
    inside = (continuous.imag > s[0].imag) & (continuous.imag < s[-1].imag)
    found = continuous[inside & (damping > 0.0) & (damping < _DAMPED)]
    return found[np.argsort(found.imag)]


def _residues(poles: Complex, delay: float, s: Complex, u: Complex, y: Complex) -> tuple[float, Array]:
    """Real residues (M, O, P) of given poles behind a delay, with a rest that is at once; what they leave comes first.

    Args:
        u: (F, R, P) and y: (F, R, O) spectra of R experiments: lines on which inputs are hard to tell apart count less.
    """
    h = np.abs(poles) ** 2 / ((s[:, None] - poles) * (s[:, None] - poles.conj()))
    basis = np.concatenate([h, np.ones((s.size, 1))], axis=1) * np.exp(-s * delay)[:, None]
    columns = (basis[:, None, :, None] * u[:, :, None, :]).reshape(s.size * u.shape[1], -1)
    target = y.reshape(columns.shape[0], -1)
    normal, right = (columns.conj().T @ columns).real, (columns.conj().T @ target).real
    found = np.linalg.lstsq(normal, right, rcond=1e-13)[0]
    cost = float((np.abs(columns @ found - target) ** 2).sum())
    return cost, np.asarray(found.reshape(poles.size + 1, u.shape[2], -1)[:-1].transpose(0, 2, 1), dtype=np.float64)
