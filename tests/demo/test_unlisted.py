"""Effects outside any catalogue: they act, they vanish, and they obey what is known of them."""

from __future__ import annotations

import numpy as np
import pytest
from concealments import moves_and_vanishes

from phnn.demo.actuator import TABLE, simulate, simulate_all
from phnn.demo.excitation import sine, step
from phnn.demo.listed import LISTED
from phnn.demo.plans import plan_of
from phnn.demo.unlisted import UNLISTED, UNLISTED_LOCATIONS

PLAN = plan_of("short")
UNSLIPPED = {**TABLE, "d_1": 1e4, "d_2": 1e4}


@pytest.mark.parametrize("name", UNLISTED)
def test_it_changes_the_output_and_vanishes_with_its_strength(name: str) -> None:
    effect = UNLISTED[name](np.random.default_rng(1), TABLE, PLAN)
    assert effect.name == name
    assert name in UNLISTED_LOCATIONS and name not in LISTED
    moves_and_vanishes(effect, PLAN, simulate_all(TABLE, PLAN))


def test_curved_capacitors_hold_the_charge_that_flowed() -> None:
    kappa = 1e-3
    hold = step(amplitude=60.0, before=0.01, hold=0.2, after=0.01)
    q = simulate({**UNSLIPPED, "kappa_C": kappa}, hold)[round(0.2 / hold.dt)]
    efforts = (75.0 * 0.8 * TABLE["alpha"] - TABLE["k"] * q) / TABLE["alpha"]
    total = 0.0
    for c in (TABLE["C_1"], TABLE["C_2"]):
        roots = np.roots([kappa, 0.0, 1.0, -TABLE["alpha"] * q / c])
        total += float(np.real(roots[np.argmin(np.abs(np.imag(roots)))]))
    assert total == pytest.approx(efforts, rel=1e-6)
    assert total < 0.97 * TABLE["alpha"] * q * (1 / TABLE["C_1"] + 1 / TABLE["C_2"])


def test_a_coarse_converter_holds_its_nearest_level() -> None:
    drive = sine(10.0, amplitude=10.0, periods=1, samples=500)
    assert np.all(simulate({**TABLE, "Delta_u": 20.1}, drive) == 0.0)
    hold = step(amplitude=7.0, before=0.01, hold=0.1, after=0.01)
    rounded = step(amplitude=6.0, before=0.01, hold=0.1, after=0.01)
    held = simulate({**TABLE, "Delta_u": 3.0}, hold)
    np.testing.assert_allclose(held, simulate(TABLE, rounded), atol=1e-5 * np.max(held))


def test_gain_grows_with_time_and_stiffness_with_the_phase() -> None:
    drive = sine(10.0, periods=2, samples=500)
    q = simulate(TABLE, drive)
    np.testing.assert_allclose(simulate({**TABLE, "kappa_y": 0.3}, drive), q * (1.0 + 0.1 * drive.t), rtol=1e-12)
    stiff = simulate({**TABLE, "kappa_p": 0.1, "f_p": 0.0, "phi_p": 0.5 * np.pi}, drive)
    np.testing.assert_allclose(stiff, simulate({**TABLE, "k": 1.1 * TABLE["k"]}, drive), atol=1e-12)


def test_a_damper_that_grows_with_the_displacement_takes_more_energy() -> None:
    drive = sine(150.0)
    values = {**UNSLIPPED, "kappa_b": 5.0}
    assert np.ptp(simulate(values, drive)) < np.ptp(simulate(UNSLIPPED, drive))
    # Where the displacement is small it is the damper of the paper.
    small = sine(150.0, amplitude=0.1)
    np.testing.assert_allclose(simulate(values, small), simulate(UNSLIPPED, small), rtol=1e-4, atol=1e-13)
