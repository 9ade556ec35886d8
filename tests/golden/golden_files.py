"""Ninety small recordings as users bring them, good and bad: each is written into an empty folder by a function."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Writer = Callable[[Path], None]

SAMPLES, STEP = 240, 2.5e-4
FILES: dict[str, Writer] = {}
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
) -> Writer:
    """Return a writer of columns as `text`, with a manifest where something is said."""

    def write(home: Path) -> None:
        text(home / file, columns, header, separator, decimal, end, form, encoding=encoding)
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


@made("csv, names and units in two rows")
def _(home: Path) -> None:
    text(home / "a.csv", _scaled(7, 1e3, 1.0, 1e6), ("Time,Voltage,Displacement\n(ms)", "(V)", "(um)"))


@made("csv below what an instrument writes")
def _(home: Path) -> None:
    above = "Instrument: Interferometer 7, serial: 12\nDate: 2024-05-01 12:30:00\nRange: 10 V\n\n"
    text(home / "a.csv", signals(8), above=above)


@made("csv of two tables")
def _(home: Path) -> None:
    lines = [*text(home / "a.csv", signals(9)), "", *text(home / "a.csv", _scaled(10, 1.0, 0.7, 0.7))]
    (home / "a.csv").write_text("\n".join(lines) + "\n")


@made("csv, cells in quotes with decimal commas")
def _(home: Path) -> None:
    text(home / "a.csv", signals(11), [f'"{n}"' for n in _HEADER], form='"{:.12g}"', decimal=".")


@made("csv, exponents of three digits and a plus sign")
def _(home: Path) -> None:
    text(home / "a.csv", signals(12), form="{:+.9E}")


@made("csv that breaks off")
def _(home: Path) -> None:
    text(home / "a.csv", signals(13), form="{:.9e}")
    content = (home / "a.csv").read_bytes()
    (home / "a.csv").write_bytes(content[:-9])


@made("csv without a last line end")
def _(home: Path) -> None:
    text(home / "a.csv", signals(13), form="{:.9e}")
    (home / "a.csv").write_bytes((home / "a.csv").read_bytes().rstrip())


@made("csv with further channels")
def _(home: Path) -> None:
    t, u, y = signals(14)
    columns = (t, u, y, 1e3 * 1e-6 * u, 21.5 + 40.0 * t, 12.0 + 0.01 * u)
    text(home / "a.csv", columns, (*_HEADER, "current_mA", "temperature_degC", "force_N"))


@made("csv, columns in another order")
def _(home: Path) -> None:
    t, u, y = signals(15)
    text(home / "a.csv", (y, t, u), ("displacement_m", "time_s", "voltage_V"))


@made("csv without time, at a stated rate")
def _(home: Path) -> None:
    text(home / "a.csv", signals(16)[1:], _HEADER[1:])
    manifest(home, "sample_rate_hz: 4000\n")


@made("csv without time")
def _(home: Path) -> None:
    text(home / "a.csv", signals(16)[1:], _HEADER[1:])


@made("csv, time since an epoch, rounded")
def _(home: Path) -> None:
    t, u, y = signals(17)
    text(home / "a.csv", (1.7e9 + np.round(t, 6), u, y), form="{:.17g}")


@made("csv, a period that repeats")
def _(home: Path) -> None:
    t, u, _ = signals(18, 480)
    u = 50.0 * np.sin(2.0 * np.pi * 50.0 * t)
    text(home / "a.csv", (t, u, 5e-7 * u + 3e-8 * np.random.default_rng(18).standard_normal(t.size)))
    manifest(home, "start: periodic\n")


@made("csv, a held input with jumps")
def _(home: Path) -> None:
    t, _, y = signals(19)
    u = 20.0 * (np.floor(t / 0.01 + 1e-6) % 3)
    text(home / "a.csv", (t, u, y))
    manifest(home, "input: zero_order\nstart: {state: rest, input_before: 0.0}\n")


@made("csv, jumps at stated times")
def _(home: Path) -> None:
    t, _, y = signals(19)
    text(home / "a.csv", (t, 20.0 * (t > 0.0202), y))
    manifest(home, "recordings:\n  - {file: a.csv, jumps_at_s: [0.0202], rise_time_s: 1.0e-4}\n")


@made("csv, segments of equal length")
def _(home: Path) -> None:
    text(home / "a.csv", signals(20)[1:], _HEADER[1:])
    manifest(home, "sample_rate_hz: 4000\nsegments: 80\n")


@made("csv, segments by jumps of time")
def _(home: Path) -> None:
    t, u, y = signals(21)
    text(home / "a.csv", (np.where(t < 0.03, t, t + 7.0), u, y))
    manifest(home, "segments: true\n")


@made("csv, slices with uses and names")
def _(home: Path) -> None:
    text(home / "a.csv", signals(22))
    manifest(
        home,
        "recordings:\n  - {file: a.csv, name: first half, slice: [0, 120], use: identification}\n"
        "  - {file: a.csv, name: second half, slice: [120, 240], use: confirmation, start: unknown}\n",
    )


@made("several files, one held out")
def _(home: Path) -> None:
    for k, name in enumerate(("b", "a", "c10", "c9")):
        text(home / f"{name}.csv", _scaled(23 + k, 1.0, 1.0 + 0.1 * k, 1.0 + 0.1 * k))
    (home / "notes.md").write_text("# What was done\n")
    manifest(home, "recordings: [b.csv, {file: a.csv, use: confirmation}, c10.csv]\n")


@made("several files without a manifest")
def _(home: Path) -> None:
    for k, name in enumerate(("run10", "run9", "run1")):
        text(home / f"{name}.csv", _scaled(27 + k, 1.0, 1.0 - 0.2 * k, 1.0 - 0.2 * k))
    (home / "readme.txt").write_text("Recorded on Tuesday.\n")
    (home / "settings.json").write_text('{"gain": 3, "operator": "me"}')


@made("two files beside each other")
def _(home: Path) -> None:
    t, u, y = signals(30)
    text(home / "u.csv", (t, u), _HEADER[:2])
    text(home / "y.csv", (y,), _HEADER[2:])
    manifest(home, "recordings: [{file: [u.csv, y.csv], name: both}]\n")


@made("known values, terminals and a sensor")
def _(home: Path) -> None:
    t, u, y = signals(31)
    text(home / "a.csv", (t, u, np.clip(y, -2e-5, 2.5e-5)))
    manifest(
        home,
        "setup: {model: piezo_actuator, hysterons: 1}\nvoltage: terminals\n"
        "known: {m: {value: 1.2, std: 0.1, unit: g}}\n"
        "sensor: {saturates: [-20 um, 25 um], lag: 0.1 ms}\noffset: shared\ninput: band_limited\n",
    )


@made("a sensor that knows no sign")
def _(home: Path) -> None:
    t, u, y = signals(32)
    text(home / "a.csv", (t, u, np.abs(y)))
    manifest(home, "setup: linear\nsensor: {rectified: true}\n")


@made("a network with two inputs")
def _(home: Path) -> None:
    t, u, y = signals(33)
    text(home / "a.csv", (t, 0.1 * u, 0.02 * u[::-1], y, 0.1 * y), ("time_s", "push_N", "pull_N", "x_m", "v"))
    (home / "rig.yaml").write_text(NETWORK, "utf-8")
    manifest(
        home,
        "setup: {network: rig.yaml}\ncolumns: {time: {column: time_s, unit: s}, input: {column: push_N, unit: N, gain: "
        "unknown}}\nports: {pull: {column: pull_N, unit: N}}\noutputs: {q: {column: x_m, unit: m}}\n",
    )


@made("imposed units of a network")
def _(home: Path) -> None:
    text(home / "a.csv", _scaled(34, 1.0, 1.0, 1e6), ("a", "b", "c"))
    (home / "rig.yaml").write_text(NETWORK, "utf-8")
    manifest(
        home,
        "setup: {network: rig.yaml}\ncolumns: {time: {column: a, unit: s}, input: {column: b, unit: lbf, scale: -0.5}, "
        "output: {column: c, unit: um}}\nstart: unknown\ninput: linear\n",
    )


# --- Binary formats ---------------------------------------------------------------------------------------------------


@made("mat of version 5, rows and columns")
def _(home: Path) -> None:
    import scipy.io

    t, u, y = signals(40)
    scipy.io.savemat(home / "a.mat", {"time_s": t, "voltage_V": u[:, None], "displacement_m": y[None, :]})


@made("mat of version 5, a matrix and a scalar rate")
def _(home: Path) -> None:
    import scipy.io

    scipy.io.savemat(home / "a.mat", {"data": np.column_stack(signals(41)), "fs": 4000.0}, do_compression=True)
    manifest(
        home,
        'variables: {time: {column: "data[0]", unit: s}, voltage: {column: "data[1]", unit: V}, '
        'displacement: {column: "data[2]", unit: m}}\n',
    )


@made("mat of version 5, a structure")
def _(home: Path) -> None:
    import scipy.io

    t, u, y = signals(42)
    scipy.io.savemat(home / "a.mat", {"run": {"t": t, "log": {"u": u.astype(np.float32), "x": y}}})
    manifest(
        home,
        "variables: {time: {column: run.t, unit: s}, voltage: {column: run.log.u, unit: V}, "
        "displacement: {column: run.log.x, unit: m}}\n",
    )


def _iddata(**changes: Any) -> dict[str, Any]:
    _, u, y = signals(43)

    def cell(value: str) -> Any:
        found = np.empty((1, 1), dtype=object)
        found[0, 0] = value
        return found

    return {
        "Domain": "Time", "Name": "", "OutputData": 1e6 * y[:, None], "OutputName": cell("y1"),
        "OutputUnit": cell("um"), "InputData": u[:, None], "InputName": cell("u1"), "InputUnit": cell("V"),
        "Period": np.inf, "InterSample": cell("zoh"), "Ts": STEP, "Tstart": np.empty((0, 0)),
        "SamplingInstants": np.empty((0, 0)), "TimeUnit": "seconds", "ExperimentName": cell("Exp1"),
        "Notes": np.empty((0, 0)),
    } | changes  # fmt: skip


@made("mat of version 5, iddata")
def _(home: Path) -> None:
    import scipy.io

    scipy.io.savemat(home / "a.mat", {"data": _iddata()})


@made("mat of version 5, iddata in frequencies")
def _(home: Path) -> None:
    import scipy.io

    scipy.io.savemat(home / "a.mat", {"data": _iddata(Domain="Frequency")})


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
    manifest(
        home,
        "variables: {time: {column: run.t, unit: s}, voltage: {column: run.u, unit: V}, "
        "displacement: {column: run.x, unit: m}}\n",
    )


@made("hdf5 with groups and units")
def _(home: Path) -> None:
    import h5py

    with h5py.File(home / "a.h5", "w") as file:
        for name, unit, values in zip(("time", "voltage", "displacement"), "sVm", signals(46), strict=True):
            made_ = file.create_dataset(f"daq/{name}", data=values, compression="gzip")
            made_.attrs["unit"] = unit
    places = {
        q: f"{{column: daq/{q}, unit: {u}}}" for q, u in zip(("time", "voltage", "displacement"), "sVm", strict=True)
    }
    manifest(home, f"variables: {{{', '.join(f'{q}: {place}' for q, place in places.items())}}}\n")


@made("hdf5, flat, chunked")
def _(home: Path) -> None:
    import h5py

    with h5py.File(home / "a.hdf5", "w") as file:
        for name, values in zip(_HEADER, signals(47), strict=True):
            file.create_dataset(name, data=values, chunks=(50,), dtype=">f8")


@made("tdms with increments")
def _(home: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    _, u, y = signals(48)
    said = {"wf_increment": STEP, "wf_start_offset": 0.0}
    with TdmsWriter(home / "a.tdms") as writer:
        writer.write_segment(
            [
                ChannelObject("daq", "voltage", u, {**said, "unit_string": "V"}),
                ChannelObject("daq", "displacement", 1e6 * y, {**said, "unit_string": "um"}),
            ]
        )


@made("tdms of other lengths")
def _(home: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    _, u, y = signals(48)
    with TdmsWriter(home / "a.tdms") as writer:
        writer.write_segment([ChannelObject("g", "voltage_V", u), ChannelObject("g", "displacement_m", y[:-7])])


@made("npz")
def _(home: Path) -> None:
    np.savez_compressed(home / "a.npz", **dict(zip(_HEADER, signals(49), strict=True)))


@made("npz in single precision, Fortran order")
def _(home: Path) -> None:
    np.savez(home / "a.npz", all=np.asfortranarray(np.column_stack(signals(50)).astype(np.float32)))
    manifest(
        home,
        'sample_rate_hz: 4000\nvariables: {voltage: {column: "all[1]", unit: V}, displacement: {column: "all[2]", '
        "unit: m}}\n",
    )


@made("npy with three axes")
def _(home: Path) -> None:
    _, u, y = signals(51)
    np.save(home / "a.npy", np.stack([np.column_stack((f * u, f * y)) for f in (1.0, 0.5)], axis=2))
    manifest(
        home,
        "sample_rate_hz: 4000\naxes: [time, channel, realisation]\ncolumns: {voltage: {column: 0, unit: V}, "
        "displacement: {column: 1, unit: m}}\nrecordings: [a.npy]\n",
    )


@made("npy of objects")
def _(home: Path) -> None:
    np.save(home / "a.npy", np.array([{"u": 1.0}, None], dtype=object), allow_pickle=True)


@made("json of columns")
def _(home: Path) -> None:
    content = {n: x.tolist() for n, x in zip(_HEADER, signals(52), strict=True)}
    (home / "a.json").write_text(json.dumps({"instrument": "laser", "data": content}))


@made("json of columns at the top")
def _(home: Path) -> None:
    (home / "a.json").write_text(json.dumps({n: x.tolist() for n, x in zip(_HEADER, signals(52), strict=True)}))


@made("json of rows")
def _(home: Path) -> None:
    rows = [dict(zip(_HEADER, row, strict=True)) for row in np.column_stack(signals(53)).tolist()]
    (home / "a.json").write_text(json.dumps(rows, indent=1))


@made("json with null")
def _(home: Path) -> None:
    content = {n: x.tolist() for n, x in zip(_HEADER, signals(54), strict=True)}
    content["displacement_m"][100] = None
    (home / "a.json").write_text(json.dumps(content))


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


@made("an empty folder")
def _(home: Path) -> None:
    pass


@made("an empty file")
def _(home: Path) -> None:
    (home / "a.csv").write_bytes(b"")


@made("bytes of no format")
def _(home: Path) -> None:
    (home / "a.csv").write_bytes(np.random.default_rng(63).integers(0, 256, 5000, dtype=np.uint8).tobytes())


@made("prose")
def _(home: Path) -> None:
    (home / "a.csv").write_text("On Tuesday we measured the stage, and it moved.\n" * 20)


@made("an unknown format")
def _(home: Path) -> None:
    (home / "a.xyz").write_text("1 2 3\n" * 50)
    manifest(home, "recordings: [a.xyz]\n")


@made("a mat file cut in half")
def _(home: Path) -> None:
    import scipy.io

    scipy.io.savemat(home / "a.mat", dict(zip(_HEADER, signals(64), strict=True)))
    (home / "a.mat").write_bytes((home / "a.mat").read_bytes()[:3000])


@made("an hdf5 file that is none")
def _(home: Path) -> None:
    (home / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + struct.pack("<40d", *range(40)))


@made("an npz file that is none")
def _(home: Path) -> None:
    (home / "a.npz").write_bytes(b"PK\x03\x04" + bytes(200))


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
