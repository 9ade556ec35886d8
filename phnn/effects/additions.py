"""The additions of effects to a setup: network parts, blocks of the measuring chain, or per-recording nuisances.

An addition is called with the setup and the effect's parameters by name, and returns the changed setup. An effect that
rewrites elements of the network uses a plain function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from phnn.laws import STORAGE_LAWS
from phnn.network.elements import Coupling, Modulation, ModulatorState, Network, Resistor, Storage
from phnn.parameters import Parameter, as_table
from phnn.setup import Block, Setup

Placed = Mapping[str, Parameter]
Addition = Callable[[Setup, Placed], Setup]


@dataclass(frozen=True)
class Parts:
    """New elements of the network, beside the existing ones."""

    storages: tuple[Storage, ...] = ()
    resistors: tuple[Resistor, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    modulations: tuple[Modulation, ...] = ()
    memories: tuple[ModulatorState, ...] = ()

    @property
    def passive(self) -> bool:
        """Whether every new storage has an energy that is bounded below."""
        return all(STORAGE_LAWS[s.law].bounded for s in self.storages if isinstance(s.law, str))

    def __call__(self, setup: Setup, parameters: Placed) -> Setup:
        network = setup.network.extend(
            self.storages,
            self.resistors,
            self.couplings,
            tuple(parameters.values()),
            self.modulations,
            self.memories,
        )
        return with_network(setup, network)


@dataclass(frozen=True)
class Chain:
    """Blocks at the end of the amplifier or of the sensor.

    Attributes:
        stage: ``amplifier`` or ``sensor``.
        blocks: blocks in series. A single block without parameter names takes all parameters of the effect.
    """

    stage: str
    blocks: tuple[Block, ...]

    passive = False

    def __call__(self, setup: Setup, parameters: Placed) -> Setup:
        for block in self.blocks:
            names = block.parameters or tuple(parameters)
            own = tuple(parameters[n] for n in names)
            setup = setup.with_block(self.stage, Block(block.kind, names), own)
        return setup


@dataclass(frozen=True)
class OfEveryRecording:
    """A nuisance: every recording adds it to its output with an amplitude of its own, so that it has no sign.

    Attributes:
        change: function that changes the setup, given the effect's parameters.
    """

    change: Addition

    passive = False
    signless = True

    def __call__(self, setup: Setup, parameters: Placed) -> Setup:
        return self.change(setup, parameters)


def at_amplifier(kind: str, *parameters: str) -> Chain:
    """A block at the end of the amplifier; it takes all parameters of the effect unless some are named."""
    return Chain("amplifier", (Block(kind, parameters),))


def at_sensor(kind: str, *parameters: str) -> Chain:
    """A block at the end of the sensor; it takes all parameters of the effect unless some are named."""
    return Chain("sensor", (Block(kind, parameters),))


def with_network(setup: Setup, network: Network) -> Setup:
    """The setup with another network."""
    return replace(setup, network=network)


def with_resistors(setup: Setup, change: Callable[[Resistor], Resistor], parameters: Placed) -> Setup:
    """The setup with its resistors changed and with more parameters."""
    network = setup.network
    table = as_table((*network.parameters.values(), *parameters.values()))
    return with_network(setup, replace(network, resistors=tuple(map(change, network.resistors)), parameters=table))


def with_following_dead_zones(setup: Setup, law: str, state: str, names: tuple[str, ...], parameters: Placed) -> Setup:
    """The setup in which every unmodulated dead zone is modulated by one state.

    Args:
        law: of the resistors; it takes the parameters of a dead zone first.
        state: the modulating state.
        names: further parameters of the law.
        parameters: parameters that the setup does not have yet.
    """

    def following(resistor: Resistor) -> Resistor:
        if resistor.law != "dead_zone":
            return resistor
        return replace(resistor, law=law, parameters=(*resistor.parameters, *names), modulated_by=state)

    return with_resistors(setup, following, parameters)
