"""Silverbox, whose linear model lacks a cubic stiffness: that is named first, and the test errors fall thirtyfold."""

from __future__ import annotations

from pathlib import Path

import pytest
from real_recordings import benchmark_errors, folder, manifest, named

from phnn.diagnose import diagnose
from phnn.identify.base import Options
from phnn.recordings import read


@pytest.mark.slow
def test_the_cubic_stiffness_is_named_and_predicts(tmp_path: Path) -> None:
    where = folder("silverbox", "SNLS80mV.mat")
    # A quarter of the samples for identification names as well, in a fraction of the time.
    campaign = read(where, manifest("silverbox", tmp_path, "[40550, 105712]", "[40550, 57900]"))
    found = diagnose(campaign, Options(starts=1, workers=1))
    assert found.judgement.verdict == "named"
    assert named(found) == ["cubic_stiffness", "quadratic_drag"]
    errors = benchmark_errors(found)
    assert errors["multisine_test"] < 0.25e-3
    assert errors["arrow_inside"] < 0.25e-3
    assert errors["arrow"] < 0.31e-3
