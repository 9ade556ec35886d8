"""The voltage that makes a model follow a reference: how closely, within which limits, for every effect and command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from effect_homes import EFFECTS, FORMULAS, LEARNED, home, point

import phnn
from phnn.chain import AMPLIFIERS, SENSORS
from phnn.cli import main
from phnn.configuration import config_folder
from phnn.effects import Effect, in_all_forms
from phnn.errors import InputRefused
from phnn.inverse import Inverse, blocks
from phnn.inverse.invert import InverseOptions, invert, smoothed, stretches
from phnn.model import Model
from phnn.models.actuator import from_paper, hrc
from phnn.models.network_file import load_network
from phnn.models.store import save
from phnn.setup import Setup

MODEL = Model(Setup(from_paper()))
RATE = 20_000.0


def swells(frequency: float = 50.0, periods: int = 3, size: float = 4e-5) -> tuple[np.ndarray, np.ndarray]:
    """A motion that begins at rest."""
    t = np.arange(round(periods / frequency * RATE) + 1) / RATE
    return t, size * (1.0 - np.cos(2.0 * np.pi * frequency * t)) * (1.0 - np.exp(-((t * frequency / 0.4) ** 3)))


def again(model: Model, found: Inverse, **options: str) -> np.ndarray:
    """The output by the public simulation."""
    return model.simulate(found.t, found.voltage, input_before=found.voltage_before, **options)


@pytest.mark.parametrize(
    ("frequency", "hold"), [(1.0, "cubic"), (25.0, "cubic"), (100.0, "cubic"), (25.0, "zero_order")]
)
def test_the_model_follows_the_reference(frequency: float, hold: str) -> None:
    t = np.arange(1501) / 500.0 / frequency
    y = 5e-5 * (1.0 - np.cos(2.0 * np.pi * frequency * t))
    found = MODEL.inverse(t, y, hold=hold)
    assert found.follows
    assert found.missed == ()
    assert np.abs(again(MODEL, found, hold=hold) - y).max() <= 1e-5 * np.ptp(y)
    assert np.array_equal(again(MODEL, found, hold=hold), found.reached)


def test_the_formula_of_the_actuator() -> None:
    # V = Σ e_i + (k q + b q̇ + m q̈)/α, e_i the voltages of the hysterons, of which a network without any has none.
    t, _ = swells()
    model = Model(Setup(hrc(0)))
    p, w = model.parameters, 2.0 * np.pi * 50.0
    y = 4e-5 * (1.0 - np.cos(w * t))
    v, a = 4e-5 * w * np.sin(w * t), 4e-5 * w**2 * np.cos(w * t)
    expected = (p["k"] * y + p["b"] * v + p["m"] * a) / p["alpha"]
    found = model.inverse(t, y).voltage
    assert np.abs(found - expected)[20:-20].max() < 1e-4 * np.ptp(expected)


def test_hysterons_make_the_voltage_differ_between_directions() -> None:
    t, y = swells(periods=4, size=8e-5)
    last = t > t[-1] - 0.02
    middle = np.abs(y[last] - y[last].mean()) < 4e-6
    rising = np.gradient(y)[last] > 0.0

    def gap(model: Model) -> float:
        voltage = model.inverse(t, y).voltage[last]
        return float(voltage[middle & rising].mean() - voltage[middle & ~rising].mean())

    # Without hysterons the damper alone makes it differ, by 2 b q̇/α.
    damper = (
        2.0 * MODEL.parameters["b"] * np.abs(np.gradient(y) * RATE)[last][middle].mean() / MODEL.parameters["alpha"]
    )
    assert gap(Model(Setup(hrc(0)))) == pytest.approx(damper, rel=0.02)
    # A hysteron that slips adds the width of its dead zone, less where it slips for a part of the way only.
    assert 1.0 < gap(MODEL) - damper < MODEL.parameters["d_1"] + MODEL.parameters["d_2"]


def test_a_held_voltage_is_half_a_sample_ahead() -> None:
    t, y = swells()
    smooth, held = MODEL.inverse(t, y), MODEL.inverse(t, y, hold="zero_order")
    assert held.follows
    # Nothing else is known of this voltage than that the public simulation takes another one.
    assert np.abs(again(MODEL, held) - y).max() > 100.0 * np.abs(held.error).max()
    expected = 0.5 * (smooth.voltage[1:] + smooth.voltage[:-1])
    assert np.abs(held.voltage[:-1] - expected).max() < 0.01 * np.ptp(expected)


def test_more_substeps_follow_as_well() -> None:
    t, y = swells()
    fine = Model(MODEL.setup, 4)
    for hold in ("cubic", "zero_order"):
        assert fine.inverse(t, y, hold=hold).follows


def test_limits_are_kept_and_what_is_missed_is_told() -> None:
    t, y = swells()
    free = MODEL.inverse(t, y)
    high = 0.9 * free.voltage.max()
    found = MODEL.inverse(t, y, limits=(-50.0, high))
    assert found.voltage.max() <= high
    assert not found.follows
    worst = max(found.missed, key=lambda s: abs(s.error))
    assert "voltage limits" in worst.causes[0]
    assert worst.error == found.error[np.argmax(np.abs(found.error))]
    # A tenth of the voltage is missing where the reference is highest, nowhere else.
    assert abs(worst.at % 0.02 - 0.01) < 0.003
    assert 0.03 * np.ptp(y) < abs(worst.error) < 0.15 * np.ptp(y)
    assert any(f"{worst.at:.6g} s" in m and "voltage limits" in m for m in found.messages)
    reachable = y < 0.6 * y.max()
    assert np.abs(found.error[reachable]).max() < 0.01 * np.ptp(y)


def test_a_slew_limit_is_kept() -> None:
    t, y = swells()
    fastest = np.abs(np.diff(MODEL.inverse(t, y).voltage)).max() * RATE
    found = MODEL.inverse(t, y, slew=0.8 * fastest)
    assert np.abs(np.diff(found.voltage)).max() * RATE <= 0.8 * fastest * (1.0 + 1e-9)
    assert "slew limit" in found.missed[0].causes[0]
    assert MODEL.inverse(t, y, slew=1.01 * fastest).follows


def test_a_reference_in_motion_is_led_in() -> None:
    t = np.arange(1001) / RATE
    y = 4e-5 * np.sin(2.0 * np.pi * 60.0 * t)
    abrupt = MODEL.inverse(t, y)
    assert any("begins in motion" in m for m in abrupt.messages)
    assert not abrupt.follows
    found = MODEL.inverse(t, y, lead_in=0.01)
    assert found.follows
    assert found.messages == ()
    assert found.t[0] == pytest.approx(-0.01)
    assert np.allclose(found.reference[-y.size :], y, atol=1e-12)
    steps = np.abs(np.diff(found.reference))
    assert steps[0] < 1e-3 * steps.max()


def test_a_low_pass_has_no_phase_and_half_the_amplitude_at_its_corner() -> None:
    t = np.arange(4001) / RATE
    y = np.sin(2.0 * np.pi * 400.0 * t)
    found = smoothed(y, 1.0 / RATE, 400.0)
    assert np.abs(found - 0.5 * y)[1000:3000].max() < 1e-3


def test_noise_is_refused_and_smoothed() -> None:
    t, y = swells()
    noisy = y + 2e-7 * np.random.default_rng(2).standard_normal(t.size)
    with pytest.raises(InputRefused, match=r"of the command is faster than 5000 Hz.*smooth = "):
        MODEL.inverse(t, noisy)
    found = MODEL.inverse(t, noisy, smooth=400.0)
    assert np.std(found.reached - y) < 2e-7
    slightly = y + 1e-9 * np.random.default_rng(2).standard_normal(t.size)
    # The noise gives the first samples a speed, with which the model cannot begin.
    assert np.std(MODEL.inverse(t, slightly).error[200:]) < 1e-9


def test_a_jump_is_refused_with_the_remedy() -> None:
    t = np.arange(1001) / RATE
    with pytest.raises(InputRefused, match="the reference jumps, has corners, or is noisy"):
        MODEL.inverse(t, 4e-5 * (t > 0.02))
    assert MODEL.inverse(t, 4e-5 * (t > 0.02), smooth=300.0).follows


def test_the_inverse_of_a_simulation_is_its_voltage() -> None:
    t = np.arange(1201) / RATE
    u = 30.0 * (1.0 - np.cos(2.0 * np.pi * 50.0 * t)) * (1.0 - np.exp(-((t / 0.005) ** 3)))
    found = MODEL.inverse(t, MODEL.simulate(t, u))
    assert np.abs(found.voltage - u)[5:-5].max() < 0.01 * np.ptp(u)


@pytest.mark.parametrize(
    ("change", "needle"),
    [
        ({"smooth": -1.0}, "smooth = -1 Hz"),
        ({"smooth": 1e5}, "below half"),
        ({"limits": (10.0, -10.0)}, "lowest voltage, then the highest"),
        ({"slew": 0.0}, "slew = 0"),
        ({"hold": "linear"}, "choose one of cubic, zero_order"),
        ({"lead_in": -1.0}, "lead_in"),
        ({"lead_in": 1e14}, "samples, at most"),
        ({"lead_in": 1e305}, "samples, at most"),
        ({"smooth": 1e-14}, "samples, at most"),
        ({"tolerance": float("nan")}, "tolerance"),
        ({"iterations": 0}, "iterations = 0"),
    ],
)
def test_options_out_of_range_are_refused(change: dict[str, float], needle: str) -> None:
    with pytest.raises(InputRefused, match=needle):
        MODEL.inverse(*swells(), **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("t", "y", "needle"),
    [
        ([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], "at least 6"),
        (np.arange(9.0) ** 2, np.arange(9.0), "equal steps"),
        (np.arange(9.0), [0.0] * 8 + [float("nan")], r"reference\[8\] is not finite"),
        (np.arange(9.0), np.zeros(8), "give as many"),
        (np.arange(9.0), np.zeros((9, 1)), "one value per sample"),
    ],
)
def test_arrays_that_are_no_reference_are_refused(t: object, y: object, needle: str) -> None:
    with pytest.raises(InputRefused, match=needle):
        MODEL.inverse(t, y)  # type: ignore[arg-type]


def test_a_network_whose_motion_does_not_tell_its_input_is_refused() -> None:
    tanks = Model(Setup(load_network(config_folder() / "network" / "tanks.yaml")))
    with pytest.raises(InputRefused, match="the port pump does not push the mass"):
        tanks.inverse(*swells())


def test_an_oscillator_is_inverted_by_its_force() -> None:
    model = Model(Setup(load_network(config_folder() / "network" / "mass_spring_damper.yaml")))
    t = np.arange(801) / 100.0
    y = 0.1 * (1.0 - np.cos(2.0 * np.pi * 0.5 * t))
    found = model.inverse(t, y)
    assert np.abs(again(model, found) - y).max() <= 1e-5 * np.ptp(y)


def test_only_an_error_at_or_after_what_was_out_of_reach_has_its_cause() -> None:
    t, error, lost = np.arange(100) * 1e-3, np.zeros(100), np.zeros(100, dtype=np.bool_)
    error[[10, 50, 90]] = 1.0
    lost[49] = True
    found = stretches(t, error, 0.5, lost, ("the limits",), 5e-3)
    assert [s.causes for s in found] == [(), ("the limits",), ()]


RATE_EFFECTS, FREQUENCY = 20_000.0, 100.0
T = np.arange(401) / RATE_EFFECTS
REFERENCE = 2e-5 * (1.0 - np.cos(2.0 * np.pi * FREQUENCY * T)) * (1.0 - np.exp(-((T / 0.004) ** 3)))
# Largest error over the range of the reference. Only what a voltage between samples cannot follow, or what takes time
# to cross, is allowed more than the tolerance of the inverse; each with the reason.
TOLERANCE = 2e-5
ALLOWED = {
    "output_backlash": 2e-2,  # the mass cannot cross the play at once when the direction changes
    "coulomb_friction": 5e-4,  # the friction turns round within one sample
    "sensor_drift": 5e-4,  # the drifting reference begins in motion, the mass at rest
    "sensor_rectification": 1e-4,  # where the reference touches zero, errors of both signs are reported as one
    "sensor_clock": 5e-5,  # a fast clock asks for what comes after the last sample
}
# Effects of systems whose motion does not tell the input.
REFUSED = dict.fromkeys(("overflow", "spill_over", "turbulent_orifice"), "does not push the mass")
REFUSED["input_backlash"] = "is the motion imposed at"
FORMS = in_all_forms([*EFFECTS, *LEARNED, *FORMULAS])


@pytest.mark.parametrize("effect_", FORMS, ids=["-".join((e.name, *e.parameters)) for e in FORMS])
def test_the_inverse_of_every_effect(effect_: Effect) -> None:
    setup = effect_.add_to(home(effect_).setup, point(effect_))
    if effect_.name in REFUSED:
        with pytest.raises(InputRefused, match=REFUSED[effect_.name]):
            invert(setup, 1, T, REFERENCE, InverseOptions())
        return
    found = invert(setup, 1, T, REFERENCE, InverseOptions())
    reached = Model(setup).simulate(T, found.voltage, input_before=found.voltage_before)
    share = np.abs(reached - REFERENCE).max() / np.ptp(REFERENCE)
    falls = {"v_s", "r_f"} <= set(
        effect_.parameters
    )  # friction turns round within one sample, and falls within the next
    assert share <= (2e-3 if falls else ALLOWED.get(effect_.name, TOLERANCE))


def test_a_strong_effect_changes_the_voltage() -> None:
    # That the inverse follows the model is worth something only where the model without the effect would not.
    for name in ("creep", "electrostriction", "amplifier_lowpass", "sensor_lag", "second_mode"):
        effect_ = next(e for e in EFFECTS if e.name == name)
        setup = effect_.add_to(home(effect_).setup, point(effect_))
        base = invert(home(effect_).setup, 1, T, REFERENCE, InverseOptions())
        missed = Model(setup).simulate(T, base.voltage, input_before=0.0) - REFERENCE
        assert np.abs(missed).max() > 50.0 * TOLERANCE * np.ptp(REFERENCE), name


def test_every_block_of_the_chain_has_an_inverse_or_is_refused() -> None:
    remembering = [{name for name, kind in kinds.items() if kind.remembers} for kinds in (AMPLIFIERS, SENSORS)]
    assert remembering[0] - set(blocks._AMPLIFIER_INVERSES) == {"play", "rate"}
    assert remembering[1] - set(blocks._SENSOR_INVERSES) == {"rate"}


COMMAND_RATE = 10_000.0


def table(size_um: float = 80.0, frequency: float = 25.0) -> pd.DataFrame:
    t = np.arange(801) / COMMAND_RATE
    y = 0.5 * size_um * (1.0 - np.cos(2.0 * np.pi * frequency * t))
    return pd.DataFrame({"time_s": t, "displacement_um": y})


@pytest.fixture
def place(tmp_path: Path) -> Path:
    save(Setup(from_paper()), tmp_path / "model", 1)
    (tmp_path / "given").mkdir()
    table().to_csv(tmp_path / "given" / "r.csv", index=False)
    return tmp_path


def run(place: Path, *more: str, reference: str = "given/r.csv") -> int:
    return main(["invert", str(place / "model"), str(place / reference), "--out", str(place / "out"), *more])


def test_the_command_can_be_given_to_the_model(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(place) == 0
    printed = capsys.readouterr().out
    assert "error of the model: at most" in printed
    assert str(place / "out" / "command.csv") in printed
    assert {p.name for p in (place / "out").iterdir()} == {".phnn", "command.csv", "invert.json", "invert.png"}
    found = pd.read_csv(place / "out" / "command.csv")
    assert list(found.columns) == ["time_s", "voltage_V", "displacement_m", "reference_m", "error_m"]
    content = json.loads((place / "out" / "invert.json").read_text())
    assert content["schema"] == "phnn.inverse/1"
    assert content["follows"] is True
    assert content["missed"] == []
    model = phnn.load(place / "model")
    y = model.simulate(found["time_s"], found["voltage_V"], input_before=content["voltage_before_V"])
    assert np.abs(y - 1e-6 * table()["displacement_um"]).max() <= content["tolerance_m"]
    assert (place / "out" / "invert.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_is_a_recording_that_phnn_predicts(place: Path) -> None:
    assert run(place) == 0
    (place / "check").mkdir()
    found = pd.read_csv(place / "out" / "command.csv")
    found[["time_s", "voltage_V"]].to_csv(place / "check" / "a.csv", index=False)
    # The folder of an identification stands for the model in it.
    (place / "identified").mkdir()
    (place / "model").rename(place / "identified" / "base")
    assert main(["predict", str(place / "identified"), str(place / "check"), "--out", str(place / "predicted")]) == 0
    predicted = pd.read_csv(place / "predicted" / "a.csv")["displacement_m"]
    # The start of a table without a manifest is zero volts, the command begins with a jump of a few volts from there.
    assert np.abs(predicted - found["displacement_m"]).max() < 0.01 * np.ptp(predicted)


def test_options_reach_the_inverse(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--limits", "-3", "40", "--slew", "1e5", "--smooth", "300", "--lead-in", "0.01", "--hold", "zero_order"]
    assert run(place, *options, "--tolerance", "1e-8") == 0
    content = json.loads((place / "out" / "invert.json").read_text())
    assert content["options"] == {
        "smooth_Hz": 300.0, "limits_V": [-3.0, 40.0], "slew_V_per_s": 1e5, "hold": "zero_order", "lead_in_s": 0.01,
    }  # fmt: skip
    assert content["tolerance_m"] == 1e-8
    found = pd.read_csv(place / "out" / "command.csv")
    assert found["time_s"][0] == pytest.approx(-0.01)
    assert found["voltage_V"].between(-3.0, 40.0).all()
    assert not content["follows"]
    assert "the voltage limits -3 V and 40 V" in content["missed"][0]["causes"][0]
    assert "it is limited by the voltage limits" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "needle"),
    [
        (lambda f: f.rename(columns={"displacement_um": "displacement"}), "no unit for the displacement"),
        (lambda f: f.rename(columns={"displacement_um": "displacement_V"}), "cannot be in V"),
        (lambda f: f.rename(columns={"displacement_um": "voltage_V"}), "no displacement column"),
        (lambda f: f.rename(columns={"displacement_um": "output_V"}), "the output of the model in m"),
        (lambda f: f.drop(columns="time_s"), "no time column"),
        (lambda f: f.assign(displacement_um=f["displacement_um"].where(f.index != 7)), "row 8"),
        (lambda f: f.assign(displacement_um=3.0), "constant at"),
        (lambda f: f.drop(index=range(100, 200)), "gap"),
        (lambda f: f.assign(time_s=f["time_s"][::-1].to_numpy()), "time"),
        (lambda f: f.assign(displacement_um=1e6 * f["displacement_um"]), "correct the unit"),
        (lambda f: f.assign(displacement_um=50.0 * (f.index > 300)), "jumps, has corners, or is noisy"),
    ],
)
def test_what_is_no_reference_is_refused(
    place: Path, capsys: pytest.CaptureFixture[str], change: object, needle: str
) -> None:
    change(table()).to_csv(place / "given" / "r.csv", index=False)  # type: ignore[operator]
    assert run(place) == 2
    streams = capsys.readouterr()
    assert needle in streams.err
    assert streams.err.count("\n") == 1
    assert not (place / "out").exists()


def test_an_absent_reference_and_another_kind_of_model_are_refused(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(place, reference="given/none.csv") == 2
    assert "no such file" in capsys.readouterr().err
    model = json.loads((place / "model" / "model.json").read_text())
    (place / "model" / "model.json").write_text(json.dumps({**model, "schema": "phnn.modal-model/3"}))
    assert run(place) == 2


def test_results_never_go_where_the_reference_lies(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = place / "given"
    assert main(["invert", str(place / "model"), str(given / "r.csv"), "--out", str(given)]) == 2
    assert "from which this command reads" in capsys.readouterr().err
    assert {p.name for p in given.iterdir()} == {"r.csv"}


def test_a_smoothed_reference_is_no_excuse(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(2001) / COMMAND_RATE
    corners = 20.0 * np.abs(2.0 * (25.0 * t % 1.0) - 1.0)
    pd.DataFrame({"time_s": t, "displacement_um": corners}).to_csv(place / "given" / "r.csv", index=False)
    assert run(place, "--smooth", "500", "--lead-in", "0.02") == 0
    printed = capsys.readouterr().out
    assert "against the smoothed reference: at most" in printed
    assert "against the reference itself: at most" in printed
    content = json.loads((place / "out" / "invert.json").read_text())
    found = pd.read_csv(place / "out" / "command.csv")
    apart = np.abs(found["displacement_m"] - found["given_m"])
    assert content["error_of_given_max_m"] == pytest.approx(apart.max())
    assert content["error_of_given_max_m"] > 10.0 * content["error_max_m"]
    np.testing.assert_allclose(found["given_m"].iloc[-t.size :], 1e-6 * corners, atol=1e-15)


def test_a_command_beyond_the_recordings_is_told(tmp_path: Path) -> None:
    t, y = np.arange(801) / COMMAND_RATE, 1e-6 * table()["displacement_um"].to_numpy()
    for inputs, told in (((-75.0, 75.0), False), ((0.0, 20.0), True), (None, False)):
        model = phnn.Model(Setup(from_paper()), inputs=inputs)
        model.save(tmp_path / str(inputs))
        loaded = phnn.load(tmp_path / str(inputs))
        assert loaded.inputs == inputs
        assert any("beyond that it extrapolates" in m for m in loaded.inverse(t, y).messages) is told
