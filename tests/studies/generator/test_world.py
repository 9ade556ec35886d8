"""The concealed actuator with every effect: closed forms, an independent solver, limits, strengths."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from studies.generator import effects
from studies.generator.effects import FORMS, FURTHER_UNLISTED, LISTED, UNLISTED, Concealed
from studies.generator.make import concealing
from studies.generator.plans import Excitation, plan_of, sine
from studies.generator.world import NEUTRAL, TABLE, play, simulate, simulate_all

# As far as the hysterons do not slip they are capacitors, and the actuator is linear.
UNSLIPPED = {**TABLE, "d_1": 1e4, "d_2": 1e4}
STIFFNESS = TABLE["k"] + TABLE["alpha"] ** 2 * (1 / TABLE["C_1"] + 1 / TABLE["C_2"])


# Parameters of effects, in groups that are switched on together.
WRITTEN_ANEW = {
    "creep": {"k_s": 300.0, "tau_s": 0.01},
    "cells": {"k_l": 40.0, "tau_l": 1e-3, "cells_l": 3.0},
    "stiffness": {"kappa_2": -0.2, "kappa_3": 0.1, "kappa_5": 0.1, "kappa_p": 0.05, "f_p": 40.0, "phi_p": 1.0},
    "drag": {"c_2": 20.0, "n_c2": 1.5},
    "damper": {"kappa_b": 2.0, "kappa_f": 0.3},
    "guide": {"c_e": 3e4, "q_e": 2e-5, "side_e": -1.0, "kappa_r": 0.01, "A_g": 0.02, "lambda_g": 3e-5},
    "friction": {"F_c": 0.05, "v_s": 1e-3, "r_s": 1.5, "v_st": 1e-2, "F_l": 0.02, "z_l": 1e-6},
    "element": {"k_w": 500.0, "z_w": 2e-5, "n_w": 2.0},
    "hysteron": {"inv_C_3": 1e5, "rho_3": 0.1, "d_3": 3.0, "rho_4": 0.05, "d_4": 5.0},
    "widths": {"kappa_d": 0.1, "kappa_v": 1.0, "kappa_w": -20.0},
    "leakage": {"G": 2e-5},
    "capacitors": {"kappa_C": 1e-3},
    "coupling": {"epsilon": 1e-3, "kappa_a": 0.05, "kappa_e": 0.03, "kappa_l": 0.02},
    "depolarisation": {"delta_z": 0.1, "tau_z": 2e-3, "V_c": 30.0},
    "warmth": {"kappa_T": -0.02, "C_T": 1e-3, "R_T": 20.0, "x_T": 1e-4},
    "supply": {"omega_u": 5.0, "kappa_u": 0.02, "f_u": 300.0, "phi_u": 0.5},
    "amplifier": {"tau_V": 1e-4, "zeta_V": 0.8, "V_max": 72.0, "s_V": 0.2, "delta_V": 0.5},
    "contact": {"k_c": 1e6, "q_c": 4e-5, "n_c": 1.5, "side": -1.0},
    "motion": {"A_b": 0.1, "f_b": 70.0, "phi_b": 0.3},
    "further hysterons": {"inv_C_5": 3e5, "rho_5": 0.05, "d_5": 4.0, "inv_C_6": 2e5, "rho_6": 1e-3, "d_6": 2.0},
    "Bouc–Wen": {"c_bouc": 5e4, "z_bouc": 4e-5, "n_bouc": 1.5, "beta_bouc": 0.7},
    "mode": {"m_2": 1e-4, "k_2": 200.0, "b_2": 0.02},
}


def _solved(w: dict[str, float], drive: Excitation) -> np.ndarray:
    """Displacement by Radau of the equations as a text would state them, all effects in one place."""

    def dead_zone(e: float, rho: float, half: float) -> float:
        return rho * math.copysign(max(abs(e) - half, 0.0), e)

    def effort(linear: float) -> float:
        roots = np.roots([w["kappa_C"], 0.0, 1.0, -linear]) if w["kappa_C"] else np.array([linear])
        return float(np.real(roots[np.argmin(np.abs(np.imag(roots)))]))

    def rates(t: float, x: np.ndarray) -> list[float]:
        q_1, q_2, q_3, q_5, q_6, q, p, cell, volt, rate, z, warm, apart, v_2, bend, bouc, wen, *cells, held = x
        v, s = p / w["m"], q / 1e-4
        passed = 75.0 * math.sin(2 * math.pi * 150.0 * t) - held
        u = passed * (1 + w["kappa_u"] * math.sin(2 * math.pi * w["f_u"] * t + w["phi_u"]))
        u = math.copysign(max(abs(u) - w["delta_V"], 0.0), u)
        beyond = abs(volt) - (1 - w["s_V"]) * w["V_max"]
        flat = abs(volt) - beyond**2 / (4 * w["s_V"] * w["V_max"]) if beyond < 2 * w["s_V"] * w["V_max"] else w["V_max"]
        voltage = math.copysign(flat, volt) if beyond > 0.0 else volt
        a = w["alpha"] * (1 + w["kappa_a"] * s) * math.exp(w["kappa_e"] * s)
        a *= (1 - w["delta_z"] * z) * (1 + w["kappa_T"] * warm) * (1 - w["kappa_l"] * math.log10(1 + t / 5e-3))
        further = [q_3 * w["inv_C_3"], q_5 * w["inv_C_5"], q_6 * w["inv_C_6"]]
        e = [effort(q_1 / w["C_1"]), effort(q_2 / w["C_2"]), *further]
        wide = 0.5 * (1 + w["kappa_d"] * s) * (1 + w["kappa_v"] * abs(v)) * math.exp(w["kappa_w"] * t / 3)
        slips = [dead_zone(e_i, w[f"rho_{i}"], w[f"d_{i}"] * wide) for i, e_i in zip((1, 2, 3, 5, 6), e, strict=True)]
        slips[2] += dead_zone(e[2], w["rho_4"], w["d_4"] * wide)
        shape = 1 + w["kappa_2"] * s + w["kappa_2"] ** 2 * s**2 / 3 + w["kappa_3"] * s**2 + w["kappa_5"] * s**4
        stiffness = w["k"] * (1 + w["kappa_p"] * math.sin(2 * math.pi * w["f_p"] * t + w["phi_p"]))
        stribeck = 1 + (w["r_s"] - 1) * math.exp(-((v / w["v_st"]) ** 2))
        opposing = sum(e) + w["c_bouc"] * bouc
        force = a * (voltage + 0.5 * w["epsilon"] * voltage**2 - opposing) - stiffness * q * shape
        force -= w["b"] * (1 + w["kappa_b"] * s**2) * (1 + w["kappa_f"] * (v > 0)) * v
        force -= w["c_2"] * abs(v) ** w["n_c2"] * v + w["F_c"] * stribeck * math.tanh(v / w["v_s"])
        force -= w["k_s"] * cell + w["k_l"] * sum(cells) + w["F_l"] * bend / w["z_l"] + w["k_w"] * wen
        force -= w["side"] * w["k_c"] * max(w["side"] * q - w["q_c"], 0.0) ** w["n_c"]
        force -= w["A_g"] * math.sin(2 * math.pi * q / w["lambda_g"]) + w["c_e"] * v * max(-q - w["q_e"], 0.0)
        force += w["k"] * (w["x_T"] * warm - w["kappa_r"] * abs(q) * math.tanh(v / w["v_s"]))
        carried = w["k_2"] * apart + w["b_2"] * (v - v_2)
        force += w["A_b"] * math.sin(2 * math.pi * w["f_b"] * t + w["phi_b"]) - carried
        charges = [a * v - h - w["G"] * i for h, i in zip(slips, e, strict=True)]
        follows = (u - volt - 2 * w["zeta_V"] * rate) / w["tau_V"]
        field = (max(abs(voltage) / w["V_c"] - 1, 0.0) - z) / w["tau_z"]
        beta, n = w["beta_bouc"], w["n_bouc"]
        slides = (beta * abs(v) * bouc + (1 - beta) * v * abs(bouc)) * abs(bouc) ** (n - 1) / w["z_bouc"] ** n
        heat = sum(i * h for i, h in zip(e, slips, strict=True)) + w["alpha"] * w["c_bouc"] * bouc * slides
        heat += w["b"] * v**2 - warm / w["R_T"]
        yields = abs(wen / w["z_w"]) ** w["n_w"] if v * wen > 0 else 0.0
        times = [w["tau_l"] * 10.0 ** (2 * j) for j in range(3)]
        return [
            *charges, v, force, v - cell / w["tau_s"], rate / w["tau_V"], follows, field, heat / w["C_T"],
            v - v_2, carried / w["m_2"], v - abs(v) * bend / (w["z_l"] * stribeck), v - slides, v * (1 - yields),
            *(v - c / tau for c, tau in zip(cells, times, strict=True)), w["omega_u"] * passed,
        ]  # fmt: skip

    sizes = np.array([*[4e-6] * 5, 1e-4, 1e-5, 1e-4, 75, 75, 1, 1, 1e-4, 1e-2, 1e-6, 1e-4, 1e-5, *[1e-4] * 3, 75])
    path = solve_ivp(rates, (0.0, drive.t[-1]), np.zeros(sizes.size), "Radau", drive.t, rtol=1e-8, atol=1e-10 * sizes)
    return np.asarray(path.y[5])


def test_all_effects_at_once_agree_with_equations_written_anew() -> None:
    drive = sine(150.0, periods=1, samples=100)
    values = TABLE | {n: v for group in WRITTEN_ANEW.values() for n, v in group.items()}
    q = simulate(values, drive)
    assert np.max(np.abs(_solved({**NEUTRAL, **values}, drive) - q)) < 1e-10
    # Each of them is in it: the output is another one without.
    for name, group in WRITTEN_ANEW.items():
        without = simulate({n: v for n, v in values.items() if n not in group}, drive)
        assert np.max(np.abs(without - q)) > 5e-9, name


def test_delay_turns_the_phase_and_a_lag_lowers_the_gain_too() -> None:
    tau, omega = 3e-4, 2.0 * math.pi * 50.0
    drive = sine(50.0, periods=8, samples=8 * 400)
    wave = np.exp(-1j * omega * drive.t[-400:])
    plain, late, lagging = (
        np.sum(simulate({**UNSLIPPED, **v}, drive)[-400:] * wave) for v in ({}, {"tau_d": tau}, {"tau_y": tau})
    )
    assert late / plain == pytest.approx(np.exp(-1j * omega * tau), rel=1e-5)
    assert lagging / plain == pytest.approx(1.0 / (1.0 + 1j * omega * tau), rel=1e-5)


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


def test_a_sensor_has_a_polynomial_errors_of_its_scale_a_growing_gain_and_a_fast_clock() -> None:
    drive = sine(10.0, periods=2, samples=1000)
    q = simulate(TABLE, drive)
    curved, growing, early = (
        simulate({**TABLE, **v}, drive) for v in ({"a_2": 50.0, "a_3": -4e5}, {"kappa_y": 0.3}, {"kappa_t": 0.01})
    )
    np.testing.assert_allclose(curved, q + 50.0 * q**2 - 4e5 * q**3, rtol=1e-12)
    scale = simulate({**TABLE, "A_y": 1e-6, "lambda_y": 2e-5, "delta_y": 4e-6, "q_y": 3e-5, "w_y": 5e-6}, drive)
    np.testing.assert_allclose(scale, q + 1e-6 * np.sin(q * np.pi * 1e5) + 2e-6 * np.tanh(q / 5e-6 - 6.0), atol=1e-17)
    np.testing.assert_allclose(growing, q * (1.0 + 0.1 * drive.t), rtol=1e-12)
    np.testing.assert_allclose(early, np.interp(0.99 * drive.t, drive.t, q), atol=1e-4 * np.ptp(q))


PLAN = plan_of("short")
FAST_AND_HELD = (PLAN[1], PLAN[3])
ALL = [*LISTED, *UNLISTED, *FURTHER_UNLISTED, *FORMS, "stop of the demonstration", "drift of the demonstration"]


def _effect(chosen: str) -> tuple[str, Concealed]:
    rng = np.random.default_rng(1)
    if chosen in FORMS:
        name, drawn_in_form = FORMS[chosen]
        assert name in LISTED
        return name, drawn_in_form(rng, TABLE, PLAN)
    if chosen not in effects.LOCATIONS:
        name = "contact_stop" if chosen.startswith("stop") else "sensor_drift"
        return name, effects.draw(name, rng, TABLE, PLAN)
    return chosen, effects.drawn(chosen, rng, TABLE, PLAN)


@cache
def undisturbed() -> tuple[np.ndarray, ...]:
    """Return the outputs of the actuator in which nothing is concealed."""
    return tuple(simulate_all(TABLE, FAST_AND_HELD))


@pytest.mark.parametrize("chosen", ALL)
def test_it_changes_the_output_and_vanishes_with_its_strength(chosen: str) -> None:
    name, effect = _effect(chosen)
    assert effect.name == name
    assert set(effect.law(effect.guess)) <= set(NEUTRAL)
    # A seal is JSON, which has no infinity.
    stated = effects.described(effect, effect.guess)
    assert stated and all(np.isfinite(value) for value in stated.values())

    def change(strength: float) -> float:
        moved = concealing(TABLE, FAST_AND_HELD, [(effect, strength)])
        return max(float(np.ptp(a - b)) for a, b in zip(moved, undisturbed(), strict=True))

    seen = change(effect.guess)
    assert seen > 1e-8
    assert change(effect.guess * 1e-3) < 0.05 * seen
