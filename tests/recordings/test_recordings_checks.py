"""Every check refuses what it should, with place and remedy; every format gives the same recording."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_example import output, play, refused, sine, write, write_sine

from phnn.errors import InputRefused
from phnn.identification.prepare import prepare
from phnn.models.network_file import ready
from phnn.recordings import read, units
from phnn.recordings.recording import unrecorded
from phnn.recordings.units import QUANTITIES, find_unit, parse_name, stated_by_name
from phnn.setup import Setup
from phnn.trajectory import simulate


def good() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t, u = sine(10.0, 75.0)
    return t, u, output(u)


# Name of a changed header, or what is done to the rows of a good recording (none: nothing), and words of the refusal.
REFUSED: list[tuple[str | Callable[[list[str]], list[str]], tuple[str, ...]]] = [
    ("time_s,voltage_V,displacement", ("displacement", "no unit", "displacement_m")),
    ("time_s,voltage_V,displacement_umm", ("unknown unit 'umm'", "um")),
    ("time_s,voltage_V,displacement_Um", ("unknown unit 'Um'", "did you mean um?")),
    ("time_s,voltage_v,displacement_m", ("unknown unit 'v'", "did you mean V?")),
    (lambda rows: cell(rows, 42, 0, "nan"), ("time_s", "row 42 (line 43)", "slice")),
    (lambda rows: cell(rows, 42, 1, "9.9e37"), ("voltage_V", "row 42 (line 43)", "slice")),
    (lambda rows: cell(rows, 1, 1, "12.x"), ("line 2", "'12.x'", "not a number", "correct or delete")),
    (lambda rows: [*rows[:20], rows[20] + ",7", *rows[21:]], ("line 21", "4 cells")),
    (lambda rows: rows[:2], ("1 sample", "at least 50")),
    (lambda rows: rows[:50], ("49 sample", "at least 50")),
    (
        lambda rows: [r.replace(",", ";").replace(".", ",") for r in cell(rows, 30, 1, "overrange")],
        ("row 30 (line 31)", "'overrange'", "not a number"),
    ),
]


def cell(rows: list[str], row: int, column: int, value: str) -> list[str]:
    cells = rows[row].split(",")
    return [*rows[:row], ",".join([*cells[:column], value, *cells[column + 1 :]]), *rows[row + 1 :]]


@pytest.mark.parametrize(("change", "words"), REFUSED)
def test_refused(tmp_path: Path, change: str | Callable[[list[str]], list[str]], words: tuple[str, ...]) -> None:
    rows = write(tmp_path / "a.csv", *good()).read_text().splitlines()
    rows = [change, *rows[1:]] if isinstance(change, str) else change(rows)
    (tmp_path / "a.csv").write_text("\n".join(rows))
    refused(tmp_path, "a.csv", *words)


def test_a_folder_that_holds_no_recordings_is_refused_with_what_it_is(tmp_path: Path) -> None:
    refused(tmp_path / "absent", "absent", "no such folder")
    refused(write_sine(tmp_path, "a", 1.0, 10.0), "this is a file", "folder")
    (tmp_path / "a.csv").rename(tmp_path / "README.md")
    refused(tmp_path, "no recordings", "README.md")


@pytest.mark.parametrize("level", [-0.95, -0.7, 0.8, 0.95])
def test_a_clipped_sensor_is_refused_at_either_end(tmp_path: Path, level: float) -> None:
    t, u, y = good()
    limited = np.minimum(y, level * y.max()) if level > 0.0 else np.maximum(y, -level * y.min())
    write(tmp_path / "a.csv", t, u, limited)
    refused(tmp_path, "displacement_m", "clipped", "largest" if level > 0.0 else "smallest", "row ", "range")


def flat() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Recordings whose output stands still and is not clipped: coarse steps, holds and backlash."""
    t, u = sine(10.0, 75.0)
    many, fine = sine(10.0, 75.0, samples=2000)
    slow = np.arange(2000) * 1e-3
    hold = np.interp(slow, [0.3, 0.6, 1.4, 1.7], [0.0, 50.0, 50.0, 0.0])
    # Dry friction stops a mass at its turning points: it slows down, stands still, and begins more slowly still.
    push, way, speed = 60.0 * np.sin(2 * np.pi * slow / 0.8), np.zeros(slow.size), 0.0
    for n in range(1, slow.size):
        pull = push[n] - 8.0 * speed
        stands = speed * (speed + 1e-3 * 60.0 * (pull - np.sign(speed) * 25.0)) <= 0.0 and abs(push[n]) < 25.0
        speed = 0.0 if stands else speed + 1e-3 * 60.0 * (pull - 25.0 * (np.sign(speed) or np.sign(pull)))
        way[n] = way[n - 1] + 1e-3 * speed
    return (
        {f"steps of {step}": (many, fine, output(fine, noise=0.0, step=step)) for step in (20e-9, 0.2e-6, 1e-6)}
        | {f"backlash of {radius}": (t, u, 1e-6 * play(u, radius)) for radius in (2.0, 10.0, 40.0)}
        | {"holds and rests": (slow, hold, 1e-6 * play(hold, 5.0))}
        | {"dry friction": (slow, push, 1e-7 * np.round(100.0 * way))}
    )


