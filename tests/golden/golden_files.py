"""Small recordings as users bring them, good and bad: each is written into an empty folder by a function."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Writer = Callable[[Path], object]

SAMPLES, STEP = 240, 2.5e-4
FILES: dict[str, Writer] = {}
_NAMES = ("b", "a", "c10", "c9")
_HEADER = ("time_s", "voltage_V", "displacement_m")
_STATED = "columns: {time: {column: 0, unit: s}, voltage: {column: 1, unit: V}, displacement: {column: 2, unit: m}}\n"
NETWORK = """\
about: a mass on a spring with a damper and two forces
junctions: {mass: 1}
elements:
  q: {type: C, junction: mass, law: spring, parameters: [k], unit: m}
  p: {type: I, junction: mass, law: capacitor, parameters: [m], unit: kg m/s}
  damper: {type: R, junction: mass, law: linear, parameters: [b], direction: resistance}
  push: {type: Se, junction: mass, unit: N}
  pull: {type: Se, junction: mass, unit: N, sign: -1}
parameters:
  k: {value: 8.0e4, unit: N/m, positive: true}
  m: {value: 0.2, unit: kg, positive: true}
  b: {value: 5.0, unit: N s/m, positive: true}
output: q
"""


def signals(seed: int = 0, samples: int = SAMPLES) -> tuple[Array, Array, Array]:
    """Return time [s], voltage [V] and displacement [m]: a sine, and a noisy loop of it."""
    random = np.random.default_rng(seed)
    t = np.arange(samples) * STEP
    u = 70.0 * np.sin(2.0 * np.pi * 50.0 * t) * (0.5 + 0.5 * t / t[-1])
    y = 5e-7 * u - 4e-6 * np.cos(2.0 * np.pi * 50.0 * t) + 1.2e-6 + 4e-8 * random.standard_normal(samples)
    return t, u, y


def text(
    path: Path,
    columns: Sequence[Array],
    header: Sequence[str] | None = _HEADER,
    separator: str = ",",
    decimal: str = ".",
    end: str = "\n",
    form: str = "{:.12g}",
    above: str = "",
    encoding: str = "utf-8",
) -> list[str]:
    """Write columns as text, and return the lines."""
    rows = zip(*(x.tolist() for x in columns), strict=True)
    lines = [separator.join(form.format(v).replace(".", decimal) for v in row) for row in rows]
    lines = [*above.splitlines(), *([separator.join(header)] if header else []), *lines]
    path.write_bytes((end.join(lines) + end).encode(encoding))
    return lines


def made(name: str) -> Callable[[Writer], Writer]:
    """Add a writer of files to the collection."""

    def add(writer: Writer) -> Writer:
        if name in FILES:
            raise ValueError(f"two files are called {name!r}: rename one")
        FILES[name] = writer
        return writer

    return add


def manifest(home: Path, content: str) -> None:
    (home / "recordings.yaml").write_text(content, "utf-8")


def as_text(
    file: str,
    columns: Sequence[Array],
    header: Sequence[str] | None = _HEADER,
    separator: str = ",",
    decimal: str = ".",
    end: str = "\n",
    form: str = "{:.12g}",
    encoding: str = "utf-8",
    said: str = "",
    above: str = "",
) -> Writer:
    """Return a writer of columns as `text`, with a manifest where something is said."""

    def write(home: Path) -> None:
        text(home / file, columns, header, separator, decimal, end, form, above, encoding)
        if said:
            manifest(home, said)

    return write


def _dialects() -> None:
    """Separators, decimal signs, line ends, encodings, units and headers."""
    for separator, decimal in ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), (" ", ",")):
        FILES[f"csv {separator!r} {decimal!r}"] = as_text("a.csv", signals(1), separator=separator, decimal=decimal)
    for end in ("\r\n", "\r"):
        FILES[f"csv, lines end with {end!r}"] = as_text("a.csv", signals(2), end=end)
    micro = ("time (s)", "voltage (V)", "displacement (µm)")
    for encoding in ("utf-8-sig", "utf-16", "latin-1", "cp1252"):
        FILES[f"csv, µm in {encoding}"] = as_text("a.csv", _scaled(3, 1.0, 1.0, 1e6), micro, encoding=encoding)
    for units, factors in (
        (("ms", "mV", "nm"), (1e3, 1e3, 1e9)),
        (("us", "kV", "mm"), (1e6, 1e-3, 1e3)),
        (("min", "V", "in"), (1 / 60, 1.0, 1 / 0.0254)),
        (("h", "J/C", "ft"), (1 / 3600, 1.0, 1 / 0.3048)),
    ):
        columns, names = _scaled(4, *factors), ("time", "voltage", "displacement")
        for form in ("{}_{}", "{} [{}]"):
            header = [form.format(name, unit) for name, unit in zip(names, units, strict=True)]
            FILES[f"csv of {', '.join(header)}"] = as_text("a.csv", columns, header, form="{:.17g}")
    for mark in "#%":
        header = (f"{mark} time_s", *_HEADER[1:])
        FILES[f"txt, header after {mark}"] = as_text("a.txt", signals(5), header, "\t")
    for suffix in ("dat", "txt", "asc", "CSV"):
        FILES[f"blanks in .{suffix} without a header"] = as_text(f"a.{suffix}", signals(6), None, " ", said=_STATED)


def _scaled(seed: int, *factors: float) -> list[Array]:
    return [x * f for x, f in zip(signals(seed), factors, strict=True)]


_dialects()


def _several(*writers: Writer, said: str = "", **others: str) -> Writer:
    """Return a writer of several files, texts among them by their names without dots, and a manifest."""

    def write(home: Path) -> None:
        for writer in writers:
            writer(home)
        for name, content in others.items():
            (home / name.replace("__", ".")).write_text(content, "utf-8")
        if said:
            manifest(home, said)

    return write


def _tables() -> None:
    """Tables of text as instruments and people write them."""
    names = ("Time,Voltage,Displacement\n(ms)", "(V)", "(um)")
    FILES["csv, names and units in two rows"] = as_text("a.csv", _scaled(7, 1e3, 1.0, 1e6), names)
    above = "Instrument: Interferometer 7, serial: 12\nDate: 2024-05-01 12:30:00\nRange: 10 V\n\n"
    FILES["csv below what an instrument writes"] = as_text("a.csv", signals(8), above=above)
    quoted = [f'"{n}"' for n in _HEADER]
    FILES["csv, cells in quotes with decimal commas"] = as_text("a.csv", signals(11), quoted, form='"{:.12g}"')
    FILES["csv, exponents of three digits and a plus sign"] = as_text("a.csv", signals(12), form="{:+.9E}")
    t, u, y = signals(14)
    FILES["csv with further channels"] = as_text(
        "a.csv", (t, u, y, 1e3 * 1e-6 * u, 21.5 + 40.0 * t, 12.0 + 0.01 * u),
        (*_HEADER, "current_mA", "temperature_degC", "force_N"),
    )  # fmt: skip
    t, u, y = signals(15)
    FILES["csv, columns in another order"] = as_text("a.csv", (y, t, u), ("displacement_m", "time_s", "voltage_V"))
    rate = "sample_rate_hz: 4000\n"
    FILES["csv without time, at a stated rate"] = as_text("a.csv", signals(16)[1:], _HEADER[1:], said=rate)
    FILES["csv without time"] = as_text("a.csv", signals(16)[1:], _HEADER[1:])
    t, u, y = signals(17)
    FILES["csv, time since an epoch, rounded"] = as_text("a.csv", (1.7e9 + np.round(t, 6), u, y), form="{:.17g}")
    t = signals(18, 480)[0]
    u = 50.0 * np.sin(2.0 * np.pi * 50.0 * t)
    y = 5e-7 * u + 3e-8 * np.random.default_rng(18).standard_normal(t.size)
    FILES["csv, a period that repeats"] = as_text("a.csv", (t, u, y), said="start: periodic\n")
    t, _, y = signals(19)
    u = 20.0 * (np.floor(t / 0.01 + 1e-6) % 3)
    said = "input: zero_order\nstart: {state: rest, input_before: 0.0}\n"
    FILES["csv, a held input with jumps"] = as_text("a.csv", (t, u, y), said=said)
    FILES["csv, segments of equal length"] = as_text(
        "a.csv", signals(20)[1:], _HEADER[1:], said="sample_rate_hz: 4000\nsegments: 80\n"
    )
    t, u, y = signals(21)
    columns = (np.where(t < 0.03, t, t + 7.0), u, y)
    FILES["csv, segments by jumps of time"] = as_text("a.csv", columns, said="segments: true\n")
    said = (
        "recordings:\n  - {file: a.csv, name: first half, slice: [0, 120], use: identification}\n"
        "  - {file: a.csv, name: second half, slice: [120, 240], use: confirmation, start: unknown}\n"
    )
    FILES["csv, slices with uses and names"] = as_text("a.csv", signals(22), said=said)


def _folders() -> None:
    """Several files in a folder, and what a manifest says of them."""
    some = (as_text(f"{n}.csv", _scaled(23 + k, 1.0, 1 + 0.1 * k, 1 + 0.1 * k)) for k, n in enumerate(_NAMES))
    said = "recordings: [b.csv, {file: a.csv, use: confirmation}, c10.csv]\n"
    FILES["several files, one held out"] = _several(*some, said=said, notes__md="# What was done\n")
    some = (
        as_text(f"run{n}.csv", _scaled(27 + k, 1.0, 1.0 - 0.2 * k, 1.0 - 0.2 * k)) for k, n in enumerate((10, 9, 1))
    )
    FILES["several files without a manifest"] = _several(
        *some, readme__txt="Recorded on Tuesday.\n", settings__json='{"gain": 3, "operator": "me"}'
    )
    t, u, y = signals(30)
    FILES["two files beside each other"] = _several(
        as_text("u.csv", (t, u), _HEADER[:2]), as_text("y.csv", (y,), _HEADER[2:]),
        said="recordings: [{file: [u.csv, y.csv], name: both}]\n",
    )  # fmt: skip
    t, u, y = signals(31)
    said = (
        "setup: {model: piezo_actuator, hysterons: 1}\nvoltage: terminals\n"
        "known: {m: {value: 1.2, std: 0.1, unit: g}}\n"
        "sensor: {saturates: [-20 um, 25 um], lag: 0.1 ms}\noffset: shared\ninput: band_limited\n"
    )
    FILES["known values, terminals and a sensor"] = as_text("a.csv", (t, u, np.clip(y, -2e-5, 2.5e-5)), said=said)
    t, u, y = signals(32)
    said = "setup: linear\nsensor: {rectified: true}\n"
    FILES["a sensor that knows no sign"] = as_text("a.csv", (t, u, np.abs(y)), said=said)
    t, u, y = signals(33)
    names = ("time_s", "push_N", "pull_N", "x_m", "v")
    FILES["a network with two inputs"] = _several(
        as_text("a.csv", (t, 0.1 * u, 0.02 * u[::-1], y, 0.1 * y), names), rig__yaml=NETWORK,
        said="setup: {network: rig.yaml}\ncolumns: {time: {column: time_s, unit: s}, input: {column: push_N, unit: N, "
        "gain: unknown}}\nports: {pull: {column: pull_N, unit: N}}\noutputs: {q: {column: x_m, unit: m}}\n",
    )  # fmt: skip
    FILES["imposed units of a network"] = _several(
        as_text("a.csv", _scaled(34, 1.0, 1.0, 1e6), ("a", "b", "c")), rig__yaml=NETWORK,
        said="setup: {network: rig.yaml}\ncolumns: {time: {column: a, unit: s}, input: {column: b, unit: lbf, "
        "scale: -0.5}, output: {column: c, unit: um}}\nstart: unknown\ninput: linear\n",
    )  # fmt: skip


_tables()
_folders()


@made("csv of two tables")
def _(home: Path) -> None:
    lines = [*text(home / "a.csv", signals(9)), "", *text(home / "a.csv", _scaled(10, 1.0, 0.7, 0.7))]
    (home / "a.csv").write_text("\n".join(lines) + "\n")


def _cut(last: int) -> Writer:
    def write(home: Path) -> None:
        text(home / "a.csv", signals(13), form="{:.9e}")
        (home / "a.csv").write_bytes((home / "a.csv").read_bytes()[:-last])

    return write


FILES["csv that breaks off"] = _cut(9)
FILES["csv without a last line end"] = _cut(1)

# --- Binary formats ---------------------------------------------------------------------------------------------------


def _mat(content: Mapping[str, Any], said: str = "", packed: bool = False) -> Writer:
    """Return a writer of a .mat file of version 5."""

    def write(home: Path) -> None:
        import scipy.io

        scipy.io.savemat(home / "a.mat", dict(content), do_compression=packed)
        if said:
            manifest(home, said)

    return write


def _places(where: str, *names: str) -> str:
    """Return a manifest that names the variables of time, voltage and displacement in SI units."""
    quantities = zip(("time", "voltage", "displacement"), names, "sVm", strict=True)
    columns = (f'{quantity}: {{column: "{name}", unit: {unit}}}' for quantity, name, unit in quantities)
    return f"{where}: {{{', '.join(columns)}}}\n"


t, u, y = signals(40)
FILES["mat of version 5, rows and columns"] = _mat(dict(zip(_HEADER, (t, u[:, None], y[None, :]), strict=True)))
FILES["mat of version 5, a matrix and a scalar rate"] = _mat(
    {"data": np.column_stack(signals(41)), "fs": 4000.0}, _places("variables", "data[0]", "data[1]", "data[2]"), True
)
t, u, y = signals(42)
FILES["mat of version 5, a structure"] = _mat(
    {"run": {"t": t, "log": {"u": u.astype(np.float32), "x": y}}},
    _places("variables", "run.t", "run.log.u", "run.log.x"),
)


@made("mat of version 7.3")
def _(home: Path) -> None:
    import h5py

    with h5py.File(home / "a.mat", "w", userblock_size=512) as file:
        for name, values in zip(_HEADER, signals(44), strict=True):
            file[name] = values[None, :]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")


@made("mat of version 7.3, a structure")
def _(home: Path) -> None:
    import h5py

    with h5py.File(home / "a.mat", "w") as file:
        group = file.create_group("run")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in zip("tux", signals(45), strict=True):
            group[name] = values[:, None]
    manifest(home, _places("variables", "run.t", "run.u", "run.x"))


@made("hdf5 with groups and units")
def _(home: Path) -> None:
    import h5py

    with h5py.File(home / "a.h5", "w") as file:
        for name, unit, values in zip(("time", "voltage", "displacement"), "sVm", signals(46), strict=True):
            made_ = file.create_dataset(f"daq/{name}", data=values, compression="gzip")
            made_.attrs["unit"] = unit
    manifest(home, _places("variables", "daq/time", "daq/voltage", "daq/displacement"))


@made("hdf5, flat, chunked")
def _(home: Path) -> None:
    import h5py

    with h5py.File(home / "a.hdf5", "w") as file:
        for name, values in zip(_HEADER, signals(47), strict=True):
            file.create_dataset(name, data=values, chunks=(50,), dtype=">f8")


def _tdms(**channels: tuple[Array, dict[str, Any]]) -> Writer:
    """Return a writer of a .tdms file of channels with properties."""

    def write(home: Path) -> None:
        from nptdms import ChannelObject, TdmsWriter

        with TdmsWriter(home / "a.tdms") as writer:
            writer.write_segment([ChannelObject("g", name, *channel) for name, channel in channels.items()])

    return write


t, u, y = signals(48)
_SAID = {"wf_increment": STEP, "wf_start_offset": 0.0}
FILES["tdms with increments"] = _tdms(
    voltage=(u, {**_SAID, "unit_string": "V"}), displacement=(1e6 * y, {**_SAID, "unit_string": "um"})
)
FILES["tdms of other lengths"] = _tdms(voltage_V=(u, {}), displacement_m=(y[:-7], {}))


FILES["npz"] = lambda home: np.savez_compressed(home / "a.npz", **dict(zip(_HEADER, signals(49), strict=True)))
FILES["npy of objects"] = lambda home: np.save(home / "a.npy", np.array([{"u": 1.0}, None], dtype=object))


@made("npz in single precision, Fortran order")
def _(home: Path) -> None:
    np.savez(home / "a.npz", all=np.asfortranarray(np.column_stack(signals(50)).astype(np.float32)))
    said = 'voltage: {column: "all[1]", unit: V}, displacement: {column: "all[2]", unit: m}'
    manifest(home, f"sample_rate_hz: 4000\nvariables: {{{said}}}\n")


@made("npy with three axes")
def _(home: Path) -> None:
    _, u, y = signals(51)
    np.save(home / "a.npy", np.stack([np.column_stack((f * u, f * y)) for f in (1.0, 0.5)], axis=2))
    manifest(
        home,
        "sample_rate_hz: 4000\naxes: [time, channel, realisation]\ncolumns: {voltage: {column: 0, unit: V}, "
        "displacement: {column: 1, unit: m}}\nrecordings: [a.npy]\n",
    )


def _json(content: Any) -> Writer:
    return lambda home: (home / "a.json").write_text(json.dumps(content))


t, u, y = (x.tolist() for x in signals(52))
FILES["json of columns"] = _json({"instrument": "laser", "data": dict(zip(_HEADER, (t, u, y), strict=True))})
FILES["json of columns at the top"] = _json(dict(zip(_HEADER, (t, u, y), strict=True)))
FILES["json of rows"] = _json([dict(zip(_HEADER, r, strict=True)) for r in np.column_stack(signals(53)).tolist()])
t, u, y = (x.tolist() for x in signals(54))
FILES["json with null"] = _json(dict(zip(_HEADER, (t, u, [*y[:100], None, *y[101:]]), strict=True)))


# --- Files that are refused -------------------------------------------------------------------------------------------


def _damaged(name: str, change: Callable[[list[str]], list[str]], said: str = "") -> None:
    def write(home: Path) -> None:
        lines = change(text(home / "a.csv", signals(60), form="{:.9g}"))
        (home / "a.csv").write_text("\n".join(lines) + "\n")
        if said:
            manifest(home, said)

    made(name)(write)


def _cell(row: int, column: int, value: str) -> Callable[[list[str]], list[str]]:
    def change(lines: list[str]) -> list[str]:
        cells = lines[row].split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return change


_damaged("a word in a cell", _cell(50, 2, "broken"))
_damaged("an empty cell", _cell(50, 1, ""))
_damaged("nan in a cell", _cell(50, 2, "NaN"))
_damaged("infinity in a cell", _cell(50, 2, "-inf"))
_damaged("a number too large", _cell(50, 2, "1e999"))
_damaged("a spike", _cell(50, 2, "0.9"))
_damaged("a row too short", lambda lines: [*lines[:70], lines[70].rsplit(",", 1)[0], *lines[71:]])
_damaged("a row twice", lambda lines: [*lines[:70], lines[69], *lines[70:]])
_damaged("a row missing", lambda lines: [*lines[:70], *lines[73:]])
_damaged("a header only", lambda lines: lines[:1])
_damaged("six samples", lambda lines: lines[:7])
_damaged("a header of four names", lambda lines: [f"{lines[0]},remark", *lines[1:]])
_damaged("decimal commas between commas", lambda lines: [lines[0], *(x.replace(".", ",") for x in lines[1:])])
_damaged("an unknown unit", lambda lines: ["time_s,voltage_V,displacement_furlong", *lines[1:]])
_damaged("the unit of another quantity", lambda lines: ["time_s,voltage_V,displacement_kg", *lines[1:]])
_damaged("a quantity twice", lambda lines: ["time_s,voltage_V,voltage_mV", *lines[1:]])
_damaged("an unknown key", lambda lines: lines, "sample_rate: 4000\n")
_damaged("an unknown model", lambda lines: lines, "setup: {model: pizo_actuator}\n")
_damaged("a file that is not there", lambda lines: lines, "recordings: [b.csv]\n")
_damaged("a file outside of the folder", lambda lines: lines, "recordings: [../outside/b.csv]\n")
_damaged("a slice beyond the end", lambda lines: lines, "recordings: [{file: a.csv, slice: [100, 9000]}]\n")
_damaged("one name twice", lambda lines: lines, "recordings: [a.csv, a.csv]\n")
_damaged("a column that is not there", lambda lines: lines, "columns: {voltage: {column: volts, unit: V}}\n")
_damaged("yaml that is none", lambda lines: lines, "recordings: [a.csv\nsetup: }\n")
_damaged("a limit without a unit", lambda lines: lines, "sensor: {saturates: [0, 1]}\n")
_damaged("all is held out", lambda lines: lines, "recordings: [{file: a.csv, use: confirmation}]\n")
t, u, y = signals(61)
FILES["time that goes back"] = as_text("a.csv", (np.where(t < 0.03, t, t - 0.01), u, y))
FILES["jittered time"] = as_text("a.csv", (t + 0.2 * STEP * np.random.default_rng(62).uniform(-1.0, 1.0, t.size), u, y))
FILES["a rate that changes"] = as_text("a.csv", (np.where(t < 0.03, t, 2.0 * t - 0.03), u, y))
FILES["a constant input"] = as_text("a.csv", (t, 0.0 * u + 5.0, y))
FILES["a constant output"] = as_text("a.csv", (t, u, 0.0 * y + 1e-6))
FILES["a clipped output"] = as_text("a.csv", (t, u, np.minimum(y, 1.5e-5)))
FILES["an output in coarse steps"] = as_text("a.csv", (t, u, np.round(y / 4e-6) * 4e-6))
FILES["no output"] = as_text("a.csv", (t, u), _HEADER[:2])
FILES["no input"] = as_text("a.csv", (t, y), (_HEADER[0], _HEADER[2]))


def _bytes(file: str, content: bytes) -> Writer:
    return lambda home: (home / file).write_bytes(content)


FILES["an empty folder"] = lambda home: None
FILES["an empty file"] = _bytes("a.csv", b"")
FILES["bytes of no format"] = _bytes("a.csv", np.random.default_rng(63).integers(0, 256, 5000, np.uint8).tobytes())
FILES["prose"] = _bytes("a.csv", b"On Tuesday we measured the stage, and it moved.\n" * 20)
FILES["an hdf5 file that is none"] = _bytes("a.h5", b"\x89HDF\r\n\x1a\n" + struct.pack("<40d", *range(40)))
FILES["an npz file that is none"] = _bytes("a.npz", b"PK\x03\x04" + bytes(200))


@made("an unknown format")
def _(home: Path) -> None:
    (home / "a.xyz").write_text("1 2 3\n" * 50)
    manifest(home, "recordings: [a.xyz]\n")


@made("a mat file cut in half")
def _(home: Path) -> None:
    import scipy.io

    scipy.io.savemat(home / "a.mat", dict(zip(_HEADER, signals(64), strict=True)))
    (home / "a.mat").write_bytes((home / "a.mat").read_bytes()[:3000])


# --- Objects in memory ------------------------------------------------------------------------------------------------


def _table() -> dict[str, Array]:
    return dict(zip(_HEADER, signals(70), strict=True))


def _frame() -> Any:
    import pandas

    return pandas.DataFrame(_table())


def _unnamed() -> dict[str, Array]:
    _, u, y = signals(70)
    return {"u": u, "y": y}


_PLACES = {"voltage": {"column": "u"}, "displacement": {"column": "y"}}
# Objects that `phnn.read` takes in place of a folder, each with a manifest or None.
IN_MEMORY: Mapping[str, Callable[[], tuple[Any, Any]]] = {
    "a mapping of columns": lambda: (_table(), None),
    "a data frame": lambda: (_frame(), None),
    "named data frames": lambda: ({"b": _frame(), "a": _table()}, {"setup": {"model": "linear"}}),
    "a list of mappings": lambda: (
        [_table(), {n: x * (1.0 if n == "time_s" else 1.1) for n, x in _table().items()}],
        None,
    ),
    "columns without units": lambda: (_unnamed(), {"sample_rate_hz": 4000, "columns": _PLACES}),
    "columns without a rate": lambda: (_unnamed(), None),
    "lengths that differ": lambda: ({**_table(), "voltage_V": signals(70)[1][:-1]}, None),
    "a number": lambda: (3.0, None),
}
