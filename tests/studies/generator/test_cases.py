"""Cases of the benchmark: what is drawn and may be asked for, what is written, and the answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from phnn.errors import InputRefused
from studies.generator import Case, Conditions, Sealed, draw_case, make_case
from studies.generator.cases import (
    BASES,
    BOUC_WEN,
    DUHEM,
    HYSTERONS,
    ON_HYSTERONS,
    PRANDTL_ISHLINSKII,
    as_stated,
    choices,
    moving,
)
from studies.generator.effects import LISTED
from studies.generator.make import ruler
from studies.generator.plans import PEAK, sine
from studies.generator.world import quasi_static_peak, simulate, simulate_all, stuck_stiffness

SENSOR_NONLINEARITY = LISTED.index("sensor_nonlinearity")
SEEDS = range(40)
OTHERS = (PRANDTL_ISHLINSKII, BOUC_WEN, DUHEM)
others = pytest.mark.parametrize("family", OTHERS)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Case, Path, Sealed]:
    case = draw_case(SENSOR_NONLINEARITY, "same", "few")
    folder = tmp_path_factory.mktemp("case") / "recordings"
    return case, folder, make_case(case, folder)


def test_the_answer_says_what_the_case_says(made: tuple[Case, Path, Sealed]) -> None:
    case, _, sealed = made
    assert (sealed.effect, sealed.effects) == ("sensor_nonlinearity", case.effects)
    assert (sealed.location, sealed.withheld, sealed.form) == (("sensor",), (), "canonical")
    assert (sealed.seed, sealed.stratum, sealed.plan, sealed.base) == (case.seed, "same", "few", case.base)
    assert set(sealed.parameters) == {"a_2", "a_3"}
    assert sealed.strength_over_noise == pytest.approx(case.targets[0], rel=0.1)
    assert (sealed.levels, sealed.deltas) == ((sealed.strength_over_noise,), (sealed.delta,))


def test_a_pair_is_measured_apart_and_together(tmp_path: Path) -> None:
    first = next(i for i, c in enumerate(choices("pair")) if c.effects == ("sensor_drift", "mains_pickup"))
    case = draw_case(first, "pair", "few", levels=(1.0, 10.0))
    assert all(2.0 <= target <= 10.0 for target in case.targets)
    sealed = make_case(case, tmp_path)
    assert (sealed.effects, sealed.location) == (("sensor_drift", "mains_pickup"), ("sensor", "environment"))
    assert sealed.levels == pytest.approx(case.targets, rel=0.1)
    # A ramp and a line are nearly orthogonal: their squares add up, and neither hides in the other.
    assert sealed.delta == pytest.approx(np.hypot(*sealed.deltas), rel=0.02)
    assert sealed.apart == pytest.approx(sealed.deltas, rel=0.02)
    assert sealed.strength_over_noise == pytest.approx(np.hypot(*sealed.levels), rel=0.02)


@pytest.mark.parametrize(
    ("drawn", "needle"),
    [
        (lambda: draw_case(0, "odd"), "stratum = 'odd'"),
        (lambda: draw_case(0, "none", "grand"), "no plan called 'grand'"),
        (lambda: draw_case(-1, "none"), "seed = -1"),
        (lambda: draw_case(0, "none", "few", (2.0, 1.0)), "the smaller one first"),
        (lambda: draw_case(0, "none", "few", (1.0, 2.0), (0.0, 1.0)), "positive"),
        (lambda: Conditions(hysterons=-1), "hysterons"),
        (lambda: Conditions(hysterons=5), "hysterons"),
        (lambda: Conditions(base="preisach"), f"take one of {', '.join(BASES)}"),
        (lambda: Conditions(base=BOUC_WEN, wrong_order=True), "no number of hysterons to state wrongly"),
    ],
)
def test_what_cannot_be_drawn_and_conditions_without_sense_are_refused(
    drawn: Callable[[], object], needle: str
) -> None:
    with pytest.raises(InputRefused, match=needle):
        drawn()


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
    other = draw_case(8, "same", "few", conditions=Conditions(base=BOUC_WEN))
    for case in (more, other):
        assert (case.noise, case.targets, case.recordings) == (plain.noise, plain.targets, plain.recordings)


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


def test_manifest_and_seal_say_what_was_drawn(tmp_path: Path) -> None:
    case = draw_case(4, "none", "few", conditions=Conditions(hysterons=3, wrong_order=True, anchor_error=True))
    sealed = make_case(case, tmp_path / "r")
    manifest = OmegaConf.load(tmp_path / "r" / "recordings.yaml")
    assert manifest["setup"]["hysterons"] == sealed.stated_hysterons != sealed.hysterons == 3
    assert manifest["known"]["m"]["value"] == sealed.stated_mass != sealed.base["m"]
    assert manifest["known"]["m"]["std"] == pytest.approx(0.01 * sealed.stated_mass, rel=1e-2)
    assert set(sealed.base) == {"m", "k", "b", "alpha", *(f"{n}_{i}" for n in ("C", "rho", "d") for i in (1, 2, 3))}
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


def base(family: str, seed: int = 0) -> dict[str, float]:
    return dict(draw_case(seed, "none", "few", conditions=Conditions(base=family)).base)


def envelopes(w: dict[str, float], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bend = w["q_play"] * (np.sqrt(1.0 + (q / w["q_play"]) ** 2) - 1.0)
    return q + (w["lean_play"] - w["gape_play"]) * bend, q + (w["lean_play"] + w["gape_play"]) * bend


def opposing(w: dict[str, float], q: np.ndarray) -> np.ndarray:
    """Voltage of the generalised Prandtl–Ishlinskii model as the operator of the literature, sample by sample."""
    low, high = envelopes(w, q)
    total = np.zeros_like(q)
    for i in range(1, 9):
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


@pytest.mark.parametrize("seed", range(20))
def test_no_cycle_of_plays_gives_energy(seed: int) -> None:
    w = base(PRANDTL_ISHLINSKII, seed)
    # Larger than any displacement of a recording, overshoot included.
    q = np.linspace(-1.6, 1.6, 1001) * w["q_play"]
    low, high = envelopes(w, q)
    assert (np.diff(low) > 0.0).all()
    assert (np.diff(high) > 0.0).all()
    for i in range(1, 9):
        # A play moves up at the lower envelope, down at the upper one: against the voltage each time.
        assert (q - low + w[f"r_play_{i}"] > 0.0).all()
        assert (q - high - w[f"r_play_{i}"] < 0.0).all()
    assert base(BOUC_WEN, seed)["beta_bouc"] > 0.5
    assert min(base(DUHEM, seed)[n] for n in ("up_duhem", "down_duhem")) > 0.0


def test_duhem_approaches_one_force_on_the_way_up_and_another_on_the_way_down() -> None:
    w, drive = base(DUHEM), sine(5.0, periods=2, samples=8000)
    q, z = simulate(w, drive), [0.0]
    for step in np.diff(q):
        end = w["up_duhem"] if step > 0.0 else -w["down_duhem"]
        z.append(end + (z[-1] - end) * np.exp(-abs(step / end)))
    v, a = np.gradient(q, drive.dt), np.gradient(np.gradient(q, drive.dt), drive.dt)
    force = w["alpha"] * (drive.voltage(drive.t) - w["c_duhem"] * np.array(z)) - w["k"] * q - w["b"] * v - w["m"] * a
    # The amplifier's corner lags behind the command by some microseconds.
    assert np.abs(force[400:-2]).max() < 2e-3 * w["alpha"] * PEAK


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
