"""The effort of an identification and a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from phnn.configuration import check, positive, whole


@dataclass(frozen=True)
class Options:
    """How hard to try; the keys of the configuration files.

        phnn.diagnose(campaign, phnn.Options(starts=2, executor="processes:2"))

    Attributes:
        seed: of every random draw.
        starts: starting points of the nonlinear stage per resonance.
        error_bound_sigma: bound on the numerical error over the plan, in standard deviations.
        max_effects: how many elements a diagnosis may add.
        evaluations: what a diagnosis may spend, in simulations of 300,000 steps; derivatives by eight variables count
            as four simulations; a step of a modulated or of a general network counts more often.
        without: effects of the catalogue that a diagnosis must not use.
        criteria: values of `phnn.criteria.Criteria` that replace the defaults, by name.
        workers: threads of a fit.
        executor: where the refits of a diagnosis are done, for choices see `phnn.parallel.executor`; anywhere
            but in ``serial`` each refit has one thread.

    Raises:
        InputRefused: a number is of the wrong kind or out of range.
    """

    seed: int = whole(0)
    starts: int = whole(4, least=1)
    error_bound_sigma: float = positive(1.0)
    max_effects: int = whole(4)
    evaluations: int = whole(4000, least=1)
    without: tuple[str, ...] = ()
    criteria: Mapping[str, float] = field(default_factory=dict)
    workers: int = whole(2, least=1)
    executor: str = "serial"

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Any) -> Options:
        """From a mapping such as a hydra configuration; keys it lacks keep their defaults."""
        given = {n: config[n] for n in cls.__dataclass_fields__ if n in config}
        wholes = {n: kind(given[n]) for n, kind in {"without": tuple, "criteria": dict}.items() if n in given}
        return cls(**(given | wholes))
