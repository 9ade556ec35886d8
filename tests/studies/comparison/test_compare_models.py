"""The comparison of models: steady cycles, energy supplied, ranges of recordings, the rivals, the script."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import compare_example as example
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scripts_example import script

from phnn.comparison import models
from phnn.comparison.run import compare
from phnn.errors import InputRefused, SolverFailed
from phnn.learn.plant import LatentPlant, NetworkPlant
from phnn.learn.solvers import Torchdiffeq, discrete_gradient
from phnn.learn.starts import scales_of
from phnn.models.actuator import from_paper, hrc
from phnn.models.bouc_wen import bouc_wen
from phnn.models.neural_ode import NeuralODE
from phnn.nn import LearnedSystem
from phnn.recordings import read
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Setup
from phnn.signals.least_squares import harmonic_weights
from studies.comparison.run import area_weights, cycle_errors, extracted, of_plant, of_setup, random_inputs, supply
from studies.comparison.uses import uses
from studies.recordings import comparison_plan
from studies.rival_models.names import register_rivals

Array = NDArray[np.float64]


def recorded(t: Array, u: Array, y: Array, period: float | None, noise: float = 1e-8) -> Recording:
    parts = (Part("a", 0, t.size, "identification"),)
    return Recording(
        "a", t, u, y, Start("rest"), "cubic", parts, noise, "given", np.ones(1), period, {}, "a.csv"
    )  # fmt: skip


# 833.3 and 900 samples a period: a fraction of a sample must do no harm.
@pytest.mark.parametrize("samples", [2500, 2700])
def test_area_of_an_ellipse(samples: int) -> None:
    a, b, lag, f = 75.0, 1e-4, 0.3, 50.0
    t = np.arange(samples) * 3.0 / f / samples
    weights = area_weights(t, a * np.sin(2 * np.pi * f * t), 1.0 / f)
    ahead = b * np.sin(2 * np.pi * f * t + lag)
    assert weights @ ahead == pytest.approx(np.pi * a * b * np.sin(lag), rel=2e-5)
    behind = b * np.sin(2 * np.pi * f * t - lag) + 3e-6
    assert weights @ behind == pytest.approx(-np.pi * a * b * np.sin(lag), rel=2e-5)
    assert abs(weights.sum()) < 1e-9 * np.abs(weights).sum()


@pytest.mark.parametrize("samples", [2500, 2700])
def test_harmonics_of_a_known_sum(samples: int) -> None:
    f = 10.0
    t = np.arange(samples) * 2.0 / f / samples
    amplitudes = np.array([3.0 - 1.0j, 0.0, 0.5j, 0.1, -0.2 + 0.1j, 0.05, 0.3j])
    y = 5.0 + sum((c * np.exp(2j * np.pi * k * f * t)).real for k, c in enumerate(amplitudes, start=1))
    assert np.allclose(harmonic_weights(t, 1.0 / f) @ y, amplitudes[:5], atol=1e-12)


def test_errors_of_a_model_of_another_size_and_phase() -> None:
    f, a, b = 50.0, 75.0, 1e-4
    t = np.arange(2500) * 3.0 / f / 2500
    phase = 2 * np.pi * f * t
    y, u = b * np.sin(phase - 0.2) + 1e-6 * np.sin(3 * phase), a * np.sin(phase)
    r = recorded(t, u, y, 1.0 / f)
    found = cycle_errors(r, r.parts[0], 1.1 * b * np.sin(phase - 0.2) + 2e-6)
    assert found is not None
    assert found.area == pytest.approx(-0.1, rel=1e-4)
    assert np.allclose(found.harmonics, [0.1 * b, 0.0, 1e-6, 0.0, 0.0], atol=1e-15)


def test_what_noise_does_to_them() -> None:
    random = np.random.default_rng(0)
    f, noise = 50.0, 1e-7
    t = np.arange(600) * 3.0 / f / 600
    clean, u = 1e-4 * np.sin(2 * np.pi * f * t - 0.2), 75.0 * np.sin(2 * np.pi * f * t)
    # Noise whose neighbours are half alike.
    correlation = np.array([1.0, 0.5])
    draws = random.standard_normal((800, 601))
    noises = noise * (draws[:, 1:] + draws[:, :-1]) / np.sqrt(2.0)
    r = replace(recorded(t, u, clean, 1.0 / f, noise), noise_correlation=correlation)
    found = [cycle_errors(r, r.parts[0], clean + n) for n in noises]
    areas = np.array([e.area for e in found if e is not None])
    harmonics = np.array([e.harmonics for e in found if e is not None])
    assert found[0] is not None
    assert np.std(areas) == pytest.approx(found[0].area_noise, rel=0.1)
    assert np.sqrt(np.mean(harmonics**2)) == pytest.approx(found[0].harmonic_noise, rel=0.05)


def test_a_start_from_rest_is_left_out() -> None:
    f = 50.0
    t = np.arange(2500) * 3.0 / f / 2500
    u = 75.0 * np.sin(2 * np.pi * f * t)
    y = 1e-6 * u
    r = recorded(t, u, y, 1.0 / f)
    wrong_at_first = np.where(t < 0.99 / f, 0.0, y)
    found = cycle_errors(r, r.parts[0], wrong_at_first)
    assert found is not None
    assert max(found.harmonics) < 1e-15
    late = cycle_errors(r, Part("a", 50, 2500, "confirmation"), y + 1e-7 * u)
    assert late is not None
    assert late.harmonics[0] == pytest.approx(7.5e-6, rel=1e-9)


COUNT = 60
RECORDINGS = [example.recording(50.0), example.recording(100.0)]


def test_share_that_a_sine_extracts() -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 4001)
    u = np.sin(phase)
    # A spring gives back what it got, a resistance nothing, and a negative one all.
    assert extracted(u, u) < 1e-6
    assert extracted(u, 1.0 - np.cos(phase)) == 0.0
    assert extracted(u, np.cos(phase) - 1.0) == pytest.approx(1.0)
    # An output ahead of the input taps the area of its ellipse.
    ahead = np.sin(phase + 0.1) - np.sin(0.1)
    moved = np.abs(np.diff(ahead) * 0.5 * (u[1:] + u[:-1])).sum()
    assert extracted(u, ahead) == pytest.approx(np.pi * np.sin(0.1) / moved, rel=0.05)
    assert extracted(u, np.full(phase.size, np.nan)) == np.inf


def test_inputs_begin_at_rest_and_stay_within_the_recorded() -> None:
    found = random_inputs(RECORDINGS, COUNT, 1)
    peaks = [float(np.abs(r.u).max()) for r in found]
    assert all(r.u[0] == 0.0 for r in found)
    assert max(peaks) <= 75.0
    assert min(peaks) < 10.0
    again = random_inputs(RECORDINGS, COUNT, 1)
    assert all(np.array_equal(a.u, b.u) for a, b in zip(found, again, strict=True))


def test_networks_extract_nothing() -> None:
    for setup in (Setup(from_paper()), Setup(hrc(0, {"m": 1e-3, "k": 2e4, "b": 3.0, "alpha": 0.04}))):
        assert supply(of_setup(setup), RECORDINGS, COUNT) == (0, COUNT)


def test_a_block_before_the_network_may_extract() -> None:
    # A Bouc–Wen block of the wrong sign adds to the voltage what it should take away.
    violations, _ = supply(of_setup(bouc_wen({"w": -400.0, "gamma": 0.0})), RECORDINGS, COUNT)
    assert violations > COUNT // 10


def test_models_without_a_guarantee_are_counted() -> None:
    with torch.no_grad():
        scales = scales_of(RECORDINGS)
        wild = LatentPlant(NeuralODE(scales, 3, 4))
        tame = NetworkPlant(LearnedSystem(3, ("voltage",), 4, scales).as_network(), torch.ones(3, dtype=torch.float64))
        assert supply(of_plant(tame, discrete_gradient), RECORDINGS, COUNT)[1] == COUNT
        responses = of_plant(wild, Torchdiffeq(wild, "rk4", adjoint=False))
        assert supply(responses, RECORDINGS, COUNT)[0] > 0


def test_what_cannot_be_simulated_is_not_counted_as_passive() -> None:
    def refuse(inputs: Sequence[Recording]) -> list[Array]:
        raise SolverFailed("no step")

    assert supply(refuse, RECORDINGS, COUNT) == (0, 0)
    assert supply(lambda inputs: [np.full(r.t.size, np.inf) for r in inputs], RECORDINGS, COUNT) == (COUNT, COUNT)


def used(name: str, use: str, u: Array, dt: float) -> Recording:
    t = dt * np.arange(u.size)
    return replace(recorded(t, u, u, None), name=name, parts=(Part(name, 0, u.size, use),))


def sine(use: str, frequency: float, amplitude: float) -> Recording:
    u = amplitude * np.sin(2 * np.pi * 3.0 * np.arange(600) / 600)
    return used(f"{frequency:g} Hz {amplitude:g} V", use, u, 3.0 / frequency / 600)


def test_the_plan_of_the_comparison_is_grouped() -> None:
    stated, plan = comparison_plan()
    found = uses([used(e.name, stated[e.name], e.voltage(e.t), e.dt) for e in plan])
    beyond = {n for n, use in found.items() if use == "outside"}
    assert beyond == {
        "sine_300Hz_75V", "sine_010Hz_37.5V", "sine_075Hz_37.5V", "sine_150Hz_37.5V", "sine_025Hz_90V",
    }  # fmt: skip
    assert {n for n, use in found.items() if use == "confirmation"} == {f"sine_{f:03}Hz_75V" for f in (10, 25, 75)}


@pytest.mark.parametrize(
    ("frequency", "amplitude", "use"),
    [
        (20.0, 60.0, "confirmation"),
        (10.2, 40.1, "confirmation"),
        (9.0, 60.0, "outside"),
        (60.0, 60.0, "outside"),
        (20.0, 30.0, "outside"),
        (20.0, 90.0, "outside"),
    ],
)
def test_frequency_and_amplitude_both_count(frequency: float, amplitude: float, use: str) -> None:
    known = [sine("identification", 10.0, 75.0), sine("identification", 50.0, 40.0)]
    other = sine("confirmation", frequency, amplitude)
    assert uses([*known, other])[other.name] == use


def test_a_step_is_judged_by_its_height() -> None:
    levels = np.concatenate([np.zeros(100), np.ones(400)])
    known = sine("identification", 10.0, 75.0)
    for height, use in ((75.0, "confirmation"), (90.0, "outside"), (20.0, "confirmation")):
        assert uses([known, used("step", "confirmation", height * levels, 1e-3)])["step"] == use
    # Nothing oscillated: a sine of any frequency counts by its height alone.
    only = used("step", "identification", 75.0 * levels, 1e-3)
    assert uses([only, sine("confirmation", 10.0, 75.0)])["10 Hz 75 V"] == "confirmation"


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "_RIVALS", {})
    register_rivals()


def test_rivals_are_scored_like_the_others(tmp_path: Path, registered: None) -> None:
    campaign = read(example.written(tmp_path / "recordings"))
    results = compare(campaign, tmp_path / "out", example.settings("models=[dahl,subnet]"))
    facts = json.loads((tmp_path / "out" / "models.json").read_text())
    assert all(f["budget"] == 1.0 and f["processor_seconds"] < 5.0 and f["size"] for f in facts.values())
    over = {m: r.evaluation.over_noise("identification") for m, r in results.items()}
    assert over["dahl"] < over["subnet"]
    again = compare(campaign, tmp_path / "out", example.settings("models=[dahl]"))
    assert again["dahl"].evaluation.parts == results["dahl"].evaluation.parts
    with pytest.raises(InputRefused, match="budget"):
        compare(campaign, tmp_path / "out", example.settings("models=[dahl]", "budget=2.0"))


@pytest.mark.slow
def test_recordings_beyond_the_identified_range_tell_models_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script("compare", f"out={tmp_path}", "inputs=50", "compare.models=[phs,bouc_wen,linear]")
    assert "held out" in capsys.readouterr().out
    found = json.loads((tmp_path / "models" / "compare.json").read_text())
    page = (tmp_path / "comparison.md").read_text()
    outside = [line.split("|")[1].strip() for line in page.splitlines() if "| held out, outside | 9" in line]
    assert len(found["phs"]) == 12
    assert len(outside) == 5
    for name in outside:
        assert found["phs"][name]["residual_over_noise"] < 1.2
        assert all(found[m][name]["residual_over_noise"] > 15.0 for m in ("bouc_wen", "linear"))
    cycles = page.partition("## Steady cycles")[2].partition("## Models")[0]
    assert sum(line.startswith("| sine_") for line in cycles.splitlines()) == 12
    assert "Table 1" in page
    # Passive by construction, and a block that has no energy.
    kinds = {
        line.split("|")[1].strip(): line.split("|")[5:7] for line in page.partition("## Models")[2].splitlines()[4:7]
    }
    assert [c.strip() for c in kinds["PHS"]] == ["0 of 10000", "0 of 50"]
    assert kinds["Bouc–Wen"][0].strip() == "no energy"
