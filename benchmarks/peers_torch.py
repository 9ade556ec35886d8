"""torchdiffeq on the case: the explicit dopri5, whose steps the fast hysteron keeps below three microseconds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torchdiffeq

from benchmarks.case import TRUTH, Array, Solve
from benchmarks.ladder import Solver
from benchmarks.reference import SCALE
from phnn.recordings.recording import Recording

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)


class Actuator(torch.nn.Module):
    """Eqs. (3)–(6) in scaled states under one recorded input, by the logarithms of the parameters."""

    def __init__(self, recording: Recording) -> None:
        super().__init__()
        self.logarithms = torch.nn.Parameter(torch.log(torch.tensor(TRUTH)))
        self.u, self.dt = recording.u.tolist(), recording.dt
        self.scale = torch.tensor(SCALE)

    def voltage(self, t: float) -> float:
        """The straight line between two samples."""
        n = min(max(int(t / self.dt), 0), len(self.u) - 2)
        return self.u[n] + (self.u[n + 1] - self.u[n]) * (t / self.dt - n)

    def forward(self, t: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        """(4,) rates of the scaled states."""
        theta = self.logarithms.exp()
        m, k, b, alpha = theta[:4].unbind()
        x = z * self.scale
        v = x[3] / m
        effort = x[:2] / theta[4:6]
        half = 0.5 * theta[8:10]
        leak = theta[6:8] * (torch.clamp(effort - half, min=0.0) + torch.clamp(effort + half, max=0.0))
        force = alpha * (self.voltage(float(t.detach())) - effort.sum()) - k * x[2] - b * v
        return torch.cat([alpha * v - leak, torch.stack([v, force])]) / self.scale


def forward(recordings: Sequence[Recording]) -> list[Solver]:
    """dopri5 for the displacements."""
    actuators = [Actuator(r) for r in recordings]
    times = [torch.from_numpy(r.t) for r in recordings]

    def one(which: int, tolerance: float) -> Array:
        start = torch.zeros(4, dtype=torch.float64)
        with torch.no_grad():
            path = torchdiffeq.odeint(actuators[which], start, times[which], rtol=tolerance, atol=tolerance)
        return np.asarray(path[:, 2].numpy() * SCALE[2])

    def prepare(settings: Sequence[float]) -> Solve:
        return lambda: np.stack([one(r, s) for r, s in enumerate(settings)])

    return [Solver("torchdiffeq dopri5", TOLERANCES, prepare)]


def gradient(recordings: Sequence[Recording], wanted: Array, adjoint: bool) -> Solver:
    """(R, 10) derivatives of ``Σ (q − wanted)²`` by the logarithms of the parameters [m²].

    Args:
        adjoint: the adjoint method, or autograd through the steps of the solver.
    """
    actuators = [Actuator(r) for r in recordings]
    times = [torch.from_numpy(r.t) for r in recordings]
    targets = torch.from_numpy(wanted) / SCALE[2]
    integrate = torchdiffeq.odeint_adjoint if adjoint else torchdiffeq.odeint

    def one(which: int, tolerance: float) -> Array:
        actuator = actuators[which]
        actuator.zero_grad()
        start = torch.zeros(4, dtype=torch.float64)
        path = integrate(actuator, start, times[which], rtol=tolerance, atol=tolerance)
        ((path[:, 2] - targets[which]) ** 2).sum().backward()
        return np.asarray(actuator.logarithms.grad.numpy() * SCALE[2] ** 2)  # type: ignore[union-attr]

    def prepare(settings: Sequence[float]) -> Solve:
        return lambda: np.stack([one(r, s) for r, s in enumerate(settings)])

    how = "odeint_adjoint" if adjoint else "odeint and autograd"
    return Solver(f"torchdiffeq dopri5, {how}", TOLERANCES, prepare)
