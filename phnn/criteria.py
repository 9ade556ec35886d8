"""The criteria of a diagnosis: every number that decides something, with unit, meaning and the case that needs it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from phnn.errors import InputRefused, meant


def criterion(default: float, unit: str, meaning: str, needed: str) -> Any:
    """Return a field of `Criteria` with what a reader has to know about it.

    Args:
        needed: the case that goes wrong with another value.
    """
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "needed": needed})


@dataclass(frozen=True)
class Criteria:
    """All numbers that decide something in a diagnosis.

    One of them is replaced by ``criteria.NAME=value`` on the command line, or by ``Options(criteria={"NAME": value})``.
    """

    material: float = criterion(
        0.1, "noise rms", "What explains less of a recording is not looked for.",
        "a creep of a fiftieth of the stiffness, which no forecast would show",
    )  # fmt: skip
    material_share: float = criterion(
        0.01, "share of the error", "A smaller change of the held-out error is no change.",
        "a model that fits as before is not refused for the fourth digit of its forecast",
    )  # fmt: skip
    score: float = criterion(
        5.0, "standard deviations", "A candidate below it is not refitted.",
        "process noise: hundreds of candidates score up to 4 by chance",
    )  # fmt: skip
    far: float = criterion(
        3.0, "noise rms", "A residual above it is far from the noise: a first derivative predicts roughly there.",
        "a cubic spring ranked fourth at 27 × noise",
    )  # fmt: skip
    near_best: float = criterion(
        0.2, "share of the best predicted fall", "Candidates below it are not refitted.",
        "of a class of three the true member is second or third",
    )  # fmt: skip
    near_best_far: float = criterion(
        0.08, "share of the best predicted fall", "The same far from the noise.",
        "a cubic spring ranked fourth at 27 × noise",
    )  # fmt: skip
    refits: int = criterion(
        8, "candidates", "Most candidates that are refitted to grow one model.",
        "of cost: a true effect was ninth at the base in one pair, and first after the first addition",
    )  # fmt: skip
    short: int = criterion(
        6, "evaluations", "Length of a first refit, with coarse sub-steps.", "of cost",
    )  # fmt: skip
    further: int = criterion(
        12, "evaluations", "Length of the second stretch of a refit, with coarse sub-steps.", "of cost",
    )  # fmt: skip
    price_effect: float = criterion(
        3.4, "nats", "Price of an effect beside that of its parameters.",
        "thirty effects: an equal chance of each",
    )  # fmt: skip
    price_learned: float = criterion(
        6.0, "nats", "The same of a learned element.",
        "a learned spring beside a hysteresis of eight plays",
    )  # fmt: skip
    slack: float = criterion(
        1.1, "noise power", "What a model may leave before its misfit makes others probable.",
        "a noise floor that was stated 5 % too low",
    )  # fmt: skip
    proven: float = criterion(
        0.95, "probability", "A name, and that the catalogue is complete, is claimed above it.", "the convention",
    )  # fmt: skip
    explained: float = criterion(
        1.2, "noise power", "What a model may leave for its names to stand for the whole mismatch.",
        "an effect beside physics that no catalogue lists",
    )  # fmt: skip
    beam: int = criterion(
        3, "models", "How many of the best models are grown.", "a pair whose first effect was confounded",
    )  # fmt: skip

    @classmethod
    def table(cls) -> list[dict[str, Any]]:
        """Return name, default, unit, meaning and case of every criterion."""
        return [{"name": f.name, "default": f.default, **f.metadata} for f in fields(cls)]

    def changed(self) -> dict[str, float]:
        """Return the values that differ from their defaults, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}

    def with_values(self, values: Mapping[str, float]) -> Criteria:
        """Return the criteria with some values replaced.

        Raises:
            InputRefused: no criterion of this name; a value that is not positive; a fraction where a count is asked.
        """
        known = {f.name: f for f in fields(self)}
        for name, value in values.items():
            if name not in known:
                raise InputRefused(
                    f"no criterion is called {name!r}{meant(name, known)}: take one of {', '.join(known)}"
                )
            unit, whole = known[name].metadata["unit"], isinstance(known[name].default, int)
            number = not isinstance(value, bool) and isinstance(value, int | float)
            if not number or not 0.0 < value < math.inf:
                raise InputRefused(f"criteria.{name}={value} must be a positive number [{unit}]")
            if whole and value != int(value):
                raise InputRefused(f"criteria.{name}={value} must be a whole number [{unit}]")
        cast = {n: type(getattr(self, n))(v) for n, v in values.items()}
        return replace(self, **cast)
