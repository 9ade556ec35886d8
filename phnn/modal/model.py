"""The modal model: its parameters, and what its modes and ports do in the steady state of a periodic input.

    q̈_i/ω_i² + 2ζ_i q̇_i/ω_i + q_i = Σ_j b_ij f_j,     x_j = Σ_i b_ij q_i
    f_j = u_j − k_j φ_j x_j,     φ_j = 1/(1 + ⟨x_j²⟩/r_j²)

``⟨x²⟩`` is the mean square over a period: the springs soften slowly, as those of a material that warms. Within a
period the structure is linear, so that the loop through modes and ports is closed line by line,

    x = (1 + Z κ)⁻¹ Z u,     Z_jl(s) = Σ_i b_ij H_i(s) b_il,     κ_j = k_j φ_j,

where x and ``φ`` are solved for together. Springs are never negative: the model is passive in every steady cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Unit of rates in the shapes of outputs [rad/s].
RATE = 2e3 * np.pi
# Largest change of ``φ`` over a period in the steady state: the target, and what is accepted.
_SETTLED, _TOLERABLE = 1e-12, 1e-8
# Further starts of the search for a steady state.
_STARTS = 30
# A held input has images about the multiples of the sampling rate, which modes fold back; those up to this one count.
_IMAGES = 8


class Steady(NamedTuple):
    """Spectra of one period in the steady state, on all lines or on some.

    Attributes:
        s: (F,) rad/s; q: (F, M) modes; x: (F, P) extensions of the ports; force: (F, P) upon the modes.
        kappa: (P,) stiffness ``k φ`` of the ports.
    """

    s: Complex
    q: Complex
    x: Complex
    force: Complex
    kappa: Array

    @property
    def columns(self) -> Complex:
        """(F, 2 M + P) what outputs are made of: q, q̇ over the reference rate, and forces."""
        return np.concatenate([self.q, self.q * (self.s / RATE)[:, None], self.force], axis=1)

    def at(self, lines: NDArray[np.int64], scale: float) -> Steady:
        """On some lines only, the motion in other units."""
        q, x, force = (scale * a[lines] for a in (self.q, self.x, self.force))
        return Steady(self.s[lines], q, x, force, self.kappa)


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Modes with slow springs at the ports; the output shapes are fitted separately.

    Attributes:
        omega, zeta: (M,) natural frequencies [rad/s] and damping ratios.
        b: (M, P) ratios between modes and ports, over the square root of a mode's static compliance.
        delay: (O,) of the outputs [s].
        springs: (P,) stiffness k of the slow springs; (0,) for the linear model.
        reach: (P,) extension r at which a spring has half of its stiffness.
    """

    omega: Array
    zeta: Array
    b: Array
    delay: Array
    springs: Array
    reach: Array

    def transfer(self, s: Complex) -> Complex:
        """(F, M) ``H_i``: the modes by the force upon each."""
        return np.asarray(self.omega**2 / (s[:, None] ** 2 + 2.0 * self.zeta * self.omega * s[:, None] + self.omega**2))

    def impedance(self, s: Complex) -> Complex:
        """(F, P, P) ``Z``: the extensions of the ports by the forces upon the modes."""
        return np.asarray((self.b.T * self.transfer(s)[:, None, :]) @ self.b)

    def steady(self, experiment: Experiment, dt: float) -> Steady:
        """The steady state under the inputs of an experiment.

        Raises:
            SolverFailed: no steady state was found.
        """
        n = len(experiment.u)
        f = np.asarray(np.fft.rfftfreq(n, dt), dtype=np.float64)
        u = np.asarray(np.fft.rfft(experiment.u, axis=0), dtype=np.complex128)
        images = range(-_IMAGES, _IMAGES + 1) if experiment.zero_order else (0,)
        shifted = [f + m / dt for m in images]
        drives = [u * _of_hold(g, dt)[:, None] for g in shifted] if experiment.zero_order else [u]
        rates = [np.asarray(2j * np.pi * g, dtype=np.complex128) for g in shifted]
        impedances = [self.impedance(s) for s in rates]

        def extended(kappa: Array) -> list[Complex]:
            return [_closed(z, kappa, d) for z, d in zip(impedances, drives, strict=True)]

        def change(softened: Array) -> Array:
            x = np.sum(extended(self.springs * softened), axis=0)
            square = 2.0 * (np.abs(x[1:]) ** 2).sum(axis=0) / n**2
            return np.asarray(1.0 / (1.0 + square / self.reach**2) - softened)

        kappa = np.zeros(self.b.shape[1])
        if self.springs.size:
            # The map of [0, 1]^P into itself has a fixed point (Brouwer); Newton's method may miss it from one start.
            further = np.random.default_rng(0).random((_STARTS, kappa.size))
            for start in (1.0 + change(np.ones_like(kappa)), *further):
                softened = root(change, start, tol=_SETTLED).x
                if np.abs(change(softened)).max() <= _TOLERABLE:
                    break
            else:
                raise SolverFailed(f"{experiment.name}: the ports of the modes come to no steady state")
            kappa = self.springs * softened
        x = extended(kappa)
        forces = [d - kappa * a for d, a in zip(drives, x, strict=True)]
        q = np.sum([self.transfer(s) * (g @ self.b.T) for s, g in zip(rates, forces, strict=True)], axis=0)
        here = len(images) // 2
        return Steady(rates[here], q, np.sum(x, axis=0), forces[here], kappa)

    def slopes(self, steady: Steady, shapes: Array, dt: float) -> Complex:
        """(F, O, K) derivatives of the outputs behind their delays by ln ω, ln ζ, b, delays in samples and ln k, all at
        the same ``φ``.

        Args:
            shapes: (O, 2 M + P), held fast.
        """
        modes, ports = self.b.shape
        s, h = steady.s, self.transfer(steady.s)
        observed = shapes[:, :modes] + shapes[:, modes : 2 * modes] * (s / RATE)[:, None, None]
        z = self.impedance(s)
        loop = np.linalg.inv(np.eye(ports) + z * steady.kappa)
        by_force = (observed * h[:, None, :]) @ self.b + shapes[:, 2 * modes :]
        # What an extension that is added from outside does to the outputs, through the springs.
        by_extension = -(by_force * steady.kappa) @ loop
        by_mode = observed + by_extension @ self.b.T
        pulled = steady.force @ self.b.T
        denominator = s[:, None] ** 2 + 2.0 * self.zeta * self.omega * s[:, None] + self.omega**2
        damping = 2.0 * self.zeta * self.omega * s[:, None] / denominator
        omega = by_mode * (h * (2.0 - damping - 2.0 * self.omega**2 / denominator) * pulled)[:, None, :]
        zeta = by_mode * (-h * damping * pulled)[:, None, :]
        b = (by_mode * h[:, None, :])[:, :, :, None] * steady.force[:, None, None, :]
        b = b + by_extension[:, :, None, :] * steady.q[:, None, :, None]
        delay = (-s[:, None] * dt * (steady.columns @ shapes.T))[:, :, None] * np.eye(len(shapes))
        springs = -(by_force + by_extension @ z) * (steady.kappa * steady.x)[:, None, :]
        every = np.concatenate([omega, zeta, b.reshape(*by_force.shape[:2], -1), delay, springs], axis=2)
        every = every[:, :, : every.shape[2] - ports + self.springs.size]
        return np.asarray(every * np.exp(-s[:, None] * self.delay)[:, :, None])


def _closed(z: Complex, kappa: Array, drive: Complex) -> Complex:
    """(F, P) extensions in the closed loop."""
    moved = np.einsum("fjl,fl->fj", z, drive)
    if not kappa.any():
        return np.asarray(moved)
    return np.asarray(np.linalg.solve(np.eye(z.shape[1]) + z * kappa, moved[:, :, None])[:, :, 0])


def _of_hold(f: Array, h: float) -> Complex:
    """Spectrum of a value held for a time h."""
    return np.asarray(np.sinc(f * h) * np.exp(-1j * np.pi * f * h))