@pytest.mark.parametrize("case", flat())
def test_an_output_that_stands_still_is_not_clipped(tmp_path: Path, case: str) -> None:
    t, u, y = flat()[case]
    write(tmp_path / "a.csv", t, u, y)
    assert read(tmp_path).recordings[0].y.size == t.size


@pytest.mark.parametrize(
    ("level", "said"), [(20.0, "unknown"), (0.0, "unknown"), (20.0, "{state: rest, input_before: 0.0}")]
)
def test_a_constant_input_is_read_where_its_start_is_stated(tmp_path: Path, level: float, said: str) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, np.full_like(u, level), y)
    write_sine(tmp_path, "b", 5.0, 40.0)
    (tmp_path / "recordings.yaml").write_text(f"recordings: [{{file: a.csv, start: {said}}}, {{file: b.csv}}]")
    assert {r.name: r.start.state for r in read(tmp_path).recordings}["a"] in said


@pytest.mark.parametrize("byte", [145, 172, 184, 185])
def test_damaged_tags_in_a_mat_file_do_not_crash_the_reader(tmp_path: Path, byte: int) -> None:
    scipy.io.savemat(tmp_path / "a.mat", dict(zip(("time_s", "voltage_V", "displacement_m"), good(), strict=True)))
    raw = bytearray((tmp_path / "a.mat").read_bytes())
    raw[byte] = 255
    (tmp_path / "a.mat").write_bytes(bytes(raw))
    refused(tmp_path, "a.mat", "save it again")


def test_name_that_only_resembles_a_quantity_is_left_alone(tmp_path: Path) -> None:
    t, u, y = good()
    rows = "\n".join(f"{a!r},{b!r},{c!r},0" for a, b, c in zip(t.tolist(), u.tolist(), y.tolist(), strict=True))
    (tmp_path / "a.csv").write_text("time_s,voltage_V,displacement_m,voltage_monitor\n" + rows)
    campaign = read(tmp_path)
    assert any("voltage_monitor" in note for note in campaign.notes)


def test_samples_that_jitter_keep_their_instants(tmp_path: Path) -> None:
    t, _ = sine(10.0, 75.0)
    jittered = t + np.random.default_rng(1).uniform(-0.3, 0.3, t.size) * t[1]
    u = 75.0 * np.sin(2.0 * np.pi * 10.0 * jittered)
    write(tmp_path / "a.csv", jittered, u, 1e-6 * u)
    campaign = read(tmp_path)
    r = campaign.recordings[0]
    assert any("jitters" in note for note in campaign.notes)
    assert np.allclose(r.t, jittered - jittered[0], rtol=0.0, atol=1e-12)
    assert np.array_equal(r.u, u)
    assert r.clock is not None


