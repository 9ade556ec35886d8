"""Tools that answer cases: what each selects, and the methods that they are made of."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import linregress

from phnn.errors import InputRefused
from studies.benchmark.tools import TOOLS, tool
from studies.benchmark.tools.common import orthonormal
from studies.benchmark.tools.lfr import group_lasso
from studies.benchmark.tools.lisdd import f_test
from studies.generator import generate

RNG = np.random.default_rng


def test_every_tool_can_be_had_and_others_are_refused() -> None:
    assert all(callable(tool(name)) for name in TOOLS)
    with pytest.raises(InputRefused, match=r"nothing is called 'lisd' .did you mean lisdd\?"):
        tool("lisd")


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


def test_orthogonal_groups_are_shrunk_as_the_closed_form_says() -> None:
    basis = orthonormal(RNG(2).normal(size=(60, 5)))
    found = [basis[:, :2], basis[:, 2:]]
    r = basis @ np.array([3.0, 4.0, 1.0, 2.0, 2.0])
    for penalty, *norms in group_lasso(r, found, steps=8, least=0.05):
        expected = [max(5.0 - penalty * 2.0**0.5, 0.0), max(3.0 - penalty * 3.0**0.5, 0.0)]
        assert norms == pytest.approx(expected, abs=1e-6)
