"""Operators against closed forms, and the dynamics behind them."""

from __future__ import annotations

import numpy as np
import pytest
from rival_example import DT, second_order, sweep
from scipy.integrate import solve_ivp

from studies.rival_models.dynamics import Dynamics, filtered
from studies.rival_models.operators import Dahl, Operator, Plays, Preisach, played

# Up to 1, down to −1, up to 1: branches of a triangle.
TRIANGLE = np.concatenate(
    [np.linspace(0.0, 1.0, 101), np.linspace(1.0, -1.0, 201)[1:], np.linspace(-1.0, 1.0, 201)[1:]]
)
BRANCHES = np.repeat([0, 1, 2], [101, 200, 200])


def closed_play(u: np.ndarray, r: float) -> np.ndarray:
    """The play of radius ``r`` on the triangle's branches, from zero."""
    rising, falling = np.maximum(u - r, -(1.0 - r)), np.minimum(u + r, 1.0 - r)
    return np.where(BRANCHES == 0, np.maximum(u - r, 0.0), np.where(BRANCHES == 1, falling, rising))


def test_plays_on_a_triangle() -> None:
    operator = Plays(4)
    state = operator.rest(operator.start, 0.0)
    columns, _ = operator.run(operator.start, state, TRIANGLE, np.zeros(TRIANGLE.size))
    assert np.allclose(columns[:, 0], TRIANGLE)
    for i, r in enumerate((0.0, 0.2, 0.4, 0.6, 0.8)):
        assert np.allclose(columns[:, 1 + i], closed_play(TRIANGLE, r), atol=1e-12)


def test_thresholds_grow_with_the_rate() -> None:
    operator, rates = Plays(1, rate=True), np.full(TRIANGLE.size, 0.5)
    shape = np.array([0.4])
    columns, _ = operator.run(shape, operator.rest(shape, 0.0), TRIANGLE, rates)
    assert np.allclose(columns[:, 1], closed_play(TRIANGLE, 0.2), atol=1e-12)
    assert np.allclose(columns[:, 2], closed_play(TRIANGLE, 0.7), atol=1e-12)


@pytest.mark.parametrize("envelope", ["tanh", "cubic"])
def test_an_envelope_without_curvature_is_the_input(envelope: str) -> None:
    flat = {"tanh": np.array([np.log(1e-4), 0.0, 0.0]), "cubic": np.zeros(3)}[envelope]
    operator = Plays(2, envelope)
    columns, _ = operator.run(flat, operator.rest(flat, 0.0), TRIANGLE, np.zeros(TRIANGLE.size))
    assert np.allclose(columns[:, 2], closed_play(TRIANGLE, 1.0 / 3.0), atol=1e-6)


def test_a_single_relay_is_a_play_above_its_middle() -> None:
    """Up at α = s + r = 0.5, down at β = s − r = −0.3, from below."""
    r, s = 0.4, 0.1
    p = played(np.zeros(1), TRIANGLE, TRIANGLE, np.full((TRIANGLE.size, 1), r))[:, 0]
    up, expected = False, []
    for x in TRIANGLE:
        up = True if x > 0.5 + 1e-9 else False if x < -0.3 - 1e-9 else up
        expected.append(up)
    off_edge = np.abs(TRIANGLE - 0.5) > 1e-6
    off_edge &= np.abs(TRIANGLE + 0.3) > 1e-6
    assert ((p > s + 1e-9) == np.array(expected))[off_edge].all()
    assert any(expected) and not all(expected[200:])


def test_preisach_of_uniform_weights_on_a_line_is_its_play() -> None:
    operator = Preisach(5, 10)
    shape = operator.start
    columns, _ = operator.run(shape, operator.rest(shape, 0.0), TRIANGLE, np.zeros(TRIANGLE.size))
    first = 0
    for r in operator.radii:
        count = max(1, round(10 * (1.0 - r)))
        line = columns[:, first : first + count].sum(axis=1) * 2.0 * (1.0 - r) / count
        assert np.allclose(line - line[0], closed_play(TRIANGLE, r), atol=1e-12)
        first += count
    assert first == columns.shape[1]


def test_dahl_is_the_solution_of_its_equation() -> None:
    operator, shape = Dahl(1, 1), np.log([0.4])
    columns, _ = operator.run(shape, operator.rest(shape, 0.0), TRIANGLE, np.zeros(TRIANGLE.size))
    z, start = [], 0.0
    for side, first, last in ((1.0, 0, 100), (-1.0, 100, 300), (1.0, 300, 500)):
        span = np.abs(TRIANGLE[first : last + 1] - TRIANGLE[first])
        found = solve_ivp(
            lambda _, x, s=side: (s - x) / 0.4, (0.0, span[-1]), [start], t_eval=span, rtol=1e-10, atol=1e-12
        )
        z.append(found.y[0][0 if first == 0 else 1 :])
        start = found.y[0][-1]
    assert np.allclose(columns[:, 1], np.concatenate(z), atol=1e-8)


@pytest.mark.parametrize("operator", [Plays(3, "cubic", True), Preisach(4, 6), Dahl(3, 2, True)])
def test_a_recording_in_pieces_is_the_whole(operator: Operator) -> None:
    u, shape = sweep(1.0, 2.0, 20.0), operator.start
    rates = np.abs(np.diff(u, prepend=0.0))
    whole, _ = operator.run(shape, operator.rest(shape, 0.0), u, rates)
    head, state = operator.run(shape, operator.rest(shape, 0.0), u[:250], rates[:250])
    tail, _ = operator.run(shape, state, u[250:], rates[250:])
    assert np.array_equal(whole, np.concatenate([head, tail]))


def test_dynamics_against_state_space() -> None:
    u = sweep(1.0, 2.0, 20.0)
    b, a = Dynamics(0, 100.0).filter(np.array([np.log(1.5), np.log(0.3), 0.0]), DT, held=False)
    assert np.allclose(filtered(b, a, u[:, None], np.zeros(1))[:, 0], second_order(u), atol=1e-10)


@pytest.mark.parametrize("held", [False, True])
def test_dynamics_rest_at_a_constant_input(held: bool) -> None:
    b, a = Dynamics(2, 100.0).filter(np.array([0.3, -1.0, 0.4, 1.0, 0.7, 4.0, 0.2]), DT, held)
    assert np.allclose(filtered(b, a, np.full((50, 1), 2.0), np.array([2.0])), 2.0, rtol=1e-8)
