"""Every format gives the same recording; units are converted once, at the boundary."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_example import output, refused, sine

from phnn.recordings import read
from phnn.recordings.units import QUANTITIES, accepted, by_pint, find_unit, known_unit, parse_name, suits, to_si

STATED = "columns: {time: {column: 0, unit: s}, voltage: {column: 1, unit: V}, displacement: {column: 2, unit: m}}\n"


OF_EACH = {
    "s": ["s", "ms", "us", "min", "h"],
    "V": ["V", "mV", "kV", "J/C"],
    "m": ["m", "mm", "um", "nm", "in", "ft"],
    "K": ["K", "degC", "degF"],
}


@settings(max_examples=60, deadline=None)
@given(
    time=st.sampled_from(OF_EACH.get("s")),
    voltage=st.sampled_from(OF_EACH.get("V")),
    displacement=st.sampled_from(OF_EACH.get("m")),
    temperature=st.sampled_from(OF_EACH.get("K")),
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
        known = known_unit(unit)
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
])  # fmt: skip
def test_units(unit: str, value: float, expected: float, si: str) -> None:
    assert to_si(np.array([value]), unit)[0] == pytest.approx(expected, rel=1e-13)
    assert known_unit(unit).si == si


@pytest.mark.parametrize("unit", ["um", "us", "nm", "mV", "uC", "mA", "kN", "mm", "ms", "uA", "nA", "nC", "mN"])
def test_a_prefix_is_exactly_a_power_of_ten(unit: str) -> None:
    assert known_unit(unit).factor == float({"u": "1e-6", "m": "1e-3", "n": "1e-9", "k": "1e3"}[unit[0]])


@pytest.mark.parametrize("text", [
    "m**9999999", "m**9**9", "m^99", "m" * 10**6, "(" * 10**5, "m*" * 10**5, "m" + "/s" * 10**5, "m e9", "1e999 m",
    "__import__('os')", "m.__class__", "lambda: 1", "0/0", "1/0", "m/0", "V\nm", "V\x00", "\x1b[31m", "", " ", "m m_",
    "dB", "dBm", "monitor", "V" + 21 * " V", "c", "k", "e", "nan", "inf", "m³²",
], ids=repr)  # fmt: skip
def test_texts_that_are_no_units_are_refused_at_once(text: str) -> None:
    start = time.perf_counter()
    assert find_unit(text) is None
    assert time.perf_counter() - start < 2.0  # the first one loads the definitions


def test_units_known_without_pint_are_those_of_pint() -> None:
    si = {name for name in QUANTITIES.values() if name}
    for name in (f"{prefix}{unit}" for prefix in ("", "m", "u", "n", "k") for unit in si):
        assert find_unit(name) == by_pint(name), name


def test_common_units_need_no_definitions() -> None:
    asked = "from phnn.recordings.units import find_unit; import sys; find_unit('um'), find_unit('V')"
    code = f"{asked}; assert 'pint' not in sys.modules; find_unit('mil'); assert 'pint' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("name", "parsed"), [
    ("displacement_um", ("displacement", "um")), ("displacement_\u00b5m", ("displacement", "um")),
    ("displacement_\u03bcm", ("displacement", "um")), ("Voltage (mV)", ("voltage", "mV")),
    ("temperature_\u00b0C", ("temperature", "degC")), ("time", ("time", None)), ("position_um", None), ("u[V", None),
])  # fmt: skip
def test_names(name: str, parsed: tuple[str, str | None] | None) -> None:
    assert parse_name(name) == parsed


def test_every_quantity_has_a_unit() -> None:
    for quantity in QUANTITIES:
        for unit in accepted(quantity).split(" and ")[0].split(", "):
            assert suits(quantity, unit)


@cache
def made() -> np.ndarray:
    t, u = sine(10.0, 75.0)
    return np.column_stack([t, u, output(u)])


def test_tdms_without_its_package_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.tdms").write_bytes(b"TDSm")
    monkeypatch.setitem(sys.modules, "nptdms", None)
    refused(tmp_path, "a.tdms", "npTDMS", "pip install 'phnn[tdms]'")


def test_datasets_of_a_group_by_name(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, column in zip(("T", "V1", "V2"), made().T, strict=True):
            file[f"scope/{name}"] = column
    (tmp_path / "recordings.yaml").write_text(
        STATED + "recordings: [{file: a.h5, variables: {time: scope.T, voltage: scope.V1, displacement: scope.V2}}]"
    )
    np.testing.assert_array_equal(read(tmp_path).recordings[0].y, made()[:, 2])


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
    t, u, y = made().T
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


def test_prediction_needs_no_output(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.csv", made()[:, :2], delimiter=",", header="time_s,voltage_V", comments="", fmt="%.17g")
    r = read(tmp_path, need_output=False).recordings[0]
    assert np.isnan(r.y).all()
    np.testing.assert_array_equal(r.u, made()[:, 1])
