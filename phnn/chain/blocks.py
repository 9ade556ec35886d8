"""The kinds of blocks of the measuring chain and of sources, each with what the rest of the package must know of it.

A function of `phnn.chain.amplifiers` or `phnn.chain.sensors` becomes a kind by its decorator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from phnn.parameters import Domain

Law = Callable[..., Any]


@dataclass(frozen=True)
class BlockKind:
    """A kind of block or of source.

    Attributes:
        law: from its input, or from the time, to its output; takes its parameters last.
        domains: admissible values of the parameters, in their order.
        remembers: its output at an instant does not follow from its input at that instant alone.
        linear: its output is linear in its input, so that changes of it pass like the signal itself.
    """

    law: Law
    domains: tuple[Domain, ...]
    remembers: bool = False
    linear: bool = False


AMPLIFIERS: dict[str, BlockKind] = {}
SENSORS: dict[str, BlockKind] = {}
SOURCES: dict[str, BlockKind] = {}


def registers(kinds: dict[str, BlockKind], *domains: Domain, name: str = "", **known: bool) -> Callable[[Law], Law]:
    """Return a decorator that makes a function a kind, by its own name if no other is given; see `BlockKind`."""

    def register(law: Law) -> Law:
        kinds[name or law.__name__] = BlockKind(law, domains, **known)
        return law

    return register
