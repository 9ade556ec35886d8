"""Settings of a study of modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phnn.configuration import check, whole


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/modes.yaml``.

    Attributes:
        experiments: of each amplitude that are fitted; the others of identification choose between elements.
        iterations: derivatives of a fit; stops: of a hysteron element; workers: threads.
    """

    experiments: int = whole(2, least=1)
    iterations: int = whole(40, least=1)
    stops: int = whole(8, least=1)
    workers: int = whole(2, least=1)

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From the composed configuration."""
        return cls(**{n: config[n] for n in cls.__dataclass_fields__})
