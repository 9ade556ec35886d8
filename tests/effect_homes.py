"""Base models that effects are added to in tests, and how their simulations are run and checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from junctions import recording

from phnn.configuration import config_folder
from phnn.effects import Effect, Scales, catalogue
from phnn.effects.formulas import formulas
from phnn.effects.learned import learned_elements
from phnn.integrate.residual import check, power_balance
from phnn.laws import STORAGE_LAWS
from phnn.models.actuator import from_paper, hrc
from phnn.models.network_file import load_network
from phnn.network import Network, PortHamiltonianSystem
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import Trajectory, simulate

FOLDER = config_folder() / "network"


@dataclass(frozen=True, eq=False)
class Home:
    """A base model, what is met in its recordings, and one of them."""

    setup: Setup
    scales: Scales
    drive: Recording


def actuator() -> Home:
    """Two amplitudes of a sine from rest."""
    scales = Scales(
        voltage=75.0, displacement=1.2e-4, velocity=0.1, stiffness=24579.0, transducer=0.046, slowest=20.0,
        fastest=150.0, duration=0.02, noise=5e-8,
    )  # fmt: skip
    t = np.arange(401) * 5e-5
    u = 75.0 * np.sin(2 * np.pi * 100.0 * t) * np.where(t < 0.01, 0.4, 1.0)
    return Home(Setup(from_paper()), scales, recording(t, u))


def tanks() -> Home:
    """A pump that fills two tanks by swells of two sizes."""
    scales = Scales(
        voltage=1e-4, displacement=1.4e-3, velocity=2e-4, stiffness=1.0, transducer=1.0, slowest=0.02, fastest=0.05,
        duration=100.0, noise=1e-6,
    )  # fmt: skip
    t = np.arange(401) * 0.25
    u = 5e-5 * (1.0 - np.cos(2 * np.pi * 0.04 * t)) * np.where(t < 50.0, 0.4, 1.0)
    return Home(Setup(load_network(FOLDER / "tanks.yaml")), scales, recording(t, u))


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
    return ACTUATOR if effect_.can_be_added_to(BASE) else TANKS


def run(setup: Setup, where: Home = ACTUATOR) -> Trajectory:
    return simulate(setup, where.drive)


@cache
def base(where: Home) -> Trajectory:
    return run(where.setup, where)


def point(effect_: Effect) -> dict[str, float]:
    """The first point of the effect's grid, made strong enough to be seen."""
    return effect_.scaled(effect_.grid(home(effect_).scales)[0], 50.0)


def added(effect_: Effect, values: dict[str, float]) -> Trajectory:
    """The simulation with one effect."""
    where = home(effect_)
    return run(effect_.add_to(where.setup, values), where)


def sources(network: Network) -> list[bool]:
    """Which storages have an energy that is not bounded below."""
    return [not STORAGE_LAWS[s.law].bounded for s in network.storages]


def is_sound(setup: Setup, where: Home = ACTUATOR) -> None:
    """The network is port-Hamiltonian and passive, weights aside, and the compiled march agrees with the module."""
    trajectory = run(setup, where)
    assert np.isfinite(trajectory.y).all()
    system = PortHamiltonianSystem(setup.network)
    assert check(trajectory, system=system) < 1e-10
    x, unbounded = torch.from_numpy(trajectory.states)[::7], torch.tensor(sources(setup.network))
    with torch.no_grad():
        j, d = system.structure(x), system.dissipation(x)
        held = system.energies(x)
    assert torch.equal(j, -j.mT)
    assert torch.equal(d, d.mT)
    assert (torch.linalg.eigvalsh(d) >= -1e-12 * d.abs().amax((-2, -1))[:, None]).all()
    assert (held[:, ~unbounded] >= 0.0).all()
    balance = power_balance(trajectory, system)
    size = balance.supplied.abs().sum(-1) + balance.dissipated.abs().sum(-1) + held.abs().max()
    assert (balance.defect.abs() <= 1e-12 * size).all()
    assert (balance.dissipated >= -1e-12 * size[:, None]).all()
