"""What an effect is: one piece of physics that a model may have left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from phnn.network.elements import Network
from phnn.parameters import Parameter, as_table
from phnn.setup import Setup

LOCATIONS = (
    "amplifier", "electrical", "hysteron", "coupling", "mechanical", "thermal", "sensor", "environment",
)  # fmt: skip


@dataclass(frozen=True)
class Scales:
    """Sizes met in a campaign and its base model, from which effects take their grids.

    Attributes:
        voltage: largest input [V]; displacement: largest change of the output [m]; velocity: largest [m/s].
        stiffness: of the base model [N/m]; transducer: its ratio α [N/V].
        slowest, fastest: lowest and highest excited frequency [Hz].
        duration: longest recording [s].
        noise: typical noise floor [m].
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


@dataclass(frozen=True)
class Effect:
    """A member of the catalogue.

    Attributes:
        name: canonical name.
        location: one of `LOCATIONS`.
        equation: LaTeX.
        statement: one or two sentences for a person; ``{parameter}`` is replaced by its value with unit.
        references: where the law comes from.
        passive: whether adding it keeps ``J = −Jᵀ``, ``D ≥ 0`` and ``H`` bounded below.
        strength: the parameter that is zero when the effect is absent; None where there is no such parameter.
        one_sided: only positive strengths are physical.
        grid: values of all its parameters to probe, given the scales. Strengths are small there.
        build: adds the effect with given parameter values.
        needs_command: makes sense only where the recorded voltage is the amplifier's command.
        neighbours: effects that ordinary recordings cannot always tell apart from it.
        contains: effects that are special cases of it, so that it can never fit worse than they do.
        rescale: how to multiply the strength where that is more than multiplying one parameter.
    """

    name: str
    location: str
    equation: str
    statement: str
    references: tuple[str, ...]
    passive: bool
    strength: str | None
    one_sided: bool
    grid: Callable[[Scales], list[dict[str, float]]]
    build: Callable[[Setup, Mapping[str, float]], Setup]
    parameters: tuple[str, ...]
    needs_command: bool = False
    neighbours: tuple[str, ...] = ()
    rescale: Callable[[Mapping[str, float], float], dict[str, float]] | None = None
    contains: tuple[str, ...] = ()

    def scaled(self, values: Mapping[str, float], factor: float) -> dict[str, float]:
        """Parameter values with the strength multiplied, kept within a physical range.

        Args:
            values: a grid point.
            factor: how much stronger than there the effect seems to be, to first order.
        """
        if self.rescale is not None:
            return self.rescale(values, factor)
        if self.strength is None:
            return dict(values)
        factor = max(factor, 1e-3) if self.one_sided else factor
        return dict(values) | {self.strength: values[self.strength] * factor}

    def add_to(self, setup: Setup, values: Mapping[str, float]) -> Setup:
        """The setup with this effect at the given parameter values (SI)."""
        return replace(self.build(setup, values), name=f"{setup.name}+{self.name}")


def with_network(setup: Setup, network: Network) -> Setup:
    """The setup around another network."""
    return replace(setup, network=network)


def replace_storage(network: Network, name: str, law: str, extra: Sequence[Parameter]) -> Network:
    """Another energy law on a storage; its parameters come after those it has."""
    storages = tuple(
        replace(s, law=law, parameters=(*s.parameters, *(p.name for p in extra))) if s.name == name else s
        for s in network.storages
    )
    parameters = as_table((*network.parameters.values(), *extra))
    return replace(network, storages=storages, parameters=parameters)
