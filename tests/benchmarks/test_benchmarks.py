"""The benchmarks' own parts: all import, the reference is right, and the peers solve the same case."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import numpy as np
import pytest

# Benchmarks are not installed with the package.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
_BEFORE = dict(os.environ)
case, reference, ladder, peers_scipy, *_ = (
    importlib.import_module(f"benchmarks.{name}")
    for name in ("case", "reference", "ladder", "peers_scipy", "peers_torch", "table", "growth", "document", "leaves")
)
# The benchmarks limit the threads of their own process; other tests keep theirs.
os.environ.clear()
os.environ.update(_BEFORE)

# The rise of 100 Hz, in which both hysterons begin to slip.
RISE = (case.sine(100.0, 251),)


@pytest.fixture(scope="module")
def truth() -> tuple[np.ndarray, np.ndarray]:
    """(1, 251) displacements and (1, 251, 10) derivatives of the rise."""
    q, by = reference.solved(RISE[0], case.TRUTH, 1e-6)
    return q[None], by[None]


def test_march_meets_the_reference_with_second_order(truth: tuple[np.ndarray, np.ndarray]) -> None:
    one, two = (ladder.relative_errors(case.march_alone(RISE, [s])(), truth[0])[0] for s in (1, 2))
    assert one < 5e-5
    assert two < 0.4 * one


@pytest.mark.slow
def test_all_gradients_are_the_slope_of_the_cost(truth: tuple[np.ndarray, np.ndarray]) -> None:
    wanted = 1.1 * truth[0]
    swept, adjoint = (make(RISE, [1], wanted)()[0] for make in (case.swept_gradient, case.adjoint_gradient))
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


def test_scipy_solves_the_same_case(truth: tuple[np.ndarray, np.ndarray]) -> None:
    for path in (peers_scipy.radau, peers_scipy.lsoda, peers_scipy.lsoda_on_samples):
        found = path(RISE[0], case.TRUTH, 1e-8)
        assert ladder.relative_errors(found[None], truth[0])[0] < 1e-5


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
