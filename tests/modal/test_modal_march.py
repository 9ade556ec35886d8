"""The march of modes: closed forms, an integrator that shares no code, and balances of power."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phnn.modal.elements import DRAG, HARDENING, SLOW, SOFTENING, STOP
from phnn.modal.model import Parts, Structure, march

Array = NDArray[np.float64]

ALL = np.array([STOP, STOP, SOFTENING, HARDENING, DRAG, SLOW])


def structure(seed: int, modes: int, ports: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    omega = np.sort(2.0 * np.pi * rng.uniform(20.0, 200.0, modes))
    return omega, rng.uniform(0.005, 0.05, modes), rng.standard_normal((modes, ports))


def elements_of(seed: int, ports: int) -> tuple[Array, Array]:
    """Weights and thresholds of all kinds of parts, strong enough to matter."""
    rng = np.random.default_rng(seed + 1)
    k = rng.uniform(0.0, 0.3, (ports, ALL.size))
    k[:, ALL == DRAG] *= 1e-5
    return k, rng.uniform(0.2, 2.0, (ports, ALL.size))


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**31), modes=st.integers(1, 5), ports=st.integers(1, 3), h=st.floats(1e-4, 4e-3))
def test_what_is_supplied_is_stored_or_lost_in_every_step(seed: int, modes: int, ports: int, h: float) -> None:
    omega, zeta, b = structure(seed, modes, ports)
    k, r = elements_of(seed, ports)
    rng = np.random.default_rng(seed + 2)
    n = 60
    u = rng.standard_normal((n, ports))
    done = march(u, Structure(omega, zeta, b), Parts(ALL, k, r), h, before=np.full(ports, 0.5), periods=1)
    assert done.solved
    x = done.q @ b
    dx, mean = np.diff(x, axis=0), done.s[:-1]
    force = u[:-1] - (k * mean).sum(axis=2)
    # Modes take up what the forces do: their stored energy and a loss that is never negative.
    q, v = done.q, velocities(u, done.s, k, omega, zeta, b, h)
    energy = 0.5 * (q**2 + (v / omega) ** 2).sum(axis=1)
    lost = (force * dx).sum(axis=1) - np.diff(energy)
    scale = np.abs(force * dx).sum(axis=1).max() + energy.max()
    assert lost.min() >= -1e-9 * scale
    for kind, stored in (
        (SOFTENING, lambda y, r: r**2 * (np.sqrt(1.0 + (y / r) ** 2) - 1.0)),
        (HARDENING, lambda y, r: 0.25 * y**4),
        (SLOW, lambda y, r: 0.5 * y**2 / (1.0 + 0.5 / r**2)),
    ):
        for a in np.flatnonzero(kind == ALL):
            work = mean[:, :, a] * dx
            assert np.allclose(work, np.diff(stored(x, r[:, a]), axis=0), rtol=1e-8, atol=1e-9 * scale)
    for a in np.flatnonzero(ALL == STOP):
        s = np.zeros((n, ports))
        for i in range(n - 1):
            s[i + 1] = np.clip(s[i] + dx[i], -r[:, a], r[:, a])
        loss = mean[:, :, a] * dx - 0.5 * np.diff(s**2, axis=0)
        assert loss.min() >= -1e-9 * scale
        assert loss.max() > 0.0 or np.abs(x - x[0]).max() < r[:, a].min()
    for a in np.flatnonzero(ALL == DRAG):
        assert (mean[:, :, a] * dx).min() >= 0.0


def velocities(u: Array, s: Array, k: Array, omega: Array, zeta: Array, b: Array, h: float) -> Array:
    """(n, M) q̇ that belongs to the forces of a march from rest, by the matrix exponential of scipy."""
    from scipy.linalg import expm

    force = (u - (k * s).sum(axis=2)) @ b.T
    out = np.zeros_like(force)
    for i, (w, z) in enumerate(zip(omega, zeta, strict=True)):
        step = expm(np.array([[0.0, 1.0], [-(w**2), -2.0 * z * w]]) * h)
        state = np.zeros(2)
        for n in range(len(u) - 1):
            rest = np.array([force[n, i], 0.0])
            state = rest + step @ (state - rest)
            out[n + 1, i] = state[1]
    return out


@pytest.mark.parametrize("kind", [STOP, SOFTENING, HARDENING, DRAG])
def test_a_march_follows_an_adaptive_integrator(kind: int) -> None:
    omega, zeta, b = structure(5, 2, 1)
    k = np.array([[1e-5 if kind == DRAG else 0.2]]) / float((b**2).sum())
    r, h, n = np.array([[0.6]]), 2e-5, 4000
    u = np.sin(2.0 * np.pi * 37.0 * h * (np.arange(n) + 0.5))[:, None]
    done = march(u, Structure(omega, zeta, b), Parts(np.array([kind]), k, r), h, periods=1)

    def slope(t: float, state: Array) -> Array:
        q, v, s = state[:2], state[2:4], state[4]
        x, rate = float(q @ b[:, 0]), float(v @ b[:, 0])
        e = {
            STOP: s,
            SOFTENING: x / np.sqrt(1.0 + (x / r[0, 0]) ** 2),
            HARDENING: x**3,
            DRAG: abs(rate) * rate,
        }[kind]
        f = np.sin(2.0 * np.pi * 37.0 * t) - k[0, 0] * e
        sliding = (s >= r[0, 0] and rate > 0.0) or (s <= -r[0, 0] and rate < 0.0)
        return np.concatenate([v, omega**2 * (b[:, 0] * f - q) - 2.0 * zeta * omega * v, [0.0 if sliding else rate]])

    times = h * np.arange(n)
    other = solve_ivp(slope, (0.0, times[-1]), np.zeros(5), t_eval=times, rtol=1e-8, atol=1e-10, max_step=5e-5)
    x = done.q @ b[:, 0]
    assert np.abs(x - other.y[:2].T @ b[:, 0]).max() < 2e-3 * np.abs(x).max()


def test_a_slow_spring_softens_with_the_period_before() -> None:
    omega, zeta, b = structure(5, 2, 1)
    k, r, h = np.array([[0.3]]), np.array([[0.5]]), 2e-4
    u = np.sin(2.0 * np.pi * np.arange(500) / 500.0)[:, None]
    done = march(u, Structure(omega, zeta, b), Parts(np.array([SLOW]), k, r), h, periods=60)
    x = done.q @ b[:, 0]
    # Far below resonance the port is a spring: its compliance in parallel with what the slow spring is by now.
    stiffness = 1.0 / (1.0 + (x**2).mean() / 0.25)
    part = done.s[:, 0, 0] @ x / (x @ x)
    assert part == pytest.approx(stiffness, rel=1e-3)
