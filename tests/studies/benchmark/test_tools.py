"""Tools that answer cases: what each selects, and the methods that they are made of."""

from __future__ import annotations

import itertools
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest, linregress

from phnn.effects import catalogue
from phnn.errors import InputRefused
from phnn.recordings.recording import unrecorded
from studies.benchmark.tools import TOOLS, tool
from studies.benchmark.tools.common import Candidate, orthonormal
from studies.benchmark.tools.lfr import Evidence, group_lasso, read_off
from studies.benchmark.tools.lisdd import autoregression, clean, f_test, whitened, winners
from studies.benchmark.tools.selection import _fewest, _grams, _supports
from studies.generator import generate

RNG = np.random.default_rng


def test_every_tool_can_be_had_and_others_are_refused() -> None:
    assert all(callable(tool(name)) for name in TOOLS)
    with pytest.raises(InputRefused, match=r"nothing is called 'lisd' .did you mean lisdd\?"):
        tool("lisd")


def regression(seed: int, coefficients: dict[int, float]) -> tuple[list[np.ndarray], list[str]]:
    """Products of four recordings in which some of twelve terms act; two neighbours belong to one effect."""
    pytest.importorskip("pysindy")
    rng, n = RNG(seed), 4000
    columns = rng.normal(size=(n, 12))
    r = rng.normal(size=n) + sum(a * columns[:, k] for k, a in coefficients.items())
    slices = [slice(k * 1000, (k + 1) * 1000) for k in range(4)]
    found: Any = SimpleNamespace(project=lambda x: x, residual=r, slices=slices)
    return _grams(found, columns)[0], [f"effect_{k // 2}" for k in range(12)]


def test_sindy_selects_the_terms_that_act() -> None:
    grams, effects = regression(1, {3: 0.8, 8: -0.5})
    assert len(grams) == 16
    every = list(range(16))
    assert (3, 8) in _supports(grams, every)
    assert _fewest(grams, every, [(every[:8], every[8:])], effects) == (3, 8)


def test_sindy_selects_nothing_in_noise() -> None:
    grams, effects = regression(2, {})
    every = list(range(16))
    assert _fewest(grams, every, [(every[:8], every[8:])], effects) == ()


def sine_case(folder: Path, effect: str) -> Path:
    """A case with four recordings, one of which is the examination's input too."""
    generate(7, folder, effect, "short")
    (folder / "exam").mkdir()
    shutil.copy(folder / "sine_100Hz_75V.csv", folder / "exam")
    (folder / "exam" / "recordings.yaml").write_text("setup: {model: piezo_actuator, hysterons: 2}\n")
    return folder


@pytest.mark.slow
def test_sindy_finds_a_concealed_cubic_spring_and_leaves_a_null_alone(tmp_path: Path) -> None:
    pytest.importorskip("pysindy")
    found = tool("sindy")(sine_case(tmp_path / "spring", "cubic_stiffness"), 0)
    assert found.claims == {"cubic_stiffness"}
    assert found.places[0] == "mechanical"
    assert found.predictions["sine_100Hz_75V"].size == 2500
    assert tool("sindy")(sine_case(tmp_path / "null", "none"), 0).claims == {"none"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lisdd", "lfr"])
def test_a_tool_finds_a_strong_effect(name: str, tmp_path: Path) -> None:
    found = tool(name)(sine_case(tmp_path / "case", "quadratic_drag"), 0)
    assert "quadratic_drag" in found.claims
    assert found.predictions["sine_100Hz_75V"].size == 2500


def test_one_slope_is_tested_as_scipy_does() -> None:
    """With a constant as the smaller model, the F-test of a slope has the p-value of its t-test."""
    rng = RNG(1)
    x = rng.normal(size=40)
    y = 3.0 + 0.4 * x + rng.normal(size=40)
    assert f_test(y, np.ones((40, 1)), x[:, None]) == pytest.approx(linregress(x, y).pvalue, rel=1e-9)


def test_coloured_noise_is_made_white_before() -> None:
    """p-values of a drifting column in strongly coloured noise are uniform after, and far too small before."""
    rng, before, after = RNG(5), [], []
    rows = [slice(0, 400)]
    for _ in range(60):
        noise = coloured(rng.normal(size=400), 0.9)
        column = np.cumsum(rng.normal(size=(400, 1)), axis=0)
        constant = np.ones((400, 1))
        before.append(f_test(noise, constant, column))
        taps = autoregression(noise, rows)
        white = [whitened(x, rows, taps) for x in (noise, constant, column)]
        after.append(f_test(*white))
    assert np.mean(np.array(before) < 0.05) > 0.3
    assert kstest(after, "uniform").pvalue > 0.01


def coloured(e: np.ndarray, a: float) -> np.ndarray:
    x = np.zeros_like(e)
    for i in range(1, e.size):
        x[i] = a * x[i - 1] + e[i]
    return x


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
    ranked = winners(r, base, np.column_stack([true, copied, -true]), fitted, ~fitted, candidates)
    assert [c.effect.canonical for c, _, _ in ranked] == ["cubic_stiffness", "creep"]
    assert ranked[0][1] == pytest.approx(0.8, abs=0.25)
    assert ranked[1][2] < 0.0 < ranked[0][2]


def test_orthogonal_groups_are_shrunk_as_the_closed_form_says() -> None:
    basis = orthonormal(RNG(2).normal(size=(60, 5)))
    found = [basis[:, :2], basis[:, 2:]]
    r = basis @ np.array([3.0, 4.0, 1.0, 2.0, 2.0])
    for penalty, *norms in group_lasso(r, found, steps=8, least=0.05):
        expected = [max(5.0 - penalty * 2.0**0.5, 0.0), max(3.0 - penalty * 3.0**0.5, 0.0)]
        assert norms == pytest.approx(expected, abs=1e-6)


MEMORY, ODD = ("mechanical", "memory"), ("mechanical", "odd spring")


@pytest.mark.parametrize(
    ("evidence", "claims"),
    [
        # The channel that predicts most gives the name; what blocks do not understand is not listed.
        (Evidence(1000.0, 150.0, 100, ("mechanical",), ("sensor",), {MEMORY: 200.0, ODD: 900.0}), {"creep"}),
        (Evidence(1000.0, 700.0, 100, ("mechanical",), (), {MEMORY: 750.0}), {"unlisted"}),
        (Evidence(100.0, 99.0, 100, ("sensor",), (), {}), {"none"}),
    ],
)
def test_blocks_are_read_off(evidence: Evidence, claims: set[str]) -> None:
    assert read_off(evidence, {}).claims == claims
