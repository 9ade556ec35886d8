"""A learned element pushes only where something was recorded."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.diagnosis.learn import learn, learned_setup
from phnn.effects import kinds


def test_springs_beyond_the_recorded_motion_stay_as_weak_as_they_begin() -> None:
    linearised = campaigns.linearised("creep")
    wide = replace(linearised, scales=replace(linearised.scales, displacement=2.0 * linearised.scales.displacement))
    found = learn(wide, kinds.ELASTIC)
    assert found is not None
    reached = max(float(np.abs(t.states[:, t.program.output]).max()) for t in linearised.trajectories)
    begun = learned_setup(linearised.fit.setup, kinds.ELASTIC, wide.scales)
    assert begun is not None
    values, stops = found.setup.values(), [f"{side}{i}" for i in range(1, 5) for side in "RL"]
    beyond = [i for i in stops if values[f"g_L{i[1]}"] > 1.01 * reached]
    assert len(beyond) >= 4
    assert not {f"k_{i}" for i in beyond} & set(found.variables.names)
    assert [values[f"k_{i}"] for i in beyond] == pytest.approx([begun.values()[f"k_{i}"] for i in beyond])
    assert any(f"k_{i}" in found.variables.names for i in stops)
