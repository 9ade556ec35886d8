"""Several inputs and outputs: arrays of a periodic experiment on two masses, read, identified and predicted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from phnn.cli import main
from phnn.configuration import config_folder
from phnn.recordings import read

TRUE = {"k_1": 700.0, "k_2": 1300.0, "k_12": 350.0, "m_1": 0.22, "m_2": 0.27, "b_1": 0.6, "b_2": 0.7}
RATE, SAMPLES, NOISE = 400.0, 400, 2e-6
LINES, FORCE = 50, 8.0
MANIFEST = """
setup: {network: two_masses.yaml}
sample_rate_hz: 400
start: periodic
input: band_limited
axes: [time, channel, realisation, period]
columns: {input: {column: 0, unit: N}}
ports: {force_2: {column: 1, unit: N}}
outputs: {q_1: {column: 2, unit: mm}, q_2: {column: 3, unit: mm}}
recordings:
  - {file: [u.npy, y.npy], name: train, use: identification}
  - {file: [u_test.npy, y_test.npy], name: test, use: confirmation}
"""


def answered(u: np.ndarray) -> np.ndarray:
    """(samples, 2) steady answer [m] to a period of forces (samples, 2), line by line in closed form."""
    s = 2.0j * np.pi * np.fft.rfftfreq(SAMPLES, 1.0 / RATE)
    p = TRUE
    stiffness = np.empty((s.size, 2, 2), complex)
    stiffness[:, 0, 0] = p["m_1"] * s**2 + p["b_1"] * s + p["k_1"] + p["k_12"]
    stiffness[:, 1, 1] = p["m_2"] * s**2 + p["b_2"] * s + p["k_2"] + p["k_12"]
    stiffness[:, 0, 1] = stiffness[:, 1, 0] = -p["k_12"]
    lines = np.linalg.solve(stiffness, np.fft.rfft(u, axis=0)[:, :, None])[:, :, 0]
    return np.asarray(np.fft.irfft(lines, SAMPLES, axis=0))


def experiment(realisations: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces [N] and noisy displacements [mm]: (time, channel, realisation, period)."""
    rng = np.random.default_rng(seed)
    u, y = (np.empty((SAMPLES, 2, realisations, 2)) for _ in range(2))
    lines = slice(1, LINES + 1)
    for r in range(realisations):
        spectrum = np.zeros((SAMPLES // 2 + 1, 2), complex)
        spectrum[lines] = np.exp(2.0j * np.pi * rng.random((LINES, 2)))
        one = FORCE * np.fft.irfft(spectrum, SAMPLES, axis=0)
        u[:, :, r, :] = one[:, :, None]
        y[:, :, r, :] = 1e3 * (answered(one)[:, :, None] + NOISE * rng.standard_normal((SAMPLES, 2, 2)))
    return u, y


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("masses")
    for name, realisations, seed in (("", 2, 1), ("_test", 1, 2)):
        u, y = experiment(realisations, seed)
        np.save(made / f"u{name}.npy", u)
        np.save(made / f"y{name}.npy", y)
    (made / "two_masses.yaml").write_text((config_folder() / "network" / "two_masses.yaml").read_text())
    (made / "recordings.yaml").write_text(MANIFEST)
    return made


def test_every_output_of_every_realisation_is_a_recording(folder: Path) -> None:
    campaign = read(folder)
    names = ["train_1.q_1", "train_1.q_2", "train_2.q_1", "train_2.q_2", "test.q_1", "test.q_2"]
    assert [r.name for r in campaign.recordings] == names
    u, y = np.load(folder / "u.npy"), np.load(folder / "y.npy")
    r = campaign.recordings[3]
    assert (r.measures, list(r.further), r.units) == ("q_2", ["force_2"], ("N", "m"))
    # Periods follow one another.
    np.testing.assert_array_equal(r.u, u[:, 0, 1, :].T.ravel())
    np.testing.assert_array_equal(r.further["force_2"], u[:, 1, 1, :].T.ravel())
    np.testing.assert_allclose(r.y, 1e-3 * y[:, 1, 1, :].T.ravel(), rtol=1e-12)
    assert r.period == pytest.approx(SAMPLES / RATE)
    assert r.noise == pytest.approx(NOISE, rel=0.1)


@pytest.mark.slow
def test_the_masses_are_identified_and_predict(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(folder), "--out", str(tmp_path / "out"), "starts=1"]) == 0
    content = json.loads((tmp_path / "out" / "identify.json").read_text())
    for name, true in TRUE.items():
        found = content["parameters"][name]
        assert abs(found["value"] - true) < 5.0 * found["std"], name
        assert found["value"] == pytest.approx(true, rel=0.01), name
    for name, score in content["fit"].items():
        assert score["residual_over_noise"] < 1.15, name
    assert main(["predict", str(tmp_path / "out" / "base"), str(folder), "--out", str(tmp_path / "y")]) == 0
    predicted = pd.read_csv(tmp_path / "y" / "test.q_2.csv")
    measured = read(folder).recordings[5].y
    assert np.std(predicted["displacement_m"] - measured) < 1.15 * NOISE
    assert "train_2.q_1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("force_2: {", "force_3: {", ("ports", "'force_3'", "force_2")),
        ("q_2: {", "q_3: {", ("outputs", "'q_3'", "q_1, q_2")),
        ("realisation, period]", "period]", ("u.npy", "(400, 2, 2, 2)", "name as many")),
        ("realisation, period]", "realisation, time]", ("axes", "each once")),
        ("[time, channel", "[times, channel", ("axes", "'times'", "accepted are time")),
        ("[u.npy, y.npy]", "[u.npy, y_test.npy]", ("u.npy, y_test.npy", "different shapes")),
        ("column: 3", "column: 4", ("column 4 does not exist",)),
        ("force_2: {column: 1, unit: N}", "force: {column: 1, unit: N}", ("'force'", "name of a quantity")),
    ],
)
def test_what_does_not_fit_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: tuple[str, ...]
) -> None:
    assert old in MANIFEST
    (tmp_path / "recordings.yaml").write_text(
        MANIFEST.replace(old, new, 1).replace("two_masses.yaml", str(folder / "two_masses.yaml"))
    )
    said = ["--manifest", str(tmp_path / "recordings.yaml"), "--out", str(tmp_path / "out")]
    assert main(["identify", str(folder), *said]) == 2
    message = capsys.readouterr().err
    for word in words:
        assert word in message


