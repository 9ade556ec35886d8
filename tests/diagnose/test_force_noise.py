"""Noise that passes through the plant: its spectrum, and the lines that short recordings seem to have by it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from junctions import recording
from scipy.signal import lfilter

import phnn
from phnn.derivatives import output_derivatives
from phnn.diagnose.lines import force_noise, own_score, spectra_of
from phnn.diagnose.locations import locate
from phnn.errors import StructureViolated
from phnn.models.actuator import hrc
from phnn.network import small_signal
from phnn.network.small_signal import output_gain
from phnn.recordings import Campaign, read
from phnn.recordings.recording import Start
from phnn.setup import DRIFT_TERMS, Own
from phnn.trajectory import simulate
from tests import campaigns

BODY = """
junctions: {supply: 1, body: 0}
elements:
  warmth: {type: C, junction: body, law: capacitor, parameters: [one], unit: K}
  loss: {type: R, junction: body, law: linear, parameters: [g], direction: conductance}
  heater: {type: Sf, junction: supply, unit: W}
bonds:
  - {type: TF, from: supply, to: body, ratio: c}
parameters:
  c: {value: 0.02, unit: K/J, positive: true}
  one: {value: 1.0, unit: "1", fixed: true}
  g: {value: 0.1, unit: 1/s, positive: true}
output: warmth
"""
MANIFEST = """setup: {network: body.yaml}
columns: {time: {column: 0, unit: s}, input: {column: 1, unit: W}, output: {column: 2, unit: K}}
"""
CAPACITY, RATE, NOISE = 0.05, 0.03, 0.05


@pytest.fixture(scope="module")
def heated(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Recordings of steps of the heater, by the exact solution of ``Ṫ = c P − g T``."""
    folder = tmp_path_factory.mktemp("heated")
    (folder / "body.yaml").write_text(BODY, encoding="utf-8")
    (folder / "recordings.yaml").write_text(MANIFEST, encoding="utf-8")
    rng = np.random.default_rng(3)
    for name, levels in {"up": (0.0, 10.0, 4.0), "down": (0.0, 15.0, 0.0), "short": (0.0, 6.0, 12.0)}.items():
        power, kept = np.repeat(levels, 200), np.exp(-0.5 * RATE)
        warmth = np.zeros(power.size)
        for n in range(power.size - 1):
            warmth[n + 1] = kept * warmth[n] + (1.0 - kept) * CAPACITY / RATE * power[n]
        table = {"t": 0.5 * np.arange(power.size), "P": power, "T": warmth + NOISE * rng.standard_normal(power.size)}
        pd.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    return read(folder)


def test_nothing_is_missing_and_the_parameters_are_right(heated: Campaign) -> None:
    found = phnn.diagnose(heated)
    assert (found.verdict, found.ended.warnings) == ("none", ())
    values = found.final.setup.values()
    assert [values["c"], values["g"]] == pytest.approx([CAPACITY, RATE], rel=0.01)
    assert np.isfinite(list(locate(found.linearised[0]).scores.values())).all()


def test_the_rate_of_the_output_is_its_change_and_no_force_acts(heated: Campaign) -> None:
    setup, recording = phnn.identify(None, heated).fit.setup, heated.recordings[0]
    trajectory = simulate(setup, recording, 1)
    assert trajectory.velocity == pytest.approx(np.diff(trajectory.states[:, 0]) / trajectory.h)
    with pytest.raises(StructureViolated, match="no force acts"):
        output_derivatives(trajectory, (), (), np.ones((trajectory.h.size, 1)))


DT = 1e-4


def linear(frequency: float, damping: float) -> dict[str, float]:
    """Stiffness and damping of a resonance [Hz]."""
    m = hrc(0).parameters["m"].value
    w = 2.0 * np.pi * frequency
    return {"k": m * w**2, "b": 2.0 * damping * m * w}


