"""Listed effects in other forms: they act, they vanish, and in a limit they are what they are called."""

from __future__ import annotations

import math

import numpy as np
import pytest
from concealments import moves_and_vanishes

from studies.generator.actuator import TABLE, simulate
from studies.generator.concealed import described
from studies.generator.excitation import Excitation, Piece, sine, step
from studies.generator.listed import LISTED
from studies.generator.other_form import FORMS
from studies.generator.plans import plan_of

PLAN = plan_of("short")
UNSLIPPED = {**TABLE, "d_1": 1e4, "d_2": 1e4}
STIFFNESS = TABLE["k"] + TABLE["alpha"] ** 2 * (1 / TABLE["C_1"] + 1 / TABLE["C_2"])


@pytest.mark.parametrize("form", FORMS)
def test_it_changes_the_output_and_vanishes_with_its_strength(form: str) -> None:
    name, drawn = FORMS[form]
    effect = drawn(np.random.default_rng(1), TABLE, PLAN)
    assert effect.name == name and name in LISTED
    moves_and_vanishes(effect, PLAN)


# Each limit turns a form into something known: the catalogue's form, a base parameter, or a changed voltage.
@pytest.mark.parametrize(
    ("form", "same"),
    [
        # Eight cells that relax slowly against the recording are springs.
        ({"k_l": 50.0, "tau_l": 1e6}, {"k": TABLE["k"] + 400.0}),
        ({"k_l": 50.0, "tau_l": 1e6, "cells_l": 3.0}, {"k": TABLE["k"] + 150.0}),
        # Friction that does not fall with the velocity is that of the catalogue.
        ({"F_c": 0.02, "r_s": 2.0, "v_st": 1e6}, {"F_c": 0.04}),
        # A stop of any power that is not reached does nothing.
        ({"k_c": 1e9, "q_c": 1e-3, "n_c": 1.5}, {}),
        # A very short parabola is a hard limit.
        ({"V_max": 70.0, "s_V": 1e-4}, {"V_max": 70.0}),
        ({"V_max": 75e4, "s_V": 1.0}, {}),
        # Strongly damped, a second-order filter has one slow pole: 2 ζ τ.
        ({"tau_V": 1e-7, "zeta_V": 500.0}, {"tau_V": 1e-4}),
        # Without its second slope a third hysteron is that of the catalogue.
        (
            {"inv_C_3": 1e5, "rho_3": 0.1, "d_3": 3.0, "rho_4": 1.0, "d_4": 1e3},
            {"inv_C_3": 1e5, "rho_3": 0.1, "d_3": 3.0},
        ),
        # A hysteresis element that never yields is a spring.
        ({"k_w": 200.0, "z_w": 1.0, "n_w": 2.0}, {"k": TABLE["k"] + 200.0}),
        # A weak exponential is a straight line.
        ({"kappa_e": 1e-3}, {"kappa_a": 1e-3}),
    ],
)
def test_limits_of_forms(form: dict[str, float], same: dict[str, float]) -> None:
    drive = sine(50.0, periods=1, samples=500)
    difference = simulate({**TABLE, **form}, drive) - simulate({**TABLE, **same}, drive)
    assert np.max(np.abs(difference)) < 2e-9


def test_bristles_shorter_than_the_motion_are_dry_friction() -> None:
    drive = sine(50.0, periods=2, samples=1000)
    plain, bristles, dry = (
        simulate({**TABLE, **v}, drive) for v in ({}, {"F_l": 0.02, "z_l": 1e-8}, {"F_c": 0.02, "v_s": 1e-5})
    )
    later = slice(250, None)  # at first the bristles still have to bend
    assert np.max(np.abs(dry - plain)[later]) > 3e-7
    assert np.max(np.abs(bristles - dry)[later]) < 6e-8


