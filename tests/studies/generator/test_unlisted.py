"""Effects outside any catalogue: they act, they vanish, and they obey what is known of them."""

from __future__ import annotations

import numpy as np
import pytest
from concealments import moves_and_vanishes

from studies.generator.actuator import TABLE, simulate
from studies.generator.excitation import sine, step
from studies.generator.listed import LISTED
from studies.generator.plans import plan_of
from studies.generator.unlisted import UNLISTED, UNLISTED_LOCATIONS

PLAN = plan_of("short")
UNSLIPPED = {**TABLE, "d_1": 1e4, "d_2": 1e4}


@pytest.mark.parametrize("name", UNLISTED)
def test_it_changes_the_output_and_vanishes_with_its_strength(name: str) -> None:
    effect = UNLISTED[name](np.random.default_rng(1), TABLE, PLAN)
    assert effect.name == name
    assert name in UNLISTED_LOCATIONS and name not in LISTED
    moves_and_vanishes(effect, PLAN)


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


def test_a_damper_of_one_direction_is_a_damper_of_both_for_what_goes_forwards() -> None:
    rise = step(amplitude=10.0, before=0.01, hold=0.05, after=0.01)
    overdamped, before_it_falls = {**UNSLIPPED, "b": 100.0}, slice(0, round(0.05 / rise.dt))
    one, both = (simulate({**overdamped, **more}, rise) for more in ({"kappa_f": 0.5}, {"b": 150.0}))
    assert np.all(np.diff(both[before_it_falls]) >= -1e-15)
    np.testing.assert_allclose(one[before_it_falls], both[before_it_falls], atol=1e-12)
    assert np.max(np.abs(one - both)) > 1e-7


def test_an_amplifier_with_a_dead_band_gives_less_of_either_sign_and_nothing_of_little() -> None:
    for sign in (1.0, -1.0):
        hold, less = (step(amplitude=sign * a, before=0.01, hold=0.1, after=0.01) for a in (7.0, 6.0))
        np.testing.assert_allclose(simulate({**TABLE, "delta_V": 1.0}, hold), simulate(TABLE, less), atol=1e-12)
    weak = sine(10.0, amplitude=0.9, periods=1, samples=500)
    assert np.all(simulate({**TABLE, "delta_V": 1.0}, weak) == 0.0)


def test_a_clock_that_runs_fast_is_early() -> None:
    drive = sine(10.0, periods=2, samples=1000)
    q, early = simulate(TABLE, drive), simulate({**TABLE, "kappa_t": 0.01}, drive)
    np.testing.assert_allclose(early, np.interp(0.99 * drive.t, drive.t, q), atol=1e-4 * np.ptp(q))
