"""Physics that no catalogue lists: it is not named, located, learned, and the model predicts better."""

from __future__ import annotations

import campaigns
import numpy as np
import pytest

from phnn.diagnose.words import picture
from phnn.effects import catalogue


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 7])
def test_a_stop_that_no_catalogue_lists_is_unknown_and_learned(seed: int) -> None:
    others = [n for n in catalogue() if n != "contact_stop"]
    made = campaigns.diagnosis("contact_stop", *others, seed=seed)
    assert made.verdict == "unknown"
    assert made.location is not None
    assert made.location.name == "mechanical"
    assert any(c.learned for c in made.claims) and not any(c.claimed for c in made.claims)
    assert made.after.over_noise("confirmation") < made.before.over_noise("confirmation")
    drawn = picture(made.linearised[0], made.location)
    assert drawn is not None
    stop = campaigns.concealed("contact_stop", seed)[1].parameters["q_c"] * 1e6
    beyond = drawn.y[drawn.x > stop]
    inside = drawn.y[np.abs(drawn.x) < 0.8 * stop]
    # Relative to a line through what lies before it, the missing force turns sharply beyond the stop.
    line = np.polyfit(drawn.x[np.abs(drawn.x) < 0.8 * stop], inside, 1)
    turn = beyond - np.polyval(line, drawn.x[drawn.x > stop])
    assert abs(turn[-1]) > 3.0 * np.ptp(inside - np.polyval(line, drawn.x[np.abs(drawn.x) < 0.8 * stop]))
