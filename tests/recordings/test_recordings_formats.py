"""Every format gives the same recording; units are converted once, at the boundary."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_example import output, refused, sine, write

from phnn.recordings import read
from phnn.recordings.reader import READERS
from phnn.recordings.text_files import read_text
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


@pytest.mark.parametrize(
    ("unit", "value", "expected", "si"),
    [
        ("min", 2.0, 120.0, "s"),
        ("kV", 1.5, 1500.0, "V"),
        ("nm", 3.0, 3e-9, "m"),
        ("micron", 3.0, 3e-6, "m"),
        ("\u00b5m", 3.0, 3e-6, "m"),
        ("in", 1.0, 0.0254, "m"),
        ("degC", 20.0, 293.15, "K"),
        ("\u00b0F", 212.0, 373.15, "K"),
        ("nC", 1.0, 1e-9, "C"),
        ("lbf", 1.0, 4.4482216152605, "N"),
        ("lbf/in", 2.0, 2 * 4.4482216152605 / 0.0254, "N/m"),
        ("Nm", 2.0, 2.0, "N·m"),
        ("mN.m", 2.0, 2e-3, "N·m"),
        ("N s/m", 2.0, 2.0, "N·s/m"),
        ("m3/s", 2.0, 2.0, "m³/s"),
        ("m³/h", 3600.0, 1.0, "m³/s"),
        ("L/min", 60.0, 1e-3, "m³/s"),
        ("mm/s^2", 2.0, 2e-3, "m/s²"),
        ("m s-2", 2.0, 2.0, "m/s²"),
        ("V/(m s)", 2.0, 2.0, "V/m/s"),
        ("rad", 2.0, 2.0, "rad"),
        ("deg/s", 180.0, np.pi, "rad/s"),
        ("rpm", 60.0, 2 * np.pi, "rad/s"),
        ("kHz", 1.0, 1e3, "Hz"),
        ("bar", 1.0, 1e5, "Pa"),
        ("%", 50.0, 0.5, "1"),
        ("mV/V", 2.0, 2e-3, "1"),
        ("1", 2.0, 2.0, "1"),
        ("1/s", 2.0, 2.0, "1/s"),
    ],
)
def test_units(unit: str, value: float, expected: float, si: str) -> None:
    assert to_si(np.array([value]), unit)[0] == pytest.approx(expected, rel=1e-13)
    assert known_unit(unit).si == si


@pytest.mark.parametrize("unit", ["um", "us", "nm", "mV", "uC", "mA", "kN", "mm", "ms", "uA", "nA", "nC", "mN"])
def test_a_prefix_is_exactly_a_power_of_ten(unit: str) -> None:
    assert known_unit(unit).factor == float({"u": "1e-6", "m": "1e-3", "n": "1e-9", "k": "1e3"}[unit[0]])


@pytest.mark.parametrize(
    "text",
    [
        *(
            "m**9999999",
            "m**9**9",
            "m^99",
            "m" * 10**6,
            "(" * 10**5,
            "m*" * 10**5,
            "m" + "/s" * 10**5,
            "m e9",
            "1e999 m",
        ),
        *(
            "__import__('os')",
            "m.__class__",
            "lambda: 1",
            "0/0",
            "1/0",
            "m/0",
            "V\nm",
            "V\x00",
            "\x1b[31m",
            "",
            " ",
            "m m_",
        ),
        *("dB", "dBm", "monitor", "V V V V V V V V V V V V V V V V V V V V V V", "c", "k", "e", "nan", "inf", "m³²"),
    ],
)
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


@pytest.mark.parametrize(
    ("name", "parsed"),
    [
        ("displacement_um", ("displacement", "um")),
        ("displacement_\u00b5m", ("displacement", "um")),
        ("displacement_\u03bcm", ("displacement", "um")),
        ("Voltage (mV)", ("voltage", "mV")),
        ("temperature_\u00b0C", ("temperature", "degC")),
        ("time", ("time", None)),
        ("position_um", None),
        ("u[V", None),
    ],
)
def test_names(name: str, parsed: tuple[str, str | None] | None) -> None:
    assert parse_name(name) == parsed


def test_every_quantity_has_a_unit() -> None:
    for quantity in QUANTITIES:
        for unit in accepted(quantity).split(" and ")[0].split(", "):
            assert suits(quantity, unit)


def recorded(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t, u = sine(10.0, 75.0)
    y = output(u)
    r = read(folder).recordings[0]
    np.testing.assert_allclose(r.t, t, atol=1e-12)
    np.testing.assert_array_equal(r.u, u)
    np.testing.assert_array_equal(r.y, y)
    return t, u, y


@cache
def made() -> np.ndarray:
    t, u = sine(10.0, 75.0)
    return np.column_stack([t, u, output(u)])


NAMES = ("time_s", "voltage_V", "displacement_m")


def _text(separator: str) -> Callable[[Path], None]:
    def save(path: Path) -> None:
        np.savetxt(path, made(), delimiter=separator, header=separator.join(NAMES), comments="", fmt="%.17g")

    return save


def _mat(path: Path) -> None:
    import scipy.io

    scipy.io.savemat(path, dict(zip(NAMES, made().T, strict=True)))


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, column in zip(NAMES, made().T, strict=True):
            file[name] = column


def _npy(path: Path) -> None:
    fields = np.dtype([(name, float) for name in NAMES])
    np.save(path, np.array([tuple(row) for row in made()], dtype=fields))


def _npz(path: Path) -> None:
    np.savez(path, **dict(zip(NAMES, made().T, strict=True)))


def _tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("run", n, c) for n, c in zip(NAMES, made().T, strict=True)])


def _json(path: Path) -> None:
    path.write_text(json.dumps(dict(zip(NAMES, made().T.tolist(), strict=True))))


WRITERS: dict[str, Callable[[Path], None]] = {
    ".csv": _text(","),
    ".tsv": _text("\t"),
    ".dat": _text(" "),
    ".txt": _text(" "),
    ".asc": _text(";"),
    ".lvm": _text("\t"),
    ".mat": _mat,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".npy": _npy,
    ".npz": _npz,
    ".tdms": _tdms,
    ".json": _json,
}


@pytest.mark.parametrize("suffix", READERS)
def test_every_format_gives_the_same_recording(tmp_path: Path, suffix: str) -> None:
    WRITERS[suffix](tmp_path / f"a{suffix}")
    recorded(tmp_path)


@pytest.mark.parametrize("suffix", [s for s, reader in READERS.items() if reader is not read_text])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.95])
def test_a_truncated_file_is_refused(tmp_path: Path, suffix: str, share: float) -> None:
    path = tmp_path / f"a{suffix}"
    WRITERS[suffix](path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    refused(tmp_path, path.name)


def test_tdms_waveforms_bring_time_and_units(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    t, u, y = made().T
    waveform = {"wf_increment": float(t[1]), "wf_start_offset": 0.0, "wf_samples": t.size}
    channels = [
        nptdms.ChannelObject("run", "Voltage", u, {**waveform, "unit_string": "V"}),
        nptdms.ChannelObject("run", "Displacement", 1e6 * y, {**waveform, "unit_string": "\u00b5m"}),
    ]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(channels)
    r = read(tmp_path).recordings[0]
    assert r.dt == pytest.approx(t[1])
    np.testing.assert_array_equal(r.u, u)
    np.testing.assert_allclose(r.y, y, rtol=1e-14)


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
    recorded(tmp_path)


@pytest.mark.parametrize("transposed", [False, True])
def test_npy(tmp_path: Path, transposed: bool) -> None:
    np.save(tmp_path / "a.npy", made().T if transposed else made())
    (tmp_path / "recordings.yaml").write_text(STATED)
    recorded(tmp_path)


@pytest.mark.parametrize("row_vectors", [False, True])
def test_mat_v5_by_name(tmp_path: Path, row_vectors: bool) -> None:
    import scipy.io

    names = ("time_s", "voltage_V", "displacement_m")
    columns = {n: (c[None, :] if row_vectors else c[:, None]) for n, c in zip(names, made().T, strict=True)}
    scipy.io.savemat(tmp_path / "a.mat", columns)
    recorded(tmp_path)


def test_mat_v5_structure(tmp_path: Path) -> None:
    import scipy.io

    t, u, y = made().T
    scipy.io.savemat(tmp_path / "a.mat", {"run": {"t": t, "both": np.column_stack([u, y])}})
    (tmp_path / "recordings.yaml").write_text(
        STATED
        + "recordings: [{file: a.mat, variables: {time: run.t, voltage: 'run.both[0]', displacement: 'run.both[1]'}}]"
    )
    recorded(tmp_path)


def test_mat_v73(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "a.mat", "w") as file:
        for name, column in zip(("T", "V1", "V2"), made().T, strict=True):
            file[name] = column[None, :]
    (tmp_path / "recordings.yaml").write_text(
        STATED + "recordings: [{file: a.mat, variables: {time: T, voltage: V1, displacement: V2}}]"
    )
    recorded(tmp_path)


@pytest.mark.parametrize("header", ["", "time_s voltage_V displacement_m\n", "# time_s voltage_V displacement_m\n"])
def test_white_space_text(tmp_path: Path, header: str) -> None:
    rows = "\n".join("  ".join(repr(float(v)) for v in row) for row in made())
    (tmp_path / "a.txt").write_text(header + rows)
    if not header:
        (tmp_path / "recordings.yaml").write_text(STATED)
    recorded(tmp_path)


def test_csv_without_header_by_index(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.csv", made(), delimiter=",", fmt="%.17g")
    (tmp_path / "recordings.yaml").write_text(STATED)
    recorded(tmp_path)


def test_csv_with_mark_comment_and_latin_micro(tmp_path: Path) -> None:
    t, u, y = made().T
    path = write(tmp_path / "a.csv", t, u, 1e6 * y, header="# bench 3\ntime_s,voltage_V,displacement_\u00b5m")
    path.write_bytes(path.read_text().encode("latin-1"))
    np.testing.assert_allclose(read(tmp_path).recordings[0].y, y, rtol=1e-14)


HEADERS = {
    "names with units": ("{s}".join(["time_s", "voltage_V", "displacement_um"]),),
    "units in brackets": ("{s}".join(["Time (s)", "Voltage (V)", "Displacement [\u00b5m]"]),),
    "a row of units": ("{s}".join(["Time", "Voltage", "Displacement"]), "{s}".join(["(s)", "(V)", "(um)"])),
    "units in words": ("{s}".join(["time", "voltage", "displacement"]), "{s}".join(["second", "Volt", "um"]), ""),
    "a block above": (
        "Instrument{s}Scope 7", "Sample interval{s}0{d}000125", "Comment{s}", "",
        "{s}".join(["time_s", "voltage_V", "displacement_um"]),
    ),
    "marked": ("# bench 3, second floor", "% " + "{s}".join(["time_s", "voltage_V", "displacement_um"])),
}  # fmt: skip


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
    above = [line.format(s=separator, d=decimal) for line in HEADERS[header]]
    text = "\r\n".join([*above, *(separator.join(row) for row in cells)]) + "\r\n"
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    r = read(tmp_path).recordings[0]
    np.testing.assert_allclose(r.t, t, atol=1e-12)
    np.testing.assert_array_equal(r.u, u)
    np.testing.assert_allclose(r.y, y, rtol=1e-14)


def test_whole_numbers_between_semicolons(tmp_path: Path) -> None:
    rows = "\n".join(f"{i};{i % 70};{i * i % 90}" for i in range(200))
    (tmp_path / "a.csv").write_text("time_ms;voltage_mV;displacement_nm\n" + rows)
    r = read(tmp_path).recordings[0]
    assert r.dt == pytest.approx(1e-3)
    np.testing.assert_allclose(r.u, 1e-3 * (np.arange(200) % 70))


def test_empty_cells_are_missing_samples(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", *made().T)
    lines = path.read_text().splitlines()
    lines[9] = lines[9].rsplit(",", 1)[0] + ","
    path.write_text("\n".join(lines))
    refused(tmp_path, "a.csv", "row 9 (line 10)", "NaN")


def test_unequal_variables(tmp_path: Path) -> None:
    import scipy.io

    scipy.io.savemat(tmp_path / "a.mat", {"voltage_V": np.arange(90.0), "displacement_m": np.arange(91.0)})
    refused(tmp_path, "a.mat", "unequal", "voltage_V", "90", "91")


def test_array_of_another_shape(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((100, 3, 2)))
    refused(tmp_path, "a.npy", "(100, 3, 2)", "(samples, columns)")


def test_pickled_arrays_are_not_loaded(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"x": 1}], dtype=object), allow_pickle=True)
    refused(tmp_path, "a.npy", "not a readable .npy file")


def test_prediction_needs_no_output(tmp_path: Path) -> None:
    t, u, _ = made().T
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(t.tolist(), u.tolist(), strict=True))
    (tmp_path / "a.csv").write_text("time_s,voltage_V\n" + rows)
    refused(tmp_path, "no displacement column")
    r = read(tmp_path, need_output=False).recordings[0]
    assert np.isnan(r.y).all()
    np.testing.assert_array_equal(r.u, u)
