"""Noise families: each has the spectrum, the tails, the steps or the growth with speed that it states."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import welch
from scipy.stats import t as student

from phnn.errors import InputRefused
from studies.generator import draw_case, make_case
from studies.generator.noise import FAMILIES, HEAVY, JITTERED, PINK, PROCESS, Noise
from studies.generator.world import simulate_all

COUNT = 200_000


def _drawn(noise: Noise, seed: int = 0) -> np.ndarray:
    return noise.drawn(COUNT, np.random.default_rng(seed))


def _errors(folder: Path, outputs: tuple[np.ndarray, ...], names: list[str]) -> list[np.ndarray]:
    """Recorded minus simulated, each without its mean."""
    tables = [pd.read_csv(folder / f"{name}.csv") for name in names]
    errors = [table["displacement_um"].to_numpy() * 1e-6 - q for table, q in zip(tables, outputs, strict=True)]
    return [e - e.mean() for e in errors]


@pytest.mark.parametrize("colour", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("step", [0.0, 20e-9, 60e-9])
def test_whitened_noise_with_rounding_is_white_of_unit_variance(colour: float, step: float) -> None:
    noise = Noise(40e-9, step, colour)
    n = noise.drawn(COUNT, np.random.default_rng(1))
    if step > 0.0:
        n = np.round(n / step) * step
    white = noise.whitened(n)
    assert white.std() == pytest.approx(1.0, rel=0.01)
    for lag in (1, 2, 3):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4.0 / np.sqrt(COUNT)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_the_share_of_pink_noise_is_the_stated_one(share: float) -> None:
    noise = Noise(50e-9, 10e-9, 0.0, PINK, share)
    paths = np.stack([noise.drawn(4096, np.random.default_rng(seed)) for seed in range(300)])
    assert np.std(paths) == pytest.approx(50e-9, rel=0.02)
    # White noise alone has the density (1 − share) σ² at Nyquist's frequency, one-sided twice that over the rate.
    f, density = welch(paths, 1.0, nperseg=1024)
    lines = np.arange(1, 4096)
    at = np.array([0.02, 0.45])
    # Line k lies at k/8192; 1/(Σ 1/k) of the pink power per line, times 1/k.
    expected = 50e-9**2 * (2.0 * (1.0 - share) + share / np.sum(1.0 / lines) / at)
    measured = [np.mean(density[:, np.abs(f - a) < 0.004]) for a in at]
    np.testing.assert_allclose(measured, expected, rtol=0.05)


def test_heavy_tails_are_those_of_student_s_t_with_the_stated_deviation() -> None:
    n = _drawn(Noise(50e-9, 10e-9, 0.0, HEAVY, 3.0)) / 50e-9
    # Variance 3 of the distribution with three degrees of freedom becomes 1.
    levels = np.array([0.001, 0.01, 0.1, 0.25, 0.75, 0.9, 0.99, 0.999])
    np.testing.assert_allclose(np.quantile(n, levels), student.ppf(levels, 3.0) / math.sqrt(3.0), rtol=0.08)


@pytest.mark.parametrize("share", [0.5, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.03, 0.1))])
def test_the_share_of_process_noise_is_the_stated_one(tmp_path: Path, share: float) -> None:
    case = draw_case(5, "none", "few", noise=f"process:{share}")
    sealed = make_case(case, tmp_path / "r")
    assert sealed.noise_unrecorded == pytest.approx(share, rel=0.1)
    assert sealed.noise_total == pytest.approx(math.hypot(sealed.noise, sealed.quantisation / 12**0.5), rel=0.03)
    # Measured again from the folder: what the sensor adds is white, so neighbours are related by the plant alone.
    errors = _errors(tmp_path / "r", simulate_all(case.base, case.recordings), [e.name for e in case.recordings])
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) == pytest.approx(sealed.noise_total, rel=1e-3)
    related = np.mean([np.mean(e[1:] * e[:-1]) / np.mean(e**2) for e in errors])
    # An oscillator of 900 Hz sampled at 10 kHz: neighbours of its part are related by some 0.85.
    assert related == pytest.approx(0.85 * share, abs=0.06)


def test_the_variance_of_jittered_noise_grows_with_the_square_of_the_speed(tmp_path: Path) -> None:
    case = draw_case(6, "none", "few", noise="jittered:2")
    sealed = make_case(case, tmp_path)
    outputs = simulate_all(case.base, case.recordings)
    errors = np.concatenate(_errors(tmp_path, outputs, [e.name for e in case.recordings]))
    speeds = [np.gradient(q, e.dt) for q, e in zip(outputs, case.recordings, strict=True)]
    fastest = max(float(np.sqrt(np.mean(v**2))) for v in speeds)
    slope, rest = np.polyfit(np.concatenate(speeds) ** 2, errors**2, 1)
    assert math.sqrt(slope) == pytest.approx(2.0 * sealed.noise / fastest, rel=0.06)
    assert math.sqrt(rest) == pytest.approx(math.hypot(sealed.noise, sealed.quantisation / 12**0.5), rel=0.1)
    assert sealed.noise_unrecorded == pytest.approx(
        slope * np.mean(np.concatenate(speeds) ** 2) / sealed.noise_total**2, rel=0.1
    )
    # The faster recording is the louder one.
    assert max(sealed.noise_rms.values()) > 2.0 * sealed.noise > 1.5 * min(sealed.noise_rms.values())


@pytest.mark.parametrize("family", list(FAMILIES))
def test_a_family_changes_nothing_but_the_noise(tmp_path: Path, family: str, brief: str) -> None:
    plain, asked = (draw_case(5, "none", brief, noise=n) for n in (None, family))
    assert (asked.base, asked.recordings, asked.family) == (plain.base, plain.recordings, family)
    assert asked.noise.deviation == plain.noise.deviation
    sealed, again = make_case(asked, tmp_path / "a"), make_case(asked, tmp_path / "b")
    assert sealed == again
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
    errors = _errors(tmp_path / "a", simulate_all(plain.base, plain.recordings), list(sealed.noise_rms))
    np.testing.assert_allclose([e.std() for e in errors], list(sealed.noise_rms.values()), rtol=1e-3)
    assert not any(
        name in path.read_text() for path in (tmp_path / "a").iterdir() for name in (JITTERED, PROCESS, PINK)
    )


@pytest.mark.parametrize("noise", ["violet", "process:1", "process:0", "process:much", "heavy:2", "white:1", "pink:"])
def test_what_is_no_noise_is_refused(noise: str) -> None:
    with pytest.raises(InputRefused, match=f"noise = '{noise}'"):
        draw_case(0, "none", noise=noise)
