"""EMPS, whose model with viscous friction alone lacks a constant load and dry friction: both are found."""

from __future__ import annotations

import pytest
from real_recordings import folder, named

from phnn.configuration import config_folder
from phnn.diagnose import diagnose
from phnn.identify.base import Options
from phnn.recordings import read

# Janot, Gautier & Brunot 2019.
PUBLISHED = {"m": 95.109, "b": 203.5, "F_c": 20.394, "F_0": 3.165}


@pytest.mark.slow
def test_load_and_dry_friction_are_found() -> None:
    where = folder("emps", "DATA_EMPS.mat")
    campaign = read(where, config_folder() / "recordings" / "emps" / "recordings.yaml")
    found = diagnose(campaign, Options(starts=1, workers=1))
    assert found.judgement.verdict == "equivalent"
    assert named(found) == ["constant_load", "coulomb_friction"]
    values, std = found.judgement.final.setup.values(), found.judgement.final.std()
    for name, published in PUBLISHED.items():
        assert abs(values[name] - published) < 3.0 * std[name]
        assert values[name] == pytest.approx(published, rel=0.12)
    assert found.judgement.final.cost < 0.01 * found.base.cost