def test_rounded_times_are_no_jitter(tmp_path: Path) -> None:
    t = np.arange(900) / 30_000.0
    u = 50.0 * np.sin(2.0 * np.pi * 100.0 * t)
    rows = "\n".join(f"{a:.6f},{b!r},{c!r}" for a, b, c in zip(t, u.tolist(), (1e-6 * u).tolist(), strict=True))
    (tmp_path / "a.csv").write_text("time_s,voltage_V,displacement_m\n" + rows)
    campaign = read(tmp_path)
    assert campaign.recordings[0].dt == pytest.approx(1 / 30_000.0, rel=1e-5)
    assert any("rounded" in note for note in campaign.notes)
    assert np.array_equal(campaign.recordings[0].u, u)


def test_rates_may_differ_between_files(tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 1.0, 10.0)
    write_sine(tmp_path, "b", 10.0, 10.0)
    assert any("different rates" in note for note in read(tmp_path).notes)


@settings(max_examples=60, deadline=None)
@given(
    time=st.sampled_from(["s", "ms", "us", "min", "h"]),
    voltage=st.sampled_from(["V", "mV", "kV", "J/C"]),
    displacement=st.sampled_from(["m", "mm", "um", "nm", "in", "ft"]),
    temperature=st.sampled_from(["K", "degC", "degF"]),
    order=st.permutations(range(4)),
    brackets=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_round_trip_with_random_units(
    time: str, voltage: str, displacement: str, temperature: str, order: list[int], brackets: bool, seed: int
) -> None:
    t, u = sine(10.0, 75.0, samples=60)
    channels = {"time": (t, time), "voltage": (u, voltage), "displacement": (output(u, seed=seed), displacement)}
    channels["temperature"] = (np.linspace(290.0, 300.0, t.size), temperature)
    names, columns = [], []
    for name, (values, unit) in channels.items():
        known = find_unit(unit)
        names.append(f"{name} [{unit}]" if brackets else f"{name}_{unit}")
        columns.append((values - known.offset) / known.factor)
    with tempfile.TemporaryDirectory() as folder:
        rows = np.column_stack([columns[i] for i in order])
        head = ",".join(names[i] for i in order)
        np.savetxt(Path(folder) / "a.csv", rows, delimiter=",", header=head, comments="", fmt="%.17g")
        r = read(folder).recordings[0]
    np.testing.assert_allclose(r.t, t, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(r.u, u, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(r.y, channels["displacement"][0], rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(r.channels["temperature"], channels["temperature"][0], rtol=1e-12)


@pytest.mark.parametrize(("unit", "value", "expected", "si"), [
    ("min", 2.0, 120.0, "s"), ("kV", 1.5, 1500.0, "V"), ("nm", 3.0, 3e-9, "m"), ("micron", 3.0, 3e-6, "m"),
    ("\u00b5m", 3.0, 3e-6, "m"), ("in", 1.0, 0.0254, "m"), ("degC", 20.0, 293.15, "K"),
    ("\u00b0F", 212.0, 373.15, "K"), ("nC", 1.0, 1e-9, "C"), ("lbf", 1.0, 4.4482216152605, "N"),
    ("lbf/in", 2.0, 2 * 4.4482216152605 / 0.0254, "N/m"), ("Nm", 2.0, 2.0, "N·m"), ("mN.m", 2.0, 2e-3, "N·m"),
    ("N s/m", 2.0, 2.0, "N·s/m"), ("m3/s", 2.0, 2.0, "m³/s"), ("m³/h", 3600.0, 1.0, "m³/s"),
    ("L/min", 60.0, 1e-3, "m³/s"), ("mm/s^2", 2.0, 2e-3, "m/s²"), ("m s-2", 2.0, 2.0, "m/s²"),
    ("V/(m s)", 2.0, 2.0, "V/m/s"), ("rad", 2.0, 2.0, "rad"), ("deg/s", 180.0, np.pi, "rad/s"),
    ("rpm", 60.0, 2 * np.pi, "rad/s"), ("kHz", 1.0, 1e3, "Hz"), ("bar", 1.0, 1e5, "Pa"), ("%", 50.0, 0.5, "1"),
    ("mV/V", 2.0, 2e-3, "1"), ("1", 2.0, 2.0, "1"), ("1/s", 2.0, 2.0, "1/s"),
    ("RPM", 30.0, np.pi, "rad/s"), ("U/min", 30.0, np.pi, "rad/s"), ("Ncm", 3.0, 0.03, "N·m"), ("N-m", 3.0, 3.0, "N·m"),
    ("kΩ", 2.0, 2e3, "Ω"), ("Amps", 2.0, 2.0, "A"), ("Deg", 180.0, np.pi, "rad"), ("deg C", 20.0, 293.15, "K"),
    ("mil", 1000.0, 0.0254, "m"), ("MM", 2.0, 2e-3, "m"), ("VDC", 2.0, 2.0, "V"), ("Watt", 2.0, 2.0, "W"),
])  # fmt: skip
def test_units(unit: str, value: float, expected: float, si: str) -> None:
    known = find_unit(unit)
    assert (value * known.factor + known.offset, known.si) == (pytest.approx(expected, rel=1e-13), si)


@pytest.mark.parametrize("text", [
    "m**9999999", "m**9**9", "m^99", "m" * 10**6, "(" * 10**5, "m*" * 10**5, "m" + "/s" * 10**5, "m e9", "1e999 m",
    "__import__('os')", "m.__class__", "lambda: 1", "0/0", "1/0", "m/0", "V\nm", "V\x00", "\x1b[31m", "", " ", "m m_",
    "dB", "dBm", "monitor", "V" + 21 * " V", "c", "k", "e", "nan", "inf", "m³²",
], ids=repr)  # fmt: skip
def test_texts_that_are_no_units_are_refused_at_once(text: str) -> None:
    start = time.perf_counter()
    assert find_unit(text) is None
    assert time.perf_counter() - start < 2.0  # the first one loads the definitions


@pytest.mark.parametrize(("prefix", "size"), [("", 1.0), ("m", 1e-3), ("u", 1e-6), ("n", 1e-9), ("k", 1e3)])
def test_a_prefix_is_exactly_a_power_of_ten_with_pint_and_without(
    prefix: str, size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = {name: find_unit(name) for name in (f"{prefix}{unit}" for unit in QUANTITIES.values() if unit)}
    monkeypatch.setattr(units, "_COMMON", {})
    assert {name: find_unit.__wrapped__(name) for name in known} == known
    assert [stated_by_name(n, "output") for n in ("power_W", "h_degC", "x_m", "flow_in")] == ["W", "degC", None, None]
    assert {unit.factor for unit in known.values() if unit is not None} == {size}


def test_common_units_need_no_definitions() -> None:
    asked = "from phnn.recordings.units import find_unit; import sys; find_unit('um'), find_unit('V')"
    code = f"{asked}; assert 'pint' not in sys.modules; find_unit('mil'); assert 'pint' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("name", "parsed"), [
    ("displacement_um", ("displacement", "um")), ("displacement_\u00b5m", ("displacement", "um")), ("", ("", None)),
    ("displacement_\u03bcm", ("displacement", "um")), ("Voltage (mV)", ("voltage", "mV")), ("time", ("time", None)),
    ("temperature_\u00b0C", ("temperature", "degC")), ("position_um", ("", None)), ("u[V", ("", None)),
])  # fmt: skip
def test_names(name: str, parsed: tuple[str, str | None]) -> None:
    assert parse_name(name) == parsed


def test_tdms_without_its_package_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.tdms").write_bytes(b"TDSm")
    monkeypatch.setitem(sys.modules, "nptdms", None)
    refused(tmp_path, "a.tdms", "npTDMS", "pip install 'phnn[tdms]'")


# A semicolon stands for the separator, an exclamation mark for the decimal sign.
HEADERS = {
    "names with units": "time_s;voltage_V;displacement_um",
    "units in brackets": "Time (s);Voltage (V);Displacement [\u00b5m]",
    "a row of units": "Time;Voltage;Displacement\n(s);(V);(um)",
    "units in words": "time;voltage;displacement\nsecond;Volt;um\n",
    "a block above": "Instrument;Scope 7\nSample interval;0!000125\nComment;\n\ntime_s;voltage_V;displacement_um",
    "marked": "# bench 3, second floor\n% time_s;voltage_V;displacement_um",
}


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("separator", [",", ";", "\t", "  "])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_text_as_instruments_write_it(tmp_path: Path, header: str, separator: str, decimal: str, encoding: str) -> None:
    t, u, y = good()
    quote = '"' if separator == decimal else ""
    cells = [
        [quote + f"{v:.17g}".replace(".", decimal) + quote for v in row] for row in zip(t, u, 1e6 * y, strict=True)
    ]
    above = HEADERS[header].replace(";", separator).replace("!", decimal).split("\n")
    text = "\r\n".join([*above, *(separator.join(row) for row in cells)]) + "\r\n"
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    r = read(tmp_path).recordings[0]
    np.testing.assert_allclose(r.t, t, atol=1e-12)
    np.testing.assert_array_equal(r.u, u)
    np.testing.assert_allclose(r.y, y, rtol=1e-14)


def test_array_of_another_shape(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((100, 3, 2)))
    refused(tmp_path, "a.npy", "(100, 3, 2)", "(samples, columns)")


STEP = 0.01
N = np.arange(600)
FORCE, PLACE = 7.0 * np.sin(1.9 * N * STEP), 31.0 * np.sin(1.9 * N * STEP - 0.3)
NOISY = PLACE + 0.02 * np.random.default_rng(3).standard_normal(N.size)


def rig(folder: Path, text: str, columns: str = "", more: str = "") -> None:
    """Write a recording of a mass on a spring and its manifest."""
    if text:
        (folder / "a.csv").write_text(text)
    said = columns or "{input: {column: force_N, unit: N}, output: {column: place_mm, unit: mm}}"
    (folder / "recordings.yaml").write_text(f"setup: {{model: mass_spring_damper}}\ncolumns: {said}\n{more}")


def rows(t: np.ndarray, u: np.ndarray, y: np.ndarray, head: str = "time_s,force_N,place_mm", form: str = "%.4f") -> str:
    """Return a csv."""
    return "\n".join(
        [head, *(",".join([form % a, f"{b:.5f}", f"{c:.5f}"]) for a, b, c in zip(t, u, y, strict=True)), ""]
    )


def test_words_dates_and_footers_stand_beside_numbers(tmp_path: Path) -> None:
    stamps = np.datetime64("2031-05-06T23:59:58.500") + (10 * N).astype("timedelta64[ms]")
    text = [f"{str(s).replace('T', ' ')}+02:00,{u:.5f},{y:.5f},{'up' if u > 0 else 'down'},"
            for s, u, y in zip(stamps, FORCE, NOISY, strict=True)]  # fmt: skip
    rig(tmp_path, "\n".join(["when,force_N,place_mm,phase", *text, "end of file,,,,"]) + "\n")
    campaign = read(tmp_path)
    (r,) = campaign.recordings
    assert r.t.size == N.size and r.dt == pytest.approx(STEP, rel=1e-9)
    np.testing.assert_allclose(r.y, 1e-3 * np.round(NOISY, 5), rtol=1e-12)
    assert all(any(word in note for note in campaign.notes) for word in ("phase", "when: dates", "end of file"))


@pytest.mark.parametrize(("cell", "value"), [("-1.234,50", -1234.5), ("1.234", None)])
def test_a_point_among_decimal_commas_is_thousands_or_refused(tmp_path: Path, cell: str, value: float | None) -> None:
    body = [f"{i / 100:.2f};{u:.5f};{y:.5f}".replace(".", ",") for i, u, y in zip(N, FORCE, 100.0 * NOISY, strict=True)]
    body[300] = f"3,00;{cell};{body[300].split(';')[2]}"
    rig(tmp_path, "\n".join(["time;force;place", "s;N;mm", *body, ""]), "{input: {column: 1}, output: {column: 2}}")
    if value is None:
        refused(tmp_path, "row 301", "1.234", "thousand")
    else:
        assert read(tmp_path).recordings[0].u[300] == value


def test_a_row_of_units_that_contradicts_a_name_is_refused(tmp_path: Path) -> None:
    rig(tmp_path, rows(N * STEP, FORCE, NOISY, "time_s,force_N,place_mm\ns,kN,mm"))
    refused(tmp_path, "line 2", "force_N", "kN")


def test_the_model_is_evaluated_at_the_stamps(tmp_path: Path) -> None:
    t = np.sort(N * STEP + np.random.default_rng(5).uniform(-0.4, 0.4, N.size) * STEP)
    t -= t[0]
    rig(tmp_path, rows(t, 7.0 * np.sin(1.9 * t), NOISY, form="%.9f"))
    (r,) = read(tmp_path).recordings
    np.testing.assert_allclose(r.t, t, atol=1e-9)
    setup = Setup(ready("mass_spring_damper", {"k": 400.0, "m": 0.9, "b": 4.0}))
    fine = np.linspace(0.0, t[-1], 20 * N.size)
    exact = simulate(setup, unrecorded("fine", fine, 7.0 * np.sin(1.9 * fine)), 2).y
    found = simulate(setup, r, 8).y
    assert np.abs(found - np.interp(t, fine, exact)).max() < 2e-4 * np.ptp(exact)


def test_rows_twice_swapped_and_missing_are_repaired_with_a_word(tmp_path: Path) -> None:
    order = np.delete(N, [200, 201, 202])
    order[[90, 91]] = order[[91, 90]]
    order = np.insert(order, 50, order[49])
    rig(tmp_path, rows(order * STEP, FORCE[order], NOISY[order]))
    campaign = read(tmp_path)
    np.testing.assert_allclose(campaign.recordings[0].t, STEP * np.delete(N, [200, 201, 202]), atol=1e-9)
    for words in ("1 times go back, the first at row 9", "1 rows repeat", "1 intervals are longer"):
        assert any(words in note for note in campaign.notes), words
    rig(tmp_path, rows(np.insert(N, 50, 49) * STEP, np.insert(FORCE, 50, 1.0), np.insert(NOISY, 50, NOISY[50])))
    refused(tmp_path, "row 51", "two rows with one time")


@pytest.mark.parametrize("every", [4, 7])
def test_a_held_output_counts_where_it_was_sampled(tmp_path: Path, every: int) -> None:
    rig(tmp_path, rows(N * STEP, FORCE, NOISY[N - N % every]))
    campaign = read(tmp_path)
    (r,) = campaign.recordings
    assert r.seen is not None and np.array_equal(np.flatnonzero(r.seen), N[::every])
    assert any(f"once in {every} rows" in note for note in campaign.notes)
    assert 0.5 * 2e-5 < r.noise < 2.0 * 2e-5


def test_two_rates_in_one_file_are_read_where_the_input_is_held(tmp_path: Path) -> None:
    t = np.concatenate([np.arange(0.0, 60.0, 1.0), np.arange(60.0, 64.0, 0.05), np.arange(64.0, 140.0, 1.0)])
    u = np.where((t >= 60.0) & (t < 64.0), 5.0, 0.0)
    rig(tmp_path, rows(t, u, 10.0 * u + 0.1 * np.sin(t)), more="input: zero_order\n")
    assert read(tmp_path).recordings[0].t[-1] == pytest.approx(139.0)


def test_channels_of_two_clocks_are_aligned_or_refused(tmp_path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    def written(dated: bool, first: str = "force_N", second: str = "place_mm", unit: str = "") -> None:
        start = np.datetime64("2030-01-01T00:00:00.000")
        late = {"wf_start_time": start + np.timedelta64(70, "ms")} if dated else {}
        with TdmsWriter(tmp_path / "a.tdms") as writer:
            writer.write_segment([
                ChannelObject("g", first, FORCE, {"wf_increment": STEP, "wf_start_time": start}),
                ChannelObject("g", second, NOISY, {"wf_increment": STEP, "unit_string": unit, **late}),
            ])  # fmt: skip

    rig(tmp_path, "")
    written(dated=True)
    (r,) = read(tmp_path).recordings
    np.testing.assert_allclose(r.u, FORCE[7:], rtol=1e-12)
    np.testing.assert_allclose(r.y, 1e-3 * NOISY[:-7], rtol=1e-12)
    written(dated=False)
    refused(tmp_path, "clocks of their own", "force_N", "place_mm")
    written(True, "force [N]", "force", "N")
    refused(tmp_path, "two channels are called force [N]")


@pytest.mark.parametrize(("fault", "words", "key"), [
    ("mark", ("row 124", "-999", "missing: [-999]"), "missing: -999"),
    ("glitch", ("row 124", "more single", "glitches"), "missing: glitches"),
    ("pair", ("row 124", "77 between", "glitches"), "missing: glitches"), ("zero", ("row 124", "[0]"), "missing: 0"),
    ("OL", ("row 124", "'OL' is not a number", "missing: ['OL']"), "missing: [OL]"),
    ("7 N", ("row 124", "a number with its unit", "unit: N"), ""), ("45%", ("a number with its unit",), ""),
    ("1 234", ("row 124", "not a number"), ""),
    ("wrap", ("row", "unwrap: 360"), "unwrap: 360"),
    ("hole", ("row 124", "missing: empty"), "missing: empty"),
])  # fmt: skip
def test_marks_glitches_and_wraps_are_named_and_masked_by_a_key(
    tmp_path: Path, fault: str, words: tuple[str, ...], key: str
) -> None:
    y = NOISY + 200.0 * (fault == "zero")
    truth = y.copy()
    if fault == "wrap":
        y = np.mod(np.cumsum(40.0 + PLACE), 360.0)
    else:
        y[123 : 124 + (fault in ("pair", "zero"))] = {"mark": -999.0, "glitch": 77.0, "pair": 77.0, "zero": 0.0}.get(
            fault, np.nan
        )
    text = rows(N * STEP, FORCE, y).replace("nan", "" if key in words else fault)
    rig(tmp_path, text)
    refused(tmp_path, "a.csv", *words)
    if not key:
        return
    rig(tmp_path, text, f"{{input: {{column: force_N, unit: N}}, output: {{column: place_mm, unit: mm, {key}}}}}")
    (r,) = read(tmp_path).recordings
    truth = np.cumsum(40.0 + PLACE) if fault == "wrap" else truth
    seen = np.ones(N.size, dtype=bool) if r.seen is None else r.seen
    assert seen.sum() == N.size - {"wrap": 0, "pair": 2, "zero": 2}.get(fault, 1)
    np.testing.assert_allclose((r.y - r.y[0])[seen], 1e-3 * (truth - truth[0])[seen], atol=2e-8)


@pytest.mark.parametrize(("unit", "words"), [
    ("mm/s", "derivative: true"), ("m/s2", "second_derivative: true"), ("N s", "output: p"), ("degC", "correct"),
])  # fmt: skip
def test_an_output_of_another_dimension_is_refused(tmp_path: Path, unit: str, words: str) -> None:
    rig(
        tmp_path,
        rows(N * STEP, FORCE, NOISY),
        f"{{input: {{column: 1, unit: N}}, output: {{column: 2, unit: {unit}}}}}",
    )
    with pytest.raises(InputRefused, match=words):
        prepare(read(tmp_path))


def test_signals_and_experiments_of_matlab_are_found_by_their_names(tmp_path: Path) -> None:
    rig(tmp_path, "")
    signals = [{"Name": n, "Data": x, "Unit": u} for n, x, u in (("F/1", FORCE, "N"), ("P 2", NOISY, "mm"))]
    scope = {"X": {"Name": "", "Data": N * STEP, "Unit": "s"}, "Y": np.array(signals, dtype=object)}
    scipy.io.savemat(tmp_path / "a.mat", {"rec": scope})
    said = "setup: {model: mass_spring_damper}\ncolumns: {input: {column: F/1}, output: {column: P 2}}\n"
    (tmp_path / "recordings.yaml").write_text(said)
    np.testing.assert_allclose(read(tmp_path).recordings[0].y, 1e-3 * NOISY, rtol=1e-12)
    cells = np.empty(2, dtype=object)
    cells[:] = [{"time_s": N[:n] * STEP, "force_N": FORCE[:n], "place_mm": NOISY[:n]} for n in (400, 600)]
    scipy.io.savemat(tmp_path / "a.mat", {"runs": cells})
    (tmp_path / "recordings.yaml").write_text(
        said.replace("F/1", "force_N, unit: N").replace("P 2", "place_mm, unit: mm")
    )
    assert [r.t.size for r in read(tmp_path).recordings] == [400, 600]


def test_what_stands_beside_a_dataset_is_taken_over(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time_s"], file["voltage_V"] = N * STEP, FORCE
        file["displacement"] = np.round(NOISY * 100.0).astype(np.int16)
        file["displacement"].attrs.update({"units": "um", "scale_factor": 0.01, "_FillValue": -32768})
    np.testing.assert_allclose(read(tmp_path).recordings[0].y, 1e-6 * np.round(NOISY, 2), atol=1e-14)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["voltage_V"].attrs["units"] = "mV"
    refused(tmp_path, "the name says V", "mV")


def test_the_only_column_with_a_unit_is_meant(tmp_path: Path) -> None:
    rows = [f"{1e3 * i * STEP:.4f};{u:.4f};{y:.4f}" for i, u, y in zip(N, FORCE, NOISY, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["Zeit [ms];Spannung [V];Weg [µm]", *rows]), encoding="utf-8")
    np.testing.assert_allclose(read(tmp_path).recordings[0].y, 1e-6 * NOISY, atol=1e-10)
    (tmp_path / "a.csv").write_text("\n".join(["t [ms];Soll [V];Ist [V]", *rows]))
    refused(tmp_path, "no voltage column")


LONG = np.arange(250_000) * 1e-4  # s
SQUARE = np.sign(np.sin(2900.0 * LONG))


@pytest.mark.parametrize(
    "voltage, samples, note",
    [
        (30.0 * np.sin(11.0 * LONG), 50_000, "of 250000 samples one in 5 is used"),
        (SQUARE, 50_000, "the first 5 s of 25 s are used"),
        (SQUARE * (0.1 + 0.9 * (LONG > 6.0)), 100_000, "the first 10 s of 25 s are used"),
        (np.sign(np.sin(100.0 * LONG**2)), 250_000, "see `slice`"),
    ],
)
def test_a_long_recording_is_thinned_and_cut_by_what_its_signals_need(
    tmp_path: Path, voltage: np.ndarray, samples: int, note: str
) -> None:
    y = 3e-5 * np.sin(11.0 * LONG - 0.2) + 2e-8 * np.random.default_rng(2).standard_normal(LONG.size)
    np.savez(tmp_path / "a.npz", time_s=LONG, voltage_V=voltage, displacement_m=y)
    campaign = read(tmp_path)
    assert campaign.recordings[0].t.size == samples and any(note in n for n in campaign.notes)


def test_two_time_columns_in_a_text_are_refused_with_both(tmp_path: Path) -> None:
    body = [f",{i * STEP:.3f},{u:.4f},{0.8 * i * STEP:.4f},{y:.4f}" for i, u, y in zip(N, FORCE, NOISY, strict=True)]
    head = ["Start,10:00:01,,10:00:02,", "Interval,0.01,,0.008,", "Channel,Force,,Place,", "Unit,s,N,s,mm"]
    rig(tmp_path, "\n".join([*head, *body, ""]), "{input: {column: 2, unit: N}, output: {column: 4, unit: mm}}")
    refused(tmp_path, "two clocks", "Force [s]", "Place [s]")
