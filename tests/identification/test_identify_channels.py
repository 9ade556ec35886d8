"""Several inputs and outputs in one fit, and the gain of an element on recordings that took no part in finding it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from junctions import recording as made
from scipy.signal import lfilter

from phnn.cli import main
from phnn.configuration import config_folder
from phnn.identification.evaluate import Evaluation, score_part
from phnn.identification.prepare import gain
from phnn.recordings import read
from phnn.recordings.recording import Part, Recording
from phnn.setup import Own

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
        ("[time, channel", "[times, channel", ("axes", "'times'", "accepted are realisation, period, time")),
        ("[u.npy, y.npy]", "[u.npy, y_test.npy]", ("u.npy, y_test.npy", "different shapes")),
        ("column: 3", "column: 4", ("column 4 does not exist",)),
        ("force_2: {column: 1, unit: N}", "force: {column: 1, unit: N}", ("'force'", "name of a quantity")),
    ],
)
def test_what_does_not_fit_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: tuple[str, ...]
) -> None:
    said = ["--manifest", str(rewritten(folder, tmp_path, (old, new))), "--out", str(tmp_path / "out")]
    assert main(["identify", str(folder), *said]) == 2
    message = capsys.readouterr().err
    for word in words:
        assert word in message


def test_a_diagnosis_says_that_it_follows_one_output(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(folder), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "several outputs (`outputs` in recordings.yaml), but a diagnosis follows one output" in told


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


GAIN_NOISE = 4e-8
GAIN_RATE = 1e4
COLOURS = {"white": ([1.0], [1.0]), "slow": ([1.0], [1.0, -0.9]), "ringing": ([1.0], [1.0, -1.7, 0.95])}


def noise(rng: np.random.Generator, size: int, colour: str = "white") -> np.ndarray:
    """(N,) of unit variance."""
    b, a = COLOURS[colour]
    impulse = lfilter(b, a, np.eye(1, 4000)[0])
    return np.asarray(lfilter(b, a, rng.standard_normal(size + 500))[500:] / np.linalg.norm(impulse))


def recording(
    name: str, y: np.ndarray, use: str = "confirmation", first: int = 0, scale: float = GAIN_NOISE
) -> Recording:
    t = np.arange(y.size) / GAIN_RATE
    u = np.sin(2.0 * np.pi * 40.0 * t)
    return made(t, u, name=name, y=scale * y, parts=(Part(name, first, y.size, use),), noise=scale)


def models(recordings: list[Recording], *outputs: list[np.ndarray]) -> list[Evaluation]:
    """Evaluations of outputs in units of the noise."""
    found = []
    for each in outputs:
        scaled = {r.name: r.noise * y for r, y in zip(recordings, each, strict=True)}
        parts = [score_part(r, scaled[r.name], p.first, p.last, p.name, p.use) for r in recordings for p in r.parts]
        found.append(Evaluation(scaled, tuple(parts)))
    return found


@pytest.mark.parametrize(
    ("shape", "colour"),
    [
        pytest.param(shape, colour, marks=() if (shape, colour) == ("burst", "slow") else pytest.mark.slow)
        for shape in ("tone", "burst", "noise")
        for colour in COLOURS
    ],
)
def test_without_a_gain_the_error_falls_significantly_as_often_as_chance_says(colour: str, shape: str) -> None:
    rng = np.random.default_rng(11)
    size, count, level = 3000, 400, 0.05
    t = np.arange(size) / GAIN_RATE
    hits = 0
    for _ in range(count):
        recordings, wrong, none = [], [], []
        for name in "abc":
            # The truth lies half-way between the two models: both are as far from it.
            change = {
                "tone": 0.3 * np.sin(2.0 * np.pi * 810.0 * t + rng.uniform(0.0, 6.0)),
                "burst": 0.8 * np.exp(-t / 0.02) * np.sin(2.0 * np.pi * 810.0 * t),
                "noise": 0.3 * noise(rng, size, colour),
            }[shape]
            recordings.append(recording(name, 0.5 * change + noise(rng, size, colour)))
            wrong.append(change)
            none.append(np.zeros(size))
        found = gain(*models(recordings, none, wrong), recordings, "confirmation", 8)
        assert found is not None and found.falls is not None
        hits += found.falls < level
    # Three standard deviations of a binomial share, and a percent for what correlation is left between blocks.
    assert hits / count < level + 0.01 + 3.0 * np.sqrt(level * (1.0 - level) / count), hits / count


@pytest.mark.parametrize("where", ["everywhere", "in one recording", "at the beginning"])
def test_a_gain_is_seen_wherever_it_lies(where: str) -> None:
    rng, size = np.random.default_rng(12), 6000
    t = np.arange(size) / GAIN_RATE
    tone = np.sin(2.0 * np.pi * 90.0 * t)
    missing = {
        "everywhere": [0.2 * tone] * 4,
        "in one recording": [0.6 * tone, *[0.0 * tone] * 3],
        "at the beginning": [4.0 * np.exp(-t / 0.01) * tone] * 4,
    }[where]
    recordings = [recording(n, x + noise(rng, size)) for n, x in zip("abcd", missing, strict=True)]
    before, after = models(recordings, [0.0 * x for x in missing], missing)
    found = gain(before, after, recordings, "confirmation", 8)
    assert found is not None and found.falls is not None and found.falls < 1e-3
    assert found.before == pytest.approx(before.over_noise("confirmation"))
    assert found.after == pytest.approx(after.over_noise("confirmation"))
    assert found.rms == pytest.approx(GAIN_NOISE * np.sqrt(np.mean(np.square(missing))), rel=0.2)
    reverse = gain(after, before, recordings, "confirmation", 8)
    assert reverse is not None and reverse.rms == pytest.approx(-found.rms)
    assert reverse.falls is not None and reverse.falls > 0.99


def test_only_the_scored_samples_of_one_use_count() -> None:
    rng, size = np.random.default_rng(13), 2000
    held = recording("a", noise(rng, size), first=100)
    other = recording("b", noise(rng, size), "identification")
    spoilt = np.where(np.arange(size) < 100, 50.0, 0.0)
    before, after = models([held, other], [spoilt, spoilt], [0.0 * spoilt, 0.0 * spoilt])
    found = gain(before, after, [held, other], "confirmation", 8)
    assert found is not None and found.rms == 0.0 and found.falls == 0.5
    assert gain(before, after, [other], "confirmation", 8) is None


def test_an_error_of_the_zero_proves_nothing() -> None:
    rng, size, count = np.random.default_rng(14), 2000, 300
    hits = 0
    for _ in range(count):
        # One zero a recording, a seventh of the noise wrong, and a model that shifts the output by as much.
        made = [recording(n, 0.05 + 0.14 * rng.standard_normal() + noise(rng, size)) for n in "ab"]
        found = gain(*models(made, [np.zeros(size)] * 2, [np.full(size, 0.1)] * 2), made, "confirmation", 8)
        assert found is not None and found.falls is not None
        hits += found.falls < 0.01
    assert hits == 0


def test_lines_that_are_fitted_to_noise_gain_nothing() -> None:
    rng, size, own = np.random.default_rng(15), 400, Own(lines=tuple(np.arange(1.0, 9.0) * 50.0))
    shares = []
    for _ in range(200):
        made = recording("a", noise(rng, size))
        phase = 2.0 * np.pi * np.outer(made.t, own.lines)
        columns = np.hstack([np.ones((size, 1)), np.cos(phase), np.sin(phase)])
        fitted = columns @ np.linalg.lstsq(columns, made.y / GAIN_NOISE, rcond=None)[0]
        mean = np.full(size, made.y.mean() / GAIN_NOISE)
        found = gain(*models([made], [mean], [fitted]), [made], "confirmation", 8, (Own(), own))
        assert found is not None
        shares.append(found.before**2 - found.after**2)
    assert abs(np.mean(shares)) < 4.0 * np.std(shares) / np.sqrt(len(shares))
    assert np.std(shares) > 0.0


def test_what_is_coherent_over_a_recording_is_one_observation_and_no_test() -> None:
    size = 4000
    drift = np.linspace(-1.0, 1.0, size) ** 3
    made = [recording(n, 100.0 * drift) for n in "ab"]
    found = gain(*models(made, [0.0 * drift] * 2, [60.0 * drift] * 2), made, "confirmation", 8)
    assert found is not None and found.falls is None
    assert found.after < 0.5 * found.before
