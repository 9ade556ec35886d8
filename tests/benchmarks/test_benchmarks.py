"""The benchmarks' own parts: the case, the reference, the ladder, the table, and that the peers solve the same case."""

from __future__ import annotations

import importlib
import os
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

# Benchmarks are not installed with the package.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
_BEFORE = dict(os.environ)
case = importlib.import_module("benchmarks.case")
reference = importlib.import_module("benchmarks.reference")
ladder = importlib.import_module("benchmarks.ladder")
table = importlib.import_module("benchmarks.table")
growth = importlib.import_module("benchmarks.growth")
document = importlib.import_module("benchmarks.document")
leaves = importlib.import_module("benchmarks.leaves")
peers_scipy = importlib.import_module("benchmarks.peers_scipy")
peers_torch = importlib.import_module("benchmarks.peers_torch")
# The benchmarks limit the threads of their own process; other tests keep theirs.
os.environ.clear()
os.environ.update(_BEFORE)

# The rise of 100 Hz, in which both hysterons begin to slip.
RISE = (case.sine(100.0, 251),)


@pytest.fixture(scope="module")
def truth() -> tuple[np.ndarray, np.ndarray]:
    """(1, 251) displacements and (1, 251, 10) derivatives of the rise."""
    q, by = reference.solved(RISE[0], case.TRUTH, 1e-8)
    return q[None], by[None]


def test_march_meets_the_reference_with_second_order(truth: tuple[np.ndarray, np.ndarray]) -> None:
    one, two = (ladder.relative_errors(case.march_alone(RISE, [s])(), truth[0])[0] for s in (1, 2))
    assert one < 5e-5
    assert two < 0.4 * one


def test_march_alone_is_what_the_whole_call_computes() -> None:
    assert np.array_equal(case.march_alone(RISE, [2])(), case.whole_call(RISE, [2])())


@pytest.mark.slow
def test_all_gradients_are_the_slope_of_the_cost(truth: tuple[np.ndarray, np.ndarray]) -> None:
    wanted = 1.1 * truth[0]
    makers = (case.swept_gradient, case.backward_gradient, case.adjoint_gradient)
    swept, backward, adjoint = (make(RISE, [1], wanted)()[0] for make in makers)
    assert backward == pytest.approx(swept, rel=1e-9)
    assert adjoint == pytest.approx(swept, rel=1e-9)
    direction = np.linspace(-1.0, 1.0, case.TRUTH.size)

    def cost(step: float) -> float:
        prepared = case.Prepared(RISE, [1], case.setup_with(case.TRUTH * np.exp(step * direction)))
        return float(np.sum((prepared.march() - wanted) ** 2))

    assert swept @ direction == pytest.approx((cost(1e-6) - cost(-1e-6)) / 2e-6, rel=1e-5)
    reference_gradient = 2.0 * np.einsum("n,nk->k", (truth[0] - wanted)[0], truth[1][0])
    assert ladder.relative_errors(swept[None], reference_gradient[None])[0] < 5e-3


def test_derivatives_of_the_reference_are_those_of_its_rates() -> None:
    # One hysteron outside its dead zone, the other inside.
    z, scale, voltage = np.array([-1.0, 0.1, 0.4, -0.3]), reference.SCALE, 30.0
    slope = reference.jacobian(z, case.TRUTH, scale)
    by = reference.by_parameters(z, voltage, case.TRUTH, scale)
    for j in range(4):
        moved = np.eye(4)[j] * 1e-6
        ends = [reference.rates(z + s * moved, voltage, case.TRUTH, scale) for s in (1.0, -1.0)]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(slope[:, j], rel=1e-6, abs=1e-6 * np.abs(slope).max())
    for k in range(10):
        factors = np.exp(np.eye(10)[k] * 1e-6)
        ends = [reference.rates(z, voltage, case.TRUTH * factors**s, scale) for s in (1.0, -1.0)]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(by[:, k], rel=1e-5, abs=1e-6 * np.abs(by).max())


