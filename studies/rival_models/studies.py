"""The studies of rivals by name, from a composed configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phnn.comparison.models import Settings
from phnn.configuration import check, checked, number, positive, whole
from phnn.errors import InputRefused
from phnn.identification.base import Progress, quiet
from phnn.results import Place
from studies.comparison.rivals import register_rivals
from studies.rival_models.contest import scarcity, truths
from studies.rival_models.coupled import loops
from studies.rival_models.long import Runs, long
from studies.rival_models.real import real

STUDIES = ("truths", "scarcity", "real", "loops", "long")


@dataclass(frozen=True)
class Chosen:
    """The keys of ``configs/experiment/rivals.yaml`` beside those under ``compare``.

    Attributes:
        study: one of `STUDIES`; truths: kinds of actuator; seeds: of actuators, noise and models.
        noise_um: standard deviation of the sensor's noise, µm.
        runs: of each model in a loop; samples, drives: of long runs.
        folder, only: of real recordings; diagnoses: whether the models of diagnoses join them.
    """

    study: str
    truths: tuple[str, ...]
    seeds: tuple[int, ...]
    only: tuple[str, ...]
    folder: str | None
    diagnoses: bool
    noise_um: float = positive(0.05)
    runs: int = whole(20, least=1)
    samples: int = whole(10_000_000, least=1)
    drives: int = whole(3, least=1)

    def __post_init__(self) -> None:
        check(self)
        for seed in self.seeds:
            number("seeds", seed, 0)
        if self.study not in STUDIES:
            raise InputRefused(f"study: nothing is called {self.study!r}: choose from {', '.join(STUDIES)}")
        if self.study == "real" and self.folder is None:
            raise InputRefused("folder: is not given: name the folder that holds a folder for each set of recordings")
        if not isinstance(self.diagnoses, bool):
            raise InputRefused(f"diagnoses: {self.diagnoses!r} is neither true nor false")
        if self.study != "real" and not (self.truths and self.seeds):
            raise InputRefused("truths, seeds: one of them is empty: name one at least")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Chosen:
        """From the composed configuration; a single value serves as a list of one. Raises InputRefused."""
        found = {name: config[name] for name in cls.__dataclass_fields__}
        return cls(**(found | {name: _several(found[name]) for name in ("truths", "seeds", "only")}))


def _several(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list | tuple) else () if value is None else (value,)


def run(config: Mapping[str, Any], progress: Progress = quiet) -> Path:
    """Carry out one study; finished models of an earlier run in the same folder are read back.

    Args:
        config: the keys of ``configs/experiment/rivals.yaml``.
        progress: told what is done.

    Returns:
        The page of markdown that was written.

    Raises:
        InputRefused: an unknown study, or settings that it cannot use.
    """
    register_rivals()
    c, settings = Chosen.from_config(config), Settings.from_config(checked("compare", config["compare"]))
    place = Place(Path(config["out"] or f"out/rivals/{c.study}").resolve())
    if c.study == "real":
        real(place, settings, Path(str(c.folder)), c.only, c.diagnoses, progress)
    elif c.study == "truths":
        truths(place, settings, c.truths, c.seeds, c.noise_um, progress)
    elif c.study == "loops":
        loops(place, settings, c.seeds, c.noise_um, c.runs, progress)
    elif c.study == "long":
        long(place, settings, c.seeds, c.noise_um, Runs(c.samples, c.drives), progress)
    else:
        scarcity(place, settings, c.truths[0], c.seeds, c.noise_um, progress)
    return place.path / f"{c.study}.md"
