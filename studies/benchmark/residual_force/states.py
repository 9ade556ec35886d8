"""Signals that the terms of a residual force depend on: states of the simulated base model at the samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.errors import InputRefused
from phnn.simulate import Trajectory
from studies.benchmark.residual_force.signals import rate_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class States:
    """A simulated recording on its samples, those before the first recorded one included.

    Attributes:
        dt: interval [s]; lead: samples before the first recorded one.
        t: (N,) time [s], zero at the first recorded sample.
        q, v, u, du: (N,) displacement [m], velocity [m/s], voltage [V] and its rate [V/s].
        e: (N, H) voltages of the hysterons [V]; slips: (N, H) −1, 0, 1, where each slips and to which side.
        alpha, b: transducer ratio [N/V], damping [N s/m].
        capacitance, slope, width: (H,) of the hysterons [F, S, V].
    """

    dt: float
    lead: int
    t: Array
    q: Array
    v: Array
    u: Array
    du: Array
    e: Array
    slips: Array
    alpha: float
    b: float
    capacitance: Array
    slope: Array
    width: Array


def states_of(trajectory: Trajectory) -> States:
    """The states at the samples.

    Raises:
        InputRefused: the model is no mass, spring and damper with hysterons under a voltage.
    """
    setup, nodes, names = trajectory.setup, trajectory.nodes, trajectory.program.states
    values = setup.values()
    if not {"q", "p"} <= set(names) or not {"m", "k", "b", "alpha"} <= set(values):
        raise InputRefused(f"{setup.name}: a residual force needs a mass, spring and damper: give a piezo actuator")
    count = sum(name.startswith("Q_") for name in names)
    capacitance, slope, width = (
        np.array([values[f"{kind}_{i + 1}"] for i in range(count)]) for kind in ("C", "rho", "d")
    )
    x = trajectory.states[nodes]
    e = x[:, [list(names).index(f"Q_{i + 1}") for i in range(count)]] / capacitance
    dt, u = trajectory.recording.dt, np.append(trajectory.fine[:, 0], trajectory.fine[-1, 2])[nodes]
    slips = np.where(np.abs(e) > 0.5 * width, np.sign(e), 0.0)
    q, v = x[:, list(names).index("q")], x[:, list(names).index("p")] / values["m"]
    t: Array = dt * (np.arange(nodes.size) - trajectory.lead).astype(np.float64)
    return States(
        dt, trajectory.lead, t, q, v, u, rate_of(u, dt), e, slips, values["alpha"], values["b"], capacitance, slope,
        width,
    )  # fmt: skip


def responses(trajectory: Trajectory, forces: Array) -> Array:
    """(N, F) changes of the output [m] by forces (N + lead, F) [N] at the samples, by the linearised base model.

    The base is linearised along its motion, hysterons included (`phnn.derivatives.output_derivatives`). Within each
    step a force is what a straight line between its samples has in the middle.
    """
    ends = np.cumsum(trajectory.h)
    middles = (ends - 0.5 * trajectory.h) / trajectory.recording.dt
    first = np.minimum(middles.astype(np.int64), forces.shape[0] - 2)
    share = (middles - first)[:, None]
    within = (1.0 - share) * forces[first] + share * forces[first + 1]
    return output_derivatives(trajectory, (), forces=within)
