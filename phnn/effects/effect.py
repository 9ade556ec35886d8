"""What an effect is: one piece of physics that a model may have left out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from phnn.errors import InputRefused
from phnn.network.bondgraph.imposed import effort_unit
from phnn.network.elements import Network
from phnn.network.roles import hysterons
from phnn.setup import Setup

LOCATIONS = (
    "amplifier", "electrical", "hysteron", "coupling", "mechanical", "thermal", "sensor", "environment",
)  # fmt: skip
# Storage laws of a spring that can be bent, or bent further.
SPRINGS = ("spring", "quadratic_spring", "cubic_spring")


@dataclass(frozen=True)
class Special:
    """An effect that is a special case of another one.

    Attributes:
        name: of the special case.
        values: of its parameters, and of those of the model that change with it, from all parameter values of a model
            with the more general effect [SI].
    """

    name: str
    values: Callable[[Mapping[str, float]], dict[str, float]]


@dataclass(frozen=True)
class Plausible:
    """Where a parameter of an effect lies in piezo actuators that exist.

    Attributes:
        lower, upper: ends of the range [SI].
        source: where it comes from, as a sentence without its full stop; empty where no range is known.
        over: parameter of the base model by which the value is divided before, so that no anchor is needed.
        outside: what a value above the range means, as the rest of a sentence.
    """

    lower: float
    upper: float
    source: str
    over: str = ""
    outside: str = ""


def no_range(*names: str) -> dict[str, Plausible]:
    """Parameters of which no plausible range is known."""
    return {name: Plausible(-math.inf, math.inf, "") for name in names}


@dataclass(frozen=True)
class Scales:
    """Sizes met in a campaign and its base model, from which effects take their grids.

    Attributes:
        voltage: largest input [V]; displacement: largest change of the output [m]; velocity: largest [m/s].
        stiffness: of the base model [N/m]; transducer: its ratio α [N/V].
        slowest, fastest: lowest and highest excited frequency [Hz].
        duration: longest recording [s].
        noise: typical noise floor [m].
        peaks: frequencies [Hz] at which the residual has most power.
        effort: largest force [N] where that is the output, the motion being imposed; 0 where the motion is the output.
    """

    voltage: float
    displacement: float
    velocity: float
    stiffness: float
    transducer: float
    slowest: float
    fastest: float
    duration: float
    noise: float
    peaks: tuple[float, ...] = ()
    effort: float = 0.0

    @property
    def sensed(self) -> float:
        """Largest output: of the displacement, or of the force that an imposed motion takes."""
        return self.effort or self.displacement

    @property
    def sensed_rate(self) -> float:
        """Largest rate of the output."""
        return 2.0 * math.pi * self.fastest * self.effort if self.effort else self.velocity


def always(setup: Setup) -> bool:
    """Whatever the setup is."""
    return True


def has_motion(setup: Setup) -> bool:
    """A momentum ``p`` moves the displacement ``q``: forces can act on it."""
    return any({c.to, c.of} == {"q", "p"} for c in setup.network.couplings)


def has_spring(setup: Setup) -> bool:
    """The displacement ``q`` has a spring of its own, which is not there for its position alone."""
    stiffness = [s.parameters[0] for s in setup.network.storages if s.name == "q" and s.law in SPRINGS]
    return has_motion(setup) and any(setup.parameters[name].value > 0.0 for name in stiffness)


def has_dead_zones(setup: Setup) -> bool:
    """Some resistor has a dead zone: there are hysterons."""
    return bool(hysterons(setup.network))


def has_plain_dead_zones(setup: Setup) -> bool:
    """Some resistor has a dead zone that follows no state yet."""
    return any(r.law == "dead_zone" for r in setup.network.resistors)


def has_transducer(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio by which the voltage port acts on the momentum."""
    ports = setup.network.ports
    return has_motion(setup) and any(p.name == "voltage" and p.on.get("p") == "alpha" for p in ports)


def sensed_unit(setup: Setup) -> str:
    """SI unit of what the sensor measures: of a displacement, or of the effort that an imposed motion takes."""
    network = setup.network
    return next((effort_unit(p.unit) for p in network.ports if p.name == network.senses), "m")


def has_tanks(setup: Setup) -> bool:
    """Stores of constant capacity drain into each other through resistors alone."""
    network = setup.network
    return all(s.law == "capacitor" for s in network.storages) and not network.couplings