def test_the_response_about_rest_is_that_of_mass_spring_and_damper() -> None:
    network = hrc(0).with_values(linear(300.0, 0.1))
    p = {n: v.value for n, v in network.parameters.items()}
    f = np.geomspace(1.0, 5e3, 50)
    s = 2j * np.pi * f
    expected = np.abs(1.0 / (p["m"] * s**2 + p["b"] * s + p["k"]))
    np.testing.assert_allclose(output_gain(network, f), expected, rtol=1e-9)


def drawn(share: float, size: int, rng: np.random.Generator, damping: float = 0.1) -> np.ndarray:
    """White noise and a white force through a resonance at 300 Hz, of unit variance together."""
    pole = np.exp(2.0 * np.pi * 300.0 * DT * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    ringing = lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(size + 2000))[2000:]
    return np.sqrt(share) * ringing / ringing.std() + np.sqrt(1.0 - share) * rng.standard_normal(size)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
def test_the_spectrum_has_the_power_of_both_parts(share: float) -> None:
    """Over forty draws: a single one scatters by a twenty-fifth about its own power."""
    network, f = hrc(0).with_values(linear(300.0, 0.1)), np.linspace(1e-3, 0.5, 2000)
    whole, above = [], []
    for seed in range(40):
        noise = drawn(share, 8000, np.random.default_rng(seed))
        found = force_noise(noise, DT, partial(output_gain, network))
        whole.append(np.mean(found.at(f)) / np.mean(noise**2))
        above.append(found.at(np.array([0.45]))[0] / (1.0 - share))
    assert np.mean(whole) == pytest.approx(1.0, abs=0.03)
    # Far above the resonance only the sensor's noise is left.
    assert np.mean(above) == pytest.approx(1.0, abs=0.03)
    assert max(np.std(whole), np.std(above)) < 0.07


def test_a_model_that_is_exact_and_one_without_a_slope_at_rest_have_a_spectrum(monkeypatch: pytest.MonkeyPatch) -> None:
    t = DT * np.arange(200)
    made = recording(t, np.zeros(t.size), Start("rest"))
    (found,) = spectra_of([np.zeros(t.size)], [made], [partial(output_gain, hrc(2))]).each
    assert np.isfinite(found.level).all() and not found.power.any()
    steep = np.full((4, 4), np.inf), np.zeros((4, 1))
    monkeypatch.setattr(small_signal, "linearised_at_rest", lambda _: steep)
    assert not output_gain(hrc(2), np.ones(3)).any()


def test_a_resonance_in_a_short_recording_is_no_line() -> None:
    """The largest ratio of power to the level around it: with the plant's response it is that of white noise."""
    network = hrc(0).with_values(linear(300.0, 0.05))
    t = DT * np.arange(400)
    ratios: dict[str, list[float]] = {"plant": [], "nothing": [], "white": []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise, white = drawn(0.9, t.size, rng, damping=0.05), rng.standard_normal(t.size)
        made = recording(t, np.zeros(t.size), Start("rest"))
        for name, residual, response in (
            ("plant", noise, partial(output_gain, network)),
            ("nothing", noise, np.zeros_like),
            ("white", white, np.zeros_like),
        ):
            (found,) = spectra_of([residual], [made], [response]).each
            ratios[name].append(float(np.max(found.power / found.level)))
    plant, nothing, white = (float(np.median(ratios[n])) for n in ("plant", "nothing", "white"))
    assert plant < 1.2 * white < nothing


def test_a_drift_is_not_taken_for_the_noise_of_a_force() -> None:
    """A ramp that the difference of the halves of a recording does not have for noise stands out of it."""
    linearised = campaigns.linearised()
    rng, own = np.random.default_rng(3), Own(drift_terms=DRIFT_TERMS)
    noise = rng.standard_normal(linearised.fit.residual.size)
    ramp = np.concatenate([np.linspace(-1.0, 1.0, s.stop - s.start) for s in linearised.slices])
    scores = []
    for size in (0.0, 1.0, 5.0):
        drifting = replace(linearised, fit=replace(linearised.fit, residual=noise + size * ramp))
        scores.append(own_score(drifting, own, drifting.spectra)[1])
    assert scores[0] < 3.0 < scores[1] < scores[2]
