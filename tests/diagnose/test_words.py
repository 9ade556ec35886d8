"""What was fitted at a location is told in words, and is learned only where something was recorded."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.diagnose.locations import locate
from phnn.diagnose.refit import converged, short
from phnn.diagnose.words import fitted_in_words
from phnn.effects.learned import learned_elements


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("cubic_stiffness", ("missing force", "the displacement")),
        pytest.param("coulomb_friction", ("missing",), marks=pytest.mark.slow),
        ("contact_stop", ("missing force", "the displacement")),
    ],
)
def test_what_was_fitted_at_the_location_in_words(effect: str, words: tuple[str, ...]) -> None:
    linearised = campaigns.linearised(effect)
    found = fitted_in_words(linearised, locate(linearised))
    assert all(w in found for w in words), found


def test_springs_beyond_the_recorded_motion_stay_as_weak_as_they_begin() -> None:
    linearised = campaigns.linearised("creep")
    wide = replace(linearised, scales=replace(linearised.scales, displacement=2.0 * linearised.scales.displacement))
    element, base = learned_elements()["learned_spring"], linearised.fit
    values = element.grid(wide.scales)[0]
    began = short(base, base.plan.coarse(), element, [values], 12)
    assert began is not None and began.cost < base.cost
    ended = converged(began, base.plan, base.held, element.parameters)
    assert ended is not None
    reached = max(float(np.abs(t.states[:, t.program.output]).max()) for t in linearised.trajectories)
    for found in (began, ended):
        fitted, stops = found.setup.values(), [f"{side}{i}" for i in range(1, 5) for side in "RL"]
        beyond = [i for i in stops if fitted[f"g_L{i[1]}"] > 1.01 * reached]
        assert len(beyond) >= 4
        assert not {f"k_{i}" for i in beyond} & set(found.variables.names)
        assert [fitted[f"k_{i}"] for i in beyond] == pytest.approx([values[f"k_{i}"] for i in beyond])
        assert any(f"k_{i}" in found.variables.names for i in stops)
