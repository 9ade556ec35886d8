"""Settings of a study of modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/modes.yaml``.

    Attributes:
        experiments: of each amplitude that are fitted; the others of identification choose between elements.
        iterations: derivatives of a fit; stops: of a hysteron element; workers: threads.
    """

    experiments: int
    iterations: int
    stops: int
    workers: int

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From the composed configuration."""
        return cls(**{n: config[n] for n in cls.__dataclass_fields__})
