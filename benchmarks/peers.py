"""The peers on the same case: diffrax and torchdiffeq. They are given the continuous sine itself, in scaled states."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import torch
import torchdiffeq

from benchmarks.case import AMPLITUDE, FREQUENCIES, PERIODS, SAMPLES, TRUTH, Array, times
from benchmarks.reference import SCALE

jax.config.update("jax_enable_x64", True)
torch.set_num_threads(1)

SOLVERS = {"Kvaerno5": diffrax.Kvaerno5(), "Kvaerno3": diffrax.Kvaerno3()}
_MAX_STEPS = 20_000
# Reverse mode stores checkpoints for so many steps; 1e-6 needs fewer than a thousand a sine.
_MAX_STEPS_REVERSE = 4096


def _rates(t: Any, z: Any, arguments: Any) -> Any:
    """Eqs. (3)–(6) in scaled states, as in `benchmarks.reference`."""
    theta, omega = arguments
    m, k, b, alpha = theta[0], theta[1], theta[2], theta[3]
    x = z * SCALE
    v = x[3] / m
    effort = x[:2] / theta[4:6]
    half = 0.5 * theta[8:10]
    leak = theta[6:8] * (jnp.maximum(effort - half, 0.0) + jnp.minimum(effort + half, 0.0))
    force = -alpha * jnp.sum(effort) - k * x[2] - b * v + alpha * AMPLITUDE * jnp.sin(omega * t)
    return jnp.concatenate([alpha * v - leak, jnp.stack([v, force])]) / SCALE


def _one(solver: Any, adjoint: Any, max_steps: int, theta: Any, frequency: Any, tolerance: Any) -> Any:
    """(SAMPLES,) displacement under one sine [m]."""
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_rates),
        solver,
        t0=0.0,
        t1=PERIODS / frequency,
        dt0=PERIODS / frequency / SAMPLES,
        y0=jnp.zeros(4),
        args=(theta, 2.0 * jnp.pi * frequency),
        saveat=diffrax.SaveAt(ts=jnp.arange(SAMPLES) * (PERIODS / frequency / SAMPLES)),
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        adjoint=adjoint,
        max_steps=max_steps,
    )
    return solution.ys[:, 2] * SCALE[2]


def diffrax_forward(name: str, together: bool) -> Callable[[float], Array]:
    """``solve(tolerance)`` of the whole campaign: all sines at once by vmap, or one after the other."""
    adjoint = diffrax.RecursiveCheckpointAdjoint()
    frequencies = jnp.array(FREQUENCIES)
    theta = jnp.array(TRUTH)

    def one(frequency: Any, tolerance: Any) -> Any:
        return _one(SOLVERS[name], adjoint, _MAX_STEPS, theta, frequency, tolerance)

    if together:
        batch = jax.jit(jax.vmap(one, (0, None)))
        return lambda tolerance: np.asarray(batch(frequencies, tolerance))
    single = jax.jit(one)
    return lambda tolerance: np.stack([np.asarray(single(f, tolerance)) for f in FREQUENCIES])


def diffrax_gradient(name: str, mode: str, together: bool, wanted: Array) -> Callable[[float], Array]:
    """``gradient(tolerance)`` of ``Σ (q − wanted)²`` by the logarithms of the parameters.

    Args:
        mode: "reverse" (recursive checkpoints) or "forward" (ten tangents).
        together: all sines at once by vmap, or one after the other.
    """
    reverse = mode == "reverse"
    adjoint = diffrax.RecursiveCheckpointAdjoint() if reverse else diffrax.ForwardMode()
    frequencies = jnp.array(FREQUENCIES)
    targets = jnp.array(wanted)
    start = jnp.log(jnp.array(TRUTH))

    def cost(logarithms: Any, frequency: Any, target: Any, tolerance: Any) -> Any:
        q = _one(SOLVERS[name], adjoint, _MAX_STEPS_REVERSE, jnp.exp(logarithms), frequency, tolerance)
        return jnp.sum(((q - target) / SCALE[2]) ** 2)

    derivative = jax.grad if reverse else jax.jacfwd
    if together:

        def whole(logarithms: Any, tolerance: Any) -> Any:
            return jnp.sum(jax.vmap(cost, (None, 0, 0, None))(logarithms, frequencies, targets, tolerance))

        batch = jax.jit(derivative(whole))
        return lambda tolerance: np.asarray(batch(start, tolerance)) * SCALE[2] ** 2
    single = jax.jit(derivative(cost))

    def solve(tolerance: float) -> Array:
        parts = [single(start, f, w, tolerance) for f, w in zip(frequencies, targets, strict=True)]
        return np.asarray(sum(parts[1:], parts[0])) * SCALE[2] ** 2

    return solve


def dopri5_one_period(frequency: float, tolerance: float) -> tuple[Array, float]:
    """Displacement over the first period by torchdiffeq's dopri5, and the seconds it took (once: it is that slow)."""
    theta = torch.tensor(TRUTH)
    scale = torch.tensor(SCALE)
    m, k, b, alpha = theta[:4]
    half = 0.5 * theta[8:10]

    def rates(t: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        x = z * scale
        v = x[3] / m
        effort = x[:2] / theta[4:6]
        leak = theta[6:8] * (torch.clamp(effort - half, min=0.0) + torch.clamp(effort + half, max=0.0))
        force = -alpha * effort.sum() - k * x[2] - b * v + alpha * AMPLITUDE * torch.sin(2.0 * np.pi * frequency * t)
        return torch.cat([alpha * v - leak, torch.stack([v, force])]) / scale

    t = torch.tensor(times(frequency)[: SAMPLES // PERIODS])
    begin = time.perf_counter()
    with torch.no_grad():
        z = torchdiffeq.odeint(rates, torch.zeros(4, dtype=torch.float64), t, rtol=tolerance, atol=tolerance)
    seconds = time.perf_counter() - begin
    return (z[:, 2] * scale[2]).numpy(), seconds
