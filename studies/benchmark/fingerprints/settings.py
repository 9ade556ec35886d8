"""The size of a training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phnn.configuration import check, whole


@dataclass(frozen=True)
class TrainSettings:
    """The keys of ``configs/bench.yaml`` that a training takes.

    Attributes:
        seed: every case follows from it and its own number; no case is one of a benchmark, whatever its seed.
        size: number of cases.

    Raises:
        InputRefused: a number is of the wrong kind or out of range.
    """

    seed: int = whole(1)
    size: int = whole(900, least=5)

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> TrainSettings:
        """From the composed configuration. Raises InputRefused."""
        return cls(**{name: config[name] for name in cls.__dataclass_fields__})