def test_a_diagnosis_says_that_it_follows_one_input_to_one_output(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(folder), "--out", str(tmp_path / "out")]) == 2
    assert "one input to one output" in capsys.readouterr().err


def test_a_check_knows_of_further_inputs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(folder)]) == 0
    text = capsys.readouterr().out
    assert "driven too at force_2" in text
    # What another input does is no lead of an output over this one.
    assert "leads the input" not in text
    assert "resonances, and further modes" in text.split("They cannot show")[0]


def rewritten(folder: Path, target: Path, *changes: tuple[str, str]) -> Path:
    """The folder's manifest with changes."""
    text = MANIFEST.replace("two_masses.yaml", str(folder / "two_masses.yaml"))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (target / "recordings.yaml").write_text(text)
    return target / "recordings.yaml"


@pytest.mark.slow
def test_a_start_may_be_unknown(folder: Path, tmp_path: Path) -> None:
    manifest = rewritten(folder, tmp_path, ("start: periodic", "start: unknown"))
    said = ["--manifest", str(manifest), "--out", str(tmp_path / "out"), "starts=1"]
    assert main(["identify", str(folder), *said]) == 0
    content = json.loads((tmp_path / "out" / "identify.json").read_text())
    for name, true in TRUE.items():
        assert content["parameters"][name]["value"] == pytest.approx(true, rel=0.02), name


def test_the_axes_say_what_a_period_is(folder: Path, tmp_path: Path) -> None:
    for name in ("u", "y", "u_test", "y_test"):
        np.save(tmp_path / f"{name}.npy", np.load(folder / f"{name}.npy")[..., 0])
    manifest = rewritten(folder, tmp_path, ("realisation, period]", "realisation]"))
    recordings = read(tmp_path, manifest, allow_outside=True).recordings
    assert [r.t.size for r in recordings] == [SAMPLES] * 6
    assert {r.cycle for r in recordings} == {SAMPLES}
    said = ["--manifest", str(manifest), "--out", str(tmp_path.parent / "periods"), "--allow-outside", "starts=1"]
    assert main(["identify", str(tmp_path), *said]) == 0
    content = json.loads((tmp_path.parent / "periods" / "identify.json").read_text())
    for name, true in TRUE.items():
        assert content["parameters"][name]["value"] == pytest.approx(true, rel=0.02), name


def test_a_slice_is_taken_of_every_realisation(folder: Path, tmp_path: Path) -> None:
    manifest = rewritten(folder, tmp_path, ("name: train, use", f"name: train, slice: [{SAMPLES}, {2 * SAMPLES}], use"))
    u = np.load(folder / "u.npy")
    campaign = read(folder, manifest)
    for r, index in ((campaign.recordings[0], 0), (campaign.recordings[3], 1)):
        np.testing.assert_array_equal(r.u, u[:, 0, index, 1])
    (tmp_path / "recordings.yaml").write_text(manifest.read_text().replace(f"{2 * SAMPLES}]", f"{2 * SAMPLES + 1}]"))
    assert main(["check", str(folder), "--manifest", str(manifest)]) == 2


def test_every_input_counts_for_period_and_noise(folder: Path, tmp_path: Path) -> None:
    """Forces of 4 and of 3 Hz repeat together every second; with one of 4 and of e Hz nothing repeats."""
    t = np.arange(4000) / RATE
    for name, other in (("both", 3.0), ("never", float(np.e))):
        u = np.column_stack([np.sin(2.0 * np.pi * f * t) for f in (4.0, other)])
        y = 1e-3 * u + NOISE * np.random.default_rng(4).standard_normal(u.shape)
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack([u, y]))
    (tmp_path / "two_masses.yaml").write_text((folder / "two_masses.yaml").read_text())
    rows = "recordings: [{file: both.txt}, {file: never.txt}]\n"
    head = MANIFEST.split("axes:")[0].replace("start: periodic", "start: unknown")
    columns = MANIFEST.split("period]")[1].split("recordings:")[0].replace("unit: mm", "unit: m")
    (tmp_path / "recordings.yaml").write_text(head + columns + rows)
    both, never = read(tmp_path).recordings[::2]
    assert both.period == pytest.approx(1.0)
    assert never.period is None
    assert both.noise == pytest.approx(NOISE, rel=0.1)
    assert never.noise < 3.0 * NOISE
