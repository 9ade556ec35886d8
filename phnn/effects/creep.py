"""Creep: Maxwell cells beside the spring, of one to three times of their own, or one in every decade of time."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Parts, Scales, constant, has_motion, kinds, positive
from phnn.network.elements import Coupling, Network, Resistor, Storage

# Cells of creep that follows the logarithm of time: their times are a decade apart. The growth of the displacement then
# differs by 5 % at most from decade to decade.
_CELLS = tuple(range(1, 7))
# Shortest of these times, as shares of the fastest period.
_SHORTEST = (0.03, 0.3, 3.0)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Relaxation times from the fastest period to the longest recording."""
    times = np.geomspace(0.1 / scales.fastest, 2.0 * scales.duration, 10)
    return [{"k_s": 1e-3 * scales.stiffness, "tau_s": float(t)} for t in times]


def grid_logarithmic(scales: Scales) -> list[dict[str, float]]:
    """A cell in each of six decades, which begin well below the fastest period, below it and beyond it."""
    return [
        {"k_s": 1e-3 * scales.stiffness} | {f"tau_s1{i}": 10.0 ** (i - 1) * share / scales.fastest for i in _CELLS}
        for share in _SHORTEST
    ]


def growth_per_decade(network: Network, stiffness: float, first: float, last: float) -> float:
    """The growth of the displacement under a constant force in every decade from one time to another [%].

    With the stiffness ``K(t) = k + Σ k_i exp(−t/τ_i)`` of the spring and all cells beside it it is
    ``100 (K(t₁)/K(t₂) − 1) / lg(t₂/t₁)``.

    Args:
        network: of a model with creep; stiffness: of its spring [N/m].
        first, last: times since the force was applied [s].
    """
    cells = [[network.parameters[n].value for n in r.parameters] for r in network.resistors if r.law == "maxwell"]
    relaxing, tau = np.array(cells).T
    early, late = (stiffness + float(relaxing @ np.exp(-t / tau)) for t in (first, last))
    return float(100.0 * (early / late - 1.0) / np.log10(last / first))


EFFECT = Effect(
    name="creep",
    kind=kinds.MEMORY,
    equation=r"F_s = k_s\,s, \quad \dot{s} = v - s/\tau_s",
    statement="Part of the stiffness relaxes: a spring of {k_s} gives way with a time constant of {tau_s}, so the "
    "displacement goes on growing after a change of voltage.",
    fingerprint="The displacement goes on growing long after a step, and the gain falls slowly towards high "
    "frequencies at a nearly constant phase.",
    separation="A step to a constant voltage held ten times the creep time and back to zero: creep recovers "
    "completely, a drifting sensor goes on in one direction, a hysteron stops.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials",),
    declares=(
        positive("k_s", "N/m", "stiffness of the relaxing spring", 1e8, strength=True).plausibly(
            0.0, 0.25, "piezo actuators creep by up to a quarter of a step in minutes to hours", over="k"
        ),
        positive("tau_s", "s", "creep time", 1e3).plausibly(
            1e-3, 1e5, "creep goes on over many decades of time, from milliseconds to days"
        ),
    ),
    adds=Parts(
        (Storage("s", "spring", ("k_s",), "m"),),
        (Resistor("creep", "maxwell", {"s": 1.0}, ("k_s", "tau_s")),),
        (Coupling("s", "p", 1.0),),
    ),
    grid=grid,
    applies=has_motion,
    neighbours=("extra_hysteron", "sensor_drift"),
    at_most=3,
).or_as(
    equation=r"F_s = k_s \sum_i s_i, \quad \dot{s}_i = v - s_i/\tau_i, \quad \tau_{i+1} = 10\,\tau_i",
    statement="Part of the stiffness relaxes with the logarithm of time, {k_s} in every decade from {tau_s11} on, so "
    "the displacement goes on growing after a change of voltage.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials, ch. 5",),
    declares=(
        positive("k_s", "N/m", "stiffness that relaxes in every decade of time", 1e8, strength=True).plausibly(
            0.0, 0.1, "piezo actuators creep by one or two per cent of a step in every decade of time", over="k"
        ),
        *(constant(f"tau_s1{i}", "s", "creep time of one decade") for i in _CELLS),
    ),
    adds=Parts(
        tuple(Storage(f"s_1{i}", "spring", ("k_s",), "m") for i in _CELLS),
        tuple(Resistor(f"creep_1{i}", "maxwell", {f"s_1{i}": 1.0}, ("k_s", f"tau_s1{i}")) for i in _CELLS),
        tuple(Coupling(f"s_1{i}", "p", 1.0) for i in _CELLS),
    ),
    grid=grid_logarithmic,
    at_most=1,
)
