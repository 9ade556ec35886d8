"""The concealed actuator against closed forms and an independent solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim, lti

from studies.generator.actuator import TABLE, simulate
from studies.generator.excitation import Excitation, Piece, sine, step
from studies.generator.plans import plan_of


def test_held_step_without_slip_rests_at_the_static_gain() -> None:
    # Far inside the dead zones the hysterons are capacitors: q = α V / (k + α² Σ 1/C), see eq. (12).
    short = step(amplitude=10.0, before=0.02, hold=0.05, after=0.02)
    q = simulate(TABLE, short)
    stiffness = TABLE["k"] + TABLE["alpha"] ** 2 * (1 / TABLE["C_1"] + 1 / TABLE["C_2"])
    held = np.searchsorted(short.t, 0.069)
    assert q[held] == pytest.approx(TABLE["alpha"] * 10.0 / stiffness, rel=1e-6)
    assert np.all(q[short.t < 0.02] == 0.0)
    assert q[-1] == pytest.approx(0.0, abs=1e-12)


def _slowly_raised(effect: dict[str, float]) -> float:
    """Displacement when 75 V is reached so slowly that every hysteron slips and stays at the edge of its dead zone."""
    quarter = sine(0.2, periods=1, samples=200)
    q = simulate({**TABLE, **effect}, quarter)
    assert quarter.voltage(quarter.t)[50] == pytest.approx(75.0)
    return float(q[50])


HALF_WIDTHS = 0.5 * (TABLE["d_1"] + TABLE["d_2"])


def test_slipped_hysterons_hold_half_their_widths() -> None:
    # Eq. (12) with e_i = d_i/2. (A sudden step would not do: its overshoot takes the hysterons past the edge and back.)
    expected = TABLE["alpha"] * (75.0 - HALF_WIDTHS) / TABLE["k"]
    assert _slowly_raised({}) == pytest.approx(expected, rel=1e-5)


def test_without_hysterons_it_is_a_linear_oscillator() -> None:
    # With huge capacitances the hysterons vanish; a linear solver must then agree over the whole transient.
    values = {**TABLE, "C_1": 1e3, "C_2": 1e3}
    drive = sine(100.0, periods=2, samples=4000)
    oscillator = lti([TABLE["alpha"]], [TABLE["m"], TABLE["b"], TABLE["k"]])
    t = drive.t
    _, expected, _ = lsim(oscillator, drive.voltage(t), t)
    q = simulate(values, drive)
    assert np.max(np.abs(q - expected)) < 2e-5 * np.max(np.abs(expected))


def test_agrees_with_an_implicit_solver_of_another_kind() -> None:
    drive = sine(150.0, periods=1, samples=200)
    w = TABLE

    def dead_zone(e: float, rho: float, d: float) -> float:
        return rho * math.copysign(max(abs(e) - d / 2, 0.0), e)

    def rates(t: float, x: np.ndarray) -> list[float]:
        current = w["alpha"] * x[3] / w["m"]
        e_1, e_2 = x[0] / w["C_1"], x[1] / w["C_2"]
        voltage = 75.0 * math.sin(2 * math.pi * 150.0 * t)
        return [
            current - dead_zone(e_1, w["rho_1"], w["d_1"]),
            current - dead_zone(e_2, w["rho_2"], w["d_2"]),
            x[3] / w["m"],
            w["alpha"] * (voltage - e_1 - e_2) - w["k"] * x[2] - w["b"] * x[3] / w["m"],
        ]

    path = solve_ivp(rates, (0.0, drive.t[-1]), np.zeros(4), "Radau", drive.t, rtol=1e-7, atol=1e-14)
    assert np.max(np.abs(path.y[2] - simulate(TABLE, drive))) < 1e-11


def test_effects_together_agree_with_equations_written_anew() -> None:
    # Most effects of the demonstration at once, straight from their equations.
    drive = sine(150.0, periods=1, samples=100)
    w = TABLE
    extra = {
        "k_s": 300.0, "tau_s": 0.01, "kappa_3": 0.1, "c_2": 20.0, "inv_C_3": 1e5, "rho_3": 0.1, "d_3": 3.0,
        "kappa_d": 0.1, "epsilon": 1e-3, "tau_V": 1e-4, "V_max": 72.0, "k_c": 1e4, "q_c": 4e-5,
    }  # fmt: skip

    def dead_zone(e: float, rho: float, half: float) -> float:
        return rho * math.copysign(max(abs(e) - half, 0.0), e)

    def rates(t: float, x: np.ndarray) -> list[float]:
        q, v, s = x[2], x[3] / w["m"], x[4]
        e = [x[0] / w["C_1"], x[1] / w["C_2"], x[5] * 1e5]
        wide = 0.5 * (1.0 + 0.1 * q / 1e-4)
        voltage = min(max(x[6], -72.0), 72.0)
        force = w["alpha"] * (voltage + 0.5e-3 * voltage**2 - sum(e)) - w["k"] * q * (1.0 + 0.1 * (q / 1e-4) ** 2)
        force -= 300.0 * s + w["b"] * v + 20.0 * abs(v) * v + 1e4 * max(q - 4e-5, 0.0)
        pairs = ((w["rho_1"], w["d_1"]), (w["rho_2"], w["d_2"]), (0.1, 3.0))
        currents = [w["alpha"] * v - dead_zone(e[i], rho, d * wide) for i, (rho, d) in enumerate(pairs)]
        follows = (75.0 * math.sin(2 * math.pi * 150.0 * t) - x[6]) / 1e-4
        return [currents[0], currents[1], v, force, v - s / 0.01, currents[2], follows]

    tolerance = 1e-9 * np.array([4e-6, 4e-6, 1e-4, 1e-5, 1e-4, 4e-6, 75.0])
    path = solve_ivp(rates, (0.0, drive.t[-1]), np.zeros(7), "Radau", drive.t, rtol=1e-7, atol=tolerance)
    moved = simulate({**TABLE, **extra}, drive)
    assert np.max(np.abs(moved - simulate(TABLE, drive))) > 1e-6
    assert np.max(np.abs(path.y[2] - moved)) < 2e-11


# Each limit turns an effect into something known: a changed base parameter or a changed input.
@pytest.mark.parametrize(
    ("effect", "same"),
    [
        # A cell that relaxes slowly against the recording is one more spring, one that relaxes fast one more damper.
        ({"k_s": 500.0, "tau_s": 1e6}, {"k": TABLE["k"] + 500.0}),
        ({"k_s": 0.05e6, "tau_s": 1e-6}, {"b": TABLE["b"] + 0.05}),
        # A third hysteron that never slips is a spring α²/C.
        ({"inv_C_3": 1e5, "rho_3": 1.0, "d_3": 1e3}, {"k": TABLE["k"] + TABLE["alpha"] ** 2 * 1e5}),
        # A stop that is touched at once, without a gap, pulls on one side only; far away it does nothing.
        ({"k_c": 1e6, "q_c": 1.0}, {}),
        # Friction far below the velocity v_s is a damper F_c/v_s.
        ({"F_c": 100.0, "v_s": 1e3}, {"b": TABLE["b"] + 0.1}),
        # A fast amplifier and one that clips above the peak are ideal.
        ({"tau_V": 1e-9}, {}),
        ({"V_max": 75.0}, {}),
    ],
)
def test_limits_of_effects(effect: dict[str, float], same: dict[str, float]) -> None:
    drive = sine(50.0, periods=1, samples=500)
    difference = simulate({**TABLE, **effect}, drive) - simulate({**TABLE, **same}, drive)
    assert np.max(np.abs(difference)) < 2e-9


def test_cubic_stiffness_balances_the_force() -> None:
    kappa = 0.2
    q = _slowly_raised({"kappa_3": kappa})
    force = TABLE["k"] * q * (1 + kappa * (q / 1e-4) ** 2)
    assert force == pytest.approx(TABLE["alpha"] * (75.0 - HALF_WIDTHS), rel=1e-5)


def test_asymmetric_thresholds_move_with_the_displacement() -> None:
    # With e_i = ½ d_i (1 + κ q/q₀) the balance of eq. (12) stays linear in q.
    kappa = 0.1
    expected = TABLE["alpha"] * (75.0 - HALF_WIDTHS) / (TABLE["k"] + TABLE["alpha"] * HALF_WIDTHS * kappa / 1e-4)
    assert _slowly_raised({"kappa_d": kappa}) == pytest.approx(expected, rel=1e-5)


def test_electrostriction_is_even_in_the_voltage() -> None:
    epsilon = 1e-3
    values = {**TABLE, "d_1": 1e4, "d_2": 1e4}
    up, down = (step(amplitude=a, before=0.0005, hold=0.05, after=0.0005) for a in (40.0, -40.0))
    both = simulate({**values, "epsilon": epsilon}, up)[-2] + simulate({**values, "epsilon": epsilon}, down)[-2]
    stiffness = TABLE["k"] + TABLE["alpha"] ** 2 * (1 / TABLE["C_1"] + 1 / TABLE["C_2"])
    assert both == pytest.approx(TABLE["alpha"] * epsilon * 40.0**2 / stiffness, rel=1e-5)


def test_drag_takes_energy_and_clipping_flattens() -> None:
    drive = sine(150.0)
    plain = simulate(TABLE, drive)
    assert np.ptp(simulate({**TABLE, "c_2": 100.0}, drive)) < np.ptp(plain)
    slow = sine(1.0, periods=1, samples=1000)
    top = np.flatnonzero(slow.voltage(slow.t) > 70.0)
    top = top[top <= 250]  # up to the crest: afterwards both unload
    clipped = simulate({**TABLE, "V_max": 70.0}, slow)
    assert np.ptp(clipped[top]) < 0.05 * np.ptp(simulate(TABLE, slow)[top])


def test_samples_on_a_jump_see_the_later_voltage_and_the_earlier_state() -> None:
    pieces = (Piece(0.0, 0.01), Piece(0.01, 0.02, level=5.0))
    drive = Excitation("jump", pieces, 0.001, 20)
    at = 10
    assert drive.voltage(drive.t)[at] == 5.0
    assert drive.voltage(drive.t)[at - 1] == 0.0
    assert simulate(TABLE, drive)[at] == 0.0


@pytest.mark.parametrize(("plan", "count"), [("demo", 12), ("short", 4)])
def test_plans_start_at_zero_volts_and_stay_below_the_peak(plan: str, count: int) -> None:
    excitations = plan_of(plan)
    assert len({e.name for e in excitations}) == len(excitations) == count
    for excitation in excitations:
        voltage = excitation.voltage(excitation.t)
        assert voltage[0] == 0.0
        assert 20.0 < np.max(np.abs(voltage)) <= 75.0
