"""Noise of recordings in which nothing repeats, against simulated truth; noise of known kind is told as what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, chirp, cont2discrete, lfilter, sosfilt

from phnn.recordings.partition import DIFFERENT, alike, pooled
from phnn.signals import least_squares
from phnn.signals.first_order import correlation_of
from phnn.signals.noise import SILENT, WHITE, NoiseFloor, estimated, from_rest, noise_floor
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement

Array = NDArray[np.float64]
SIZE, DT, NOISE = 4000, 1e-3, 30e-9


def driven(kind: str, rng: np.random.Generator) -> Array:
    """(N,) voltages that do not repeat: slow, through a resonance at 40 Hz, or up to the highest frequencies."""
    t = np.arange(SIZE)
    if kind == "slow":
        return np.asarray(50.0 * np.sin(2.0 * np.pi * 1.3 * t / SIZE) * (1.0 + 0.3 * t / SIZE))
    if kind == "sweep":
        return np.asarray(50.0 * chirp(t, 1e-4, SIZE, 0.02, phi=-90))
    order, edge = (4, 0.04) if kind == "band" else (2, 0.5)
    return np.asarray(50.0 * sosfilt(butter(order, edge, output="sos"), rng.normal(size=SIZE)))


def actuator(u: Array) -> Array:
    """Plays of three widths before a resonance at 40 Hz: kinks, loops and ringing."""
    v = u.copy()
    for share in (0.05, 0.1, 0.2):
        half, z = share * np.ptp(u), u[0]
        for i, x in enumerate(u):
            z = min(max(z, x - half), x + half)
            v[i] += 0.1 * z
    w = 2.0 * np.pi * 40.0
    b, a, _ = cont2discrete(([w * w], [1.0, 0.2 * w, w * w]), DT, "bilinear")
    return np.asarray(1e-6 * lfilter(np.ravel(b), np.ravel(a), v))


def noisy(y: Array, kind: str, rng: np.random.Generator) -> tuple[Array, float]:
    """An output with noise, and the standard deviation of that."""
    if kind.startswith("steps of"):
        step = float(kind.split()[-1]) * NOISE
        return np.round((y + NOISE * rng.normal(size=SIZE)) / step) * step, float(np.hypot(NOISE, step / np.sqrt(12.0)))
    a = 0.0 if kind == "white" else float(kind.split()[-1])
    return y + NOISE * np.sqrt(1.0 - a * a) * lfilter([1.0], [1.0, -a], rng.normal(size=SIZE + 500))[500:], NOISE


WHAT = [
    *((drive, noise) for drive in ("slow", "sweep", "band") for noise in ("white", "steps of 1", "steps of 5")),
    ("slow", "first-order 0.5"), ("slow", "first-order 0.8"), ("sweep", "first-order 0.5"),
    ("wide", "white"), ("wide", "steps of 5"),
]  # fmt: skip


def covered(drive: str, noise: str, draws: range, most: int = 40) -> tuple[int, int]:
    """In how many draws the interval holds the truth, and in how many there is one, at most so many."""
    right = given = 0
    for seed in draws:
        if given == most:
            break
        rng = np.random.default_rng(seed)
        u = driven(drive, rng)
        y, truth = noisy(actuator(u), noise, rng)
        found = estimated(u, y)
        if found is not None:
            given += 1
            right += found.low <= truth <= found.high
            assert found.low <= found.value <= found.high <= 3.0 * found.low
    return right, given


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "noise"), WHAT)
def test_intervals_hold_the_truth_in_nine_draws_of_ten(drive: str, noise: str) -> None:
    # Where the input reaches the highest frequencies, few recordings show the noise.
    right, given = covered(drive, noise, range(1000, 1240))
    assert given >= 20 and right >= 0.9 * given, (right, given)


def test_what_follows_the_input_is_no_noise() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=SIZE)
    y = lfilter([0.0, 1e-6], [1.0, -0.5], u) + NOISE * rng.normal(size=SIZE)
    found = noise_floor(u, y, DT)
    assert found.value == pytest.approx(NOISE, rel=0.1)
    assert found.interval is not None and "one-step-ahead" in found.source and "order 24" in found.source


def test_a_shaft_that_coasts_while_its_input_rests_is_no_noise() -> None:
    t = 0.01 * np.arange(3000)
    u = np.where(t < 2.0, 3.0, 0.0)
    angle = 9.0 * np.where(t < 2.0, t**2, 4.0 * t - 4.0) % 6.28
    noisy = angle + 1e-3 * np.random.default_rng(4).standard_normal(t.size)
    assert from_rest(u, noisy) is None
    resting = np.where(t < 2.0, angle, angle[199]) + noisy - angle
    rest = from_rest(u, resting)
    assert rest is not None and 0.8e-3 < rest.value < 1.2e-3


def test_noise_too_small_to_fit_to_is_told() -> None:
    rng = np.random.default_rng(4)
    u = driven("slow", rng)
    floor = noise_floor(u, 1e-6 * u + 1e-11 * rng.normal(size=SIZE), DT)
    assert not floor.found and floor.interval is not None
    assert floor.interval[0] <= 1e-11 <= floor.interval[1] and "too small" in floor.source


def test_recordings_are_said_to_differ_as_often_as_the_level_says() -> None:
    rng = np.random.default_rng(5)
    apart, draws = 0, 2000
    for _ in range(draws):
        errors = rng.uniform(0.01, 0.1, 6)
        logs = errors * rng.normal(size=6)
        bounds = [(float(np.exp(x - 1.96 * s)), float(np.exp(x + 1.96 * s))) for x, s in zip(logs, errors, strict=True)]
        shared = alike(np.exp(logs).tolist(), bounds)
        apart += shared is None or len(shared[2]) < 6
    assert 0.5 * DIFFERENT <= apart / draws <= 1.6 * DIFFERENT


def of_one_sensor(floors: list[NoiseFloor]) -> list[NoiseFloor]:
    """Return the pooled floors of recordings of one sensor."""
    return pooled(floors, [("q", 1)] * len(floors))


def floor_of(value: float) -> NoiseFloor:
    return NoiseFloor(value, "the spectrum above 10 Hz", WHITE, None, interval=(0.95 * value, 1.05 * value))


def test_one_that_differs_keeps_its_own_floor() -> None:
    floors = [floor_of(v) for v in (1.0, 1.02, 2.0, 0.99)]
    found = pooled(floors, [("a", 1)] * 4)
    assert [f.value for f in found] == pytest.approx([1.003] * 2 + [2.0] + [1.003], rel=1e-3)
    assert "shared by 3" in found[0].source and found[2] is floors[2]
    # Where nothing agrees with coloured noise, the smaller floor of white noise stands.
    white = floor_of(1.0)
    assert pooled([floor_of(1.0), replace(floor_of(2.0), smaller=white)], [("a", 1)] * 2)[1] is white
    # Other outputs and rates have floors of their own.
    assert pooled(floors[:2], [("a", 1), ("b", 1)]) == floors[:2]


def test_a_spectrum_that_a_signal_fills_is_no_word_on_the_noise() -> None:
    """What agrees in colour must agree in size as well: 48 nm and 3 µm are no two observations of one noise."""
    trusted = [
        NoiseFloor(44e-9, "spectrum", WHITE, 0.0, interval=(42e-9, 51e-9)),
        NoiseFloor(47e-9, "spectrum", WHITE, 0.0, interval=(42e-9, 49e-9)),
        NoiseFloor(48e-9, "spectrum", correlation_of(0.13), 0.13, interval=(45e-9, 51e-9)),
    ]
    ringing = NoiseFloor(3e-6, "spectrum", correlation_of(0.35), 0.35)
    found = of_one_sensor([*trusted, ringing])
    assert [f.value for f in found[:2]] == [44e-9, 47e-9]
    assert all(f.value == pytest.approx(45.5e-9) for f in found[2:])
    # A floor that is trusted, or smaller, keeps its own word.
    louder = replace(ringing, value=200e-9, interval=(150e-9, 250e-9))
    finer = replace(ringing, value=5e-9)
    assert [f.value for f in of_one_sensor([*trusted, louder, finer])[3:]] == [200e-9, 5e-9]
    # Two of four are no majority that would know better.
    assert [f.value for f in of_one_sensor([*trusted[:2], ringing, replace(ringing, value=9e-6)])][2:] == [3e-6, 9e-6]


def test_a_floor_taken_as_white_at_the_highest_frequencies_agrees_with_first_order_noise_there() -> None:
    """With coefficient 0.7 the highest frequencies have 0.42 times the deviation of the noise."""
    known = [NoiseFloor(40e-9, "spectrum", correlation_of(0.7), 0.7)] * 3
    high = NoiseFloor(0.42 * 40e-9, "the highest frequencies, noise taken as white", WHITE, 0.0)
    found = of_one_sensor([*known, high])[-1]
    assert found.value == pytest.approx(40e-9)
    assert found.correlation == pytest.approx(correlation_of(0.7))
    # Less or more than the first-order noise has there is another noise, and so is what is trusted or comes from
    # frequencies about which the drive is silent.
    others = replace(high, value=0.2 * 40e-9), replace(high, value=0.65 * 40e-9), replace(high, interval=(16e-9, 18e-9))
    for other in (*others, replace(high, source=SILENT)):
        assert of_one_sensor([*known, other])[-1] is other


def test_a_level_of_the_highest_frequencies_gives_way_to_what_others_of_the_sensor_show() -> None:
    whole = [NoiseFloor(v, "period-to-period differences", correlation_of(0.7)) for v in (60e-9, 62e-9, 64e-9)]
    level = NoiseFloor(25e-9, "the highest frequencies, noise taken as white", WHITE, 0.0)
    found = pooled([*whole, level], [("q", 1e-4)] * 3 + [("q", 2e-4)])
    assert found[:3] == whole
    assert found[3].value == pytest.approx(62e-9)
    assert found[3].correlation == pytest.approx(correlation_of(0.7))
    # Another sensor, too few that show their noise, and one that comes with an interval keep their own.
    trusted = replace(level, interval=(24e-9, 26e-9))
    assert pooled([*whole, level], [("q", 1e-4)] * 3 + [("i", 1e-4)])[3] is level
    assert of_one_sensor([*whole[:2], level])[2] is level
    assert of_one_sensor([*whole, trusted])[3].value == trusted.value


@pytest.mark.parametrize("dependent", [False, True])
def test_blocks_leave_what_the_whole_matrix_leaves(dependent: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 1013)
    columns = np.column_stack([np.ones(t.size), t, np.sin(40.0 * t), np.cos(40.0 * t)])
    if dependent:
        columns = np.column_stack([columns, columns @ [1.0, 2.0, 3.0, 4.0]])
    y = columns @ rng.standard_normal(columns.shape[1]) + 0.1 * rng.standard_normal(t.size)
    whole = least_squares.residual(y, lambda rows: columns[rows])
    assert np.allclose(columns.T @ whole, 0.0, atol=1e-10)
    monkeypatch.setattr(least_squares, "_WHOLE", 100)
    monkeypatch.setattr(least_squares, "_ROWS", 100)
    assert np.allclose(least_squares.residual(y, lambda rows: columns[rows]), whole, atol=1e-12)
    for matrix in (columns, columns[:5, :5], columns[:257, :2]):
        assert np.allclose(np.abs(least_squares.triangle(matrix)), np.abs(np.linalg.qr(matrix, mode="r")))


DT_STATEMENT, COUNT = 1e-4, 3000
T = DT_STATEMENT * np.arange(COUNT)
SPEED = 0.05 * np.cos(2.0 * np.pi * 50.0 * T)
# Steps that hold what they say for any unit of the noise.
SIGMA = 5e-8


def stated(noise: np.ndarray, step: float = 0.0, above: float = 0.0) -> NoiseStatement:
    sample = Sample(noise / SIGMA, DT_STATEMENT, SPEED / SIGMA, step / SIGMA, SIGMA, above)
    return noise_statement(SIGMA, "stated", "m", sample)


def white(seed: int) -> np.ndarray:
    return np.asarray(SIGMA * np.random.default_rng(seed).standard_normal(COUNT))


def test_white_noise_is_white_and_nothing_else() -> None:
    found = [stated(white(seed)) for seed in range(200)]
    # One per cent of each test is meant: colour, growth and tails.
    assert sum(f.colour != "white" for f in found) <= 6
    assert sum(bool(f.notes) for f in found) <= 12
    assert found[0].rms == SIGMA and found[0].source == "stated"


@pytest.mark.parametrize(("phi", "side"), [(0.5, "low"), (-0.5, "high")])
def test_noise_of_first_order(phi: float, side: str) -> None:
    found = stated(lfilter([1.0], [1.0, -phi], white(2)))
    assert found.colour == "spectrum"
    assert f"more power at {side} frequencies" in found.notes[0]
    assert f"{phi:g}" in found.notes[0]


def test_what_lies_below_the_band_is_no_colour() -> None:
    settling = white(3) + 20.0 * SIGMA * np.sin(2.0 * np.pi * 5.0 * T / T[-1])
    assert stated(settling).colour == "spectrum"
    assert stated(settling, above=6.0 / T[-1]).colour == "white"


def test_steps_beside_the_noise() -> None:
    for step, told in ((2.0 * SIGMA, True), (0.1 * SIGMA, False)):
        y = np.round((1e-5 * np.sin(300.0 * T) + white(6)) / step) * step
        found = stated(y - 1e-5 * np.sin(300.0 * T), step)
        assert any("quantised: steps of 100 nm" in n for n in found.notes) is told
        assert not any("outliers" in n for n in found.notes)


def test_what_cannot_be_seen_is_not_told() -> None:
    for sample in (None, Sample(white(0)[:50], DT_STATEMENT), Sample(np.zeros(COUNT), DT_STATEMENT)):
        found = noise_statement(SIGMA, "stated", "m", sample)
        assert found.notes == ("assumed, for the noise cannot be seen apart from the motion",)
    assert found.document() == {"rms": SIGMA, "source": "stated", "colour": "white", "notes": list(found.notes)}
