"""Sets of recordings, and voltages with jumps and kinks between samples: what is sampled, how the actuator responds."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf
from scipy.integrate import solve_ivp

from studies.generator import draw_case, make_case
from studies.generator.plans import DT, HEIGHT, KINKED, Excitation
from studies.generator.world import TABLE, simulate

SEEDS = st.integers(0, 2**31)


def made(kind: str, seed: int) -> Excitation:
    return KINKED[kind](np.random.default_rng(seed))


def borders(excitation: Excitation) -> np.ndarray:
    return np.array([piece.start for piece in excitation.pieces[1:]])


def sides(excitation: Excitation) -> np.ndarray:
    """Voltages just before and at every border, (borders, 2)."""
    pairs = zip(excitation.pieces[:-1], excitation.pieces[1:], strict=True)
    return np.array([[p.voltage(np.array([p.end]))[0], q.voltage(np.array([q.start]))[0]] for p, q in pairs])


@settings(deadline=None)
@given(SEEDS)
@pytest.mark.parametrize("kind", list(KINKED))
def test_pieces_follow_each_other_and_their_borders_lie_between_samples(kind: str, seed: int) -> None:
    drive = made(kind, seed)
    assert drive.pieces[0].start == 0.0
    assert all(p.end == q.start and p.start < p.end for p, q in zip(drive.pieces, drive.pieces[1:], strict=False))
    assert drive.pieces[-1].end == pytest.approx(drive.samples * drive.dt)
    assert drive.dt == DT
    assert not drive.held
    fraction = borders(drive) / DT % 1.0
    assert np.all(np.minimum(fraction, 1.0 - fraction) > 0.0)
    voltage = drive.voltage(drive.t)
    assert voltage[0] == 0.0
    assert np.max(np.abs(voltage)) <= HEIGHT * (1.0 + 1e-9)


@settings(deadline=None)
@given(SEEDS)
def test_a_triangle_has_its_frequency_and_its_height_at_every_corner(seed: int) -> None:
    drive = made("triangle", seed)
    frequency = float(drive.name.split("_")[1].rstrip("Hz"))
    assert min(abs(frequency / f - 1.0) for f in (5.0, 20.0, 60.0)) <= 0.1 + 1e-3
    times, voltages = borders(drive), sides(drive)
    np.testing.assert_allclose(np.diff(voltages, axis=1), 0.0, atol=1e-6)
    np.testing.assert_allclose(voltages[1:, 1], HEIGHT * (-1.0) ** np.arange(times.size - 1), atol=1e-6)
    np.testing.assert_allclose(np.diff(times[1:]), 0.5 / frequency, rtol=1e-6)
    # The closed form of a triangle from the start on.
    since = drive.t - times[0]
    expected = np.where(since > 0.0, 2.0 * HEIGHT / np.pi * np.arcsin(np.sin(2.0 * np.pi * frequency * since)), 0.0)
    np.testing.assert_allclose(drive.voltage(drive.t), expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["step", "ramp", "stair"])
def test_the_simulation_follows_the_continuous_voltage(kind: str) -> None:
    # Radau on the same pieces, started anew at every border; the sampled voltage alone could not give this output.
    w, drive = TABLE, made(kind, 3)
    count = 1600
    wanted = drive.t[:count]

    def dead_zone(e: float, rho: float, d: float) -> float:
        return rho * math.copysign(max(abs(e) - d / 2, 0.0), e)

    x, expected = np.zeros(4), np.zeros(count)
    for piece in drive.pieces:

        def rates(t: float, x: np.ndarray) -> list[float]:
            current, voltage = w["alpha"] * x[3] / w["m"], float(piece.voltage(np.array([t]))[0])  # noqa: B023
            e_1, e_2 = x[0] / w["C_1"], x[1] / w["C_2"]
            force = w["alpha"] * (voltage - e_1 - e_2) - w["k"] * x[2] - w["b"] * x[3] / w["m"]
            slips = [dead_zone(e_1, w["rho_1"], w["d_1"]), dead_zone(e_2, w["rho_2"], w["d_2"])]
            return [current - slips[0], current - slips[1], x[3] / w["m"], force]

        inside = np.flatnonzero((wanted >= piece.start) & (wanted < piece.end))
        if inside.size == 0:
            break
        end = min(piece.end, wanted[-1] + DT)
        times = np.concatenate([wanted[inside], [end]])
        scales = 1e-9 * np.array([4e-6, 4e-6, 1e-4, 1e-5])
        path = solve_ivp(rates, (piece.start, end), x, "Radau", times, rtol=1e-8, atol=scales)
        expected[inside], x = path.y[2, :-1], path.y[:, -1]
    simulated = simulate(w, drive)[:count]
    assert np.max(np.abs(simulated)) > 4e-5
    assert np.max(np.abs(simulated - expected)) < 5e-11


def test_a_folder_says_nothing_of_what_lies_between_the_samples(tmp_path: Path) -> None:
    case = draw_case(7, "none", "short_step")
    make_case(case, tmp_path)
    manifest = OmegaConf.load(tmp_path / "recordings.yaml")
    assert [e.get("input") for e in manifest["recordings"]] == [None] * 4
    drive = case.recordings[-1]
    table = pd.read_csv(tmp_path / f"{drive.name}.csv")
    np.testing.assert_array_equal(table["voltage_V"], drive.voltage(drive.t))
    assert set(table["voltage_V"]) == {0.0, HEIGHT}
    # Voltage and displacement are sampled at one time: the displacement moves by the end of the jump's interval.
    at = int(np.argmax(table["voltage_V"] > 0.0))
    y = table["displacement_um"]
    assert (at - 1) * DT < borders(drive)[0] < at * DT
    assert abs(y[at - 1] - y[0]) < 6.0 * (case.noise.deviation + case.noise.step) * 1e6
    assert y[at + 5] - y[0] > 10.0
