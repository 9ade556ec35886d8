"""How much an element gains on held-out recordings, and how surely."""

from __future__ import annotations

import campaigns
import numpy as np
import pytest
from scipy.signal import lfilter

from phnn.identification.evaluate import Evaluation, score_part
from phnn.identification.order import gain
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Own

NOISE = 4e-8
RATE = 1e4
COLOURS = {"white": ([1.0], [1.0]), "slow": ([1.0], [1.0, -0.9]), "ringing": ([1.0], [1.0, -1.7, 0.95])}


def noise(rng: np.random.Generator, size: int, colour: str = "white") -> np.ndarray:
    """(N,) of unit variance."""
    b, a = COLOURS[colour]
    impulse = lfilter(b, a, np.eye(1, 4000)[0])
    return np.asarray(lfilter(b, a, rng.standard_normal(size + 500))[500:] / np.linalg.norm(impulse))


def recording(name: str, y: np.ndarray, use: str = "confirmation", first: int = 0, scale: float = NOISE) -> Recording:
    t = np.arange(y.size) / RATE
    u = np.sin(2.0 * np.pi * 40.0 * t)
    part = Part(name, first, y.size, use)
    return Recording(
        name, t, u, scale * y, Start("rest"), "cubic", (part,), scale, "stated", np.array([1.0]), None, {}, name
    )  # fmt: skip


def models(recordings: list[Recording], *outputs: list[np.ndarray]) -> list[Evaluation]:
    """Evaluations of outputs in units of the noise."""
    found = []
    for each in outputs:
        scaled = {r.name: r.noise * y for r, y in zip(recordings, each, strict=True)}
        parts = [score_part(r, scaled[r.name], p.first, p.last, p.name, p.use) for r in recordings for p in r.parts]
        found.append(Evaluation(scaled, tuple(parts)))
    return found


@pytest.mark.parametrize(
    ("shape", "colour"),
    [
        pytest.param(shape, colour, marks=() if i == j else pytest.mark.slow)
        for i, shape in enumerate(("tone", "burst", "noise"))
        for j, colour in enumerate(COLOURS)
    ],
)
def test_without_a_gain_the_error_falls_significantly_as_often_as_chance_says(colour: str, shape: str) -> None:
    rng = np.random.default_rng(11)
    size, count, level = 3000, 400, 0.05
    t = np.arange(size) / RATE
    hits = np.zeros(2)
    for _ in range(count):
        recordings, wrong, none = [], [], []
        for name in "abc":
            # The truth lies half-way between the two models: both are as far from it.
            change = {
                "tone": 0.3 * np.sin(2.0 * np.pi * 810.0 * t + rng.uniform(0.0, 6.0)),
                "burst": 0.8 * np.exp(-t / 0.02) * np.sin(2.0 * np.pi * 810.0 * t),
                "noise": 0.3 * noise(rng, size, colour),
            }[shape]
            recordings.append(recording(name, 0.5 * change + noise(rng, size, colour)))
            wrong.append(change)
            none.append(np.zeros(size))
        found = gain(*models(recordings, none, wrong), recordings, "confirmation", 8)
        assert found is not None and found.falls is not None and found.rises is not None
        hits += np.array([found.falls, found.rises]) < level
    # Three standard deviations of a binomial share, and a percent for what correlation is left between blocks.
    assert (hits / count < level + 0.01 + 3.0 * np.sqrt(level * (1.0 - level) / count)).all(), hits / count


