"""What a case can be asked to have besides its effect: hysterons, a wrong order, a background, an anchor's error."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from scipy.integrate import solve_ivp

from phnn.errors import InputRefused
from studies.generator import Conditions, draw_case, make_case, open_seal, write_seal
from studies.generator.actuator import simulate, simulate_all
from studies.generator.base import as_stated
from studies.generator.concealed import quasi_static_peak, stuck_stiffness
from studies.generator.excitation import sine
from studies.generator.strength import ruler

SEEDS = range(40)


def test_what_is_asked_for_changes_no_other_draw() -> None:
    plain = draw_case(8, "same", "few")
    for conditions in (Conditions(True), Conditions(wrong_order=True), Conditions(anchor_error=True)):
        case = draw_case(8, "same", "few", conditions=conditions)
        other = {"conditions", "stated_hysterons", "stated_mass"}
        assert {n: v for n, v in asdict(case).items() if n not in other} == {
            n: v for n, v in asdict(plain).items() if n not in other
        }
    more = draw_case(8, "same", "few", conditions=Conditions(hysterons=4))
    assert {n: v for n, v in plain.base.items() if n[0] != "d"}.items() <= more.base.items()
    assert (more.noise, more.targets, more.recordings) == (plain.noise, plain.targets, plain.recordings)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_every_hysteron_of_a_base_slips(count: int) -> None:
    for seed in SEEDS:
        base = draw_case(seed, "none", "few", conditions=Conditions(hysterons=count)).base
        stated = as_stated(base)
        assert {n for n in stated if n.startswith("C_")} == {f"C_{i + 1}" for i in range(count)}
        assert len(stated) == 4 + 3 * count
        elastance = sum(1.0 / stated[f"C_{i + 1}"] for i in range(count))
        assert stuck_stiffness(base) == pytest.approx(base["k"] + base["alpha"] ** 2 * elastance, rel=1e-6)
        charge = base["alpha"] * quasi_static_peak(base)
        assert all(charge / stated[f"C_{i + 1}"] > 0.5 * stated[f"d_{i + 1}"] for i in range(count))


def test_four_hysterons_agree_with_equations_written_anew() -> None:
    base = dict(draw_case(2, "none", "few", conditions=Conditions(hysterons=4)).base)
    w, drive = as_stated(base), sine(80.0, periods=1, samples=200)

    def rates(t: float, x: np.ndarray) -> list[float]:
        v = x[1] / w["m"]
        e = [x[2 + i] / w[f"C_{i + 1}"] for i in range(4)]
        slips = [w[f"rho_{i + 1}"] * math.copysign(max(abs(e[i]) - w[f"d_{i + 1}"] / 2, 0.0), e[i]) for i in range(4)]
        voltage = 75.0 * math.sin(2 * math.pi * 80.0 * t)
        force = w["alpha"] * (voltage - sum(e)) - w["k"] * x[0] - w["b"] * v
        return [v, force, *(w["alpha"] * v - s for s in slips)]

    scales = 1e-9 * np.array([1e-4, 1e-5, *[4e-6] * 4])
    path = solve_ivp(rates, (0.0, drive.t[-1]), np.zeros(6), "Radau", drive.t, rtol=1e-8, atol=scales)
    q = simulate(base, drive)
    assert np.max(np.abs(path.y[0] - q)) < 1e-10
    without = simulate({n: v for n, v in base.items() if n[-1] not in "56"}, drive)
    assert np.max(np.abs(without - q)) > 1e-6


def test_one_hysteron_is_the_actuator_without_the_second() -> None:
    base = draw_case(2, "none", "few", conditions=Conditions(hysterons=1)).base
    drive = sine(50.0, periods=1, samples=300)
    # A second hysteron that slips freely at once has no voltage either.
    free = {**base, "C_2": 5e-7, "rho_2": 10.0, "d_2": 0.0}
    assert np.max(np.abs(simulate(base, drive) - simulate(free, drive))) < 2e-8


def test_numbers_of_hysterons_are_drawn_and_stated_wrongly_on_request() -> None:
    drawn = [draw_case(s, "none", "few", conditions=Conditions(hysterons=0, wrong_order=True)) for s in range(200)]
    assert {c.hysterons for c in drawn} == {1, 2, 3, 4}
    assert {(c.hysterons, c.stated_hysterons) for c in drawn} == {(1, 2), (2, 1), (2, 3), (3, 2), (3, 4), (4, 3)}
    right = [draw_case(s, "none", "few", conditions=Conditions(hysterons=0)) for s in range(50)]
    assert all(c.hysterons == c.stated_hysterons for c in right)


def test_a_stated_mass_errs_by_its_stated_deviation() -> None:
    cases = [draw_case(s, "none", "few", conditions=Conditions(anchor_error=True)) for s in range(500)]
    errors = np.array([c.stated_mass / c.base["m"] - 1.0 for c in cases]) / 0.01
    assert abs(errors.mean()) < 4.0 / math.sqrt(500.0)
    assert errors.std() == pytest.approx(1.0, abs=0.13)


def test_manifest_and_seal_say_what_was_drawn(tmp_path: Path) -> None:
    case = draw_case(4, "none", "few", conditions=Conditions(hysterons=3, wrong_order=True, anchor_error=True))
    sealed = make_case(case, tmp_path / "r")
    manifest = OmegaConf.load(tmp_path / "r" / "recordings.yaml")
    assert manifest["setup"]["hysterons"] == sealed.stated_hysterons != sealed.hysterons == 3
    assert manifest["known"]["m"]["value"] == sealed.stated_mass != sealed.base["m"]
    assert manifest["known"]["m"]["std"] == pytest.approx(0.01 * sealed.stated_mass, rel=1e-2)
    assert set(sealed.base) == {"m", "k", "b", "alpha", *(f"{n}_{i}" for n in ("C", "rho", "d") for i in (1, 2, 3))}
    write_seal(sealed, tmp_path / "seal.json")
    assert open_seal(tmp_path / "seal.json") == sealed
    table = pd.read_csv(tmp_path / "r" / f"{case.recordings[0].name}.csv")
    q = simulate(case.base, case.recordings[0])
    assert np.std(table["displacement_um"] * 1e-6 - q) < 1.2 * math.hypot(sealed.noise, sealed.quantisation)


def test_the_background_is_small_and_acts_in_the_recordings(tmp_path: Path, brief: str) -> None:
    case = draw_case(3, "none", brief, noise="white", conditions=Conditions(background=True))
    sealed = make_case(case, tmp_path)
    assert sealed.background_effects == ("creep", "hysteresis_asymmetry")
    assert set(sealed.background) == {"k_s", "tau_s", "kappa_d"}
    assert sealed.base == dict(case.base)
    # Two parts that overlap: between their difference and their sum.
    assert 0.1 < sealed.background_level < 1.5
    outputs = simulate_all({**case.base, **sealed.background}, case.recordings)
    measure = ruler(case.base, case.recordings)
    assert np.sqrt(np.mean(measure.left(outputs) ** 2)) / sealed.noise == pytest.approx(
        sealed.background_level, rel=1e-6
    )
    errors = [
        pd.read_csv(tmp_path / f"{e.name}.csv")["displacement_um"].to_numpy() * 1e-6 - q
        for e, q in zip(case.recordings, outputs, strict=True)
    ]
    assert np.sqrt(np.mean([np.var(e) for e in errors])) == pytest.approx(sealed.noise_total, rel=0.02)


def test_levels_of_the_background_spread_from_a_third_of_the_noise_to_all_of_it(tmp_path: Path, brief: str) -> None:
    levels = [
        make_case(
            draw_case(s, "none", brief, conditions=Conditions(background=True)), tmp_path / str(s)
        ).background_level
        for s in range(3)
    ]
    assert all(0.1 < level < 1.5 for level in levels)
    assert np.ptp(levels) > 0.1


def test_what_is_concealed_is_no_background(tmp_path: Path, brief: str) -> None:
    case = draw_case(0, "same", brief, conditions=Conditions(background=True))
    assert case.effects == ("creep",)
    sealed = make_case(replace(case, targets=(3.0,)), tmp_path)
    assert sealed.effects == ("creep",)
    assert sealed.background_effects == ("hysteresis_asymmetry",)
    assert set(sealed.parameters) == {"k_s", "tau_s"}
    # What the effect leaves is measured beyond the background.
    assert sealed.strength_over_noise == pytest.approx(3.0, rel=0.1)
    outputs = simulate_all({**case.base, **sealed.background, **sealed.parameters}, case.recordings)
    table = pd.read_csv(tmp_path / f"{case.recordings[0].name}.csv")
    error = table["displacement_um"].to_numpy() * 1e-6 - outputs[0]
    assert error.std() == pytest.approx(math.hypot(sealed.noise, sealed.quantisation / 12**0.5), rel=0.05)


@pytest.mark.parametrize("count", [-1, 5])
def test_numbers_out_of_range_are_refused(count: int) -> None:
    with pytest.raises(InputRefused, match=f"hysterons = {count}"):
        Conditions(hysterons=count)
