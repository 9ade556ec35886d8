"""Small recordings as users bring them, good and bad: each is written into an empty folder by a function."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Writer = Callable[[Path], object]

SAMPLES, STEP = 240, 2.5e-4
FILES: dict[str, Writer] = {}
_HEADER = ("time_s", "voltage_V", "displacement_m")
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


def text(path: Path, columns: Sequence[Array], header: Sequence[str] = _HEADER, form: str = "{:.12g}") -> list[str]:
    """Write columns as text, and return the lines."""
    rows = zip(*(x.tolist() for x in columns), strict=True)
    lines = [",".join(header), *(",".join(form.format(v) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", "utf-8")
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
    file: str, columns: Sequence[Array], header: Sequence[str] = _HEADER, form: str = "{:.12g}", said: str = ""
) -> Writer:
    """Return a writer of columns as `text`, with a manifest where something is said."""

    def write(home: Path) -> None:
        text(home / file, columns, header, form)
        if said:
            manifest(home, said)

    return write


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
    FILES["csv ',' '.'"] = as_text("a.csv", signals(1))
    FILES["csv without time"] = as_text("a.csv", signals(16)[1:], _HEADER[1:])
    t, u, y = signals(17)
    FILES["csv, time since an epoch, rounded"] = as_text("a.csv", (1.7e9 + np.round(t, 6), u, y), form="{:.17g}")
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
    drawn = [(n, 1.0 - 0.2 * k, signals(27 + k)) for k, n in enumerate((10, 9, 1))]
    some = (as_text(f"run{n}.csv", (t, part * u, part * y)) for n, part, (t, u, y) in drawn)
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
    t, u, y = signals(33)
    names = ("time_s", "push_N", "pull_N", "x_m", "v")
    FILES["a network with two inputs"] = _several(
        as_text("a.csv", (t, 0.1 * u, 0.02 * u[::-1], y, 0.1 * y), names), rig__yaml=NETWORK,
        said="setup: {network: rig.yaml}\ncolumns: {time: {column: time_s, unit: s}, input: {column: push_N, unit: N, "
        "gain: unknown}}\nports: {pull: {column: pull_N, unit: N}}\noutputs: {q: {column: x_m, unit: m}}\n",
    )  # fmt: skip


_tables()
_folders()


# --- Binary formats ---------------------------------------------------------------------------------------------------


def _places(*names: str) -> str:
    """Return a manifest that names the variables of time, voltage and displacement in SI units."""
    quantities = zip(("time", "voltage", "displacement"), names, "sVm", strict=True)
    columns = (f'{quantity}: {{column: "{name}", unit: {unit}}}' for quantity, name, unit in quantities)
    return f"variables: {{{', '.join(columns)}}}\n"


@made("mat of version 5, a matrix and a scalar rate")
def _(home: Path) -> None:
    import scipy.io

    scipy.io.savemat(home / "a.mat", {"data": np.column_stack(signals(41)), "fs": 4000.0}, do_compression=True)
    manifest(home, _places("data[0]", "data[1]", "data[2]"))


@made("mat of version 7.3, a structure")
def _(home: Path) -> None:
    import h5py

    with h5py.File(home / "a.mat", "w", userblock_size=512) as file:
        group = file.create_group("run")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in zip("tux", signals(45), strict=True):
            group[name] = values[:, None]
            group[name].attrs["MATLAB_class"] = np.bytes_("double")
    manifest(home, _places("run.t", "run.u", "run.x"))


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
FILES["npy of objects"] = lambda home: np.save(home / "a.npy", np.array([{"u": 1.0}, None], dtype=object))


@made("npy with three axes")
def _(home: Path) -> None:
    _, u, y = signals(51)
    np.save(home / "a.npy", np.stack([np.column_stack((f * u, f * y)) for f in (1.0, 0.5)], axis=2))
    manifest(
        home,
        "sample_rate_hz: 4000\naxes: [time, channel, realisation]\ncolumns: {voltage: {column: 0, unit: V}, "
        "displacement: {column: 1, unit: m}}\nrecordings: [a.npy]\n",
    )


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


_damaged("a spike", _cell(50, 2, "0.9"))
_damaged("a row twice", lambda lines: [*lines[:70], lines[69], *lines[70:]])
_damaged("a header only", lambda lines: lines[:1])
_damaged("a header of four names", lambda lines: [f"{lines[0]},remark", *lines[1:]])
_damaged("decimal commas between commas", lambda lines: [lines[0], *(x.replace(".", ",") for x in lines[1:])])
_damaged("an unknown unit", lambda lines: ["time_s,voltage_V,displacement_furlong", *lines[1:]])
_damaged("a quantity twice", lambda lines: ["time_s,voltage_V,voltage_mV", *lines[1:]])
_damaged("an unknown model", lambda lines: lines, "setup: {model: pizo_actuator}\n")
_damaged("a file that is not there", lambda lines: lines, "recordings: [b.csv]\n")
_damaged("a file outside of the folder", lambda lines: lines, "recordings: [../outside/b.csv]\n")
_damaged("one name twice", lambda lines: lines, "recordings: [a.csv, a.csv]\n")
_damaged("all is held out", lambda lines: lines, "recordings: [{file: a.csv, use: confirmation}]\n")
t, u, y = signals(61)
FILES["a constant input"] = as_text("a.csv", (t, 0.0 * u + 5.0, y))
FILES["a constant output"] = as_text("a.csv", (t, u, 0.0 * y + 1e-6))


def _bytes(file: str, content: bytes) -> Writer:
    return lambda home: (home / file).write_bytes(content)


FILES["an empty file"] = _bytes("a.csv", b"")
FILES["bytes of no format"] = _bytes("a.csv", np.random.default_rng(63).integers(0, 256, 5000, np.uint8).tobytes())
FILES["prose"] = _bytes("a.csv", b"On Tuesday we measured the stage, and it moved.\n" * 20)
FILES["an hdf5 file that is none"] = _bytes("a.h5", b"\x89HDF\r\n\x1a\n" + struct.pack("<40d", *range(40)))
FILES["an npz file that is none"] = _bytes("a.npz", b"PK\x03\x04" + bytes(200))


@made("a mat file cut in half")
def _(home: Path) -> None:
    import scipy.io

    scipy.io.savemat(home / "a.mat", dict(zip(_HEADER, signals(64), strict=True)))
    (home / "a.mat").write_bytes((home / "a.mat").read_bytes()[:3000])
