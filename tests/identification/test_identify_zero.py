"""A zero of the output that all recordings share is a parameter of the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_homes import EFFECTS, FORMULAS, LEARNED, SCALES, home
from junctions import recording

from phnn.configuration import config_folder
from phnn.effects import Effect, effect, in_all_forms
from phnn.errors import InputRefused
from phnn.identification.base import identify_base
from phnn.identification.evaluate import evaluate
from phnn.identification.fit import fit
from phnn.identification.options import Options
from phnn.identification.plan import Plan
from phnn.models.network_file import load_network
from phnn.models.store import load, save
from phnn.recordings import read
from phnn.recordings.recording import Anchor, Campaign, Part, Recording, Start
from phnn.setup import Setup
from phnn.trajectory import simulate

NETWORK = config_folder() / "network" / "mass_spring_damper.yaml"
MODEL, ZERO, NOISE = Setup(load_network(NETWORK)), 0.05, 1e-3


def recorded(name: str, use: str, offset: str = "shared") -> Recording:
    rng = np.random.default_rng(sum(map(ord, name)))
    t = 0.05 * np.arange(400)
    force = np.repeat(rng.uniform(-1.0, 1.0, 40), 10)
    blank = recording(t, force, Start("rest", force[0]), interpolation="zero_order", offset=offset)
    y = simulate(MODEL, blank).y + ZERO + NOISE * rng.standard_normal(t.size)
    return replace(blank, name=name, y=y, noise=NOISE, parts=(Part(name, 0, t.size, use),))


def campaign(*recordings: Recording) -> Campaign:
    return Campaign(recordings, {"network": str(NETWORK)}, {}, "terminals", (), True, "made")


def test_a_shared_zero_is_estimated_once_and_predicts_what_is_held_out() -> None:
    held = recorded("c", "confirmation")
    fitted, _ = identify_base(
        campaign(recorded("a", "identification"), recorded("b", "identification"), held), Options(workers=1, starts=1)
    )
    value, spread = fitted.setup.parameters["y_0"].value, fitted.std()["y_0"]
    assert abs(value - ZERO) < 4.0 * spread
    assert 0.5 < spread / (NOISE / np.sqrt(800)) < 3.0
    plan = Plan((held,), workers=1)
    (score,) = evaluate(fitted.setup, plan, {}).parts
    assert score.residual_over_noise < 1.1
    moved = replace(held, y=held.y + 10.0 * NOISE)
    (score,) = evaluate(fitted.setup, Plan((moved,), workers=1), {}).parts
    assert score.residual_over_noise == pytest.approx(10.0, rel=0.1)


def test_zeros_of_their_own_stay_out_of_the_model() -> None:
    fitted, _ = identify_base(campaign(recorded("a", "identification", "own")), Options(workers=1, starts=1))
    assert set(fitted.setup.parameters) == set(MODEL.parameters)


def test_recordings_share_a_zero_all_or_none() -> None:
    mixed = campaign(recorded("a", "identification"), recorded("b", "identification", "own"))
    with pytest.raises(InputRefused, match="b has a zero of its own, a shares one"):
        identify_base(mixed, Options(workers=1))


def test_the_manifest_says_it(tmp_path: Path) -> None:

    (tmp_path / "recordings.yaml").write_text("offset: common\n")
    with pytest.raises(InputRefused, match="offset: 'common' is not known: accepted are own, shared"):
        read(tmp_path)


def test_an_unknown_gain_of_the_input_is_estimated() -> None:
    run = recorded("a", "identification", "own")
    halved = replace(run, u=0.5 * run.u, start=Start("rest", 0.5 * run.start.input_before), gain="unknown")
    known = replace(campaign(halved), known={"m": Anchor(MODEL.parameters["m"].value)})
    fitted, _ = identify_base(known, Options(workers=1, starts=1))
    assert fitted.setup.parameters["gamma_u"].value == pytest.approx(2.0, rel=0.01)
    assert fitted.setup.parameters["k"].value == pytest.approx(MODEL.parameters["k"].value, rel=0.01)
    with pytest.raises(InputRefused, match="takes up any factor"):
        identify_base(replace(known, setup={"model": "piezo_actuator"}, known={}), Options(workers=1))


def test_the_manifest_says_that_a_gain_is_unknown(tmp_path: Path) -> None:
    t = 1e-3 * np.arange(200)
    rows = np.column_stack([t, np.sin(40.0 * t), np.cos(40.0 * t)])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time_s,input_V,output_V", comments="")
    manifest = tmp_path / "recordings.yaml"
    manifest.write_text(f"setup: {{network: {NETWORK.name}}}\ncolumns: {{input: {{gain: unknown}}}}\n")
    (tmp_path / NETWORK.name).write_text(NETWORK.read_text())
    assert read(tmp_path).recordings[0].gain == "unknown"
    for wrong, words in (("input: {gain: maybe}", "gain: 'maybe' is not known"), ("output: {gain: unknown}", "'gain'")):
        manifest.write_text(f"columns: {{{wrong}}}\n")
        with pytest.raises(InputRefused, match=words):
            read(tmp_path)


def test_a_model_with_zero_and_gain_is_kept_by_a_file(tmp_path: Path) -> None:
    run = replace(recorded("a", "identification"), gain="unknown")
    fitted, _ = identify_base(
        replace(campaign(run), known={"m": Anchor(MODEL.parameters["m"].value)}), Options(workers=1, starts=1)
    )
    save(fitted.setup, tmp_path, 1)
    again, _ = load(tmp_path)
    np.testing.assert_array_equal(simulate(again, run).y, simulate(fitted.setup, run).y)


_ALL = in_all_forms([*EFFECTS, *LEARNED, *FORMULAS])


@pytest.mark.parametrize("effect_", _ALL, ids=["-".join((e.name, *e.parameters)) for e in _ALL])
@pytest.mark.parametrize("time", [1e-7, 1e7])
def test_an_effect_can_be_placed_in_a_system_of_any_size_and_speed(effect_: Effect, time: float) -> None:
    base = home(effect_).setup
    for length in (1e-6, 1e6):
        for drive in (1e-6, 1e7):
            scales = replace(
                SCALES,
                slowest=SCALES.slowest / time,
                fastest=SCALES.fastest / time,
                duration=SCALES.duration * time,
                displacement=SCALES.displacement * length,
                velocity=SCALES.velocity * length / time,
                stiffness=SCALES.stiffness * drive / length,
                noise=SCALES.noise * length,
                voltage=SCALES.voltage * drive,
            )
            for values in effect_.grid(scales):
                effect_.add_to(base, values)
                effect_.add_to(base, effect_.scaled(values, 1e3))


@pytest.mark.parametrize(("name", "parameter"), [("amplifier_lowpass", "tau_a"), ("sensor_lag", "tau_y")])
def test_a_lag_of_a_minute_is_found_in_samples_every_four_seconds(name: str, parameter: str) -> None:
    tanks = Setup(load_network(config_folder() / "network" / "tanks.yaml"))
    rng = np.random.default_rng(3)
    t = 4.0 * np.arange(400)
    u = 1e-4 * (1.0 + np.repeat(rng.uniform(-0.5, 0.5, 40), 10))
    blank = recording(t, u, Start("rest", 1e-4), interpolation="linear")
    true = effect(name).add_to(tanks, {parameter: 54.0})
    y = simulate(true, blank).y
    noise = 1e-4 * float(np.ptp(y))
    run = replace(
        blank, y=y + noise * rng.standard_normal(t.size), noise=noise, parts=(Part("a", 0, t.size, "identification"),)
    )
    found = fit(effect(name).add_to(tanks, {parameter: 0.05}), Plan((run,)), [parameter])
    assert found.chi2 < 1.3
    assert found.setup.parameters[parameter].value == pytest.approx(54.0, rel=0.02)
