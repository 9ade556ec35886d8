"""Derivatives of the outputs by equivalent linearisation: one integration serves for all parameters.

What a small change of the extension changes at an element is described by ``δe_j = κ_j(s) δx_j`` with

    κ_j(s) = κ_j0 + i κ_j1 + s κ_j2,

the real coefficients of which come from the element's own response by least squares (describing function for random
excitation: Booton 1954; Pintelon & Schoukens 2012, ch. 3). The loop through modes and ports is then closed exactly,

    δx = (1 + Z κ)⁻¹ δx⁰,     Z_jl = Σ_i b_ij H_i b_il,

so that derivatives are exact for a linear model and good to a share of what the element feeds back otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.modal.model import ModalModel, Seen

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def output_slopes(model: ModalModel, seen: Seen, shapes: Array, dt: float) -> Complex:
    """(F, O, K) derivatives of the outputs behind their delays by ln ω, ln ζ, b, delays in samples and ln k.

    Args:
        shapes: (O, 2 M + P), held fast.
    """
    modes, ports = model.b.shape
    s, h = seen.s, model.transfer(seen.s)
    observed = shapes[:, :modes] + shapes[:, modes : 2 * modes] * seen.rate[:, None, None]
    kappa = _equivalent(model, seen)
    z = np.einsum("ij,fi,il->fjl", model.b, h, model.b, optimize=True)
    loop = np.linalg.inv(np.eye(ports) + z * kappa[:, None, :])
    by_force = np.einsum("foi,fi,ij->foj", observed, h, model.b, optimize=True) + shapes[:, 2 * modes :]
    # What an extension that is added from outside does to the outputs, through the elements.
    by_extension = -np.einsum("fol,fl,flj->foj", by_force, kappa, loop, optimize=True)
    by_mode = observed + by_extension @ model.b.T
    pulled = seen.force @ model.b.T
    denominator = s[:, None] ** 2 + 2.0 * model.zeta * model.omega * s[:, None] + model.omega**2
    damping = 2.0 * model.zeta * model.omega * s[:, None] / denominator
    omega = by_mode * (h * (2.0 - damping - 2.0 * model.omega**2 / denominator) * pulled)[:, None, :]
    zeta = by_mode * (-h * damping * pulled)[:, None, :]
    b = np.einsum("foi,fi,fj->foij", by_mode, h, seen.force, optimize=True)
    b = b + by_extension[:, :, None, :] * seen.q[:, None, :, None]
    outputs = seen.columns @ shapes.T
    delay = np.einsum("fo,op->fop", -s[:, None] * dt * outputs, np.eye(len(shapes)))
    closed = by_force + by_extension @ z
    k = -closed[:, :, :, None] * (model.k * seen.parts)[:, None, :, :]
    size = (len(s), len(shapes), -1)
    every = np.concatenate([omega, zeta, b.reshape(size), delay, k.reshape(size)], axis=2)
    return np.asarray(every * np.exp(-s[:, None] * model.delay)[:, :, None])


def _equivalent(model: ModalModel, seen: Seen) -> Complex:
    """(F, P) what an element answers to a change of its extension."""
    x, e = seen.q @ model.b, (model.k * seen.parts).sum(axis=2)
    found = np.zeros(x.shape, dtype=complex)
    if not model.k.size:
        return found
    basis = np.stack([np.ones_like(seen.s), 1j * np.ones_like(seen.s), seen.rate], axis=1)
    for j in range(x.shape[1]):
        columns = basis * x[:, j : j + 1]
        stacked = np.concatenate([columns.real, columns.imag])
        answer = np.concatenate([e[:, j].real, e[:, j].imag])
        found[:, j] = basis @ np.linalg.lstsq(stacked, answer, rcond=None)[0]
    return found
