"""The modal model: its parameters, and what its modes and ports do in the steady state of a periodic input.

    q̈_i/ω_i² + 2ζ_i q̇_i/ω_i + q_i = Σ_j b_ij f_j,     x_j = Σ_i b_ij q_i
    f_j = u_j − k_j φ_j x_j − c_j (1 − φ_j) ẋ_j,     φ_j = 1/(1 + ⟨x_j²⟩/r_j²)

``⟨x²⟩`` is the mean square over a period: springs that soften and dampers that grow slowly, as those of a material that
warms. Within a period the structure is linear, so that the loop through modes and ports is closed line by line,

    x = (1 + Z κ)⁻¹ Z u,     Z_jl(s) = Σ_i b_ij H_i(s) b_il,     κ_j(s) = k_j φ_j + s c_j (1 − φ_j),

where x and ``φ`` are solved for together. Springs and dampers are never negative: the model is passive in every steady
cycle.
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

# What the rows of the weights are.
ROWS = ("springs", "dampers")
# Unit of rates in the shapes of outputs [rad/s].
RATE = 2e3 * np.pi
# Largest change of ``φ`` over a period in the steady state: the target, and what is accepted.
_SETTLED, _TOLERABLE = 1e-12, 1e-8
# A held input has images about the multiples of the sampling rate, which modes fold back; those up to this one count.
_IMAGES = 8


class Steady(NamedTuple):
    """Spectra of one period in the steady state, on all lines or on some.

    Attributes:
        s: (F,) rad/s; q: (F, M) modes; x: (F, P) extensions of the ports; force: (F, P) upon the modes.
        kappa: (F, P) what the ports' springs and dampers answer to an extension; parts: (n, F, P) each row's share.
        softened: (P,) ``φ``.
    """

    s: Complex
    q: Complex
    x: Complex
    force: Complex
    kappa: Complex
    parts: Complex
    softened: Array

    @property
    def columns(self) -> Complex:
        """(F, 2 M + P) what outputs are made of: q, q̇ over the reference rate, and forces."""
        return np.concatenate([self.q, self.q * (self.s / RATE)[:, None], self.force], axis=1)

    def at(self, lines: NDArray[np.int64], scale: float) -> Steady:
        """On some lines only, the motion in other units."""
        moved = (scale * a[lines] for a in (self.q, self.x, self.force))
        return Steady(self.s[lines], *moved, self.kappa[lines], self.parts[:, lines], self.softened)


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Modes with slow springs and dampers at the ports; the output shapes are fitted separately.

    Attributes:
        omega, zeta: (M,) natural frequencies [rad/s] and damping ratios.
        b: (M, P) ratios between modes and ports, over the square root of a mode's static compliance.
        delay: (O,) of the outputs [s].
        weights: (n, P) of the springs k and the dampers c at the ports; n is 0 for the linear model, and 1 without
            dampers.
        reach: (P,) extension r at which a spring has half of its stiffness.
    """

    omega: Array
    zeta: Array
    b: Array
    delay: Array
    weights: Array
    reach: Array

    def transfer(self, s: Complex) -> Complex:
        """(F, M) ``H_i``: the modes by the force upon each."""
        return np.asarray(self.omega**2 / (s[:, None] ** 2 + 2.0 * self.zeta * self.omega * s[:, None] + self.omega**2))

    def impedance(self, s: Complex) -> Complex:
        """(F, P, P) ``Z``: the extensions of the ports by the forces upon the modes."""
        return np.asarray((self.b.T * self.transfer(s)[:, None, :]) @ self.b)

    def parts(self, s: Complex, softened: Array) -> Complex:
        """(n, F, P) what springs and dampers answer to an extension, where ``φ`` (P,) is known."""
        rows = [np.ones_like(s)[:, None] * softened, s[:, None] * (1.0 - softened)]
        return np.reshape([w * row for w, row in zip(self.weights, rows, strict=False)], (-1, s.size, len(softened)))

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

        def moved(softened: Array) -> tuple[list[Complex], list[Complex]]:
            kappas = [self.parts(s, softened).sum(axis=0) for s in rates]
            return kappas, [_closed(z, k, d) for z, k, d in zip(impedances, kappas, drives, strict=True)]

        def change(softened: Array) -> Array:
            x = np.sum(moved(softened)[1], axis=0)
            square = 2.0 * (np.abs(x[1:]) ** 2).sum(axis=0) / n**2
            return np.asarray(1.0 / (1.0 + square / self.reach**2) - softened)

        softened = np.ones(self.b.shape[1])
        if self.weights.size:
            solved = root(change, softened + change(softened), tol=_SETTLED)
            softened = np.clip(solved.x, 0.0, 1.0)
            if np.abs(change(softened)).max() > _TOLERABLE:
                raise SolverFailed(f"{experiment.name}: the ports of the modes come to no steady state")
        kappas, x = moved(softened)
        forces = [d - k * a for d, k, a in zip(drives, kappas, x, strict=True)]
        q = np.sum([self.transfer(s) * (g @ self.b.T) for s, g in zip(rates, forces, strict=True)], axis=0)
        here = len(images) // 2
        parts = self.parts(rates[here], softened)
        return Steady(rates[here], q, np.sum(x, axis=0), forces[here], kappas[here], parts, softened)

    def slopes(self, steady: Steady, shapes: Array, dt: float) -> Complex:
        """(F, O, K) derivatives of the outputs behind their delays by ln ω, ln ζ, b, delays in samples, ln of the
        weights and, where there are any, ln of the reach.

        Args:
            shapes: (O, 2 M + P), held fast.
        """
        modes, ports = self.b.shape
        s, h = steady.s, self.transfer(steady.s)
        observed = shapes[:, :modes] + shapes[:, modes : 2 * modes] * (s / RATE)[:, None, None]
        z = self.impedance(s)
        loop = np.linalg.inv(np.eye(ports) + z * steady.kappa[:, None, :])
        by_force = (observed * h[:, None, :]) @ self.b + shapes[:, 2 * modes :]
        # What an extension that is added from outside does to the outputs, through springs and dampers.
        by_extension = -(by_force * steady.kappa[:, None, :]) @ loop
        late = (-s[:, None] * dt * (steady.columns @ shapes.T))[:, :, None] * np.eye(len(shapes))
        by = self._columns(steady, h, (observed + by_extension @ self.b.T, by_extension, by_force + by_extension @ z))
        if len(self.weights):
            by = self._followed(steady, by, self._columns(steady, h, (loop @ self.b.T, loop, loop @ z)))
        before = 2 * modes + modes * ports
        every = np.concatenate([by[:, :, :before], late, by[:, :, before:]], axis=2)
        return np.asarray(every * np.exp(-s[:, None] * self.delay)[:, :, None])

    def _columns(self, steady: Steady, h: Complex, by: tuple[Complex, Complex, Complex]) -> Complex:
        """(F, O, …) derivatives by ln ω, ln ζ, b, ln of the weights and φ, of what is moved (F, O, …) by the modes, by
        extensions and by forces."""
        s, (by_mode, by_extension, closed) = steady.s, by
        pulled = steady.force @ self.b.T
        denominator = s[:, None] ** 2 + 2.0 * self.zeta * self.omega * s[:, None] + self.omega**2
        damping = 2.0 * self.zeta * self.omega * s[:, None] / denominator
        omega = by_mode * (h * (2.0 - damping - 2.0 * self.omega**2 / denominator) * pulled)[:, None, :]
        zeta = by_mode * (-h * damping * pulled)[:, None, :]
        b = (by_mode * h[:, None, :])[:, :, :, None] * steady.force[:, None, None, :]
        b = b + by_extension[:, :, None, :] * steady.q[:, None, :, None]
        changes = list(steady.parts)
        if changes:
            rows = (np.ones_like(s)[:, None], -s[:, None])
            changes.append(sum(w * row for w, row in zip(self.weights, rows, strict=False)))
        ends = [-closed * (change * steady.x)[:, None, :] for change in changes]
        return np.concatenate([omega, zeta, b.reshape(*by_mode.shape[:2], -1), *ends], axis=2)

    def _followed(self, steady: Steady, by: Complex, extended: Complex) -> Complex:
        """(F, O, …) derivatives of a steady state, where φ changes too: ln of the reach takes the place of φ.

        Args:
            by: (F, O, …) derivatives at constant φ; extended: (F, P, …) the same of the extensions, which give those of
                the mean squares.
        """
        ports, moving = self.reach.size, steady.x * (steady.s != 0.0)[:, None]
        square = (
            2.0 * np.einsum("fj,fjk->jk", moving.conj(), extended).real / (np.abs(moving) ** 2).sum(axis=0)[:, None]
        )
        slope = (steady.softened * (1.0 - steady.softened))[:, None]
        ahead = np.hstack([-slope * square[:, :-ports], 2.0 * slope * np.eye(ports)])
        follow = np.linalg.solve(np.eye(ports) + slope * square[:, -ports:], ahead)
        alone = np.concatenate([by[:, :, :-ports], np.zeros((*by.shape[:2], ports))], axis=2)
        return np.asarray(alone + by[:, :, -ports:] @ follow)


def _closed(z: Complex, kappa: Complex, drive: Complex) -> Complex:
    """(F, P) extensions in the closed loop."""
    moved = np.einsum("fjl,fl->fj", z, drive)
    if not kappa.any():
        return np.asarray(moved)
    return np.linalg.solve(np.eye(z.shape[1]) + z * kappa[:, None, :], moved[:, :, None])[:, :, 0]


def _of_hold(f: Array, h: float) -> Complex:
    """Spectrum of a value held for a time h."""
    return np.asarray(np.sinc(f * h) * np.exp(-1j * np.pi * f * h))
