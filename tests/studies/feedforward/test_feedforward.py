"""The inverse of an identified model on plants that are not the model."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import campaigns
import numpy as np
import pandas as pd
import pytest

from phnn.identification.identified import Identified
from phnn.identification.plan import Options
from phnn.model import Model
from phnn.models.actuator import hrc
from phnn.setup import Setup
from studies.feedforward import RESULTS, Models, row, run_feedforward, table

# What is claimed: the error of the full inverse over what noise and parameter errors allow, and how many times smaller
# it is than without compensation.
MOST, LEAST = 1.2, 20.0
NOISE = 50e-9


def small() -> Models:
    """An identified actuator, and the same without hysterons as its linear model."""
    fit: Any = campaigns.base()
    full = Identified(campaigns.campaign(), fit, None, Options())  # type: ignore[arg-type]
    values = {n: fit.setup.values()[n] for n in ("m", "k", "b", "alpha")}
    linear: Any = SimpleNamespace(model=Model(Setup(hrc(0, values))))
    return Models(full, linear, values["alpha"] / values["k"])


def test_the_inverse_follows_as_well_as_noise_and_parameters_allow() -> None:
    found = row(small(), 100.0, NOISE, 4, np.random.default_rng(2))
    assert found.ratio <= MOST
    assert found.drawn["none"] / found.drawn["full"] >= LEAST
    assert found.drawn["none"] > found.drawn["linear"] > found.drawn["full"]
    assert found.nominal < found.drawn["clean"] < 0.5 * NOISE
    assert table([found])[0][0] == "100 Hz"


@pytest.mark.slow
def test_the_whole_study(tmp_path: Path) -> None:
    text = run_feedforward(tmp_path / "out", 0, 8, 0.05)
    assert {p.name for p in (tmp_path / "out").iterdir()} >= set(RESULTS)
    found = pd.read_csv(tmp_path / "out" / "feedforward.csv")
    assert list(found["reference"]) == ["1 Hz", "25 Hz", "100 Hz"]
    assert (found["full / allowed"] <= MOST).all()
    assert (found["none / full"] >= LEAST).all()
    assert (found["full, LSODA"] <= MOST * found["allowed"]).all()
    # Without noise the parameters are what is left, and the first order tells how much.
    expected = np.hypot(found["parameters"], found["full, no noise, plant = model"])
    assert (found["full, no noise"] <= 2.0 * expected).all()
    assert all(f"{r} |" in text for r in found["reference"])
