"""The benchmarks' own parts, without the peers: the case, the reference, the table."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

# Benchmarks are not installed with the package.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
_BEFORE = dict(os.environ)
case = importlib.import_module("benchmarks.case")
reference = importlib.import_module("benchmarks.reference")
table = importlib.import_module("benchmarks.table")
# The benchmarks limit the threads of their own process; other tests keep theirs.
os.environ.clear()
os.environ.update(_BEFORE)

LOUD = case.FREQUENCIES.index(100.0)


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    """100 Hz at a tolerance that is a hundred times tighter than the solver is meant to be."""
    return reference.radau(100.0, case.TRUTH, 1e-8)


def test_march_meets_its_goal_against_an_independent_solver(truth: np.ndarray) -> None:
    error = [
        table.relative_error(
            case.Prepared(case.simulate_all(case.TRUTH, s, case.RECORDINGS[LOUD:][:1])).march()[0], truth
        )
        for s in (1, 2)
    ]
    assert error[0] < 5e-5
    # Second order: half the step, about a quarter of the error.
    assert error[1] < 0.4 * error[0]


def test_march_alone_is_what_the_whole_call_computes() -> None:
    trajectories = case.simulate_all(case.TRUTH, 2, case.RECORDINGS[LOUD:][:1])
    assert np.array_equal(case.Prepared(trajectories).march(), case.outputs(trajectories))


def test_cost_gradient_is_the_slope_of_the_cost() -> None:
    one = case.RECORDINGS[LOUD:][:1]
    wanted = 1.1 * case.outputs(case.simulate_all(case.TRUTH, 1, one))

    def cost(theta: np.ndarray) -> float:
        return float(np.sum((case.outputs(case.simulate_all(theta, 1, one)) - wanted) ** 2))

    gradient = case.cost_gradient(case.Prepared(case.simulate_all(case.TRUTH, 1, one)), wanted)
    direction = np.linspace(-1.0, 1.0, case.TRUTH.size)
    step = 1e-6
    slope = (cost(case.TRUTH * np.exp(step * direction)) - cost(case.TRUTH * np.exp(-step * direction))) / (2 * step)
    assert gradient @ direction == pytest.approx(slope, rel=1e-5)


def test_jacobian_of_the_reference_is_the_derivative_of_its_rates() -> None:
    # One hysteron outside its dead zone, the other inside.
    z = np.array([1.0, 0.1, 0.4, -0.3])
    arguments = (300.0, case.TRUTH, reference.SCALE)
    slope = reference.jacobian(0.01, z, *arguments)
    for j in range(4):
        moved = np.eye(4)[j] * 1e-6
        difference = reference.rates(0.01, z + moved, *arguments) - reference.rates(0.01, z - moved, *arguments)
        assert difference / 2e-6 == pytest.approx(slope[:, j], rel=1e-6, abs=1e-6 * np.abs(slope).max())


def test_measure_takes_turns_and_relates_to_the_first() -> None:
    order: list[str] = []

    def solver(name: str, value: float) -> table.Contender:
        def solve() -> np.ndarray:
            order.append(name)
            return np.array([value, 0.0])

        return table.Contender(name, 1e-6, solve, repeats=2)

    rows = table.measure([solver("a", 1.0), solver("b", 1.5)], np.array([1.0, 0.0]))
    assert order == ["a", "b", "a", "b", "a", "b"]
    assert [row.measured_error for row in rows] == [0.0, 0.5]
    assert rows[0].ratio_to_phnn == 1.0
    assert rows[1].ratio_to_phnn == pytest.approx(rows[1].median_s / rows[0].median_s)


def test_csv_has_the_agreed_columns_and_the_picture_is_drawn(tmp_path: Path) -> None:
    rows = [table.Row("phnn, 1 sub-step", 5e-5, 2e-5, 0.01, 1.0), table.Row("other, 1e-06", 1e-6, 9e-6, 0.05, 5.0)]
    table.write_csv(rows, tmp_path / "new" / "forward.csv")
    read = pd.read_csv(tmp_path / "new" / "forward.csv")
    assert list(read.columns) == ["solver", "target_error", "measured_error", "median_s", "ratio_to_phnn"]
    assert read["solver"].tolist() == ["phnn, 1 sub-step", "other, 1e-06"]
    assert read["ratio_to_phnn"].tolist() == [1.0, 5.0]
    table.picture(rows, tmp_path / "forward.png", "title")
    assert (tmp_path / "forward.png").stat().st_size > 5000