def test_a_second_order_filter_has_its_frequency_response() -> None:
    tau, zeta, omega = 5e-4, 0.6, 2.0 * math.pi * 50.0
    drive = sine(50.0, periods=8, samples=3200)
    last = slice(2800, 3200)
    wave = np.exp(-1j * omega * drive.t[last])
    plain, filtered = (np.sum(simulate({**UNSLIPPED, **v}, drive)[last] * wave) for v in (
        {}, {"tau_V": tau, "zeta_V": zeta}))  # fmt: skip
    s = 1j * omega * tau
    assert filtered / plain == pytest.approx(1.0 / (s**2 + 2.0 * zeta * s + 1.0), rel=1e-5)


def test_saturations_bend_the_voltage_as_they_should() -> None:
    hold = step(amplitude=60.0, before=0.01, hold=0.1, after=0.01)
    at = round(0.1 / hold.dt)
    per_volt = simulate(UNSLIPPED, hold)[at] / 60.0
    rounded = simulate({**UNSLIPPED, "V_max": 80.0, "s_V": 1.0}, hold)[at]
    assert rounded / per_volt == pytest.approx(80.0 * math.tanh(0.75), rel=1e-6)
    parabola = simulate({**UNSLIPPED, "V_max": 55.0, "s_V": 0.2}, hold)[at]
    assert parabola / per_volt == pytest.approx(60.0 - (60.0 - 44.0) ** 2 / (4.0 * 0.2 * 55.0), rel=1e-6)


def test_stiffening_and_contact_balance_the_force() -> None:
    hold = step(amplitude=60.0, before=0.01, hold=0.3, after=0.01)
    at = round(0.3 / hold.dt)
    for values, extra in (
        ({"kappa_5": 0.1}, lambda q: TABLE["k"] * q * 0.1 * (q / 1e-4) ** 4),
        ({"k_c": 1e6, "q_c": 4e-5, "n_c": 1.5}, lambda q: 1e6 * (q - 4e-5) ** 1.5),
    ):
        q = simulate({**UNSLIPPED, **values}, hold)[at]
        assert extra(q) > 1e-3
        assert STIFFNESS * q + extra(q) == pytest.approx(TABLE["alpha"] * 60.0, rel=1e-6)


def test_a_yielding_element_holds_its_limit() -> None:
    # Bouc and Wen's z goes to z_w; so slowly raised, the force is that of eq. (12) less k_w z_w.
    quarter = sine(0.2, periods=1, samples=200)
    widths = 0.5 * (TABLE["d_1"] + TABLE["d_2"])
    q = simulate({**TABLE, "k_w": 1e4, "z_w": 5e-6, "n_w": 3.0}, quarter)[50]
    assert TABLE["k"] * q == pytest.approx(TABLE["alpha"] * (75.0 - widths) - 0.05, rel=2e-4)


@pytest.mark.parametrize(("c", "power"), [(2.0, 1.0), (4.0, 1.5), (20.0, 2.0)])
def test_weak_drag_grows_with_its_power_of_the_amplitude(c: float, power: float) -> None:
    changes = []
    for amplitude in (30.0, 60.0):
        drive = sine(100.0, amplitude=amplitude)
        moved = simulate({**UNSLIPPED, "c_2": c, "n_c2": power}, drive) - simulate(UNSLIPPED, drive)
        changes.append(np.max(np.abs(moved)))
    assert changes[0] > 1e-9
    assert changes[1] / changes[0] == pytest.approx(2.0 ** (power + 1.0), rel=0.05)


def test_drifts_of_other_kinds() -> None:
    walk = FORMS["random_walk_drift"][1](np.random.default_rng(0), TABLE, PLAN)
    paths = [walk.added(2e-6, e) for e in PLAN]
    for excitation, path in zip(PLAN, paths, strict=True):
        assert np.std(np.diff(path)) == pytest.approx(2e-6 * math.sqrt(excitation.dt), rel=0.08)
    assert abs(np.corrcoef(paths[0], paths[2])[0, 1]) < 0.999
    settled = FORMS["exponential_drift"][1](np.random.default_rng(0), TABLE, PLAN)
    stated = described(settled, 1e-6)
    late = Excitation("late", (Piece(0.0, 100.0),), 1.0, 100)
    assert settled.added(1e-6, late)[-1] == pytest.approx(stated["A"], rel=1e-9)
    assert abs(stated["A"]) == 1e-6
