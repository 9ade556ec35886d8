"""LISDD as a tool: the F-test, the choice of clean regimes, discoveries, hold-out over a library."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import f, kstest, linregress

from phnn.effects import catalogue
from phnn.errors import InputRefused
from phnn.recordings.recording import unrecorded
from studies.benchmark.tools.exhaustive import Candidate, products, winners
from studies.benchmark.tools.nested import autoregression, f_test, filtered
from studies.benchmark.tools.regimes import clean, discoveries

RNG = np.random.default_rng


def test_one_slope_is_tested_as_scipy_does() -> None:
    """With a constant as the smaller model, the F-test of a slope has the p-value of its t-test."""
    rng = RNG(1)
    x = rng.normal(size=40)
    y = 3.0 + 0.4 * x + rng.normal(size=40)
    found = f_test(y, np.ones((40, 1)), x[:, None])
    assert (found.q, found.left) == (1, 38)
    assert found.p_value == pytest.approx(linregress(x, y).pvalue, rel=1e-9)


def test_several_columns_are_tested_by_the_sums_of_squares() -> None:
    rng = RNG(2)
    base, more, y = rng.normal(size=(50, 3)), rng.normal(size=(50, 2)), rng.normal(size=50)
    left = [float(np.sum((y - m @ np.linalg.lstsq(m, y)[0]) ** 2)) for m in (base, np.hstack([base, more]))]
    expected = ((left[0] - left[1]) / 2) / (left[1] / 45)
    found = f_test(y, base, more)
    assert found.statistic == pytest.approx(expected, rel=1e-9)
    assert found.p_value == pytest.approx(float(f.sf(expected, 2, 45)), rel=1e-9)


def test_a_column_that_is_there_already_is_no_direction() -> None:
    base = RNG(3).normal(size=(30, 2))
    found = f_test(RNG(4).normal(size=30), base, base @ np.ones((2, 1)))
    assert (found.q, found.p_value) == (0, 1.0)


def test_no_degree_of_freedom_is_refused() -> None:
    with pytest.raises(InputRefused, match="give more samples"):
        f_test(np.ones(3), np.eye(3)[:, :2], np.eye(3)[:, 2:])


def test_coloured_noise_is_made_white_before() -> None:
    """p-values of a drifting column in strongly coloured noise are uniform after, and far too small before."""
    rng, before, after = RNG(5), [], []
    rows = [slice(0, 400)]
    for _ in range(60):
        noise = filtered_back(rng.normal(size=400), 0.9)
        column = np.cumsum(rng.normal(size=(400, 1)), axis=0)
        constant = np.ones((400, 1))
        before.append(f_test(noise, constant, column).p_value)
        taps = autoregression(noise, rows)
        white = [filtered(x, rows, taps) for x in (noise, constant, column)]
        after.append(f_test(*white).p_value)
    assert np.mean(np.array(before) < 0.05) > 0.3
    assert kstest(after, "uniform").pvalue > 0.01


def filtered_back(e: np.ndarray, a: float) -> np.ndarray:
    x = np.zeros_like(e)
    for i in range(1, e.size):
        x[i] = a * x[i - 1] + e[i]
    return x


def test_false_discoveries_are_limited_as_benjamini_and_hochberg_do() -> None:
    # Their thresholds are 0.0125, 0.025, 0.0375, 0.05: the third holds, and with it the second.
    assert discoveries(np.array([0.9, 0.03, 0.026, 0.001]), 0.05) == [1, 2, 3]
    assert discoveries(np.array([0.9, 0.5, 0.2, 0.02]), 0.05) == []


def linearised(residual: np.ndarray, jacobian: np.ndarray, edges: list[int], inputs: list[np.ndarray]) -> Any:
    slices = [slice(a, b) for a, b in itertools.pairwise(edges)]
    recordings = [unrecorded(f"r{i}", 1e-3 * np.arange(u.size), u) for i, u in enumerate(inputs)]
    return SimpleNamespace(
        slices=slices,
        plan=SimpleNamespace(recordings=recordings),
        fit=SimpleNamespace(residual=residual, jacobian=jacobian),
    )


def test_the_regimes_without_the_missing_physics_are_found() -> None:
    """A cubic term acts where amplitudes are large; a slope was fitted to all."""
    rng = RNG(6)
    inputs = [a * np.sin(0.1 * np.arange(200)) for a in (0.2, 1.0, 0.3, 1.2)]
    x = np.concatenate(inputs)
    y = x + 3.0 * x**3 + 0.01 * rng.normal(size=x.size)
    slope = float(x @ y / (x @ x))
    found = linearised((y - slope * x) / 0.01, -x[:, None] / 0.01, [0, 200, 400, 600, 800], inputs)
    assert clean(found) == [0, 2]


def test_hold_out_prefers_what_generalises() -> None:
    """Of a true column and one that copies the noise where it is fitted, the true one wins; wrong signs are none."""
    rng = RNG(7)
    n = 300
    fitted = np.arange(n) < n // 2
    base, true, noise = np.ones((n, 1)), np.sin(0.2 * np.arange(n)), rng.normal(size=n)
    copied = np.where(fitted, noise, rng.normal(size=n))
    r = 0.8 * true + noise
    free, sided = catalogue()["cubic_stiffness"], catalogue()["quadratic_drag"]
    assert sided.one_sided and not free.one_sided
    candidates = [Candidate(free, {}, 0), Candidate(catalogue()["creep"], {}, 1), Candidate(sided, {}, 2)]
    found = products(r, base, np.column_stack([true, copied, -true]), fitted, ~fitted)
    ranked = winners(found, candidates)
    assert [w.name for w in ranked] == ["cubic_stiffness", "creep"]
    assert ranked[0].coefficient == pytest.approx(0.8, abs=0.25)
    assert ranked[1].gain < 0.0 < ranked[0].gain