@dataclass(frozen=True)
class Effect:
    """A member of the catalogue.

    Its law is written for a displacement ``q`` that a momentum ``p`` moves, with stiffness ``k`` and damping ``b``, for
    a port ``voltage`` that acts on it with the ratio ``alpha``, and hysterons ``Q_i`` with ``C_i``, ``rho_i``, ``d_i``;
    `phnn.effects.places` finds what has these roles in a network of other names.

    Attributes:
        name: canonical name.
        location: one of `LOCATIONS`.
        kind: what sort of thing it is there: elastic, dissipative, memory, lag, …; effects of one kind act through the
            same local variables.
        akin: further kinds at its place as which another form of it may show.
        equation: LaTeX.
        statement: one or two sentences for a person; ``{parameter}`` is replaced by its value with unit.
        fingerprint: one sentence: what betrays it in recordings.
        separation: one sentence: the experiment that separates it from its neighbours.
        references: where the law comes from.
        passive: whether adding it keeps ``J = −Jᵀ``, ``D ≥ 0`` and ``H`` bounded below.
        strength: the parameter that is zero when the effect is absent; None where there is no such parameter.
        strengths: where several parameters are zero when the effect is absent, all of them, ``strength`` the first.
        one_sided: only positive strengths are physical.
        grid: values of all its parameters to probe, given the scales. Strengths are small there.
        build: adds the effect with given parameter values.
        applies: whether it can be added to a setup at all.
        needs_command: makes sense only where the recorded voltage is the amplifier's command.
        neighbours: effects that ordinary recordings cannot always tell apart from it.
        contains: effects that are special cases of it, so that it can never fit worse than they do.
        exchanged: values of the model's parameters that have what it adds in the place of something alike, from all
            values of a model with it: where to begin when it is taken away again.
        searched: its parameter that is a frequency to be found in the spectrum of what the model leaves.
        rescale: how to multiply the strength where that is more than multiplying parameters.
        forms: the same physics by other laws, under the same name, at the same place and of the same kind.
        place: displacement of the motion that it acts on, where that is not the measured one.
        at_most: how many of it may act at one place, 1 to 3; which: "second" or "third", empty for the first.
        after: parameters of the one before, which has to be there already.
        several_of: name of the effect that a learned element is several of, and nothing else.
        plausible: where each of its parameters lies in actuators that exist, or that no range is known.
    """

    name: str
    location: str
    kind: str
    equation: str
    statement: str
    fingerprint: str
    separation: str
    references: tuple[str, ...]
    passive: bool
    strength: str | None
    one_sided: bool
    grid: Callable[[Scales], list[dict[str, float]]]
    build: Callable[[Setup, Mapping[str, float]], Setup]
    parameters: tuple[str, ...]
    applies: Callable[[Setup], bool] = always
    needs_command: bool = False
    neighbours: tuple[str, ...] = ()
    rescale: Callable[[Mapping[str, float], float], dict[str, float]] | None = None
    contains: tuple[Special, ...] = ()
    exchanged: Callable[[Mapping[str, float]], list[dict[str, float]]] | None = None
    searched: str | None = None
    akin: tuple[str, ...] = ()
    forms: tuple[Effect, ...] = ()
    plausible: Mapping[str, Plausible] = field(default_factory=dict, compare=False)
    strengths: tuple[str, ...] = ()
    place: str = ""
    at_most: int = 1
    which: str = ""
    after: tuple[str, ...] = ()
    several_of: str = ""

    @property
    def title(self) -> str:
        """Name in the catalogue and place, whichever of several it is."""
        return self.name.removeprefix(f"{self.which} ") if self.which else self.name

    @property
    def canonical(self) -> str:
        """Name in the catalogue, whatever the place."""
        return self.title.removesuffix(f" at {self.place}") if self.place else self.title

    def is_more_of(self, other: Effect) -> bool:
        """Whether a learned element is the same physics as another effect at the same place."""
        return self.several_of == other.canonical and self.place == other.place

    @property
    def all_strengths(self) -> tuple[str, ...]:
        """The parameters that are zero when the effect is absent."""
        return self.strengths or (() if self.strength is None else (self.strength,))

    @property
    def special(self) -> tuple[str, ...]:
        """Names of its special cases."""
        return tuple(s.name for s in self.contains)

    def scaled(self, values: Mapping[str, float], factor: float) -> dict[str, float]:
        """Parameter values with the strengths multiplied, kept within a physical range.

        Args:
            values: a grid point.
            factor: how much stronger than there the effect seems to be, to first order.
        """
        if self.rescale is not None:
            return self.rescale(values, factor)
        factor = max(factor, 1e-3) if self.one_sided else factor
        return dict(values) | {name: values[name] * factor for name in self.all_strengths}

    def can_be_added_to(self, setup: Setup) -> bool:
        """Whether it applies to the setup, which has the one before it, and is not in it already, under its own
        parameter names."""
        there = set(setup.parameters)
        return self.applies(setup) and set(self.after) <= there and not set(self.parameters) & there

    def add_to(self, setup: Setup, values: Mapping[str, float]) -> Setup:
        """The setup with this effect at the given parameter values (SI).

        Raises:
            InputRefused: it does not apply to the setup, or is in it already.
        """
        if not self.applies(setup) and not set(self.parameters) & set(setup.parameters):
            wanted = (self.applies.__doc__ or "").strip()
            raise InputRefused(f"{self.name} cannot be added to {setup.name}; it can be where this holds: {wanted}")
        return replace(self.build(setup, values), name=f"{setup.name}+{self.name}")


def with_network(setup: Setup, network: Network) -> Setup:
    """The setup around another network."""
    return replace(setup, network=network)
