"""Base models that effects are added to in tests, and how their simulations are run and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.integrate import solve_ivp

from phnn.configuration import config_folder
from phnn.effects import Effect, catalogue, soundness
from phnn.effects.formulas import formulas
from phnn.effects.learned import learned_elements
from phnn.effects.soundness import Home, actuator, faults, tanks
from phnn.models.actuator import hrc
from phnn.models.network_file import load_network
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate

FOLDER = config_folder() / "network"
ACTUATOR, TANKS = actuator(), tanks()
BASE, SCALES = ACTUATOR.setup, ACTUATOR.scales
# What is no actuator: no hysteron, no transducer, no spring, no motion.
OTHERS = {
    "oscillator": Setup(load_network(FOLDER / "mass_spring_damper.yaml")),
    "mass": Setup(load_network(FOLDER / "mass_damper.yaml")),
    "tanks": TANKS.setup,
    "linear": Setup(hrc(0)),
}
EFFECTS = list(catalogue().values())
LEARNED = list(learned_elements().values())
FORMULAS = list(formulas().values())
OF_ACTUATOR = [e for e in EFFECTS if e.can_be_added_to(BASE)]


def home(effect_: Effect) -> Home:
    """The base model for an effect: the actuator wherever it applies to that."""
    where = soundness.home_of(effect_)
    assert where is not None
    return where


def run(setup: Setup, where: Home = ACTUATOR) -> Trajectory:
    return simulate(setup, where.drive)


def base(where: Home) -> Trajectory:
    return soundness.base_of(where)


def point(effect_: Effect) -> dict[str, float]:
    """The first point of the effect's grid, made strong enough to be seen."""
    return soundness.point(effect_, home(effect_))


def added(effect_: Effect, values: dict[str, float]) -> Trajectory:
    """The simulation with one effect."""
    return soundness.added(effect_, values, home(effect_))


def is_sound(setup: Setup, where: Home = ACTUATOR) -> None:
    """The network is port-Hamiltonian and passive, weights aside, and the compiled march agrees with the module."""
    assert faults(setup, where) == []


def march_against_radau(
    setup: Setup,
    rate: Callable[[float, np.ndarray], np.ndarray],
    order: tuple[str, ...],
    shown: Mapping[str, Callable[[np.ndarray], np.ndarray]] | None = None,
) -> None:
    """The compiled march agrees with Radau's method on equations written down anew.

    Args:
        rate: of the states in ``order``; shown: what stands for some of them in these equations.
    """
    trajectory = simulate(setup, ACTUATOR.drive, 4)
    names = list(setup.network.state_names)
    found = np.stack([(shown or {}).get(n, np.asarray)(trajectory.states[:, names.index(n)]) for n in order], axis=1)
    scale = np.abs(found).max(axis=0)
    state, worst = found[0], np.zeros(len(order))
    # Inputs are those of the march, constant over every step; two periods of the larger amplitude.
    for n in range(trajectory.h.size):
        voltage = trajectory.u[n, 0]
        end = solve_ivp(
            lambda t, z, v=voltage: rate(v, z), (0.0, trajectory.h[n]), state, "Radau", rtol=1e-6, atol=1e-8 * scale
        )
        state = end.y[:, -1]
        worst = np.maximum(worst, np.abs(state - found[n + 1]) / scale)
    assert (worst < 2e-3).all(), dict(zip(order, worst, strict=True))


def elementary(setup: Setup) -> Callable[[float, np.ndarray, Callable[[float, float], float]], np.ndarray]:
    """Eqs. (3)–(6) of two hysterons, with a further force on the mass."""
    v = setup.values()

    def rate(voltage: float, z: np.ndarray, force: Callable[[float, float], float]) -> np.ndarray:
        speed = z[3] / v["m"]
        efforts = z[:2] / np.array([v["C_1"], v["C_2"]])
        half = 0.5 * np.array([v["d_1"], v["d_2"]])
        lost = np.array([v["rho_1"], v["rho_2"]]) * (efforts - np.clip(efforts, -half, half))
        charged = v["alpha"] * speed - lost
        pushed = v["alpha"] * (voltage - efforts.sum()) - v["k"] * z[2] - v["b"] * speed - force(z[2], speed)
        return np.array([*charged, speed, pushed])

    return rate
