"""What warming up looks like: a gain that drifts with the dissipated power and recovers at rest."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from junctions import march
from numpy.typing import NDArray

from phnn.models.variants import thermal_hrc
from phnn.simulate import Trajectory

torch.set_num_threads(1)
Array = NDArray[np.float64]


def driven(seconds: float, frequency: float, h: float, amplitude: float = 75.0) -> tuple[Array, Array]:
    """Inputs and steps of a sine."""
    n = round(seconds / h)
    t = h * (np.arange(n) + 0.5)
    u = np.zeros((n, 2))
    u[:, 0] = amplitude * np.sin(2 * np.pi * frequency * t)
    return u, np.full(n, h)


def gains(amplitude: float, frequency: float, periods: int, values: dict[str, float]) -> tuple[Array, Trajectory]:
    """Amplitude of the displacement in every period of a sine."""
    per_period = 1000
    u, h = driven(periods / frequency, frequency, 1.0 / (per_period * frequency), amplitude)
    run = march(thermal_hrc(2, values), u, h, np.zeros(5))
    q = run.states[1:, 2].reshape(periods, per_period)
    return 0.5 * np.ptp(q, axis=1), run


def drift(amplitude: float, frequency: float, **values: float) -> float:
    """Growth of the gain per second, relative to the same actuator at constant temperature."""
    coefficients = {"kappa_alpha": 1e-3, "kappa_rho": 0.0, "kappa_d": 0.0}
    thermal = {"C_T": 0.02, "R_T": 1e4}
    warm, _ = gains(amplitude, frequency, 40, coefficients | thermal | values)
    cold, _ = gains(amplitude, frequency, 40, coefficients | thermal | values | {"kappa_alpha": 0.0})
    return float((warm[-1] / cold[-1] - 1.0) * frequency / 40.0)


def test_gain_drifts_with_dissipated_power() -> None:
    # Without dead zones hysterons are linear: what they lose grows with the square of the amplitude.
    linear = {"d_1": 1e-9, "d_2": 1e-9}
    assert drift(40.0, 20.0, **linear) == pytest.approx(4.0 * drift(20.0, 20.0, **linear), rel=0.02)
    # Far below their relaxation dead zones lose the same in every cycle, so that power grows with frequency.
    slow = {"rho_2": 0.1, "b": 1.0}
    assert drift(75.0, 10.0, **slow) == pytest.approx(2.0 * drift(75.0, 5.0, **slow), rel=0.05)


def test_gain_recovers_at_rest() -> None:
    values = {"C_T": 1e-3, "R_T": 200.0, "kappa_alpha": 1e-3, "kappa_rho": 0.0, "kappa_d": 0.0}
    _, run = gains(75.0, 100.0, 60, values)
    hot = float(run.states[-1, 4])
    # Two time constants R_T C_T = 0.2 s at rest, and the same sine again.
    u, h = driven(0.03, 100.0, 5e-5)
    pause, waiting = np.zeros((4000, 2)), np.full(4000, 1e-4)
    again = march(run.setup.network, np.vstack([pause, u]), np.concatenate([waiting, h]), run.states[-1])
    assert again.states[4000, 4] == pytest.approx(hot * np.exp(-2.0), rel=0.05)
    # The charges that the first sine has left stay what they are, whatever the temperature.
    cold = march(run.setup.network, u, h, np.append(again.states[4000, :4], 0.0))
    straight = march(run.setup.network, u, h, np.append(again.states[4000, :4], hot))
    cooled, first, warm = (np.ptp(r.states[-200:, 2]) for r in (again, cold, straight))
    assert 0.0 < cooled / first - 1.0 < 0.25 * (warm / first - 1.0)
