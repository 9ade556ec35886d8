"""A setup: amplifier → network → sensor, the thing a folder of recordings is a recording *of*.

The blocks before and behind the network are not passive and stand openly outside its passive core.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from phnn.errors import StructureViolated
from phnn.network.elements import Network
from phnn.parameters import Parameter, as_table, with_values


@dataclass(frozen=True)
class Block:
    """One element of the measuring chain, of a kind that `phnn.chain` lists, and its parameters."""

    kind: str
    parameters: tuple[str, ...] = ()


@dataclass(frozen=True)
class Source:
    """What acts on a port of the network beside the recorded input: of a kind that `phnn.chain` lists.

    Attributes:
        kind: which function; parameters: names of its parameters, in its order.
        port: name of the port whose input it is.
    """

    kind: str
    port: str
    parameters: tuple[str, ...] = ()


class Own(NamedTuple):
    """Nuisances of the recordings: terms of the output whose amplitudes differ from recording to recording.

    They are projected out, like the zero of the output.

    Attributes:
        lines: frequencies [Hz] of lines, whose amplitude and phase differ from recording to recording.
        drift_terms: how many half-cosines over the recording make up the slow drift of a sensor.
    """

    lines: tuple[float, ...] = ()
    drift_terms: int = 0


NOTHING = Own()
# Half-cosines of the slow drift of a sensor: they leave a fourteenth of the variance of a random walk.
DRIFT_TERMS = 8


@dataclass(frozen=True)
class Setup:
    """What is between the recorded input and the recorded output.

        setup = phnn.Setup(phnn.models.hrc(hysterons=2))     # no amplifier or sensor of note

    Attributes:
        network: the passive core.
        amplifier: blocks from the recorded input to the port.
        sensor: blocks from the network's output to the recorded output.
        block_parameters: parameters of the blocks and sources, by name.
        name: for tables and reports.
        sources: inputs of further ports, each a function of the recording's time.
        own: parts of the output that have nothing to do with the actuator.
    """

    network: Network
    amplifier: tuple[Block, ...] = ()
    sensor: tuple[Block, ...] = ()
    block_parameters: Mapping[str, Parameter] | None = None
    name: str = "model"
    sources: tuple[Source, ...] = ()
    own: Own = NOTHING

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Return all parameters, the network's first."""
        return as_table((*self.network.parameters.values(), *(self.block_parameters or {}).values()))

    @property
    def free(self) -> tuple[str, ...]:
        """Return the names of the parameters that may be estimated."""
        return tuple(n for n, p in self.parameters.items() if not p.fixed)

    @property
    def has_zero(self) -> bool:
        """Return whether the zero of the output is a parameter, and no recording has one of its own."""
        return any(block.kind == "zero" for block in self.sensor)

    def values(self) -> dict[str, float]:
        """Return the parameter values by name, SI."""
        return {n: p.value for n, p in self.parameters.items()}

    def with_values(self, values: Mapping[str, float]) -> Setup:
        """Return the same setup with other parameter values."""
        blocks = self.block_parameters or {}
        unknown = sorted(set(values) - set(self.parameters))
        if unknown:
            raise StructureViolated(f"no parameter called {', '.join(unknown)} in {self.name}")
        return replace(
            self,
            network=self.network.with_values({n: v for n, v in values.items() if n not in blocks}),
            block_parameters=with_values(blocks, {n: v for n, v in values.items() if n in blocks}),
        )

    def with_block(self, stage: str, block: Block, parameters: tuple[Parameter, ...]) -> Setup:
        """Return the setup with one more block at the end of the ``amplifier`` or ``sensor`` stage."""
        table = as_table((*(self.block_parameters or {}).values(), *parameters))
        if stage == "amplifier":
            return replace(self, amplifier=(*self.amplifier, block), block_parameters=table)
        return replace(self, sensor=(*self.sensor, block), block_parameters=table)

    def with_source(self, source: Source, parameters: tuple[Parameter, ...]) -> Setup:
        """Return the setup with one more source, on a port that the network has.

        Raises:
            StructureViolated: it has no such port, or that of the recorded input, its first.
        """
        ports = [p.name for p in self.network.ports]
        if source.port not in ports[1:]:
            raise StructureViolated(
                f"a source acts on the port {source.port!r}: name one beside the recorded input, "
                f"{', '.join(ports[1:]) or 'of which there is none'}"
            )
        table = as_table((*(self.block_parameters or {}).values(), *parameters))
        return replace(self, sources=(*self.sources, source), block_parameters=table)
