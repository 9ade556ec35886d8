"""A learned element pushes only where something was recorded."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.diagnose.learn import learn


def test_springs_beyond_the_recorded_motion_stay_as_weak_as_they_begin() -> None:
    ground = campaigns.ground("creep")
    wide = replace(ground, scales=replace(ground.scales, displacement=2.0 * ground.scales.displacement))
    found = learn(wide, "elastic")
    assert found is not None
    reached = max(float(np.abs(t.states[:, t.program.output]).max()) for t in ground.trajectories)
    values, begun = found.setup.values(), 1e-4 * 0.05 * wide.scales.stiffness
    beyond = [i for i in range(12) if abs(values[f"g_x{i}"]) > 1.01 * reached]
    assert len(beyond) >= 6
    assert not {f"k_x{i}" for i in beyond} & set(found.variables.names)
    assert [values[f"k_x{i}"] for i in beyond] == pytest.approx([begun] * len(beyond))
    assert any(f"k_x{i}" in found.variables.names for i in range(12))
