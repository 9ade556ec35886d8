"""Folders that conceal an effect: reproducible, readable, sealed, as strong as intended; their voltages and plans."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf
from scipy.signal import welch
from scipy.stats import t as student

from phnn.errors import InputRefused, SolverFailed
from studies.generator import EFFECTS, ON_REQUEST, Sealed, draw_case, generate, make_case, open_seal, write_seal
from studies.generator.make import find_strength
from studies.generator.noise import FAMILIES, HEAVY, JITTERED, PINK, PROCESS, Noise
from studies.generator.plans import DT, HEIGHT, KINKED, Excitation, plan_of
from studies.generator.world import TABLE, simulate, simulate_all

# SHA-256 of what drives the recordings (see `digest`) and of the seal. The seal of a case that conceals nothing holds
# drawn numbers only: its bytes are the same on every machine. Displacements are not, for the linear algebra of a
# processor decides on their last bits and with them on steps of the sensor: of each recording there is one sum (see
# `sums`), which other noise would change by many times its tolerance.
NOTHING = {
    (3, "few"): (
        "9edd3dd36764e1780c9440c27a1a02e3338eb59be4433fa51cdbbc3e34d44a0d",
        "0920fe9be4066fbbb39dc7b46e34148767c034185ebfac8f50b6ab7a668390ac",
        [-434.023, -1347.922],
    ),
    (4, "full"): (
        "3b1f3dc08b4bb240e5da99c75c33d0ba40b614b01146e710a532a5958062f049",
        "07ac120a7d894c9aae94599ca74033c17f3695bdde26fbb9dd4094dcedb889c5",
        [-5368.393, -5119.411, -9745.03, 1477.383, -682.28, 2141.799, 2043.183, -2000.252, -6417.821, -634.168,
         -741.499, -93.888, -7202.717],
    ),
}  # fmt: skip
PARAMETERS, DELTA = {"a_2": 181.23941968713712, "a_3": -480798.26460422185}, 519.9229033283128
# Sums agree to so much [µm] on every processor, and strengths, which a search finds, to this share.
TOLERANCE, STRENGTH = 0.1, 3e-4


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Sealed]:
    folder = tmp_path_factory.mktemp("demo") / "recordings"
    return folder, generate(5, folder, "creep", "short")


def test_a_folder_does_not_tell_what_it_conceals(made: tuple[Path, Sealed]) -> None:
    folder, sealed = made
    for excitation in plan_of("short"):
        table = pd.read_csv(folder / f"{excitation.name}.csv")
        np.testing.assert_array_equal(table["voltage_V"], excitation.voltage(excitation.t))
        steps = table["displacement_um"] / (sealed.quantisation * 1e6)
        assert np.max(np.abs(steps - np.round(steps))) < 1e-3 / (sealed.quantisation * 1e6)
    written = "".join(p.read_text() for p in folder.iterdir())
    assert not any(name in written for name in (*EFFECTS, *ON_REQUEST))


def test_strength_is_what_a_refit_of_the_base_cannot_take(made: tuple[Path, Sealed]) -> None:
    # Measured again in another way: one-sided sensitivities, the zeros as explicit columns, least squares.
    _, sealed = made
    plan = plan_of("short")
    base = simulate_all(sealed.base, plan)
    moved = simulate_all({**sealed.base, **sealed.parameters}, plan)
    columns = []
    for name in TABLE:
        ahead = simulate_all({**sealed.base, name: sealed.base[name] * 1.003}, plan)
        columns.append(np.concatenate([(a - b) / 0.003 for a, b in zip(ahead, base, strict=True)]))
    sizes = [len(b) for b in base]
    columns += list(np.repeat(np.eye(len(sizes)), sizes, axis=1) * 1e-5)
    change = np.concatenate([a - b for a, b in zip(moved, base, strict=True)])
    matrix = np.stack(columns, axis=1)
    fitted, *_ = np.linalg.lstsq(matrix, change, rcond=1e-6)
    left = np.sqrt(np.mean((change - matrix @ fitted) ** 2)) / sealed.noise
    assert left == pytest.approx(sealed.strength_over_noise, rel=0.1)
    assert 1.4 < sealed.strength_over_noise < 10.3


def test_seal_survives_the_round_trip_and_betrays_a_change(tmp_path: Path, made: tuple[Path, Sealed]) -> None:
    _, sealed = made
    path = tmp_path / "kept" / "sealed.json"
    digest = write_seal(sealed, path)
    assert open_seal(path) == sealed
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    # What a case was not asked for is left out: the bytes of a seal are those that it had before there was a choice.
    names = list(asdict(sealed))
    stated = {n: asdict(sealed)[n] for n in names[: names.index("redrawn") + 1]}
    assert json.loads(path.read_text()) == json.loads(json.dumps(stated))
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(("content", "needle"), [(None, "cannot be read"), (b"\xff{", "json"), (b"{}", "no sealed")])
def test_what_is_no_seal_is_refused(tmp_path: Path, content: bytes | None, needle: str) -> None:
    path = tmp_path / "sealed.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputRefused, match=needle):
        open_seal(path)


def test_what_cannot_be_made_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="telepathy"):
        generate(0, tmp_path / "r", "telepathy")
    (tmp_path / "old.csv").touch()
    with pytest.raises(InputRefused, match=r"holds old\.csv"):
        generate(0, tmp_path, "none", "short")
    with pytest.raises(InputRefused, match="is a file"):
        generate(0, tmp_path / "old.csv", "none", "short")
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_the_search_finds_the_strength_of_a_power_law(power: float) -> None:
    calls = []

    def residual(strength: float) -> float:
        calls.append(strength)
        return 7.0 * strength**power

    strength, left = find_strength(residual, 1e-3, 1e6, 3.0)
    assert left == pytest.approx(3.0, rel=0.02)
    assert 7.0 * strength**power == left
    assert len(calls) < 12


def test_the_search_crosses_a_threshold_and_a_plateau_and_gives_up_in_the_open() -> None:
    strength, _ = find_strength(lambda z: max(z - 2.0, 0.0), 1e-2, 1e3, 0.5)
    assert strength == pytest.approx(2.5, rel=0.01)
    strength, _ = find_strength(lambda z: 1.0 / (1.0 + np.exp(-40.0 * (z - 1.0))), 0.1, 10.0, 0.5)
    assert strength == pytest.approx(1.0, rel=0.01)
    with pytest.raises(SolverFailed, match="draw another seed"):
        find_strength(lambda z: z / (1.0 + z), 0.1, 10.0, 2.0)


def digest(folder: Path) -> str:
    """Hash of the manifest, of all times and voltages; these to a nanovolt, for the last bit of a sine depends on the
    processor."""
    found = hashlib.sha256((folder / "recordings.yaml").read_bytes())
    for path in sorted(folder.glob("*.csv")):
        table = pd.read_csv(path)[["time_s", "voltage_V"]]
        found.update(path.name.encode())
        found.update(table.round(9).to_csv(index=False, float_format="%.9f").encode())
    return found.hexdigest()


def sums(folder: Path) -> list[float]:
    """Of each recording the displacements, µm, with weights that no motion follows."""
    found = []
    for path in sorted(folder.glob("*.csv")):
        y = pd.read_csv(path)["displacement_um"].to_numpy()
        found.append(float(np.cos(0.7 * np.arange(y.size) ** 2 % (2.0 * np.pi)) @ y))
    return found


@pytest.mark.parametrize("chosen", [(3, "few"), pytest.param((4, "full"), marks=pytest.mark.slow)], ids=str)
def test_a_case_that_conceals_nothing_stays_what_it_was(tmp_path: Path, chosen: tuple[int, str]) -> None:
    seed, plan = chosen
    sealed = make_case(draw_case(seed, "none", plan), tmp_path / "recordings")
    seal = write_seal(sealed, tmp_path / "sealed.json")
    driven, sealed_by, expected = NOTHING[chosen]
    assert (digest(tmp_path / "recordings"), seal) == (driven, sealed_by)
    assert sums(tmp_path / "recordings") == pytest.approx(expected, abs=TOLERANCE)


def test_a_concealed_effect_stays_what_it_was(tmp_path: Path) -> None:
    sealed = make_case(draw_case(21, "same", "few"), tmp_path / "recordings")
    assert sealed.effect == "sensor_nonlinearity"
    assert sealed.parameters == pytest.approx(PARAMETERS, rel=STRENGTH)
    assert sealed.delta == pytest.approx(DELTA, rel=STRENGTH)


SEEDS = st.integers(0, 2**31)


def plans_made(kind: str, seed: int) -> Excitation:
    return KINKED[kind](np.random.default_rng(seed))


def borders(excitation: Excitation) -> np.ndarray:
    return np.array([piece.start for piece in excitation.pieces[1:]])


@settings(deadline=None)
@given(SEEDS)
@pytest.mark.parametrize("kind", list(KINKED))
def test_pieces_follow_each_other_and_their_borders_lie_between_samples(kind: str, seed: int) -> None:
    drive = plans_made(kind, seed)
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


@pytest.mark.parametrize("kind", ["step", "stair"])
def test_the_simulation_follows_the_voltage_between_the_samples(kind: str) -> None:
    # Where no hysteron slips the actuator is a linear oscillator: a sum of its responses to every step of the voltage.
    drive = plans_made(kind, 3)
    stiffness = TABLE["k"] + TABLE["alpha"] ** 2 * (1.0 / TABLE["C_1"] + 1.0 / TABLE["C_2"])
    pole = np.roots([TABLE["m"], TABLE["b"], stiffness])[0]
    levels = [float(piece.voltage(np.array([piece.start]))[0]) for piece in drive.pieces]
    expected = np.zeros(drive.samples)
    for piece, height in zip(drive.pieces, np.diff(levels, prepend=0.0), strict=True):
        t = np.maximum(drive.t - piece.start, 0.0)
        decayed = (np.exp(pole * t) * (1.0 + 1j * pole.real / pole.imag)).real
        expected += TABLE["alpha"] / stiffness * height * (1.0 - decayed)
    simulated = simulate({**TABLE, "d_1": 1e4, "d_2": 1e4}, drive)
    assert np.max(np.abs(simulated)) > 1e-5
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


COUNT = 200_000


def _drawn(noise: Noise, seed: int = 0) -> np.ndarray:
    return noise.drawn(COUNT, np.random.default_rng(seed))


def _errors(folder: Path, outputs: tuple[np.ndarray, ...], names: list[str]) -> list[np.ndarray]:
    """Recorded minus simulated, each without its mean."""
    tables = [pd.read_csv(folder / f"{name}.csv") for name in names]
    errors = [table["displacement_um"].to_numpy() * 1e-6 - q for table, q in zip(tables, outputs, strict=True)]
    return [e - e.mean() for e in errors]


@pytest.mark.parametrize("colour", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("step", [0.0, 20e-9, 60e-9])
def test_whitened_noise_with_rounding_is_white_of_unit_variance(colour: float, step: float) -> None:
    noise = Noise(40e-9, step, colour)
    n = noise.drawn(COUNT, np.random.default_rng(1))
    if step > 0.0:
        n = np.round(n / step) * step
    white = noise.whitened(n)
    assert white.std() == pytest.approx(1.0, rel=0.01)
    for lag in (1, 2, 3):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4.0 / np.sqrt(COUNT)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_the_share_of_pink_noise_is_the_stated_one(share: float) -> None:
    noise = Noise(50e-9, 10e-9, 0.0, PINK, share)
    paths = np.stack([noise.drawn(4096, np.random.default_rng(seed)) for seed in range(300)])
    assert np.std(paths) == pytest.approx(50e-9, rel=0.02)
    # White noise alone has the density (1 − share) σ² at Nyquist's frequency, one-sided twice that over the rate.
    f, density = welch(paths, 1.0, nperseg=1024)
    lines = np.arange(1, 4096)
    at = np.array([0.02, 0.45])
    # Line k lies at k/8192; 1/(Σ 1/k) of the pink power per line, times 1/k.
    expected = 50e-9**2 * (2.0 * (1.0 - share) + share / np.sum(1.0 / lines) / at)
    measured = [np.mean(density[:, np.abs(f - a) < 0.004]) for a in at]
    np.testing.assert_allclose(measured, expected, rtol=0.05)


def test_heavy_tails_are_those_of_student_s_t_with_the_stated_deviation() -> None:
    n = _drawn(Noise(50e-9, 10e-9, 0.0, HEAVY, 3.0)) / 50e-9
    # Variance 3 of the distribution with three degrees of freedom becomes 1.
    levels = np.array([0.001, 0.01, 0.1, 0.25, 0.75, 0.9, 0.99, 0.999])
    np.testing.assert_allclose(np.quantile(n, levels), student.ppf(levels, 3.0) / math.sqrt(3.0), rtol=0.08)


@pytest.mark.parametrize("share", [0.5, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.03, 0.1))])
def test_the_share_of_process_noise_is_the_stated_one(tmp_path: Path, share: float) -> None:
    case = draw_case(5, "none", "few", noise=f"process:{share}")
    sealed = make_case(case, tmp_path / "r")
    assert sealed.noise_unrecorded == pytest.approx(share, rel=0.1)
    assert sealed.noise_total == pytest.approx(math.hypot(sealed.noise, sealed.quantisation / 12**0.5), rel=0.03)
    # Measured again from the folder: what the sensor adds is white, so neighbours are related by the plant alone.
    errors = _errors(tmp_path / "r", simulate_all(case.base, case.recordings), [e.name for e in case.recordings])
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) == pytest.approx(sealed.noise_total, rel=1e-3)
    related = np.mean([np.mean(e[1:] * e[:-1]) / np.mean(e**2) for e in errors])
    # An oscillator of 900 Hz sampled at 10 kHz: neighbours of its part are related by some 0.85.
    assert related == pytest.approx(0.85 * share, abs=0.06)


def test_the_variance_of_jittered_noise_grows_with_the_square_of_the_speed(tmp_path: Path) -> None:
    case = draw_case(6, "none", "few", noise="jittered:2")
    sealed = make_case(case, tmp_path)
    outputs = simulate_all(case.base, case.recordings)
    errors = np.concatenate(_errors(tmp_path, outputs, [e.name for e in case.recordings]))
    speeds = [np.gradient(q, e.dt) for q, e in zip(outputs, case.recordings, strict=True)]
    fastest = max(float(np.sqrt(np.mean(v**2))) for v in speeds)
    slope, rest = np.polyfit(np.concatenate(speeds) ** 2, errors**2, 1)
    assert math.sqrt(slope) == pytest.approx(2.0 * sealed.noise / fastest, rel=0.06)
    assert math.sqrt(rest) == pytest.approx(math.hypot(sealed.noise, sealed.quantisation / 12**0.5), rel=0.1)
    assert sealed.noise_unrecorded == pytest.approx(
        slope * np.mean(np.concatenate(speeds) ** 2) / sealed.noise_total**2, rel=0.1
    )
    # The faster recording is the louder one.
    assert max(sealed.noise_rms.values()) > 2.0 * sealed.noise > 1.5 * min(sealed.noise_rms.values())


@pytest.mark.parametrize("family", list(FAMILIES))
def test_a_family_changes_nothing_but_the_noise(tmp_path: Path, family: str, brief: str) -> None:
    plain, asked = (draw_case(5, "none", brief, noise=n) for n in (None, family))
    assert (asked.base, asked.recordings, asked.family) == (plain.base, plain.recordings, family)
    assert asked.noise.deviation == plain.noise.deviation
    sealed, again = make_case(asked, tmp_path / "a"), make_case(asked, tmp_path / "b")
    assert sealed == again
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
    errors = _errors(tmp_path / "a", simulate_all(plain.base, plain.recordings), list(sealed.noise_rms))
    np.testing.assert_allclose([e.std() for e in errors], list(sealed.noise_rms.values()), rtol=1e-3)
    assert not any(
        name in path.read_text() for path in (tmp_path / "a").iterdir() for name in (JITTERED, PROCESS, PINK)
    )


@pytest.mark.parametrize("noise", ["violet", "process:1", "process:0", "process:much", "heavy:2", "white:1", "pink:"])
def test_what_is_no_noise_is_refused(noise: str) -> None:
    with pytest.raises(InputRefused, match=f"noise = '{noise}'"):
        draw_case(0, "none", noise=noise)
