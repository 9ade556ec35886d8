"""A folder in which every command can be run."""

from __future__ import annotations

import runpy
from collections.abc import Iterator

import campaigns
import numpy as np
import pandas as pd
import pytest
from small_runs import ROOT, Runner

from phnn.models.actuator import hrc
from phnn.models.store import save
from phnn.setup import Setup


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    """A folder with recordings and models, and what runs commands in it."""
    home = tmp_path_factory.mktemp("kills")
    setup = Setup(hrc(1, campaigns.GENTLE), name="phs")
    for name, frequencies in (("gentle", (30.0, 50.0, 80.0, 120.0)), ("fewer", (30.0, 80.0))):
        recordings = []
        for k, f in enumerate(frequencies):
            t = np.arange(161) / 160.0 / f
            u = 75.0 * np.sin(2.0 * np.pi * f * t)
            recordings.append(campaigns.recorded(setup, f"sine_{f:.0f}", t, u, 60e-9, k))
        campaigns.written(home / name, recordings)
    save(setup, home / "model", 2)
    save(setup.with_values({"k": 2.2e4}), home / "other", 2)
    (home / "wanted").mkdir()
    wanted = pd.DataFrame({"time_s": t, "displacement_um": 20.0 * (1.0 - np.cos(2.0 * np.pi * f * t))})
    wanted.to_csv(home / "wanted" / "reference.csv", index=False)
    (home / "modes").mkdir()
    structure = runpy.run_path(str(ROOT / "tests" / "modal" / "structure.py"))
    structure["write_folder"](home / "modes", "none", 3, levels=(0.7,))
    made = Runner(home)
    yield made
    made.end()
