"""Families of nulls: what noise and what input the recordings have in which nothing is concealed.

A family is an input kind (``ramp``), a noise (``process:0.1``), or one of each (``ramp+process:0.1``).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from phnn.errors import InputRefused
from studies.generator.noise import asked
from studies.generator.plans import KINKED

_SEED_BYTES = 6


@dataclass(frozen=True)
class Family:
    """What the nulls of a family have in common.

    Attributes:
        name: as it is asked for.
        plan: set of recordings.
        noise: as `studies.generator.draw_case` takes it; empty for white noise, of first order in one case of three.
    """

    name: str
    plan: str
    noise: str


def family(name: str, plan: str) -> Family:
    """The family of a name.

    Args:
        plan: the set of recordings, without a kind of input.

    Raises:
        InputRefused: the name has two inputs, two noises, or something that is neither.
    """
    parts = name.split("+")
    inputs = [p for p in parts if p in KINKED]
    noises = [p for p in parts if p not in KINKED]
    if len(inputs) > 1 or len(noises) > 1:
        raise InputRefused(f"null_families: {name!r} has two inputs or two noises: join one of each, as in ramp+pink")
    for noise in noises:
        try:
            asked(noise)
        except InputRefused as error:
            raise InputRefused(
                f"null_families: {name!r} is no family: name an input ({', '.join(KINKED)}), a noise or both ({error})"
            ) from error
    return Family(name, "_".join([plan, *inputs]), "".join(noises))


def seed_of(seed: int, name: str, number: int) -> int:
    """Seed of a null: its own for every family, however many families there are."""
    word = hashlib.sha256(f"{seed} {name} {number}".encode()).digest()
    return int.from_bytes(word[:_SEED_BYTES], "big")
