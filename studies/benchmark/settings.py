"""The size of a benchmark."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phnn.configuration import check, whole
from phnn.errors import InputRefused

# Kinds of cases. A background is physics that acts beside what is concealed and leaves less than the noise.
GROUPS = ("none", "same", "other", "outside", "pair", "background")


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/bench.yaml``.

    Attributes:
        seed: every case follows from it and its own number.
        none: cases with nothing concealed, in turn under noise of each family.
        same, other: cases with one listed effect, in the form of the catalogue or in another form.
        outside: cases with an effect that no catalogue lists.
        pair: cases with two listed effects.
        background: cases with one listed effect beside a background.
    """

    seed: int = whole(1)
    none: int = whole(9)
    same: int = whole(27)
    other: int = whole(9)
    outside: int = whole(9)
    pair: int = whole(9)
    background: int = whole(9)

    def __post_init__(self) -> None:
        check(self)
        if not any(getattr(self, group) for group in GROUPS):
            raise InputRefused("no cases: give numbers of cases, 0 or more, not all 0")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From the composed configuration. Raises InputRefused."""
        return cls(**{name: config[name] for name in cls.__dataclass_fields__})
