"""The held-out recordings have the last word."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.diagnose import diagnosis as path
from phnn.diagnose.judge import Judgement
from phnn.identify.evaluate import Evaluation, PartScore


def held_out(over_noise: float) -> Evaluation:
    return Evaluation(
        {}, (PartScore("a", "identification", 99.0, 1e-7, 1.0), PartScore("b", "confirmation", 99.0, 1e-7, over_noise))
    )


def judged(leaves: float) -> Judgement:
    """A named effect that leaves a share of an excess of eight times the noise."""
    base = campaigns.base()
    unit = base.residual / np.sqrt(base.chi2)
    before, after = (replace(base, residual=unit * np.sqrt(1.0 + 8.0 * share)) for share in (1.0, leaves))
    ground, naming = mock.Mock(fit=before), mock.Mock(statistic=10.0, numerical=0.0)
    location = mock.sentinel.location
    return Judgement("named", ground, naming, location, after, mock.Mock(), (mock.sentinel.finding,), remainder=None)


@pytest.mark.parametrize(
    ("leaves", "had", "has", "verdict"),
    [
        (0.3, 3.0, 2.9, "unknown"),  # a third left, and nothing of it confirmed
        (0.3, 3.0, 1.5, "named"),  # most of it confirmed
        (0.02, 3.0, 2.9, "named"),  # explained well: another form may fail elsewhere
        (0.3, 1.08, 1.05, "named"),  # nothing to confirm there
        (0.02, 3.0, 3.1, "equivalent"),  # explained well, of no help there
    ],
)
def test_what_held_out_recordings_refute_is_unknown(leaves: float, had: float, has: float, verdict: str) -> None:
    judgement = judged(leaves)
    with mock.patch.object(path, "score_on_all", side_effect=[held_out(had), held_out(has)]):
        found, before, after = path._confirmed(judgement, judgement.ground.fit, mock.sentinel.campaign)
    assert found.verdict == verdict
    if verdict == "unknown":
        assert found.findings == () and found.final is judgement.ground.fit and after is before
        assert found.remainder_location is judgement.location
    else:
        assert found.findings and found.final is judgement.final


def test_a_learned_element_that_helps_no_held_out_recording_is_dropped_with_all_that_was_said_of_it() -> None:
    named = judged(0.3)
    learned = replace(named, verdict="unknown", findings=(), learned=True, remainder_location=mock.sentinel.elsewhere)
    with mock.patch.object(path, "score_on_all", side_effect=[held_out(3.0), held_out(3.1)]):
        found, *_ = path._confirmed(learned, learned.ground.fit, mock.sentinel.campaign)
    assert found.verdict == "unknown" and not found.learned
    assert found.final is learned.ground.fit and found.final_ground is learned.ground
    assert found.remainder is learned.naming and found.remainder_location is learned.location