@pytest.mark.parametrize("where", ["everywhere", "in one recording", "at the beginning"])
def test_a_gain_is_seen_wherever_it_lies(where: str) -> None:
    rng, size = np.random.default_rng(12), 6000
    t = np.arange(size) / RATE
    tone = np.sin(2.0 * np.pi * 90.0 * t)
    missing = {
        "everywhere": [0.2 * tone] * 4,
        "in one recording": [0.6 * tone, *[0.0 * tone] * 3],
        "at the beginning": [4.0 * np.exp(-t / 0.01) * tone] * 4,
    }[where]
    recordings = [recording(n, x + noise(rng, size)) for n, x in zip("abcd", missing, strict=True)]
    before, after = models(recordings, [0.0 * x for x in missing], missing)
    found = gain(before, after, recordings, "confirmation", 8)
    assert found is not None and found.falls is not None and found.rises is not None
    assert found.falls < 1e-3 and found.rises > 0.99
    assert found.before == pytest.approx(before.over_noise("confirmation"))
    assert found.after == pytest.approx(after.over_noise("confirmation"))
    assert found.share_of_noise == pytest.approx(np.sqrt(np.mean(np.square(missing))), rel=0.2)
    assert found.rms == pytest.approx(NOISE * found.share_of_noise)
    reverse = gain(after, before, recordings, "confirmation", 8)
    assert reverse is not None and reverse.share_of_noise == pytest.approx(-found.share_of_noise)


def test_only_the_scored_samples_of_one_use_count() -> None:
    rng, size = np.random.default_rng(13), 2000
    held = recording("a", noise(rng, size), first=100)
    other = recording("b", noise(rng, size), "identification")
    spoilt = np.where(np.arange(size) < 100, 50.0, 0.0)
    before, after = models([held, other], [spoilt, spoilt], [0.0 * spoilt, 0.0 * spoilt])
    found = gain(before, after, [held, other], "confirmation", 8)
    assert found is not None and found.share_of_noise == 0.0 and found.falls == 0.5
    assert gain(before, after, [other], "confirmation", 8) is None


def test_an_error_of_the_zero_proves_nothing() -> None:
    rng, size, count = np.random.default_rng(14), 2000, 300
    hits = 0
    for _ in range(count):
        # One zero a recording, a seventh of the noise wrong, and a model that shifts the output by as much.
        made = [recording(n, 0.05 + 0.14 * rng.standard_normal() + noise(rng, size)) for n in "ab"]
        found = gain(*models(made, [np.zeros(size)] * 2, [np.full(size, 0.1)] * 2), made, "confirmation", 8)
        assert found is not None and found.falls is not None
        hits += found.falls < 0.01
    assert hits == 0


def test_lines_that_are_fitted_to_noise_gain_nothing() -> None:
    rng, size, own = np.random.default_rng(15), 400, Own(lines=tuple(np.arange(1.0, 9.0) * 50.0))
    shares = []
    for _ in range(200):
        made = recording("a", noise(rng, size))
        phase = 2.0 * np.pi * np.outer(made.t, own.lines)
        columns = np.hstack([np.ones((size, 1)), np.cos(phase), np.sin(phase)])
        fitted = columns @ np.linalg.lstsq(columns, made.y / NOISE, rcond=None)[0]
        mean = np.full(size, made.y.mean() / NOISE)
        found = gain(*models([made], [mean], [fitted]), [made], "confirmation", 8, (Own(), own))
        assert found is not None
        shares.append(found.before**2 - found.after**2)
    assert abs(np.mean(shares)) < 4.0 * np.std(shares) / np.sqrt(len(shares))
    assert np.std(shares) > 0.0


def test_what_is_coherent_over_a_recording_is_one_observation_and_no_test() -> None:
    size = 4000
    drift = np.linspace(-1.0, 1.0, size) ** 3
    made = [recording(n, 100.0 * drift) for n in "ab"]
    found = gain(*models(made, [0.0 * drift] * 2, [60.0 * drift] * 2), made, "confirmation", 8)
    assert found is not None and found.blocks < 8
    assert found.falls is None and found.rises is None
    assert found.after < 0.5 * found.before


def test_the_noise_of_a_campaign_is_the_unit() -> None:
    held = next(r for r in campaigns.campaign().recordings if any(p.use == "confirmation" for p in r.parts))
    y = {held.name: held.y + held.noise}
    exact = {held.name: held.y}
    found = gain(Evaluation(y, ()), Evaluation(exact, ()), [held], "confirmation", 8)
    assert found is not None
    assert (found.before, found.after, found.rms) == pytest.approx((1.0, 0.0, held.noise))
