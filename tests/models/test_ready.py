"""Ready models: each is identified, predicted and exported from simulated recordings, and in full diagnosed."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Lab
from typing import Any

import numpy as np
import pytest
import yaml
from junctions import recording
from numpy.typing import NDArray
from scipy.signal import lsim

import phnn
from phnn.check import doubts
from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.diagnose.locations import locate
from phnn.effects.effect import effect
from phnn.effects.places import attached
from phnn.errors import InputRefused, StructureViolated
from phnn.models.network_file import load_network, ready
from phnn.recordings import describe
from phnn.recordings.manifest import READY
from phnn.recordings.recording import Start, Units
from phnn.recordings.units import scales_with_forces
from phnn.report.statements import acts_like
from phnn.setup import Setup
from phnn.trajectory import simulate

Array = NDArray[np.float64]
TABLE = yaml.safe_load(Path(__file__).with_name("laboratories.yaml").read_text())
LABS = {name: Lab(**{"known": {}, "further": {}, "input": "zero_order"} | said) for name, said in TABLE.items()}
SAMPLES = 1000
OSCILLATOR = """setup: {model: mass_spring_damper}
columns: {input: {column: force_N, unit: N}, output: {column: y_m, unit: m}}
"""


def save(file: Path, table: Array, header: str) -> None:
    """Write a table with a header."""
    np.savetxt(file, table, delimiter=",", header=header, comments="")


def drives(name: str, lab: Lab, seed: int) -> Array:
    """Steps that are held for some samples, or sines that lie still at first, around zero or above it."""
    rng, t = np.random.default_rng(seed), np.arange(SAMPLES)
    if lab.input == "cubic":
        return lab.drive * sum(
            a * np.sin(2 * np.pi * f * (t - 50) / SAMPLES) for a, f in ((0.5, 6.0 + seed), (0.3, 17.0), (0.1, 90.0))
        ) * np.clip((t - 50) / 200, 0.0, 1.0)  # fmt: skip
    held = np.repeat(rng.choice([-1.0, -0.4, 0.0, 0.5, 1.0], SAMPLES // 60 + 1), 60)[:SAMPLES]
    held[:60] = 0.0
    return lab.drive * (np.abs(held) if name in ("tank", "heated_body", "room") else held)


def folder_of(name: str, folder: Path) -> Path:
    """Two recordings of a simulated plant and their manifest."""
    lab, network, t = LABS[name], ready(name, LABS[name].values), LABS[name].dt * np.arange(SAMPLES)
    folder.mkdir(exist_ok=True)
    for seed, file in ((1, "a"), (2, "b")):
        u = drives(name, lab, seed)
        further = {p: 5.0 * np.cos(2 * np.pi * t / t[-1]) - 5.0 for p in lab.further}
        known = {"name": file, "interpolation": lab.input, "units": Units(*lab.units), "further": further}
        run = recording(t, u, Start("rest", 0.0), **known)
        y = simulate(Setup(network), run, 8).y + lab.noise * np.random.default_rng(seed + 10).standard_normal(SAMPLES)
        header = "time_s,u,w,y" if further else "time_s,u,y"
        save(folder / f"{file}.csv", np.column_stack([t, u, *further.values(), y]), header)
    ports = "".join(f"ports: {{{p}: {{column: w, unit: {unit}}}}}\n" for p, unit in lab.further.items())
    keys = ("voltage", "displacement") if name == "piezo_actuator" else ("input", "output")
    known = f"known: {{{', '.join(f'{n}: {v}' for n, v in lab.known.items())}}}\n" if lab.known else ""
    (folder / "recordings.yaml").write_text(
        f"setup: {{model: {name}}}\n{known}{ports}input: {lab.input}\nvoltage: terminals\n"
        f"start: {{state: rest, input_before: 0.0}}\n"
        f"columns: {{{keys[0]}: {{column: u, unit: {lab.units[0]}}}, {keys[1]}: {{column: y, unit: {lab.units[1]}}}}}\n"
        "recordings: [{file: a.csv, use: identification}, {file: b.csv, use: confirmation}]\n"
    )
    return folder


def test_every_name_has_a_laboratory(tmp_path: Path) -> None:
    assert set(LABS) == set(READY)
    folder = folder_of("tank", tmp_path)
    for refused in (lambda: ready("moter"), lambda: phnn.identify("moter", folder)):
        with pytest.raises(InputRefused, match=r"mass_damper.*motor"):
            refused()


@pytest.mark.parametrize("name", LABS)
def test_a_ready_model_goes_all_the_way(name: str, tmp_path: Path) -> None:
    lab, folder = LABS[name], folder_of(name, tmp_path)
    campaign = phnn.read(folder)
    assert name in describe(campaign)
    found = phnn.identify(None, campaign)
    assert found.fit.chi2 < 1.3
    for parameter, value in lab.values.items():
        estimate, std = found.parameters[parameter]
        if parameter not in lab.known:
            assert std is not None and std < 0.1 * value, parameter
            assert abs(estimate - value) < 6.0 * std + 2e-3 * value, parameter
    found.model.save(tmp_path / "model")
    for predicted in phnn.predict(tmp_path / "model", campaign):
        assert np.sqrt(np.mean(predicted.error**2)) < 1.5 * lab.noise
    (program, *_) = phnn.export(tmp_path / "model", "python", tmp_path / "python", dt=lab.dt, substeps=8)
    assert_like_the_model(program, found.model, name)


@pytest.mark.slow
def test_nothing_is_missing_of_a_heated_body(tmp_path: Path) -> None:
    """The output is no position, so that no force acts on it."""
    found = phnn.diagnose(folder_of("heated_body", tmp_path))
    assert (found.verdict, found.ended.warnings) == ("none", ())
    assert np.isfinite(list(locate(found.linearised[0]).scores.values())).all()
    trajectory = found.linearised[0].trajectories[0]
    assert trajectory.velocity == pytest.approx(np.diff(trajectory.states[:, 0]) / trajectory.h)
    with pytest.raises(StructureViolated, match="no force acts"):
        output_derivatives(trajectory, (), (), np.ones((trajectory.h.size, 1)))


def assert_like_the_model(program: Path, model: phnn.Model, name: str) -> None:
    """The exported program follows the model under an input without jumps.

    The effort of an imposed motion at an instant follows from its means beside it: before it alone in a program.
    """
    lab, u = LABS[name], LABS[name].drive * np.sin(np.arange(200) / 30.0)
    scope: dict[str, Any] = {}
    exec(compile(program.read_text(), program.name, "exec"), scope)
    step = scope["Model"](0.0).step
    found = [step(float(x)) for x in u[1:]]
    wanted = model.simulate(lab.dt * np.arange(u.size), u, input_before=0.0, hold="linear", substeps=8)
    close = 1e-9 if not model.setup.network.senses else 2e-4
    np.testing.assert_allclose(found, wanted[1:], atol=close * float(np.ptp(wanted)))


def test_a_free_decay_tells_ratios_alone_and_a_reversed_sign_is_told(tmp_path: Path) -> None:
    t = 0.004 * np.arange(1500)
    y = 6e-3 * np.exp(-0.4 * t) * np.cos(19.0 * t) + 4e-6 * np.random.default_rng(3).standard_normal(t.size)
    save(tmp_path / "a.csv", np.column_stack([t, 0.0 * t, y]), "time_s,force_N,y_m")
    (tmp_path / "recordings.yaml").write_text(f"{OSCILLATOR}start: unknown\n")
    found = phnn.identify(None, tmp_path).fit
    assert not set(found.setup.network.parameters) & {n for n, s in found.std().items() if np.isfinite(s)}
    assert "free decay: a common factor of" in found.open_statement() and "known only relative to" in found.note("m")
    for name, wanted in (("b/m", 0.8), ("k/m", 19.0**2 + 0.4**2)):
        ratio, error = found.ratios()[name]
        assert abs(ratio - wanted) < 5.0 * error < 0.01 * wanted
    folder = folder_of("mass_damper", tmp_path / "reversed")
    manifest = folder / "recordings.yaml"
    manifest.write_text(manifest.read_text().replace("column: y, unit: m", "column: y, unit: m, scale: -1"))
    with pytest.raises(InputRefused, match="the output falls where the input rises: reverse a sign"):
        phnn.identify(None, folder)


@pytest.mark.parametrize(("units", "gain"), [(("mA", "bar"), 4.5e7), (("percent", "kPa"), 2.5e6), (("V", "nm"), 3e-8)])
def test_a_gain_may_have_any_size_and_has_the_units_of_the_recordings(
    tmp_path: Path, units: tuple[str, str], gain: float
) -> None:
    t, scale = 0.02 * np.arange(2000), {"mA": 1e-3, "bar": 1e5, "percent": 1e-2, "kPa": 1e3, "V": 1.0, "nm": 1e-9}
    u = 0.008 * np.sin(2.0 * np.pi * np.outer(t, (0.05, 0.31, 1.3))).sum(axis=1) / scale[units[0]]
    y = gain * scale[units[0]] / scale[units[1]] * lsim(([1.0], [0.3, 1.0]), u, t)[1]
    save(tmp_path / "a.csv", np.column_stack([t, u, y + 1e-3 * y.std() * np.cos(1e6 * t)]), "time_s,u,y")
    (tmp_path / "recordings.yaml").write_text(
        f"setup: {{model: first_order}}\nstart: unknown\n"
        f"columns: {{input: {{column: u, unit: {units[0]}}}, output: {{column: y, unit: {units[1]}}}}}"
    )
    found = phnn.identify(None, tmp_path)
    assert found.fit.setup.values()["K"] == pytest.approx(gain, rel=2e-3)
    assert found.fit.setup.values()["T"] == pytest.approx(0.3, rel=2e-3)
    assert found.fit.setup.parameters["K"].unit == {"bar": "Pa/A", "kPa": "Pa", "nm": "m/V"}[units[1]]


def test_a_decay_from_far_away_is_followed(tmp_path: Path) -> None:
    t = 0.01 * np.arange(600)
    y = 180.0 * np.exp(-t / 0.7) + 0.05 * np.random.default_rng(5).standard_normal(t.size)
    save(tmp_path / "a.csv", np.column_stack([t, 0.0 * t, y]), "time_s,input_V,speed")
    (tmp_path / "recordings.yaml").write_text(
        "setup: {model: first_order}\nstart: unknown\ncolumns: {output: {column: speed, unit: rad/s}}"
    )
    found = phnn.identify(None, tmp_path).fit
    assert found.setup.values()["T"] == pytest.approx(0.7, rel=5e-3) and found.chi2 < 1.2


def test_an_unstable_plant_is_told_with_its_negative_stiffness(tmp_path: Path) -> None:
    t = 1e-3 * np.arange(4000)
    r = 1e-3 * np.sin(2.0 * np.pi * np.outer(t, (0.7, 2.3, 6.1))).sum(axis=1)
    _, _, x = lsim(([[0.0, 1.0], [-840.0, -32.0]], [[0.0], [1200.0]], np.eye(2), np.zeros((2, 1))), r, t)
    save(tmp_path / "a.csv", np.column_stack([t, 120.0 * (r - x[:, 0]) - 3.0 * x[:, 1], x[:, 0]]), "time_s,force_N,y_m")
    (tmp_path / "recordings.yaml").write_text(OSCILLATOR)
    with pytest.raises(InputRefused, match=r"unstable: .* of about -3[56]\S* N/m.*inertia of 0\.[01].*set point"):
        phnn.identify(None, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", LABS)
def test_nothing_is_missing_in_a_ready_model(name: str, tmp_path: Path) -> None:
    folder = folder_of(name, tmp_path)
    assert phnn.diagnose(folder).verdict == "none"


def test_starting_values_on_another_time_scale_end_where_the_truth_does(tmp_path: Path) -> None:
    values = {"m": 0.016, "b": 0.7, "k": 7e3}
    t = 1e-3 * np.arange(3000)
    u = 50.0 * np.sin(2 * np.pi * 5.0 * t) * (1.0 - np.exp(-t / 0.35))
    run = recording(t, u, Start("rest", 0.0), units=Units("N", "m"))
    y = simulate(Setup(ready("mass_spring_damper", values)), run, 8).y
    y = y + 1.5e-6 * np.random.default_rng(5).standard_normal(t.size)
    save(tmp_path / "a.csv", np.column_stack([t, u, y]), "time_s,force_N,y_m")
    described = Setup(ready("mass_spring_damper", {"m": 1.0, "b": 1.0, "k": 1000.0}), name="oscillator")
    (tmp_path / "recordings.yaml").write_text(OSCILLATOR.replace("mass_spring_damper", "linear"))
    found = phnn.identify(described, tmp_path)
    assert found.fit.chi2 < 1.2
    for name, value in values.items():
        estimate, std = found.parameters[name]
        assert std is not None and abs(estimate - value) < 5.0 * std < 0.2 * value, name


def test_effects_speak_the_units_of_the_network() -> None:
    shaft, heated = Setup(ready("motor")), Setup(ready("heated_body"))
    circuit = Setup(load_network(config_folder() / "recordings" / "silverbox" / "oscillator.yaml"))

    def units_of(name: str, setup: Setup) -> dict[str, str]:
        (one, *_) = attached(effect(name), setup)
        built = one.build(setup, dict.fromkeys(one.parameters, 0.1))
        added = {s.name: s.unit for s in built.network.storages if s.name not in setup.network.storage_names}
        return {n: built.parameters[n].unit for n in one.parameters} | added

    assert units_of("cubic_stiffness", circuit)["q_0"] == "V"
    turned = units_of("output_backlash", shaft) | units_of("coulomb_friction", shaft)
    assert turned == {"delta_b": "rad", "F_c": "N m", "v_s": "rad/s"}
    assert units_of("contact_stop", shaft) == {"k_c": "N m/rad", "g_c": "rad", "x_c": "rad"}
    assert units_of("quadratic_drag", shaft)["c_2"] == "N m s²/rad²"
    mode = units_of("second_mode", shaft)
    assert mode["m_2"] == "kg m2" and mode["x_2"] == "rad" and mode["p_2"] == "N m s"
    of_heat = units_of("sensor_drift", heated) | units_of("slew_limit", heated)
    assert (of_heat["drift_rate"], of_heat["S"]) == ("K/s", "W/s")
    assert units_of("contact_stop", Setup(ready("mass_damper")))["k_c"] == "N/m"


def test_a_fixed_torque_constant_anchors_all_torques() -> None:
    told = {"N m/V": True, "kg m2": True, "ohm": True, "V": False, "N m/A": False, "rad/s": False, "V s/m": False}
    assert {unit: scales_with_forces(unit) for unit in told} == told


def unrelated(folder: Path) -> Path:
    """Two recordings whose output is noise and follows no input."""
    rng, t = np.random.default_rng(7), 2e-3 * np.arange(1200)
    for name in "ab":
        u = 3.0 * np.repeat(rng.choice([-1.0, 0.2, 0.7], 30), 40)
        save(folder / f"{name}.csv", np.column_stack([t, u, 4e-6 * rng.standard_normal(t.size)]), "time_s,force_N,y_m")
    (folder / "recordings.yaml").write_text(
        f"{OSCILLATOR}recordings: [{{file: a.csv, use: identification}}, {{file: b.csv, use: confirmation}}]\n"
    )
    return folder


def test_an_output_that_follows_no_input_is_said_to_be_unexplained(tmp_path: Path) -> None:
    campaign = phnn.read(unrelated(tmp_path))
    told = doubts(campaign)
    assert len(told) == 1 and "times the deviation of the whole output" in told[0] and "similar in b" in told[0]
    fitted = phnn.identify(None, campaign).fit
    assert fitted.chi2 < 1.3 and fitted.explained < 0.05
    assert "explains" in fitted.nothing_statement() and "which is nothing" in fitted.nothing_statement()


@pytest.mark.slow
def test_nothing_is_never_missing_where_nothing_is_explained(tmp_path: Path) -> None:
    found = phnn.diagnose(unrelated(tmp_path))
    assert found.verdict == "unknown"
    assert "which is nothing" in acts_like(found)
