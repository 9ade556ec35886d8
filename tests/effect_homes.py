"""Base models that effects are added to in tests, and how their simulations are run and checked."""

from __future__ import annotations

from phnn.configuration import config_folder
from phnn.effects import Effect, catalogue
from phnn.effects.formulas import formulas
from phnn.effects.learned import learned_elements
from phnn.effects.soundness import homes
from phnn.effects.soundness.homes import Home
from phnn.effects.soundness.structure import faults
from phnn.models.actuator import hrc
from phnn.models.network_file import load_network
from phnn.setup import Setup
from phnn.simulate import Trajectory

FOLDER = config_folder() / "network"
ACTUATOR, TANKS = homes.actuator(), homes.tanks()
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
    return homes.simulated(setup, where)


def base(where: Home) -> Trajectory:
    return homes.base_of(where)


def point(effect_: Effect) -> dict[str, float]:
    """The first point of the effect's grid, made strong enough to be seen."""
    return homes.point(effect_, home(effect_))


def added(effect_: Effect, values: dict[str, float]) -> Trajectory:
    """The simulation with one effect."""
    return homes.added(effect_, values, home(effect_))


def is_sound(setup: Setup, where: Home = ACTUATOR) -> None:
    """The network is port-Hamiltonian and passive, weights aside, and the compiled march agrees with the module."""
    assert faults(setup, where) == []
