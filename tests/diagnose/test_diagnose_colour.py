"""The noise that scores are judged with, against matrices written out and noise of known colour."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from phnn.diagnose.colour import Colour
from phnn.diagnose.ground import Ground
from phnn.diagnose.residual_noise import doubt, first_order_of
from tests import campaigns


def with_residual(ground: Ground, residual: np.ndarray) -> Ground:
    """The ground with another residual, of which the base explains nothing."""
    nothing = np.zeros((residual.size, 0))
    return replace(ground, fit=replace(ground.fit, residual=residual, jacobian=nothing))


def test_stated_correlation_is_a_symmetric_band_within_a_recording() -> None:
    ground = campaigns.ground()
    rho = np.array([1.0, 0.5, 0.2])
    recordings = tuple(replace(r, noise_correlation=rho) for r in ground.plan.recordings)
    fitted = replace(ground.fit, plan=replace(ground.fit.plan, recordings=recordings))
    edge = ground.slices[0].stop
    colour = Colour(replace(ground, fit=fitted))
    for lag, expected in [(1, 3.0), (2, 2.4), (3, 2.0)]:
        pairs = np.zeros((ground.fit.residual.size, 2))
        # Another recording has noise of its own.
        pairs[[10, 10 + lag], 0] = pairs[[edge - 1, edge - 1 + lag], 1] = 1.0
        np.testing.assert_allclose(colour.stated(pairs), [expected, 2.0])


def test_what_is_left_is_first_order_noise_within_a_recording() -> None:
    ground = campaigns.ground()
    n = ground.fit.residual.size
    rng = np.random.default_rng(0)
    ground = with_residual(ground, lfilter([1.0], [1.0, -0.6], 3.0 * rng.standard_normal(n)))
    columns = rng.standard_normal((n, 2))
    expected = []
    for rows in ground.slices:
        power, a = first_order_of(ground.residual[rows])
        expected.append(power * toeplitz(a ** np.arange(rows.stop - rows.start)) @ columns[rows])
    np.testing.assert_allclose(Colour(ground).left(columns), columns.T @ np.concatenate(expected), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("a", [0.0, 0.4, 0.8])
def test_colour_of_known_noise(a: float) -> None:
    noise = lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], np.random.default_rng(1).standard_normal(20_000))
    power, found = first_order_of(2.0 * noise)
    assert power == pytest.approx(4.0, rel=0.05)
    assert found == pytest.approx(a, abs=0.02)
    assert a > 0.0 or found == 0.0


def test_doubt_never_sharpens_and_never_blinds() -> None:
    np.testing.assert_allclose(doubt(np.array([0.1, 2.25, 1e6]), np.ones(3)), [1.0, 1.5, 2.0])
