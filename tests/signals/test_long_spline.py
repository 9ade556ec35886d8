"""A spline in pieces against the one through all samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from phnn.signals import long_spline


@pytest.mark.parametrize("size", [400, 401, 501, 999])
def test_pieces_are_the_spline_through_all_samples(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.random.default_rng(size).standard_normal(size)
    places = np.linspace(0.0, size - 1.0, 7919)
    expected = CubicSpline(np.arange(size), x)(places)
    assert np.array_equal(long_spline.spline(x)(places), expected)
    monkeypatch.setattr(long_spline, "_AT_ONCE", 100)
    assert np.allclose(long_spline.spline(x)(places), expected, rtol=0.0, atol=1e-13)