def test_reference_derivatives_are_differences_of_the_reference(truth: tuple[np.ndarray, np.ndarray]) -> None:
    begin = case.sine(100.0, 101)
    for name in ("C_1", "d_2"):
        factor = np.where(np.array(case.NAMES) == name, np.exp(1e-4), 1.0)
        up, down = (reference.solved(begin, case.TRUTH * factor**s, 1e-9)[0] for s in (1.0, -1.0))
        by = truth[1][0, :101, case.NAMES.index(name)]
        assert (up - down) / 2e-4 == pytest.approx(by, abs=1e-4 * np.abs(by).max())


def test_scipy_solves_the_same_case(truth: tuple[np.ndarray, np.ndarray]) -> None:
    for path in (peers_scipy.radau, peers_scipy.lsoda, peers_scipy.lsoda_on_samples):
        found = path(RISE[0], case.TRUTH, 1e-8)
        assert ladder.relative_errors(found[None], truth[0])[0] < 1e-5


def test_torch_peer_has_the_rates_of_the_reference() -> None:
    actuator = peers_torch.Actuator(RISE[0])
    z, n = np.array([1.0, -0.8, 0.4, -0.3]), 100
    middle = 0.5 * (RISE[0].t[n] + RISE[0].t[n + 1])
    wanted = reference.rates(z, 0.5 * (RISE[0].u[n] + RISE[0].u[n + 1]), case.TRUTH, reference.SCALE)
    found = actuator(torch.tensor(middle), torch.from_numpy(z)).detach().numpy()
    assert found == pytest.approx(wanted, rel=1e-9)


