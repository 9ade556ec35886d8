"""Rate dependence: Fig. 15 shows a property of the model, not of the drawing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.models.actuator import from_paper, hrc
from phnn.setup import Setup
from studies.generator.plans import sine
from studies.generator.world import TABLE
from studies.generator.world import simulate as independent
from studies.paper.rate import loop, ramps

PAPER = Setup(from_paper())


@settings(deadline=None, max_examples=5)
@given(frequency=st.floats(1.0, 150.0), peak=st.floats(20.0, 80.0))
def test_a_loop_is_the_last_period_of_an_independent_simulation(frequency: float, peak: float) -> None:
    found = loop(PAPER, peak, frequency)
    other = independent(TABLE, sine(frequency, peak, 3, 3000))
    at = np.arange(2000, 3000) / 1000.0 - 2.0
    np.testing.assert_allclose(np.interp(at, found.t, found.y), other[2000:], atol=1e-4 * np.abs(other).max())


def test_the_same_extreme_values_at_another_rate_give_another_displacement() -> None:
    slow, fast = (ramps(PAPER, 75.0, duration) for duration in (1.0, 0.03))
    np.testing.assert_array_equal(slow.u, fast.u)
    corners = slice(0, None, 1200)
    assert np.abs(slow.u[corners]).max() == pytest.approx(75.0)
    # Extremes and what lies between them differ by far more than a percent of the range.
    size = float(np.ptp(slow.y))
    assert abs(slow.y.max() - fast.y.max()) > 0.01 * size
    assert np.median(np.abs(slow.y - fast.y)) > 0.01 * size


def test_rate_dependence_ends_where_everything_relaxes() -> None:
    # Hundred times slower changes less than a hundredth of what a faster passage does.
    first, second, third = (ramps(PAPER, 75.0, duration).y for duration in (0.03, 1.0, 100.0))
    assert np.abs(second - third).max() < 0.1 * np.abs(first - second).max()


def test_without_hysterons_slow_loops_close_up() -> None:
    linear = loop(Setup(hrc(0)), 75.0, 1.0)
    hysteretic = loop(PAPER, 75.0, 1.0)

    def width(found: np.ndarray, u: np.ndarray) -> float:
        # area over the area of the bounding box
        return abs(float(np.trapezoid(found, u))) / float(np.ptp(u) * np.ptp(found))

    assert width(linear.y, linear.u) == pytest.approx(np.pi / 4 * 2 * np.pi * TABLE["b"] / TABLE["k"], rel=0.01)
    assert width(hysteretic.y, hysteretic.u) > 20.0 * width(linear.y, linear.u)
