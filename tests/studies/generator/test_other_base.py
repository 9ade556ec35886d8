"""Actuators with another hysteresis than hysterons: equations, passivity, and what can be concealed in them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf
from scipy.integrate import solve_ivp

from phnn.errors import InputRefused
from studies.generator import Conditions, draw_case, make_case, open_seal, write_seal
from studies.generator.actuator import simulate
from studies.generator.base import as_stated, moving
from studies.generator.concealed import quasi_static_peak, stuck_stiffness
from studies.generator.excitation import PEAK, sine
from studies.generator.other_base import BASES, BOUC_WEN, HYSTERONS, ON_HYSTERONS, PRANDTL_ISHLINSKII, acts_on
from studies.generator.strata import STRATA, choices, in_turn

OTHERS = (PRANDTL_ISHLINSKII, BOUC_WEN)
others = pytest.mark.parametrize("family", OTHERS)


def base(family: str, seed: int = 0) -> dict[str, float]:
    return dict(draw_case(seed, "none", "few", conditions=Conditions(base=family)).base)


def envelopes(w: dict[str, float], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bend = w["q_play"] * (np.sqrt(1.0 + (q / w["q_play"]) ** 2) - 1.0)
    return q + (w["lean_play"] - w["gape_play"]) * bend, q + (w["lean_play"] + w["gape_play"]) * bend


def opposing(w: dict[str, float], q: np.ndarray) -> np.ndarray:
    """Voltage of the generalised Prandtl–Ishlinskii model as the operator of the literature, sample by sample."""
    low, high = envelopes(w, q)
    total = np.zeros_like(q)
    for i in (1, 2, 3, 4):
        play, r = 0.0, w[f"r_play_{i}"]
        for k in range(q.size):
            play = max(low[k] - r, min(high[k] + r, play))
            total[k] += w[f"c_play_{i}"] * (q[k] - play)
    return total


@pytest.mark.parametrize("seed", range(3))
def test_plays_are_those_of_the_generalised_operator(seed: int) -> None:
    w, drive = base(PRANDTL_ISHLINSKII, seed), sine(5.0, periods=2, samples=8000)
    q = simulate(w, drive)
    v, a = np.gradient(q, drive.dt), np.gradient(np.gradient(q, drive.dt), drive.dt)
    left = w["alpha"] * (drive.voltage(drive.t) - opposing(w, q)) - w["k"] * q - w["b"] * v - w["m"] * a
    # The start from rest sets the mass in motion, which the differences resolve only afterwards.
    assert np.abs(left[400:-2]).max() < 2e-3 * w["alpha"] * PEAK


def test_bouc_wen_agrees_with_equations_written_anew() -> None:
    w, drive = base(BOUC_WEN), sine(80.0, periods=1, samples=400)

    def rates(t: float, x: np.ndarray) -> list[float]:
        q, p, z = x
        v = p / w["m"]
        power = abs(z) ** (w["n_bouc"] - 1.0) / w["z_bouc"] ** w["n_bouc"]
        slope = w["beta_bouc"] * abs(v) * z * power + (1.0 - w["beta_bouc"]) * v * abs(z) * power
        force = w["alpha"] * (PEAK * math.sin(2 * math.pi * 80.0 * t) - w["c_bouc"] * z) - w["k"] * q - w["b"] * v
        return [v, force, v - slope]

    scales = 1e-9 * np.array([1e-4, 1e-5, 1e-4])
    path = solve_ivp(rates, (0.0, drive.t[-1]), np.zeros(3), "Radau", drive.t, rtol=1e-8, atol=scales)
    q = simulate(w, drive)
    assert np.max(np.abs(path.y[0] - q)) < 1e-10
    assert np.max(np.abs(simulate({**w, "c_bouc": 0.0}, drive) - q)) > 1e-6


@pytest.mark.parametrize("seed", range(20))
def test_no_cycle_of_plays_gives_energy(seed: int) -> None:
    w = base(PRANDTL_ISHLINSKII, seed)
    # Larger than any displacement of a recording, overshoot included.
    q = np.linspace(-1.6, 1.6, 1001) * w["q_play"]
    low, high = envelopes(w, q)
    assert (np.diff(low) > 0.0).all()
    assert (np.diff(high) > 0.0).all()
    for i in (1, 2, 3, 4):
        # A play moves up at the lower envelope, down at the upper one: against the voltage each time.
        assert (q - low + w[f"r_play_{i}"] > 0.0).all()
        assert (q - high - w[f"r_play_{i}"] < 0.0).all()
    assert base(BOUC_WEN, seed)["beta_bouc"] > 0.5


@others
def test_loops_are_as_large_as_those_of_hysterons(family: str) -> None:
    drive = sine(10.0, periods=2, samples=2000)
    u, last = drive.voltage(drive.t), slice(1000, 2000)
    for seed in range(4):
        areas = [abs(np.trapezoid(simulate(base(f, seed), drive)[last], u[last])) for f in (HYSTERONS, family)]
        assert 0.3 < areas[1] / areas[0] < 3.0


def test_envelopes_are_asymmetric() -> None:
    drive = sine(10.0, periods=2, samples=2000)
    for seed in range(4):
        q = simulate(base(PRANDTL_ISHLINSKII, seed), drive)[1000:]
        assert abs(q.max() + q.min()) > 0.01 * np.ptp(q)
        even = simulate(base(BOUC_WEN, seed), drive)[1000:]
        assert abs(even.max() + even.min()) < 1e-3 * np.ptp(even)


@others
def test_a_base_has_its_own_parameters_and_no_hysterons(family: str) -> None:
    w, plain = base(family), base(HYSTERONS)
    assert {n: w[n] for n in ("m", "k", "b", "alpha")} == {n: plain[n] for n in ("m", "k", "b", "alpha")}
    stated = as_stated(w)
    assert not any(n.startswith(("C_", "rho_", "d_")) for n in stated)
    assert set(moving(w)) == set(stated) - {"q_play"}
    assert all(v != 0.0 for v in stated.values())
    # As stiff as the hysterons that it replaces, about.
    assert 0.5 < stuck_stiffness(w) / stuck_stiffness(plain) < 1.2
    assert 0.8 < quasi_static_peak(w) / quasi_static_peak(plain) < 2.0


def test_draws_of_hysterons_stay_what_they_were() -> None:
    for stratum in STRATA:
        plain = draw_case(11, stratum, "few")
        assert draw_case(11, stratum, "few", conditions=Conditions(base=HYSTERONS)) == plain
        assert in_turn(stratum, 11) == in_turn(stratum, 11, HYSTERONS)
        other = draw_case(11, stratum, "few", conditions=Conditions(base=BOUC_WEN))
        assert (other.noise, other.recordings) == (plain.noise, plain.recordings)


@pytest.mark.slow
@others
def test_what_acts_on_hysterons_is_not_concealed_where_there_are_none(family: str) -> None:
    for stratum in STRATA:
        names = {n for c in choices(stratum) for n in c.effects}
        turns = [in_turn(stratum, number, family) for number in range(len(choices(stratum)))]
        assert {n for turn in turns for c in turn for n in c.effects} == names - set(ON_HYSTERONS)
    assert all(acts_on(name, HYSTERONS) for name in ON_HYSTERONS)


@others
def test_recordings_and_seal_say_what_was_drawn(tmp_path: Path, family: str, brief: str) -> None:
    case = draw_case(3, "same", brief, conditions=Conditions(base=family, hysterons=3))
    sealed = make_case(replace(case, targets=(3.0,)), tmp_path / "r")
    assert (sealed.base_family, sealed.hysterons, sealed.stated_hysterons) == (family, 0, 3)
    assert sealed.base == as_stated(case.base)
    assert sealed.effects
    assert sealed.effects[0] not in ON_HYSTERONS
    # What the effect changes is measured beyond a refit of this very actuator.
    assert sealed.strength_over_noise == pytest.approx(3.0, rel=0.1)
    manifest = (tmp_path / "r" / "recordings.yaml").read_text(encoding="utf-8")
    assert OmegaConf.create(manifest)["setup"] == {"model": "piezo_actuator", "hysterons": 3}
    assert family not in manifest
    write_seal(sealed, tmp_path / "seal.json")
    assert open_seal(tmp_path / "seal.json") == sealed


def test_a_background_beside_another_hysteresis_is_creep_alone(tmp_path: Path, brief: str) -> None:
    case = draw_case(3, "none", brief, conditions=Conditions(background=True, base=BOUC_WEN))
    assert make_case(case, tmp_path).background_effects == ("creep",)


def test_conditions_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputRefused, match=f"take one of {', '.join(BASES)}"):
        Conditions(base="preisach")
    with pytest.raises(InputRefused, match="no number of hysterons to state wrongly"):
        Conditions(base=BOUC_WEN, wrong_order=True)
