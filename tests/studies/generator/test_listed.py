"""Every listed effect that a case can conceal: it acts, it vanishes, and it obeys what is known of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from concealments import moves_and_vanishes
from scipy.signal import lsim, lti

from studies.generator.actuator import TABLE, simulate
from studies.generator.concealed import described
from studies.generator.excitation import Excitation, Piece, sine, step
from studies.generator.listed import ALIKE, LISTED, LOCATIONS, drawn, may_be_paired
from studies.generator.plans import plan_of
from studies.generator.sensor import play

PLAN = plan_of("short")
# As far as the hysterons do not slip they are capacitors, and the actuator is linear.
UNSLIPPED = {**TABLE, "d_1": 1e4, "d_2": 1e4}
STIFFNESS = TABLE["k"] + TABLE["alpha"] ** 2 * (1 / TABLE["C_1"] + 1 / TABLE["C_2"])


@pytest.mark.parametrize("name", LISTED)
def test_it_changes_the_output_and_vanishes_with_its_strength(name: str) -> None:
    effect = drawn(name, np.random.default_rng(1), TABLE, PLAN)
    assert effect.name == name
    moves_and_vanishes(effect, PLAN)


def _gain(values: dict[str, float], drive: Excitation) -> complex:
    """Complex amplitude of the last period at the frequency of the drive, over that of the voltage."""
    y, frequency = simulate(values, drive), drive.pieces[0].frequency
    last = drive.t >= drive.pieces[-1].end - 1.0 / frequency - 0.5 * drive.dt
    wave = np.exp(-2j * math.pi * frequency * drive.t[last])
    return complex(np.sum(y[last] * wave) / np.sum(drive.voltage(drive.t)[last] * wave))


SETTLED = sine(50.0, periods=8, samples=8 * 400)


def test_delay_turns_the_phase_and_a_lag_lowers_the_gain_too() -> None:
    tau, omega = 3e-4, 2.0 * math.pi * 50.0
    plain = _gain(UNSLIPPED, SETTLED)
    assert _gain({**UNSLIPPED, "tau_d": tau}, SETTLED) / plain == pytest.approx(np.exp(-1j * omega * tau), rel=1e-5)
    assert _gain({**UNSLIPPED, "tau_y": tau}, SETTLED) / plain == pytest.approx(
        1.0 / (1.0 + 1j * omega * tau), rel=1e-5
    )


def test_delayed_steps_are_the_step_later() -> None:
    whole = 4  # samples
    drive = step(before=0.01, hold=0.03, after=0.02)
    late = simulate({**TABLE, "tau_d": whole * drive.dt}, drive)
    np.testing.assert_allclose(late[whole:], simulate(TABLE, drive)[:-whole], atol=1e-11)


def test_slew_limit_makes_a_triangle_of_a_steep_sine_and_leaves_a_flat_one() -> None:
    # Followed quasi-statically, in which the displacement shows the voltage itself.
    values = {**UNSLIPPED, "m": 1e-9, "b": 1e-3}
    drive = sine(50.0, amplitude=10.0, periods=12, samples=12_000)
    steepest = 2.0 * math.pi * 50.0 * 10.0
    plain = simulate(values, drive)
    np.testing.assert_allclose(simulate({**values, "S": 1.01 * steepest}, drive), plain, atol=1e-5 * np.ptp(plain))
    slow = simulate({**values, "S": 0.2 * steepest}, drive)[11_000:]
    slopes = np.abs(np.diff(slow)) / drive.dt * STIFFNESS / TABLE["alpha"]
    assert np.median(slopes) == pytest.approx(0.2 * steepest, rel=1e-3)
    assert np.ptp(slow) * STIFFNESS / TABLE["alpha"] == pytest.approx(0.2 * steepest / 100.0, rel=1e-2)


def test_play_keeps_its_width_and_holds_after_reversals() -> None:
    q = 3.0 * np.sin(np.linspace(0.0, 12.0, 4001))
    y = play(q, 0.5)
    assert np.max(np.abs(q - y)) <= 0.5 + 1e-12
    assert (np.max(y), np.min(y)) == pytest.approx((2.5, -2.5), abs=1e-5)
    assert np.all(play(q, 3.1) == 0.0)
    turned = np.flatnonzero(np.diff(np.sign(np.diff(q))))[0]
    falls = np.argmax(y[turned:] < y[turned] - 1e-12) + turned
    assert q[turned] - q[falls] == pytest.approx(1.0, abs=0.01)


def test_backlash_turns_where_the_displacement_does_not_where_it_is_sampled() -> None:
    coarse = Excitation("coarse", sine(150.0, periods=3).pieces, 1e-3, 20)
    half = 2e-6
    dense = Excitation("dense", coarse.pieces, 2e-6, 10_000)
    expected = play(simulate(TABLE, dense), half)[::500]
    np.testing.assert_allclose(simulate({**TABLE, "delta_b": half}, coarse), expected[:20], atol=2e-9)


def test_curved_sensor_is_a_polynomial() -> None:
    drive = sine(10.0, periods=1, samples=200)
    q = simulate(TABLE, drive)
    y = simulate({**TABLE, "a_2": 50.0, "a_3": -4e5}, drive)
    np.testing.assert_allclose(y, q + 50.0 * q**2 - 4e5 * q**3, rtol=1e-12)


def _slowly_raised(effect: dict[str, float]) -> float:
    quarter = sine(0.2, periods=1, samples=200)
    return float(simulate({**TABLE, **effect}, quarter)[50])


HALF_WIDTHS = 0.5 * (TABLE["d_1"] + TABLE["d_2"])


def test_quadratic_stiffness_balances_the_force() -> None:
    q = _slowly_raised({"kappa_2": -0.3})
    s = q / 1e-4
    force = TABLE["k"] * q * (1 - 0.3 * s + 0.03 * s**2)
    assert force == pytest.approx(TABLE["alpha"] * (75.0 - HALF_WIDTHS), rel=2e-4)


def test_coupling_follows_the_displacement() -> None:
    q = _slowly_raised({"kappa_a": 0.1})
    force = TABLE["alpha"] * (1 + 0.1 * q / 1e-4) * (75.0 - HALF_WIDTHS)
    assert TABLE["k"] * q == pytest.approx(force, rel=2e-4)


def test_leaked_hysterons_let_the_actuator_go_to_its_spring() -> None:
    hold = step(amplitude=10.0, before=0.01, hold=1.0, after=0.01)
    q = simulate({**TABLE, "G": 1e-4}, hold)
    assert q[round(1.0 / hold.dt)] == pytest.approx(TABLE["alpha"] * 10.0 / TABLE["k"], rel=1e-4)


def test_thresholds_that_follow_the_velocity_widen_the_loop_at_high_frequency_only() -> None:
    for frequency, least, most in ((1.0, 0.0, 5e-3), (100.0, 3e-2, 1.0)):
        drive = sine(frequency, periods=2, samples=2000)
        moved = simulate({**TABLE, "kappa_v": 10.0}, drive) - simulate(TABLE, drive)
        assert least <= np.max(np.abs(moved)) / 1e-4 < most


def test_depolarised_after_a_high_field_it_moves_less_and_recovers() -> None:
    up = (Piece(0.0, 0.2, level=20.0), Piece(0.2, 0.6, level=60.0), Piece(0.6, 3.0, level=20.0))
    drive = Excitation("field", up, 1e-3, 2999)
    q = simulate({**UNSLIPPED, "delta_z": 0.1, "tau_z": 0.1, "V_c": 40.0}, drive)
    plain = simulate(UNSLIPPED, drive)
    before, at, after = 195, 595, 2990
    assert q[before] == pytest.approx(plain[before], rel=1e-9)
    # z has settled at 60/40 − 1. Charge that flowed at another α stays: force balance with Q_i = ∫ α v.
    assert q[at] < 0.97 * plain[at]
    assert q[after] == pytest.approx(plain[after], rel=3e-2)


def test_a_second_mass_is_the_linear_system_of_two_masses() -> None:
    m_2, k_2, b_2 = 1e-4, 200.0, 0.02
    drive = sine(150.0, periods=4, samples=4000)
    total, m, b = STIFFNESS, TABLE["m"], TABLE["b"]
    inner = np.array([b_2, k_2])
    carried = np.polyadd(np.array([m_2, 0.0, 0.0]), inner)
    denominator = np.polyadd(np.polymul([m, b, total], carried), np.polymul([m_2, 0.0, 0.0], inner))
    _, expected, _ = lsim(lti(TABLE["alpha"] * carried, denominator), drive.voltage(drive.t), drive.t)
    q = simulate({**UNSLIPPED, "m_2": m_2, "k_2": k_2, "b_2": b_2}, drive)
    np.testing.assert_allclose(q, expected, atol=2e-5 * np.ptp(expected))


def test_losses_warm_the_actuator_until_they_flow_off() -> None:
    # With C_T → 0 the warmth is R_T P, and with α (1 + κ R_T P) the gain of a damped oscillator follows b v².
    drive = sine(100.0, amplitude=20.0, periods=6, samples=6000)
    tau, resistance, kappa = 5.0, 1e3, -1e-2
    values = {**UNSLIPPED, "kappa_T": kappa, "C_T": tau / resistance, "R_T": resistance}
    v = np.gradient(simulate(UNSLIPPED, drive), drive.dt)
    warmth = np.cumsum(TABLE["b"] * v**2) * drive.dt * resistance / tau
    ratio = abs(_gain(values, drive)) / abs(_gain(UNSLIPPED, drive)) - 1.0
    # Half a cycle of the expansion: force and charge both scale with α, k with neither.
    stiff = STIFFNESS - TABLE["k"]
    expected = kappa * np.mean(warmth[-1000:]) * (1.0 - 2.0 * stiff / STIFFNESS)
    assert ratio == pytest.approx(expected, rel=0.15)


def test_base_motion_is_the_same_force_in_every_recording() -> None:
    still = Excitation("still", (Piece(0.0, 0.5),), 1e-4, 5000)
    force = {"A_b": 0.1, "f_b": 40.0, "phi_b": 1.0}
    q = simulate({**UNSLIPPED, **force}, still)
    t = still.t[3000:]
    omega = 2.0 * math.pi * 40.0
    gain = 0.1 / (STIFFNESS - TABLE["m"] * omega**2 + 1j * omega * TABLE["b"])
    np.testing.assert_allclose(q[3000:], np.imag(gain * np.exp(1j * (omega * t + 1.0))), atol=1e-5 * abs(gain))
    other = sine(25.0, amplitude=5.0, periods=1, samples=400)
    both = simulate({**UNSLIPPED, **force}, other) - simulate(UNSLIPPED, other)
    np.testing.assert_allclose(both[::50], q[:400:1][np.round(other.t[::50] / 1e-4).astype(int)], atol=1e-11)


def test_mains_lines_have_phases_of_their_own() -> None:
    effect = drawn("mains_pickup", np.random.default_rng(3), TABLE, PLAN)
    stated = described(effect, 1e-6)
    first, second = (effect.added(1e-6, e) for e in PLAN[:2])
    line = np.exp(-2j * math.pi * stated["f_m"] * PLAN[0].t)
    assert np.max(np.abs(first)) <= sum(v for n, v in stated.items() if n != "f_m") + 1e-12
    assert abs(np.angle(np.sum(first * line)) - np.angle(np.sum(second * np.exp(
        -2j * math.pi * stated["f_m"] * PLAN[1].t)))) > 1e-3  # fmt: skip


def test_contact_on_either_side() -> None:
    drive = sine(10.0, periods=1, samples=400)
    for side in (1.0, -1.0):
        moved = simulate({**TABLE, "k_c": 1e4, "q_c": 4e-5, "side": side}, drive) - simulate(TABLE, drive)
        assert (np.min(moved) < -1e-6) == (side > 0.0)


def test_pairs_are_of_different_kinds() -> None:
    assert may_be_paired("creep", "delay")
    assert not may_be_paired("delay", "delay")
    assert not may_be_paired("delay", "sensor_lag")
    assert not may_be_paired("slew_limit", "amplifier_saturation")
    assert set().union(*ALIKE) <= set(LISTED)
    assert set(LOCATIONS.values()) == {
        "amplifier", "electrical", "hysteron", "coupling", "mechanical", "thermal", "sensor", "environment"
    }  # fmt: skip
