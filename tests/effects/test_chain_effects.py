"""What effects of the measuring chain do to a recording, each against what is known of it in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from junctions import recording

from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.effects import Scales, effect
from phnn.errors import InputRefused, SolverFailed
from phnn.models.actuator import from_paper, hrc
from phnn.models.network_file import load_network
from phnn.recordings.recording import Recording, Start
from phnn.setup import Setup
from phnn.trajectory import simulate

BASE = Setup(from_paper())
SCALES = Scales(
    voltage=75.0, displacement=1.2e-4, velocity=0.1, stiffness=24579.0, transducer=0.046, slowest=2.0,
    fastest=150.0, duration=0.5, noise=5e-8,
)  # fmt: skip


def sine(amplitude: float = 75.0, offset: float = 0.0, start: Start | None = None) -> Recording:
    t = np.arange(401) * 1e-4
    return recording(t, offset + amplitude * np.sin(2.0 * np.pi * 50.0 * t), start)


def with_effect(name: str, values: dict[str, float], setup: Setup = BASE) -> Setup:
    return effect(name).add_to(setup, values)


def moved(y: np.ndarray, base: np.ndarray) -> np.ndarray:
    """A change of the output without the zero of the displacement."""
    return y - base - (y - base).mean()


@pytest.mark.parametrize("start", [Start("rest", 0.0), Start("rest", 15.0), Start("unknown")])
def test_an_offset_of_the_amplifier_is_a_zero_of_the_plain_actuator_and_no_more(start: Start) -> None:
    run = sine(offset=15.0 if start.input_before else 0.0, start=start)
    base, shifted = simulate(BASE, run).y, simulate(with_effect("amplifier_offset", {"V_0": 8.0}), run).y
    size = np.abs(base).max()
    assert np.abs(shifted - base).min() > 1e-2 * size
    np.testing.assert_allclose(moved(shifted, base), 0.0, atol=1e-9 * size)
    # To first order as well, from rest without an input on.
    column = output_derivatives(simulate(with_effect("amplifier_offset", {"V_0": 0.0}), run), ["V_0"])[:, 0]
    np.testing.assert_allclose(column, 0.046311 / 24579.0, rtol=1e-6)


def test_an_offset_has_no_rest_without_a_spring() -> None:
    free = Setup(load_network(config_folder() / "network" / "mass_damper.yaml"))
    t = np.arange(50) * 1e-3
    at_rest, unknown = (recording(t, np.sin(30.0 * t), Start(state)) for state in ("rest", "unknown"))
    pushed = with_effect("amplifier_offset", {"V_0": 1.0}, free)
    with pytest.raises(SolverFailed, match="nothing holds"):
        simulate(pushed, at_rest)
    with pytest.raises(SolverFailed, match="nothing holds"):
        output_derivatives(simulate(with_effect("amplifier_offset", {"V_0": 0.0}, free), at_rest), ["V_0"])
    # Where the initial state is given, nothing need rest.
    column = output_derivatives(simulate(pushed, unknown, initial=np.zeros(2)), ["V_0"])[:, 0]
    ends = [simulate(pushed.with_values({"V_0": 1.0 + s}), unknown, initial=np.zeros(2)).y for s in (1e-4, -1e-4)]
    np.testing.assert_allclose(column, (ends[0] - ends[1]) / 2e-4, atol=1e-4 * np.abs(column).max())


def test_a_delay_of_the_voltage_is_a_delay_of_the_output() -> None:
    # Seven samples: the delayed output is the earlier one.
    base, late = simulate(BASE, sine()).y, simulate(with_effect("delay", {"tau_d": 7e-4}), sine()).y
    np.testing.assert_allclose(late[7:], base[:-7], atol=1e-6 * np.abs(base).max())
    assert (late[:8] == 0.0).all()


def test_a_linear_lag_before_and_behind_a_linear_network_are_one() -> None:
    linear = Setup(hrc(0))
    before = simulate(with_effect("amplifier_lowpass", {"tau_a": 1e-3}, linear), sine(), substeps=16).y
    behind = simulate(with_effect("sensor_lag", {"tau_y": 1e-3}, linear), sine(), substeps=16).y
    np.testing.assert_allclose(behind, before, atol=1e-3 * np.abs(before).max())


def test_a_slew_limit_acts_above_a_product_of_amplitude_and_frequency() -> None:
    limit = {"S": 2.0 * np.pi * 50.0 * 40.0}
    base, slow = simulate(BASE, sine(39.0)).y, simulate(with_effect("slew_limit", limit), sine(39.0)).y
    np.testing.assert_allclose(slow, base, atol=1e-9 * np.abs(base).max())
    base, slow = simulate(BASE, sine(60.0)).y, simulate(with_effect("slew_limit", limit), sine(60.0)).y
    assert np.abs(slow - base).max() > 0.05 * np.abs(base).max()


def test_the_sensors_act_on_what_the_network_puts_out() -> None:
    q = simulate(BASE, sine()).y
    bent = simulate(with_effect("sensor_nonlinearity", {"a_2": 500.0, "a_3": -3e6}), sine()).y
    np.testing.assert_allclose(bent, q + 500.0 * q**2 - 3e6 * q**3, rtol=1e-12)
    np.testing.assert_array_equal(simulate(with_effect("sensor_rectification", {}), sine()).y, np.abs(q))
    played = simulate(with_effect("output_backlash", {"delta_b": 2e-6}), sine()).y
    assert (np.abs(played - q) <= 2e-6 * (1.0 + 1e-9)).all()
    # The plateau after the first peak is as high as the peak less the width.
    peak = int(np.argmax(q))
    np.testing.assert_allclose(played[peak + 1], q[peak] - 2e-6, atol=1e-3 * q[peak])
    assert np.ptp(played[peak + 1 : peak + 5]) < 1e-14


def test_what_has_no_sign_cannot_lose_it_again() -> None:
    rectified = with_effect("sensor_rectification", {})
    assert effect("sensor_rectification").can_be_added_to(BASE)
    with pytest.raises(InputRefused, match=r"it can be where this holds: No block of the sensor rectifies already"):
        effect("sensor_rectification").add_to(rectified, {})


def test_base_motion_is_probed_in_both_phases_at_a_frequency_to_be_searched() -> None:
    member = effect("base_motion")
    points = member.grid(SCALES)
    assert member.searched == "f_b"
    assert [(p["A_c"] == 0.0, p["A_s"] == 0.0) for p in points] == [(False, True), (True, False)]


def test_base_motion_needs_a_mass() -> None:
    assert effect("base_motion").can_be_added_to(BASE)
    assert not effect("base_motion").can_be_added_to(with_effect("base_motion", effect("base_motion").grid(SCALES)[0]))


def test_play_is_probed_from_below_the_noise_to_a_share_of_the_displacement() -> None:
    widths = [p["delta_b"] for p in effect("output_backlash").grid(SCALES)]
    np.testing.assert_allclose([widths[0], widths[-1]], [1.5e-8, 3.6e-6])
    assert widths == sorted(widths)


def test_pickup_adds_lines_and_nothing_to_the_simulation() -> None:
    noisy = with_effect("mains_pickup", {"f_m": 60.0})
    assert noisy.own.lines == (60.0, 120.0, 180.0)
    assert "f_m" not in noisy.free
    assert noisy.with_values({"k": 2e4}).own.lines == noisy.own.lines
    np.testing.assert_array_equal(simulate(noisy, sine()).y, simulate(BASE, sine()).y)
