"""The input between its samples."""

from __future__ import annotations

import numpy as np
import pytest

from phnn.errors import InputRefused
from phnn.signals.reconstruct import METHODS, find_jumps, mean_input, substep_counts, substep_input


def positions(counts: np.ndarray) -> np.ndarray:
    """(n, 3) start, middle and end of every sub-step, in samples."""
    starts = np.concatenate([i + np.arange(c) / c for i, c in enumerate(counts)])
    size = np.repeat(1.0 / counts, counts)
    return np.column_stack([starts, starts + 0.5 * size, starts + size])


COUNTS = np.array([1, 3, 2, 5] * 10)
SAMPLES = np.arange(COUNTS.size + 1.0)


@pytest.mark.parametrize(("method", "degree"), [("linear", 1), ("cubic", 3), ("quintic", 5)])
def test_polynomials_are_exact(method: str, degree: int) -> None:
    for n in range(degree + 1):
        fine = substep_input(((SAMPLES - 17.3) / 20.0) ** n, COUNTS, method)
        np.testing.assert_allclose(fine, ((positions(COUNTS) - 17.3) / 20.0) ** n, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_passes_through_the_samples(method: str) -> None:
    u = np.sin(0.3 * SAMPLES) + 0.1 * SAMPLES
    fine = substep_input(u, COUNTS, method)
    assert fine.shape == (COUNTS.sum(), 3)
    first = np.concatenate([[0], np.cumsum(COUNTS)[:-1]])
    np.testing.assert_allclose(fine[first, 0], u[:-1], atol=1e-6)
    if method != "zero_order":
        np.testing.assert_allclose(fine[1:, 0], fine[:-1, 2], atol=1e-12)


def test_zero_order_holds_the_earlier_sample() -> None:
    fine = substep_input(SAMPLES**2, COUNTS, "zero_order")
    np.testing.assert_array_equal(fine, np.repeat(SAMPLES[:-1] ** 2, COUNTS)[:, None] * np.ones(3))


@pytest.mark.parametrize("cycles", [0.01, 0.1, 0.2])
def test_a_band_limited_sine_is_accurate_away_from_the_ends(cycles: float) -> None:
    t = np.arange(801.0)
    counts = np.full(800, 4)
    fine = substep_input(np.sin(2 * np.pi * cycles * t + 0.4), counts, "band_limited")
    error = np.abs(fine - np.sin(2 * np.pi * cycles * positions(counts) + 0.4))
    limit = 1e-6 if cycles <= 0.1 else 1e-5
    assert error[400:-400].max() < limit


def test_orders_of_a_sine_at_67_samples_a_period() -> None:
    # 150 Hz at 10 kHz: what a linear hold makes of it is far above the noise of a good sensor.
    t = np.arange(401.0)
    counts = np.full(400, 2)
    exact = np.sin(2 * np.pi * 0.015 * positions(counts))
    errors = {m: np.abs(substep_input(np.sin(2 * np.pi * 0.015 * t), counts, m) - exact)[40:-40].max() for m in METHODS}
    assert errors["band_limited"] < 1e-6
    assert errors["quintic"] < errors["cubic"] < 2e-6
    assert 5e-4 < errors["linear"] < 2e-3 < errors["zero_order"]


def test_a_jump_is_found_and_held_until_its_instant() -> None:
    u = np.sin(0.02 * SAMPLES)
    u[25:] += 3.0
    assert find_jumps(u).tolist() == [25]
    fine = substep_input(u, COUNTS, "cubic")
    nodes = np.concatenate([[0], np.cumsum(COUNTS)])
    assert (fine[nodes[24] : nodes[25]] == u[24]).all()
    assert fine[nodes[25], 0] == u[25]
    # The smooth stretches on both sides know nothing of it.
    at = positions(COUNTS)
    np.testing.assert_allclose(fine[: nodes[24]], np.sin(0.02 * at[: nodes[24]]), atol=1e-7)
    np.testing.assert_allclose(fine[nodes[25] :], 3.0 + np.sin(0.02 * at[nodes[25] :]), atol=1e-7)


def test_several_jumps_a_staircase_and_none() -> None:
    stairs = np.repeat([0.0, 1.0, 1.0, 3.0], 12)
    assert find_jumps(stairs).tolist() == [12, 36]
    counts = np.full(stairs.size - 1, 2)
    fine = substep_input(stairs, counts, "cubic")
    np.testing.assert_allclose(fine, np.repeat(stairs[:-1], 2)[:, None] * np.ones(3), atol=1e-14)
    assert find_jumps(np.sin(0.9 * SAMPLES)).size == 0
    assert find_jumps(np.ones(50)).size == 0
    assert find_jumps(np.array([0.0, 5.0, 0.0])).size == 0


def test_more_substeps_follow_a_jump_and_a_start_that_is_one() -> None:
    u = np.sin(0.02 * np.arange(200.0))
    assert (substep_counts(u, 0.0, 2) == 2).all()
    u[100:] += 3.0
    counts = substep_counts(u, 0.0, 2)
    assert counts.size == 199
    assert (counts[:100] == 2).all()
    assert (counts[100:110] > 2).all()
    assert (counts[150:] == 2).all()
    assert (substep_counts(u + 5.0, 0.0, 2)[:10] > 2).all()


def test_mean_is_that_of_a_cubic() -> None:
    at = positions(COUNTS)
    mean = mean_input(at**3 - at)
    exact = ((at[:, 2] ** 4 - at[:, 0] ** 4) / 4 - (at[:, 2] ** 2 - at[:, 0] ** 2) / 2) / (at[:, 2] - at[:, 0])
    np.testing.assert_allclose(mean, exact, rtol=1e-9, atol=1e-9)


def test_short_records_and_an_unknown_method() -> None:
    for n in (2, 3, 4, 5):
        fine = substep_input(np.arange(n, dtype=float), np.full(n - 1, 2), "cubic")
        np.testing.assert_allclose(fine, positions(np.full(n - 1, 2)), atol=1e-12)
    with pytest.raises(InputRefused, match=r"'spline' is not a reconstruction; choose cubic"):
        substep_input(SAMPLES, COUNTS, "spline")


def test_a_band_limited_input_is_not_cut_where_it_looks_like_a_jump() -> None:
    # A seed whose samples around the 99th happen to look like a step.
    rng = np.random.default_rng(362)
    sizes, phases, cycles = rng.standard_normal(60), rng.uniform(0.0, 6.28, 60), np.arange(1, 61) / 200.0

    def u(t: np.ndarray) -> np.ndarray:
        return np.cos(2.0 * np.pi * np.outer(t, cycles) + phases) @ sizes

    samples = u(np.arange(200.0))
    assert find_jumps(samples).tolist() == [99]
    middles = (np.arange(398) + 0.5) / 2.0
    error = np.abs(substep_input(samples, np.full(199, 2), "band_limited")[:, 1] - u(middles))
    assert error[80:320].max() < 1e-4 * np.abs(samples).max()
