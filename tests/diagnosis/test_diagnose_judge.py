"""Where a judgement places the mismatch."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import Judgement
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.trial import Trial
from phnn.effects import effect
from phnn.identification.fit import Fit


def leaving(left: float) -> Fit:
    """A fit that leaves so many times the noise."""
    base = campaigns.base()
    return replace(base, residual=left * base.residual / np.sqrt(base.chi2))


def judged(left: float, *names: str, provisional: bool = True) -> Judgement:
    """What functions find at the sensor, and elements of a model that goes from ten times the noise to ``left``."""
    trials = [Trial(Candidate(effect(n), {}, (), 10.0, 1e-3), None) for n in names]
    findings = tuple(Finding(t, (t,), (t,), mock.Mock(), provisional=provisional) for t in trials)
    location = mock.Mock(detail="lag or play", tied=("amplifier",))
    location.name = "sensor"
    base = mock.Mock(fit=leaving(10.0))
    return Judgement("unknown", base, mock.Mock(), location, leaving(left), mock.Mock(), findings)


@pytest.mark.parametrize(
    ("found", "places", "detail"),
    [
        (judged(2.0, "coulomb_friction", "creep"), ("mechanical",), "dissipative"),
        (judged(8.0, "coulomb_friction", "creep"), ("sensor", "amplifier"), "lag or play"),  # they explain little
        (judged(2.0, "coulomb_friction", "sensor_lag"), ("sensor", "amplifier"), "lag or play"),
        (judged(8.0, "creep", provisional=False), ("mechanical",), "memory"),
        (judged(10.0), ("sensor", "amplifier"), "lag or play"),
    ],
)
def test_elements_at_one_place_that_explain_most_say_where_it_is(
    found: Judgement, places: tuple[str, ...], detail: str
) -> None:
    assert found.places == places
    assert found.detail == detail


def test_nothing_is_nowhere() -> None:
    nothing = replace(judged(1.0), location=None)
    assert nothing.places == () and nothing.detail == ""
