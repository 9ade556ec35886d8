"""Settings of a study of modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phnn.errors import InputRefused


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
        """From the composed configuration.

        Raises:
            InputRefused: a number is less than one.
        """
        found = cls(**{n: config[n] for n in cls.__dataclass_fields__})
        for name in cls.__dataclass_fields__:
            if getattr(found, name) < 1:
                raise InputRefused(f"setting {name}={getattr(found, name)} must be a whole number, 1 or more")
        return found
