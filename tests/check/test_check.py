"""What is noticed about recordings before any model is fitted: each fault made, and found again where it was put."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.check import Finding, check
from phnn.cli import main
from phnn.models.network_file import load_network
from phnn.models.store import save
from phnn.recordings import read
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Campaign, Part, Recording, Start, Units
from phnn.setup import Setup

DT, NOISE, GAIN = 1e-4, 2e-8, 5e-7


def recording(u: np.ndarray, y: np.ndarray, name: str = "a", dt: float = DT) -> Recording:
    period = excitation_of(u, dt).period
    return Recording(
        name, dt * np.arange(u.size), u, y, Start("rest"), "cubic", (Part(name, 0, u.size, "identification"),), NOISE,
        "made", np.ones(1), period, {}, "a.csv",
    )  # fmt: skip


def sine(frequency: float = 8.0, amplitude: float = 70.0, cycles: int = 6, lag: float = 2e-4) -> Recording:
    t = DT * np.arange(round(cycles / (frequency * DT)))
    u, y = (amplitude * np.sin(2.0 * np.pi * frequency * (t - shift)) for shift in (0.0, lag))
    return recording(u, GAIN * y + NOISE * np.random.default_rng(round(frequency)).standard_normal(t.size))


def with_output(r: Recording, added: np.ndarray) -> Recording:
    return recording(r.u, r.y + added)


def campaign(*recordings: Recording, voltage: str = "command") -> Campaign:
    return Campaign(recordings, {"model": "piezo_actuator"}, {}, voltage, (), False, "made")


def found(r: Recording) -> dict[str, Finding]:
    return {f.kind: f for f in check(campaign(r)).findings["a"]}


@settings(max_examples=25, deadline=None)
@given(st.floats(3.0, 40.0), st.integers(3, 12), st.floats(0.0, 2e-3))
def test_nothing_is_noticed_in_a_clean_recording(frequency: float, cycles: int, lag: float) -> None:
    assert found(sine(float(f"{frequency:.2g}"), cycles=cycles, lag=lag)) == {}


@pytest.mark.parametrize("frequency", [50.0, 60.0, 100.0, 150.0])
def test_mains_are_found_with_their_amplitude(frequency: float) -> None:
    clean = sine(7.0, cycles=28)
    noticed = found(with_output(clean, 2e-8 * np.sin(2.0 * np.pi * frequency * clean.t + 0.3)))["mains"]
    assert set(noticed.values) == {f"amplitude_{frequency:g}Hz"}
    assert noticed.values[f"amplitude_{frequency:g}Hz"] == pytest.approx(2e-8, rel=0.15)
    assert f"{frequency:g} Hz" in noticed.text


def test_a_tone_that_the_drive_may_cause_is_no_mains() -> None:
    clean = sine(10.0, cycles=12)
    assert "mains" not in found(with_output(clean, 2e-8 * np.sin(2.0 * np.pi * 50.0 * clean.t)))


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 40))
def test_an_output_that_leads_is_found_with_its_lead(samples: int) -> None:
    noticed = found(sine(8.0, lag=-samples * DT))["lead"]
    assert noticed.values["lead_s"] == pytest.approx(samples * DT, rel=0.05)


@settings(max_examples=25, deadline=None)
@given(st.floats(5.0, 40.0), st.integers(3, 9), st.floats(0.003, 0.1), st.floats(0.003, 0.1))
def test_distortion_is_told_by_even_and_odd_harmonics(frequency: float, cycles: int, even: float, odd: float) -> None:
    """A square and a cube of a sine make a second harmonic of a half and a third one of a quarter of themselves."""
    clean = sine(float(f"{frequency:.2g}"), cycles=cycles, lag=0.0)
    x, drift = clean.u / 70.0, 4e-7 * clean.t
    noticed = found(with_output(clean, GAIN * 70.0 * (2.0 * even * x**2 + 4.0 * odd * x**3) + drift))["distortion"]
    total = np.sqrt((1.0 + 3.0 * odd) ** 2 + even**2 + odd**2)
    least = 3.0 * noticed.values["noise"]
    assert noticed.values["even"] == pytest.approx(even / total, rel=0.03, abs=least)
    assert noticed.values["odd"] == pytest.approx(odd / total, rel=0.03, abs=least)


def test_drift_from_period_to_period_and_between_rests() -> None:
    clean = sine(8.0, cycles=10)
    ramp = 4e-7 * clean.t / clean.t[-1]
    noticed = found(with_output(clean, ramp))["drift"]
    assert noticed.severity == "warning"
    # The first period does not count: of the ten there are eight steps between the others.
    assert noticed.values["change"] == pytest.approx(0.8 * 4e-7, rel=0.05)
    quiet = np.zeros(2000)
    u = np.concatenate([quiet, clean.u[: clean.u.size // 10], quiet])
    noise = NOISE * np.random.default_rng(3).standard_normal(u.size)
    still = recording(u, GAIN * u + noise)
    assert "drift" not in found(still)
    moved = with_output(still, 1e-7 * (np.arange(u.size) > 2600))
    assert found(moved)["drift"].values["change"] == pytest.approx(1e-7, rel=0.05)


def test_an_output_that_moves_by_itself_is_noticed_and_one_that_dies_away_is_not() -> None:
    t = np.arange(4000) * 1e-3
    u = np.where(t > 0.5, 10.0, 0.0)
    noise = NOISE * np.random.default_rng(5).standard_normal(t.size)
    wave, fades = 1e-6 * np.sin(2.0 * np.pi * 7.3 * t), np.exp(-(t - 0.5) / 0.6)
    noticed = found(with_output(recording(u, GAIN * u + noise), wave))["restless"]
    assert noticed.severity == "warning"
    assert noticed.values["rms"] == pytest.approx(1e-6 / np.sqrt(2.0), rel=0.05)
    for y in (0.0 * t, wave * fades):
        assert "restless" not in found(with_output(recording(u, GAIN * u + noise), y))


def test_what_the_start_leaves_is_no_drift() -> None:
    clean = sine(8.0, cycles=10)
    settling = 4e-7 * np.exp(-8.0 * clean.t)
    noticed = found(with_output(clean, settling))["drift"]
    assert noticed.severity == "note"
    assert "what the start left" in noticed.text
    few = sine(8.0, cycles=3)
    assert "what the start left" in found(with_output(few, 2e-6 * np.exp(-8.0 * few.t)))["drift"].text


@pytest.mark.parametrize(("step", "severity"), [(1e-8, "note"), (1e-7, "warning")])
def test_steps_of_the_converter(step: float, severity: str) -> None:
    clean = sine()
    noticed = found(recording(clean.u, step * np.round(clean.y / step)))["quantisation"]
    assert noticed.severity == severity
    assert noticed.values["step"] == pytest.approx(step, rel=1e-6)


def test_without_a_noise_floor_nothing_is_held_against_it() -> None:
    clean = sine(cycles=10)
    moving = with_output(recording(clean.u, 1e-8 * np.round(clean.y / 1e-8)), 4e-7 * np.round(clean.t, 1))
    assert "drift" in found(moving)
    bare = found(replace(moving, noise_found=False))
    assert "drift" not in bare
    assert not any("noise" in f.text for f in bare.values())


def test_samples_at_the_end_of_the_range() -> None:
    clean = sine(cycles=6)
    noticed = found(recording(clean.u, np.minimum(clean.y, np.quantile(clean.y, 0.99))))["limits"]
    assert noticed.values["samples"] == pytest.approx(0.01 * clean.y.size, rel=0.1)


def test_what_recordings_can_show() -> None:
    def shown(*recordings: Recording, voltage: str = "command") -> list[bool]:
        return [a.able for a in check(campaign(*recordings, voltage=voltage)).abilities]

    step = np.where((DT * np.arange(12000) > 0.1) & (DT * np.arange(12000) < 0.6), 50.0, 0.0)
    held = recording(step, GAIN * step + NOISE * np.random.default_rng(0).standard_normal(step.size), "step")
    assert shown(sine()) == [False, False, False, False, False, False, True]
    assert shown(sine(), sine(amplitude=30.0)) == [True, False, False, False, False, False, True]
    assert shown(sine(), sine(90.0)) == [False, True, False, False, False, False, True]
    assert shown(sine(), held) == [False, False, True, True, True, False, True]
    assert shown(sine(), voltage="terminals")[5]


def test_a_step_beside_other_motion_shows_resonances() -> None:
    def resonances(r: Recording) -> bool:
        return next(a.able for a in check(campaign(r)).abilities if "resonances" in a.shows)

    t = DT * np.arange(6000)
    slow = 20.0 * np.sin(2.0 * np.pi * 5.0 * t)
    assert not resonances(recording(slow, GAIN * slow))
    stepped = slow + 87.0 * (t > 0.31)
    assert resonances(recording(stepped, GAIN * stepped))
    # A record that begins with its step.
    assert resonances(recording(87.0 + slow, GAIN * (87.0 + slow)))
    assert not resonances(replace(recording(87.0 + slow, GAIN * (87.0 + slow)), start=Start("unknown")))


def test_what_to_record_is_said_in_the_words_and_the_time_of_the_system() -> None:
    t = 4.0 * np.arange(600)
    u = 3.0 + np.sin(2.0 * np.pi * t / 900.0) + 0.3 * np.sin(2.0 * np.pi * t / 431.0)
    slow = replace(recording(u, 0.1 * u, dt=4.0), units=Units("m³/s", "m"))
    tanks = Campaign((slow,), {"network": "tanks.yaml"}, {}, "command", (), False, "made")
    said = [f"{a.shows}; {a.record}" for a in check(tanks).abilities]
    for word in ("actuator", "spring", "voltage", "second of rest", "creep"):
        assert not any(word in text for text in said), word
    assert any("334 samples (22 min)" in text for text in said)
    of_actuator = check(campaign(sine())).abilities
    assert any("the amplifier against the actuator" in a.shows for a in of_actuator)
    assert any("334 samples (33 ms)" in a.record for a in of_actuator)


@settings(max_examples=20, deadline=None)
@given(st.floats(2.3, 40.0), st.floats(0.03, 0.06), st.integers(0, 50))
def test_a_sine_in_noise_is_a_sine(cycles: float, noise: float, seed: int) -> None:
    t = np.arange(1500) / 1500.0
    u = np.sin(2.0 * np.pi * cycles * t) + noise * np.random.default_rng(seed).standard_normal(t.size)
    found = excitation_of(u, 1e-3)
    assert found.kind == "sine"
    assert found.low_Hz == pytest.approx(cycles / 1.5, rel=0.02)


def multisine(seed: int, noise: float = NOISE, tones: tuple[float, ...] = ()) -> Recording:
    """Two periods of a random-phase multisine below 250 Hz."""
    rng, size = np.random.default_rng(seed), 4096
    lines = np.zeros(size // 2 + 1, dtype=complex)
    lines[1:103] = np.exp(2j * np.pi * rng.random(102))
    u = np.tile(5.0 * size / 60.0 * np.fft.irfft(lines, size), 2)
    t = DT * np.arange(2 * size)
    y = GAIN * u + noise * rng.standard_normal(u.size)
    y += sum(1e-7 * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0)) for f in tones)
    return recording(u, y, f"run_{seed}")


def test_a_contaminated_realisation_is_found_among_the_others() -> None:
    tones = (411.3, 777.7)
    runs = [multisine(seed, tones=tones if seed == 3 else ()) for seed in range(5)]
    findings = check(campaign(*runs, multisine(9, 10.0 * NOISE))).findings
    kinds = {name: [f.kind for f in some if f.kind == "contaminated"] for name, some in findings.items()}
    assert kinds == {f"run_{i}": ["contaminated"] if i in (3, 9) else [] for i in (0, 1, 2, 3, 4, 9)}
    noticed = next(f for f in findings["run_3"] if f.kind == "contaminated")
    assert [noticed.values[f"tone_{i}_Hz"] for i in (1, 2)] == pytest.approx(tones, abs=2.0)
    assert "tones at" in noticed.text
    assert "tones" not in next(f for f in findings["run_9"] if f.kind == "contaminated").text
    # Two of a kind are too few to tell which of them is wrong.
    few = check(campaign(runs[0], runs[3])).findings
    assert not [f for some in few.values() for f in some if f.kind == "contaminated"]


def test_text_and_document_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clean = sine(7.0, cycles=28)
    y = clean.y + 3e-8 * np.sin(2.0 * np.pi * 50.0 * clean.t)
    table = np.column_stack([clean.t, clean.u, y])
    folder = tmp_path / "made"
    folder.mkdir()
    np.savetxt(folder / "a.csv", table, delimiter=",", header="time_s,voltage_V,displacement_m", comments="")
    assert main(["check", str(folder), "--out", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    document = json.loads((tmp_path / "out" / "check.json").read_text())
    (noticed,) = document["recordings"]["a"]["findings"]
    assert noticed["kind"] == "mains" and noticed["text"] in text
    for ability in document["abilities"]:
        assert ability["shows"] in text
        assert (ability["record"] in text) is not ability["able"]
    assert document["recordings"]["a"]["noise_floor"] > 0.0
    page = (tmp_path / "out" / "check.html").read_text()
    assert html.escape(noticed["text"], quote=False) in html.unescape(page)
    assert page.count('<img src="data:image/png;base64,') == 1
    assert "<script" not in page


OSCILLATOR = """
about: an electronic oscillator
junctions: {mass: 1}
elements:
  q: {type: C, junction: mass, law: spring, parameters: [k], unit: V}
  p: {type: I, junction: mass, law: capacitor, parameters: [m], unit: V s}
  damper: {type: R, junction: mass, law: linear, parameters: [d], direction: resistance}
  input: {type: Se, junction: mass, unit: V}
