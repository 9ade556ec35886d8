"""The studies of rivals by name, from a composed configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from phnn.configuration import checked
from phnn.errors import InputRefused
from phnn.identification.base import Progress, quiet
from phnn.output import Place
from phnn.studies.comparison.settings import Settings
from phnn.studies.rival_models.contest import scarcity, truths
from phnn.studies.rival_models.coupled import loops
from phnn.studies.rival_models.long import Runs, long
from phnn.studies.rival_models.real import real

STUDIES = ("truths", "scarcity", "real", "loops", "long")


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
    study = str(config["study"])
    if study not in STUDIES:
        raise InputRefused(f"study: nothing is called {study!r}: choose from {', '.join(STUDIES)}")
    settings = Settings.from_config(checked("compare", config["compare"]))
    place = Place(Path(config["out"] or f"out/rivals/{study}").resolve())
    if study == "real":
        if config["folder"] is None:
            raise InputRefused("folder: is not given: name the folder that holds a folder for each set of recordings")
        real(place, settings, Path(config["folder"]), list(config["only"]), bool(config["diagnoses"]), progress)
    elif not config["truths"] or not config["seeds"]:
        raise InputRefused("truths, seeds: one of them is empty: name one at least")
    elif study == "truths":
        truths(place, settings, config["truths"], config["seeds"], float(config["noise_um"]), progress)
    elif study == "loops":
        loops(place, settings, config["seeds"], float(config["noise_um"]), int(config["runs"]), progress)
    elif study == "long":
        runs = Runs(int(config["samples"]), int(config["drives"]))
        long(place, settings, config["seeds"], float(config["noise_um"]), runs, progress)
    else:
        scarcity(place, settings, config["truths"][0], config["seeds"], float(config["noise_um"]), progress)
    return place.path / f"{study}.md"
