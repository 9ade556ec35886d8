"""Whether forces are known in newtons is read from what is stated and from units, never from names."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import pytest

from phnn.recordings.recording import Anchor, Units
from phnn.report.anchored import forces_known


@pytest.mark.parametrize(
    ("known", "units", "expected"),
    [
        ({"m": Anchor(1e-3, 1e-5)}, Units("V", "m"), True),
        ({"d_1": Anchor(10.0, 0.0)}, Units("V", "m"), False),
        ({}, Units("V", "m"), False),
        ({}, Units("N", "m"), True),
        ({"rho_2": Anchor(1e-4, 0.0)}, Units("V", "m"), True),
    ],
)
def test_a_stated_value_or_a_measured_force_fixes_the_common_factor(
    known: dict[str, Anchor], units: Units, expected: bool
) -> None:
    found = campaigns.diagnosis("quadratic_drag", "quadratic_drag")
    first, *others = found.campaign.recordings
    campaign = replace(found.campaign, known=known, recordings=(replace(first, units=units), *others))
    assert forces_known(replace(found, campaign=campaign)) is expected


def test_a_force_of_unknown_gain_fixes_nothing() -> None:
    found = campaigns.diagnosis("quadratic_drag", "quadratic_drag")
    recordings = tuple(replace(r, units=Units("N", "m"), gain="unknown") for r in found.campaign.recordings)
    assert not forces_known(replace(found, campaign=replace(found.campaign, known={}, recordings=recordings)))
