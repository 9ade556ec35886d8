"""The input between its samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from phnn.errors import InputRefused
from phnn.signals.reconstruct import METHODS, Reconstruction, find_breaks, find_jumps, mean_input


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
        fine = Reconstruction(((SAMPLES - 17.3) / 20.0) ** n, COUNTS, method).fine()
        np.testing.assert_allclose(fine, ((positions(COUNTS) - 17.3) / 20.0) ** n, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_passes_through_the_samples(method: str) -> None:
    u = np.sin(0.3 * SAMPLES) + 0.1 * SAMPLES
    fine = Reconstruction(u, COUNTS, method).fine()
    assert fine.shape == (COUNTS.sum(), 3)
    first = np.concatenate([[0], np.cumsum(COUNTS)[:-1]])
    np.testing.assert_allclose(fine[first, 0], u[:-1], atol=1e-6)
    if method != "zero_order":
        np.testing.assert_allclose(fine[1:, 0], fine[:-1, 2], atol=1e-12)


def test_zero_order_holds_the_earlier_sample() -> None:
    fine = Reconstruction(SAMPLES**2, COUNTS, "zero_order").fine()
    np.testing.assert_array_equal(fine, np.repeat(SAMPLES[:-1] ** 2, COUNTS)[:, None] * np.ones(3))


@pytest.mark.parametrize("cycles", [0.01, 0.1, 0.2])
def test_a_band_limited_sine_is_accurate_away_from_the_ends(cycles: float) -> None:
    t = np.arange(801.0)
    counts = np.full(800, 4)
    fine = Reconstruction(np.sin(2 * np.pi * cycles * t + 0.4), counts, "band_limited").fine()
    error = np.abs(fine - np.sin(2 * np.pi * cycles * positions(counts) + 0.4))
    limit = 1e-6 if cycles <= 0.1 else 1e-5
    assert error[400:-400].max() < limit


def test_orders_of_a_sine_at_67_samples_a_period() -> None:
    # 150 Hz at 10 kHz: what a linear hold makes of it is far above the noise of a good sensor.
    t = np.arange(401.0)
    counts = np.full(400, 2)
    exact = np.sin(2 * np.pi * 0.015 * positions(counts))
    found = {m: Reconstruction(np.sin(2 * np.pi * 0.015 * t), counts, m).fine() for m in METHODS}
    errors = {m: np.abs(fine - exact)[40:-40].max() for m, fine in found.items()}
    assert errors["band_limited"] < 1e-6
    assert errors["quintic"] < errors["cubic"] < 2e-6
    assert 5e-4 < errors["linear"] < 2e-3 < errors["zero_order"]


def test_a_jump_is_found_and_the_stretch_before_it_continued_until_its_instant() -> None:
    u = np.sin(0.02 * SAMPLES)
    u[25:] += 3.0
    assert find_jumps(u).tolist() == [25]
    at = positions(COUNTS)
    for instants, instant in ((None, 25.0), (np.array([0.4]), 24.4)):
        fine = Reconstruction(u, COUNTS, "cubic").fine(instants)
        whole = (at[:, 2] <= instant) | (at[:, 0] >= instant)
        np.testing.assert_allclose(
            fine[whole], (np.sin(0.02 * at) + 3.0 * (at[:, :1] >= instant))[whole], rtol=0.0, atol=1e-7
        )
        # In the sub-step of the jump the mean is that of the true input.
        sizes = at[:, 2] - at[:, 0]
        missing = np.sum((mean_input(fine) - mean_input(np.sin(0.02 * at))) * sizes)
        np.testing.assert_allclose(missing, 3.0 * (SAMPLES[-1] - instant), atol=1e-6)


def test_kinks_are_placed_between_the_samples() -> None:
    counts = np.full(199, 3)
    at, sizes = positions(counts), np.diff(positions(counts)[:, [0, 2]], axis=1)[:, 0]

    def trapezoid(t: np.ndarray) -> np.ndarray:
        return np.clip((t - 60.3) / 10.0, 0.0, 1.0) - np.clip((t - 120.9) / 7.0, 0.0, 1.0)

    u = 60.0 * trapezoid(np.arange(200.0))
    breaks = find_breaks(u)
    np.testing.assert_allclose(breaks.at - 1 + breaks.instant, [60.3, 70.3, 120.9, 127.9], atol=1e-9)
    fine = Reconstruction(u, counts, "cubic").fine()
    smooth = np.all([(at[:, 2] <= kink) | (at[:, 0] >= kink) for kink in (60.3, 70.3, 120.9, 127.9)], axis=0)
    np.testing.assert_allclose(fine[smooth], 60.0 * trapezoid(at)[smooth], atol=1e-9)
    # The integral of every sub-step, by a grid that contains the kinks.
    dense = np.linspace(0.0, 199.0, 199 * 90 + 1)
    area = np.concatenate([[0.0], np.cumsum(np.diff(dense) * 0.5 * (trapezoid(dense)[1:] + trapezoid(dense)[:-1]))])
    exact = np.interp(at[:, 2], dense, area) - np.interp(at[:, 0], dense, area)
    np.testing.assert_allclose(mean_input(fine) * sizes, 60.0 * exact, atol=1e-6)


def test_smooth_inputs_have_no_breaks() -> None:
    t, rng = np.arange(6000.0), np.random.default_rng(3)
    tones = rng.uniform(0.0, 0.1, 300)
    for u in (
        np.sin(0.1 * t), np.round(75.0 * np.sin(0.001 * t), 2), np.sin(1e-5 * t**2), rng.standard_normal(6000),
        np.sin(0.01 * t) + 1e-3 * rng.standard_normal(6000), np.tanh((t - 3000.0) / 20.0),
        np.cos(2.0 * np.pi * np.outer(t, tones) + rng.uniform(0.0, 6.28, 300)).sum(axis=1),
    ):  # fmt: skip
        assert find_breaks(u).at.size == 0


@given(instants=st.lists(st.floats(0.01, 0.99), min_size=3, max_size=3), seed=st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_slopes_are_the_derivatives_of_the_mean_input(instants: list[float], seed: int) -> None:
    # On the border of two sub-steps the mean input has a kink.
    assume(all(abs(a * n - round(a * n)) > 1e-4 for a in instants for n in range(1, 9)))
    # A plain jump, and a transition by way of a single sample.
    u = np.repeat([0.0, 5.0, 7.0, 12.0], [40, 30, 1, 29]) + 0.3 * np.sin(0.1 * np.arange(100.0) + seed)
    found = Reconstruction(u, np.random.default_rng(seed).integers(1, 9, 99), "cubic")
    assert found.breaks.jumps.tolist() == [40, 70, 71]
    at, group = np.array(instants), np.array([0, 1, 1])
    slopes = found.slopes(at, group)
    for g in (0, 1):
        step = 1e-7 * (group == g)
        change = (mean_input(found.fine(at + step)) - mean_input(found.fine(at - step))) / 2e-7
        np.testing.assert_allclose(slopes[:, g], change, atol=1e-5)


def test_several_jumps_a_staircase_and_none() -> None:
    stairs = np.repeat([0.0, 1.0, 1.0, 3.0], 12)
    assert find_jumps(stairs).tolist() == [12, 36]
    counts = np.full(stairs.size - 1, 2)
    fine = Reconstruction(stairs, counts, "cubic").fine()
    np.testing.assert_allclose(fine, np.repeat(stairs[:-1], 2)[:, None] * np.ones(3), atol=1e-14)
    assert find_jumps(np.sin(0.9 * SAMPLES)).size == 0
    assert find_jumps(np.ones(50)).size == 0
    assert find_jumps(np.array([0.0, 5.0, 0.0])).size == 0


def test_short_records_and_an_unknown_method() -> None:
    for n in (2, 3, 4, 5):
        fine = Reconstruction(np.arange(n, dtype=float), np.full(n - 1, 2), "cubic").fine()
        np.testing.assert_allclose(fine, positions(np.full(n - 1, 2)), atol=1e-12)
    with pytest.raises(InputRefused, match=r"'spline' is not a reconstruction; choose cubic"):
        Reconstruction(SAMPLES, COUNTS, "spline").fine()


def test_a_band_limited_input_is_not_cut_where_it_looks_like_a_jump() -> None:
    # A seed whose samples around the 99th happen to look like a step.
    rng = np.random.default_rng(362)
    sizes, phases, cycles = rng.standard_normal(60), rng.uniform(0.0, 6.28, 60), np.arange(1, 61) / 200.0

    def u(t: np.ndarray) -> np.ndarray:
        return np.cos(2.0 * np.pi * np.outer(t, cycles) + phases) @ sizes

    samples = u(np.arange(200.0))
    assert find_jumps(samples).tolist() == [99]
    middles = (np.arange(398) + 0.5) / 2.0
    error = np.abs(Reconstruction(samples, np.full(199, 2), "band_limited").fine()[:, 1] - u(middles))
    assert error[80:320].max() < 1e-4 * np.abs(samples).max()


def test_a_short_pulse_back_is_no_ramp() -> None:
    u = np.concatenate([np.zeros(10), [1.0, 0.0], np.ones(12)])
    assert find_breaks(u).jumps.tolist() == [10, 11, 12]
    fine = Reconstruction(u, np.full(u.size - 1, 4), "cubic").fine()
    assert fine.min() >= -1e-12
    assert fine.max() <= 1.0 + 1e-12


@given(seed=st.integers(0, 10**6), hold=st.integers(1, 9), levels=st.integers(2, 5))
@settings(deadline=None, max_examples=15)
def test_a_sequence_of_levels_stays_within_its_levels(seed: int, hold: int, levels: int) -> None:
    # Levels that change with every sample, and are more than two, may as well be samples of something smooth.
    hold = hold if levels == 2 else max(hold, 2)
    u = np.repeat(np.random.default_rng(seed).integers(0, levels, 300).astype(float), hold)
    fine = Reconstruction(u, np.full(u.size - 1, 3), "cubic").fine()
    assert fine.min() >= u.min() - 1e-9
    assert fine.max() <= u.max() + 1e-9


def test_a_sine_of_few_samples_a_period_is_no_sequence_of_levels() -> None:
    u = np.tile(np.sin(2.0 * np.pi * (np.arange(8) + 0.5) / 8.0).round(12), 50)
    assert find_breaks(u).jumps.size == 0


def test_pulses_of_single_samples_keep_their_area_with_a_shared_instant() -> None:
    u = np.zeros(1300)
    for k in range(60):
        u[10 + 20 * k : 10 + 20 * k + (1 if k % 2 else 5)] = 1.0
    found = Reconstruction(u, np.full(u.size - 1, 4), "cubic", sharp=True)
    for instant in (0.0, 0.4, 1.0):
        area = mean_input(found.fine(np.full(found.breaks.jumps.size, instant))).sum() / 4.0
        np.testing.assert_allclose(area, u.sum(), rtol=1e-9)
