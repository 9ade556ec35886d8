"""What every memory law owes: an affine rate, whose exact flow the step takes, and heat that adds up."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phnn.laws import MEMORY_LAWS, MemoryLaw
from phnn.laws.other import advanced, average

POINTS = np.array([-2.3, -0.71, -0.0021, 0.0017, 0.83, 1.9])
every = pytest.mark.parametrize("law", MEMORY_LAWS.values(), ids=MEMORY_LAWS.keys())
HOLDING = [law for law in MEMORY_LAWS.values() if law.heat is not None]


@every
def test_rate_is_affine_with_the_slope_of_the_decay(law: MemoryLaw) -> None:
    z, drive = POINTS, np.roll(POINTS, 1)
    decay = law.decay(*law.example)
    assert decay > 0.0
    expected = law.rate(0.0 * z, drive, *law.example) - decay * z
    np.testing.assert_allclose(law.rate(z, drive, *law.example), expected, rtol=1e-12, atol=1e-13)


@every
@pytest.mark.parametrize("h", [1e-6, 0.3, 40.0])
def test_step_is_the_flow_and_its_mean(law: MemoryLaw, h: float) -> None:
    z, drive = 1.7, -0.9
    rate, decay = law.rate(z, drive, *law.example), law.decay(*law.example)

    def flow(t: float, y: np.ndarray) -> list[float]:
        return [law.rate(y[0], drive, *law.example), y[0]]

    exact = solve_ivp(flow, (0.0, h), [z, 0.0], "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    assert advanced(z, h, rate, decay) == pytest.approx(exact[0], rel=1e-10, abs=1e-10)
    assert average(z, h, rate, decay) == pytest.approx(exact[1] / h, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("law", HOLDING, ids=lambda law: law.name)
def test_heat_is_what_the_drive_leaves(law: MemoryLaw) -> None:
    a, b, heat = POINTS, np.roll(POINTS, 1), law.heat
    assert heat is not None
    reference = law.example[3]
    # U' ż = s − q, and dS = dU/T with the logarithmic mean of the temperatures between two states.
    slope = heat.energy(1.0, *law.example) - heat.energy(0.0, *law.example)
    np.testing.assert_allclose(slope * law.rate(a, 0.4, *law.example), 0.4 - heat.flow(a, *law.example), rtol=1e-12)
    mean = (b - a) / np.log((reference + b) / (reference + a))
    received = heat.energy(b, *law.example) - heat.energy(a, *law.example)
    np.testing.assert_allclose(heat.entropy(a, b, *law.example), received / mean, rtol=1e-9)
    assert heat.flow(heat.ambient(*law.example) - reference, *law.example) == 0.0


def test_only_what_lies_beyond_the_threshold_is_remembered() -> None:
    law = MEMORY_LAWS["exceeding"]
    assert law.rate(0.0, 0.49, 0.8, 0.5) == law.rate(0.0, -0.49, 0.8, 0.5) == 0.0
    assert law.rate(0.0, -1.0, 0.8, 0.5) == law.rate(0.0, 1.0, 0.8, 0.5) == pytest.approx(1.0 / 0.8)