@pytest.mark.slow
def test_diffrax_solves_the_same_case(truth: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("diffrax")
    peers = importlib.import_module("benchmarks.peers")
    wanted = 1.1 * truth[0]
    gradient = 2.0 * np.einsum("n,nk->k", (truth[0] - wanted)[0], truth[1][0])[None]
    for solver in (*peers.forward(RISE, "Kvaerno3", True), peers.forward(RISE, "Kvaerno5", False)[0]):
        assert ladder.relative_errors(solver.prepare([1e-7])(), truth[0])[0] < 1e-5
    for planned in (None, peers.FEW_STEPS):
        found = peers.gradient(RISE, wanted, "Kvaerno3", True, planned, "")([1e-7])()
        assert ladder.relative_errors(found, gradient)[0] < 1e-2


@pytest.mark.slow
def test_identifications_share_start_and_cost() -> None:
    pytest.importorskip("optimistix")
    identify = importlib.import_module("benchmarks.identify")
    assert identify.theta_of(identify.Z_START) == pytest.approx(identify.START)
    assert identify.START[0] == case.TRUTH[0]
    assert sorted(set(np.round(identify.START[1:] / case.TRUTH[1:], 9))) == [round(1 / 1.5, 9), 1.5]
    recording = identify.replace(RISE[0], y=np.linspace(0.0, 1e-4, 251), noise=identify.NOISE)
    choice = ladder.Choice(identify.peers.forward((recording,), "Kvaerno3", True)[0], 1e-5, (1e-7,), 0.0)
    by_jax = np.asarray(identify.jax_residual([recording], choice)(identify.Z_START))
    output = peers_scipy.radau(recording, identify.START, 1e-7)
    ours = identify.residual([recording], [output])
    assert abs(ours.sum()) < 1e-6 * np.abs(ours).sum()
    assert by_jax == pytest.approx(ours, abs=1e-3 * np.abs(ours).max())


def _constant(errors: dict[float, list[float]], name: str = "s") -> ladder.Solver:
    """A solver of two recordings whose truth is one, with errors by rung."""

    def prepare(settings: list[float]) -> table.Solve:
        return lambda: np.array([[1.0 + errors[s][r]] for r, s in enumerate(settings)])

    return ladder.Solver(name, tuple(errors), prepare)


def test_climb_takes_the_loosest_setting_of_every_recording() -> None:
    solver = _constant({1e-1: [5e-3, 1e-5], 1e-2: [1e-4, 1e-3], 1e-3: [np.nan, 1e-7]})
    loose, middle, tight = ladder.climb(solver, np.ones((2, 1)), (1e-2, 1e-3, 1e-6))
    assert loose.settings == (1e-1, 1e-1)
    # The second recording keeps the first rung, although the next one is worse.
    assert middle.settings == (1e-2, 1e-1)
    assert middle.error == pytest.approx(1e-4)
    assert tight.settings is None
    assert tight.error == pytest.approx(1e-4)


def test_settings_are_tightened_until_their_own_run_meets_the_target() -> None:
    errors = {1e-1: [5e-3, 1.0], 1e-2: [1e-3, 1e-3], 1e-3: [1e-4, 1e-4]}

    def prepare(settings: list[float]) -> table.Solve:
        worse = 3.0 if len(set(settings)) > 1 else 1.0
        return lambda: np.array([[1.0 + worse * errors[s][r]] for r, s in enumerate(settings)])

    (choice,) = ladder.climb(ladder.Solver("s", tuple(errors), prepare), np.ones((2, 1)), (1e-2,))
    assert choice.settings == (1e-2, 1e-2)
    assert choice.error == pytest.approx(1e-3)


def test_choose_takes_the_faster_variant_and_one_that_reaches() -> None:
    def slow(settings: list[float]) -> table.Solve:
        def solve() -> np.ndarray:
            np.linalg.svd(np.ones((300, 300)))
            return np.ones((2, 1))

        return solve

    quick = _constant({1e-1: [1e-3, 1e-3]}, "quick")
    heavy = ladder.Solver("heavy", (1e-1,), slow)
    loose, tight = ladder.choose([heavy, quick], np.ones((2, 1)), (1e-2, 1e-6))
    assert loose.solver.name == "quick"
    assert tight.solver.name == "heavy"


def test_setting_tells_tolerances_from_substeps() -> None:
    solver = ladder.Solver("s", (), partial(case.march_alone, RISE), "stepping on samples")
    assert ladder.Choice(solver, 1e-4, (1e-6, 1e-4), 0.0).setting() == "tolerance 1e-06 to 1e-04, stepping on samples"
    assert ladder.Choice(_constant({}), 1e-4, (2.0, 2.0), 0.0).setting() == "2 sub-steps"
    assert ladder.Choice(solver, 1e-4, None, 0.0).setting() == ""


def test_timed_takes_turns_and_rows_relate_to_the_first_of_a_target() -> None:
    order: list[str] = []

    def contender(name: str, warm: bool) -> table.Contender:
        def solve() -> np.ndarray:
            order.append(name)
            return np.array([float(len(name))])

        return table.Contender("case", 1e-4, name, "", 1e-5, solve, warm)

    lost = table.Contender("case", 1e-4, "lost", "", 1e-3, None)
    seconds, values = table.timed([contender("a", False), contender("bb", True), lost])
    # One run more to compile; then every run that counts follows one that does not.
    assert order == ["a", "a", "bb", *["a", "a", "bb", "bb"] * table.ROUNDS]
    assert values[:2] == [np.array([1.0]), np.array([2.0])]
    assert values[2] is None
    assert np.isnan(seconds[2])
    others = table.Contender("case", 1e-5, "a", "", 1e-6, None)
    found = table.rows([contender("a", True), contender("bb", True), others], [2.0, 3.0, 4.0])
    assert found["ratio"].tolist() == [1.0, 1.5, 1.0]


def test_csv_and_picture_are_written(tmp_path: Path) -> None:
    names = ["phnn", "other"]
    contenders = [table.Contender("case", 1e-4, n, "", e, None) for n, e in zip(names, (1e-5, 2e-5), strict=True)]
    found = table.rows(contenders, [0.01, 0.05])
    table.write_csv(found, tmp_path / "new" / "forward.csv")
    read = pd.read_csv(tmp_path / "new" / "forward.csv")
    assert list(read.columns) == ["case", "target", "solver", "setting", "error", "seconds", "ratio"]
    assert read["ratio"].tolist() == [1.0, 5.0]
    table.picture(found, tmp_path / "forward.png", "title")
    assert (tmp_path / "forward.png").stat().st_size > 5000


def test_page_gets_one_line_a_solver_between_its_marks() -> None:
    contenders = [
        table.Contender("case", target, name, "", error, None)
        for target in (1e-4, 1e-5)
        for name, error in (("phnn", 0.5 * target), ("other", 3e-5))
    ]
    found = document.by_target(table.rows(contenders, [0.002, 4.0, 0.004, float("nan")]))
    assert found.columns.tolist() == ["solver", "1e-04", "1e-05"]
    assert found.to_numpy().tolist() == [
        ["phnn", "2 ms (1×)", "4 ms (1×)"],
        ["other", "4 s (2,000×)", "not reached (3e-05)"],
    ]
    assert document.markdown(pd.DataFrame({"a": ["x"], "ratio": [2.0]})) == "| a | ratio |\n| --- | ---: |\n| x | 2 |"
    first, last = document.MARKS
    page = f"head\n{first}\nold\n{last}\ntail"
    assert document.replaced(page, "new") == f"head\n{first}\n\nnew\n\n{last}\ntail"
    with pytest.raises(ValueError, match="marks"):
        document.replaced("nothing", "new")


def test_slopes_are_the_powers_of_growth() -> None:
    sizes = np.array([1e3, 1e4, 1e5, 1e6])
    # A constant cost of the call weighs on the shortest only.
    lines = [("samples", int(n), "forward", 1e-6 * n + 1e-2 * (n < 5e3)) for n in sizes]
    lines += [("hysterons", int(n), "forward", 3.0 * n**2) for n in sizes]
    found = growth.slopes(pd.DataFrame(lines, columns=["sweep", "size", "what", "seconds"]))
    assert found["slope_of_the_large"].tolist() == pytest.approx([1.0, 2.0])
    assert found["slope"][0] < 0.9


def test_growth_has_the_gradient_of_all_parameters() -> None:
    network = growth.with_cells(3)
    assert len(network.parameters) == 10
    derivatives = growth.gradient_solve(network, 50, recordings=2)()
    assert derivatives.shape == (10,)
    assert np.count_nonzero(derivatives) == 10
    assert derivatives == pytest.approx(2.0 * growth.gradient_solve(network, 50)())
    assert growth.forward_solve(network, 50, recordings=2)().shape == (2, 50)


def test_rules_for_a_leaf_are_compared_on_the_same_steps() -> None:
    exact, quick = (leaves.Run(line, 1, RISE) for line in (leaves.RULES[0], leaves.QUICK))
    midpoint = leaves.Run(leaves.RULES[2], 1, RISE)
    for run in (exact, quick, midpoint):
        run.march()
    np.testing.assert_allclose(exact.march(), quick.march(), rtol=1e-9, atol=1e-15)
    apart = np.abs(midpoint.march() - exact.march()).max()
    assert 0.0 < apart < 1e-2 * np.abs(exact.march()).max()
    # Two rules that know nothing of each other lose the same energy.
    assert leaves.dissipated(midpoint.trajectories[0]) == pytest.approx(
        leaves.dissipated(exact.trajectories[0]), rel=1e-2
    )
    assert leaves.dissipated(exact.trajectories[0]) > 0.0


def test_error_of_a_column_is_relative_to_its_peak() -> None:
    truth = np.array([[[1.0, 10.0], [2.0, -20.0]], [[0.5, 1.0], [0.25, 1.0]]])
    off = truth.copy()
    off[1, 0, 0] += 0.1
    assert leaves.worst_error(off, truth) == pytest.approx(0.1 / 0.5)
    assert leaves.worst_error(off, truth, pooled=True) == pytest.approx(0.1 / 2.0)
    off[0, 0, 0] = np.nan
    assert leaves.worst_error(off, truth) == np.inf
