"""The additions of effects to a setup: network parts, blocks of the measuring chain, or per-recording nuisances.

An addition is called with the setup and the effect's parameters by name, and returns the changed setup. An effect that
rewrites elements of the network uses a plain function. Of springs and ports an effect makes one nonlinear, or adds a
term to one that is nonlinear already. The rim of a tank is a resistor that opens above a volume.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from phnn.effects.declaration import inertia
from phnn.laws import STORAGE_LAWS
from phnn.network.elements import Coupling, Modulation, ModulatorState, Network, Port, Ratio, Resistor, Storage
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
        """Return whether every new storage has an energy that is bounded below."""
        return all(STORAGE_LAWS[s.law].bounded for s in self.storages if isinstance(s.law, str))

    def __call__(self, setup: Setup, parameters: Placed) -> Setup:
        network = setup.network.extend(
            self.storages, self.resistors, self.couplings, tuple(parameters.values()), self.modulations, self.memories
        )
        return with_network(setup, network)


@dataclass(frozen=True)
class Slipping:
    """``F += −E(z)``, ``ż = v − φ``: a storage of the displacement ``z`` whose slip reads the momentum.

    Attributes:
        name: of the resistor by which it slips; law: of it; shape: its parameters but the inertia.
        spring: the storage.
    """

    name: str
    law: str
    spring: Storage
    shape: tuple[str, ...]
    passive = True

    def __call__(self, setup: Setup, parameters: Placed) -> Setup:
        """Return the setup with it."""
        z = self.spring.name
        slip = Resistor(self.name, self.law, {z: 1.0}, (*self.shape, inertia(setup)), "p")
        return Parts((self.spring,), (slip,), (Coupling(z, "p"),))(setup, parameters)


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
            block_parameters = tuple(parameters[n] for n in names)
            setup = setup.with_block(self.stage, Block(block.kind, names), block_parameters)
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
    """Return a block at the end of the amplifier; it takes all parameters of the effect unless some are named."""
    return Chain("amplifier", (Block(kind, parameters),))


def at_sensor(kind: str, *parameters: str) -> Chain:
    """Return a block at the end of the sensor; it takes all parameters of the effect unless some are named."""
    return Chain("sensor", (Block(kind, parameters),))


def with_network(setup: Setup, network: Network) -> Setup:
    """Return the setup with another network."""
    return replace(setup, network=network)


def with_resistors(setup: Setup, change: Callable[[Resistor], Resistor], parameters: Placed) -> Setup:
    """Return the setup with its resistors changed and with more parameters."""
    network = setup.network
    table = as_table((*network.parameters.values(), *parameters.values()))
    return with_network(setup, replace(network, resistors=tuple(map(change, network.resistors)), parameters=table))


def with_following_dead_zones(
    setup: Setup, parameters: Placed, law: str, state: str, further: tuple[str, ...] = ()
) -> Setup:
    """Return the setup in which every unmodulated dead zone is modulated by one state.

    Args:
        parameters: parameters that the setup does not have yet.
        law: of the resistors; it takes the parameters of a dead zone, then these, then the further ones.
        state: the modulating state.
    """

    def following(resistor: Resistor) -> Resistor:
        if resistor.law != "dead_zone":
            return resistor
        names = (*resistor.parameters, *parameters, *further)
        return replace(resistor, law=law, parameters=names, modulated_by=state)

    return with_resistors(setup, following, parameters)


def bent_spring(setup: Setup, law: str, parameters: Placed) -> Setup:
    """Return the setup whose spring of ``q`` follows ``quadratic_spring`` or ``cubic_spring``, or both.

    Args:
        law: the law to add; the spring may have the other one already.
        parameters: those of the law, its reference displacement last.
    """
    network, mine = setup.network, tuple(parameters)

    def bent(spring: Storage) -> Storage:
        stiffness, *before = spring.parameters
        if spring.law == "spring":
            return replace(spring, law=law, parameters=(stiffness, *mine))
        # The combined law takes the quadratic parameters first.
        names = (*mine, *before) if law == "quadratic_spring" else (*before, *mine)
        return replace(spring, law="bent_spring", parameters=(stiffness, *names))

    # First, as it refuses parameters that a law has already.
    table = as_table((*network.parameters.values(), *parameters.values()))
    storages = tuple(bent(s) if s.name == "q" else s for s in network.storages)
    return with_network(setup, replace(network, storages=storages, parameters=table))


def bent_port(setup: Setup, parameters: Placed, law: str) -> Setup:
    """Return the setup whose voltage port follows ``electrostriction`` or ``polynomial``, or both.

    Args:
        parameters: those of the law, its reference voltage last.
        law: the law to add; the port may have the other one already.
    """
    network, mine = setup.network, tuple(parameters)

    def bent(port: Port) -> Port:
        if port.name != "voltage":
            return port
        if port.law == "linear":
            return replace(port, law=law, parameters=mine)
        # The combined law takes the parameter of electrostriction first.
        names = (*mine, *port.parameters) if law == "electrostriction" else (*port.parameters, *mine)
        return replace(port, law="electrostrictive_polynomial", parameters=names)

    # First, as it refuses parameters that a law has already.
    table = as_table((*network.parameters.values(), *parameters.values()))
    return with_network(setup, replace(network, ports=tuple(map(bent, network.ports)), parameters=table))


def with_rim(setup: Setup, name: str, tank: str, on: Mapping[str, Ratio], parameters: Placed) -> Setup:
    """Return the setup in which the volume above the rim of a tank flows off.

    Args:
        name: of the resistor.
        tank: whose volume is compared with that of the rim.
        on: storages on which the resistor acts, with their signs.
        parameters: rate [1/s] and volume up to the rim [m³], in this order.
    """
    (capacity,) = next(s.parameters for s in setup.network.storages if s.name == tank)
    rim = Resistor(name, "overflow", dict(on), (*parameters, capacity))
    return Parts(resistors=(rim,))(setup, parameters)