parameters:
  k: {value: 1.0, unit: "1", positive: true}
  m: {value: 5.0e-6, unit: s2, positive: true}
  d: {value: 2.0e-4, unit: s, positive: true}
output: q
"""


def test_another_system_keeps_its_units_to_the_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "made"
    folder.mkdir()
    t = np.arange(1200) / 600.0
    u = 0.05 * np.sin(2.0 * np.pi * 5.0 * t)
    y = 2.0 * u + 1e-3 * np.round(np.random.default_rng(2).standard_normal(t.size) * 0.4)
    rows = np.column_stack([t, u, y])
    np.savetxt(folder / "a.csv", rows, delimiter=",", header="time_s,input_V,output_V", comments="", fmt="%.9g")
    (folder / "network.yaml").write_text(OSCILLATOR)
    (folder / "recordings.yaml").write_text("setup: {network: network.yaml}\nvoltage: terminals\n")
    recording = read(folder).recordings[0]
    assert recording.units == ("V", "V")
    assert main(["check", str(folder)]) == 0
    text = capsys.readouterr().out
    assert "mV" in text
    assert not re.search(r"\d [nµm]?m\b", text)
    setup = Setup(load_network(folder / "network.yaml"))
    save(setup, tmp_path / "model", 2)
    assert main(["predict", str(tmp_path / "model"), str(folder), "--out", str(tmp_path / "y")]) == 0
    assert (tmp_path / "y" / "a.csv").read_text().startswith("time_s,output_V\n")


def test_a_recording_in_another_unit_is_noticed() -> None:
    some = [replace(sine(f), name=f"at_{f:g}") for f in (5.0, 8.0, 12.0, 20.0)]
    assert not any(check(campaign(*some)).findings.values())
    for factor in (1e-3, 1e3, 1e6):
        wrong = replace(some[1], y=factor * some[1].y, noise=factor * NOISE)
        findings = check(campaign(some[0], wrong, *some[2:])).findings
        assert [name for name, found in findings.items() if any("of the 3 others" in f.text for f in found)] == ["at_8"]
    # Of a faster one, and where the large unit is that of the input.
    wrong = replace(some[3], u=1e3 * some[3].u, name="fast")
    assert any("of the 3 others" in f.text for f in check(campaign(*some[:3], wrong)).findings["fast"])
    # A resonance may do this.
    higher = replace(some[1], y=50.0 * some[1].y)
    findings = check(campaign(some[0], higher, *some[2:])).findings
    assert not any(f.kind == "units" for found in findings.values() for f in found)


@pytest.mark.parametrize("turned", [0, 1, 3])
def test_a_recording_of_the_other_sign_is_noticed(turned: int) -> None:
    some = [replace(sine(f), name=f"at_{f:g}") for f in (5.0, 8.0, 12.0, 20.0)]
    one = replace(some[turned], y=-some[turned].y)
    findings = check(campaign(*some[:turned], one, *some[turned + 1 :])).findings
    assert [name for name, told in findings.items() if any("scale: -1" in f.text for f in told)] == [one.name]
    # All of them may be so, and one that is much faster may lie above a resonance.
    assert not any(check(campaign(*(replace(r, y=-r.y) for r in some))).findings.values())
    above = replace(sine(90.0), name="above", y=-sine(90.0).y)
    assert not any(check(campaign(*some, above)).findings.values())


def test_a_voltage_that_no_actuator_takes_is_noticed() -> None:
    some = [replace(sine(f), name=f"at_{f:g}", u=1e3 * sine(f).u) for f in (5.0, 8.0)]
    findings = check(campaign(*some)).findings
    assert all([f.values for f in told] == [{"voltage": pytest.approx(7e4, rel=1e-3)}] for told in findings.values())


def test_a_stroke_that_no_actuator_has_is_noticed() -> None:
    one = sine()
    wrong = replace(one, u=1e-3 * one.u)
    (noticed,) = (f for f in check(campaign(wrong, voltage="terminals")).findings["a"] if f.kind == "units")
    assert noticed.severity == "warning"
    assert noticed.values["gain"] == pytest.approx(1e3 * GAIN, rel=0.05)
    # A small command in front of an amplifier, another system, and a measured voltage at rest.
    assert "units" not in found(wrong)
    assert "units" not in found(replace(wrong, units=Units("N", "m")))
    small = found(replace(one, y=1e-3 * one.y, noise=1e-3 * one.noise))["units"]
    assert small.severity == "note" and "as of a single crystal" in small.text
    rng = np.random.default_rng(2)
    resting = replace(
        one, name="rest", u=2e-4 * rng.standard_normal(one.u.size), y=NOISE * rng.standard_normal(one.u.size)
    )
    findings = check(campaign(one, resting, voltage="terminals")).findings
    assert not any(f.kind == "units" for some in findings.values() for f in some)


def test_the_small_gain_of_a_fast_recording_is_no_wrong_unit() -> None:
    some = [replace(sine(f), name=f"at_{f:g}") for f in (5.0, 8.0, 12.0, 20.0)]
    fast = sine(400.0, cycles=300)
    fast = replace(fast, name="fast", y=1e-3 * fast.y, noise=1e-3 * NOISE)
    assert not any(f.kind == "units" for f in check(campaign(*some, fast)).findings["fast"])


def test_what_hysteresis_leaves_is_told_from_what_goes_on() -> None:
    u = np.concatenate([np.zeros(2000), 75.0 * np.ones(2000), np.zeros(4000)])
    noise = NOISE * np.random.default_rng(4).standard_normal(u.size)
    left = 2e-6 * (np.arange(u.size) >= 4000)
    resting = found(recording(u, GAIN * u + left + noise))["drift"]
    assert resting.severity == "note"
    assert "hysteresis leaves such a change" in resting.text
    short = np.concatenate([np.zeros(2000), 75.0 * np.ones(4000), np.zeros(200)])
    drifting = 30.0 * NOISE * np.arange(short.size) / short.size
    some = NOISE * np.random.default_rng(5).standard_normal(short.size)
    assert found(recording(short, GAIN * short + drifting + some))["drift"].severity == "warning"
    creeping = left * np.exp(-np.maximum(np.arange(u.size) - 4000.0, 0.0) / 3000.0)
    assert found(recording(u, GAIN * u + creeping + noise))["drift"].severity == "warning"


def test_what_recordings_share_is_printed_once() -> None:
    some = [replace(sine(f), name=f"at_{f:g}") for f in (5.0, 8.0, 12.0)]
    coarse = [replace(r, y=1e-8 * np.round(r.y / 1e-8)) for r in some]
    text = str(check(campaign(*coarse)))
    assert text.count("10000 Hz") == 3
    assert text.count("rest, input 0 V before") == 1
    assert text.count("output in steps of") == 1
    assert "at_5: output in steps of 10 nm" in text
    assert "similar in at_8, at_12" in text


def test_another_system_than_an_actuator_may_have_any_gain() -> None:
    coil = replace(campaign(recording(sine().u, 4e4 * sine().y)), setup={"model": "voice_coil"})
    assert not [f for f in check(coil).findings["a"] if f.kind == "units"]
    assert "units" in found(coil.recordings[0])
