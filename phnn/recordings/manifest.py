"""``recordings.yaml``: what cannot be told from the files themselves."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.intake.limits import LIMITS
from phnn.intake.yaml_file import load_yaml
from phnn.recordings.recording import Anchor, Start
from phnn.recordings.sensor import PLAIN, Sensor, sensor_of
from phnn.recordings.units import QUANTITIES, check_unit, find_unit
from phnn.recordings.values import choice, flag, keys_of, label, mapping, number, shown, text

DRIVING = ("input", "voltage", "force")
GAINS = ("known", "unknown")
# What may be missing beside numbers: cells without a number, and single samples far off their neighbours.
EMPTY, GLITCHES = "empty", "glitches"
AXES = ("time", "channel", "realisation", "period")


@dataclass(frozen=True)
class Column:
    """Where a quantity is found and how it is read: SI value = unit(scale × number).

    Attributes:
        gain: ``"unknown"`` where the number is proportional to what drives the system by an unknown factor.
        unwrap: the number by which a counter or an angle starts again, None where it does not.
        missing: numbers that mark a missing value; `EMPTY` for empty cells, `GLITCHES` for single samples far off.
    """

    place: int | str | None = None
    unit: str | None = None
    scale: float = 1.0
    gain: str = "known"
    unwrap: float | None = None
    missing: tuple[float | str, ...] = ()


def columns_of(value: Any, inherited: Mapping[str, Column], where: str) -> dict[str, Column]:
    """Columns by quantity, laid over inherited ones."""
    content = mapping(value, where)
    keys_of(content, QUANTITIES, where)
    columns = dict(inherited)
    for quantity, said in content.items():
        columns[quantity] = _column(said, columns.get(quantity, Column()), quantity, f"{where}: {quantity}")
    return columns


def variables_of(value: Any, inherited: Mapping[str, Column], where: str) -> dict[str, Column]:
    """Names of variables. Places given elsewhere no longer count (they describe other files), units still do."""
    content = mapping(value, where)
    columns = {quantity: replace(column, place=None) for quantity, column in inherited.items()}
    return columns_of(content, columns, where)


def named_of(value: Any, quantity: str, where: str) -> dict[str, Column]:
    """Columns by the name of a port or a storage."""
    content = {label(n, where): said for n, said in mapping(value, where).items()}
    columns = {n: _column(said, Column(), quantity, f"{where}: {n}") for n, said in content.items()}
    for name, column in columns.items():
        if name in QUANTITIES or column.place is None:
            cause = "is the name of a quantity" if name in QUANTITIES else "has no column"
            raise InputRefused(
                f"{where}: {shown(name)} {cause}: write NAME: {{column: ..., unit: ...}}, NAME of the network's"
            )
    return columns


def axes_of(value: Any, where: str) -> tuple[str, ...]:
    """What the axes of an array are."""
    axes = tuple(choice(v, AXES, where) for v in value) if isinstance(value, list) else ()
    if "time" not in axes or len(set(axes)) < len(axes):
        raise InputRefused(
            f"{where}: {shown(value)}: list the axes of the array in order, each once: {', '.join(AXES)}"
        )
    return axes


def _column(said: Any, inherited: Column, quantity: str, where: str) -> Column:
    if isinstance(said, (int, str)) and not isinstance(said, bool):
        said = {"column": said}
    content = mapping(said, where)
    keys_of(
        content, ("column", "unit", "scale", "unwrap", "missing", *(("gain",) if quantity in DRIVING else ())), where
    )
    column = inherited
    if "column" in content:
        place = content["column"]
        if isinstance(place, bool) or not isinstance(place, (int, str)) or (isinstance(place, int) and place < 0):
            raise InputRefused(
                f"{where}: column {shown(place)} is neither an index from 0 on nor a name: give one of them"
            )
        column = replace(column, place=place)
    if "unit" in content:
        column = replace(column, unit=check_unit(quantity, str(content["unit"]), where))
    if "gain" in content:
        column = replace(column, gain=choice(content["gain"], GAINS, f"{where}: gain"))
    if "unwrap" in content:
        column = replace(column, unwrap=number(content["unwrap"], f"{where}: unwrap", above=0.0))
    if "missing" in content:
        said = content["missing"] if isinstance(content["missing"], list) else [content["missing"]]
        marks = tuple(v if v in (EMPTY, GLITCHES) else number(v, f"{where}: missing") for v in said)
        column = replace(column, missing=marks)
    if "scale" in content:
        scale = number(content["scale"], f"{where}: scale")
        if scale == 0.0:
            raise InputRefused(f"{where}: scale 0 would erase the column: give the factor from number to {quantity}")
        column = replace(column, scale=scale)
    return column


# Ready models; their networks stand in phnn/models/ready.yaml, but for the actuator's.
READY = (
    "first_order", "mass_damper", "mass_spring_damper", "two_masses", "motor", "voice_coil", "heated_body", "room",
    "rc", "battery", "tank", "friction_rig", "piezo_actuator",
)  # fmt: skip
MODELS = (*READY, "hrc", "linear", "bouc_wen")
STATES = ("rest", "unknown", "periodic")
INPUTS = ("cubic", "band_limited", "linear", "zero_order")
USES = ("identification", "confirmation")
OFFSETS = ("own", "shared")
VOLTAGES = ("command", "terminals")

_SHARED = (
    "columns", "variables", "sample_rate_hz", "start", "periodic", "input", "rise_time_s", "segments", "ports",
    "outputs", "axes", "sensor", "offset",
)  # fmt: skip
# What a manifest may say of the whole folder.
TOP_KEYS = ("setup", "known", "voltage", *_SHARED, "recordings")
_EACH = (*_SHARED, "jumps_at_s", "slice", "use", "file", "name")


@dataclass(frozen=True)
class Entry:
    """What the manifest says about one recording; ``None`` means it says nothing.

    Attributes:
        rise_time_s: how long jumps of the input take; jumps_at_s: when they happen, from the first sample on.
        segments: the file holds several recordings one after another, separated by jumps of time or, where a number
            is given, so many samples each.
        beside: further files whose columns stand beside those of the first.
        ports: inputs at further ports of the network; outputs: several outputs, by the storage that is measured.
        axes: what the axes of an array are, of `AXES`.
        sensor: what is known of the sensor; offset: whether the zero of the output is its own or shared.
    """

    file: str = ""
    name: str | None = None
    columns: Mapping[str, Column] = field(default_factory=dict)
    sample_rate_hz: float | None = None
    slice: tuple[int, int] | None = None
    use: str | None = None
    start: Start | None = None
    periodic: bool | None = None
    input: str | None = None
    rise_time_s: float = 0.0
    jumps_at_s: tuple[float, ...] = ()
    segments: bool | int = False
    beside: tuple[str, ...] = ()
    ports: Mapping[str, Column] = field(default_factory=dict)
    outputs: Mapping[str, Column] = field(default_factory=dict)
    axes: tuple[str, ...] = ()
    sensor: Sensor = PLAIN
    offset: str = "own"

    @property
    def files(self) -> tuple[str, ...]:
        """All its files."""
        return (self.file, *self.beside)


@dataclass(frozen=True)
class Manifest:
    """The manifest, validated. ``entries`` is ``None`` where it lists no recordings: then every file is one."""

    setup: Mapping[str, Any]
    known: Mapping[str, Anchor]
    voltage: str
    common: Entry
    entries: tuple[Entry, ...] | None
    path: Path | None


# What may stand in the place of a number of hysterons: the recordings choose, or another form of hysteresis.
HYSTERESES = ("auto", "distributed", "bouc_wen", "duhem")
DEFAULT_SETUP: Mapping[str, Any] = {"model": "piezo_actuator", "hysterons": 2}


def load_manifest(folder: Path, path: Path | None, outside: bool = False) -> Manifest:
    """The manifest at ``path``, else ``folder/recordings.yaml``, else the defaults.

    Args:
        outside: what lies in ``folder``, or is named in the manifest, may lead out of it.

    Raises:
        InputRefused: a manifest that is absent, unreadable or says something that is not understood.
    """
    inside: tuple[Path, ...] = ()
    if path is None:
        path, inside = folder / "recordings.yaml", (folder,)
        if not os.path.lexists(path):
            return Manifest(DEFAULT_SETUP, {}, "command", Entry(), None, None)
    source = named_file(path, inside, "manifest", "check the path given to --manifest", outside)
    return manifest_of(load_yaml(source), source.name, (path.parent, folder), outside, path)


def manifest_of(
    content: Any, name: str, homes: Sequence[Path], outside: bool = False, path: Path | None = None
) -> Manifest:
    """The manifest with a content, as `load_manifest`; None says nothing.

    Args:
        content: plain values.
        name: of the manifest, for messages; path: of its file.
        homes: folders in which a network file may lie; outside: it may also lie elsewhere.
    """
    top = mapping({} if content is None else content, name)
    keys_of(top, TOP_KEYS, name)
    common = _entry({key: top[key] for key in _SHARED if key in top}, Entry(), name)
    listed = top.get("recordings")
    entries = None if listed is None else _entries(listed, common, name)
    return Manifest(
        _setup(top.get("setup"), name, homes, outside),
        _known(top.get("known"), name),
        choice(top.get("voltage", "command"), VOLTAGES, f"{name}: voltage"),
        common,
        entries,
        path,
    )


def _entries(listed: Any, common: Entry, name: str) -> tuple[Entry, ...]:
    if isinstance(listed, list) and len(listed) > LIMITS.recordings:
        raise InputRefused(f"{name}: {len(listed)} recordings, at most {LIMITS.recordings} are accepted: list fewer")
    if not isinstance(listed, list) or not listed:
        raise InputRefused(
            f"{name}: recordings must be a list such as `- {{file: loops.csv}}`, not {shown(listed)}: "
            f"list the files, or leave `recordings` out to take every file of the folder"
        )
    entries = []
    for i, item in enumerate(listed):
        where = f"{name}: recordings[{i}]"
        item = mapping({"file": item} if isinstance(item, str) else item, where)
        if "file" not in item:
            raise InputRefused(f"{where}: no `file`: name the file it describes")
        entries.append(_entry(item, common, where))
    return tuple(entries)


def _entry(item: Mapping[str, Any], common: Entry, where: str) -> Entry:
    """Return one entry laid over the common one: what it says itself wins, quantity by quantity for columns."""
    keys_of(item, _EACH, where)
    said: dict[str, Any] = {}
    for key in (key for key in _EACH if key in item):
        value, here = item[key], f"{where}: {key}"
        if key in ("columns", "variables"):
            laid = columns_of if key == "columns" else variables_of
            said["columns"] = laid(value, said.get("columns", common.columns), here)
        elif key == "file":
            files = value if isinstance(value, list) and value else [value]
            said["file"], *beside = (text(file, here) for file in files)
            said["beside"] = tuple(beside)
        else:
            said[key] = _READ[key](value, here)
    return replace(common, **said)


def _start(value: Any, where: str) -> Start:
    content = mapping({"state": value} if isinstance(value, str) else value, where)
    keys_of(content, ("state", "input_before"), where)
    state = choice(content.get("state", "rest"), STATES, f"{where}: state")
    if "input_before" in content and state != "rest":
        raise InputRefused(
            f"{where}: input_before has a meaning only for a start at rest, not for {state!r}: leave it out"
        )
    return Start(state, number(content.get("input_before", 0.0), f"{where}: input_before"))


def _times(value: Any, where: str) -> tuple[float, ...]:
    if not isinstance(value, list) or not value:
        raise InputRefused(f"{where}: {shown(value)} is no list of times: write [0.0503, …], in seconds")
    return tuple(number(t, where) for t in value)


def _slice(value: Any, where: str) -> tuple[int, int]:
    whole = isinstance(value, list) and len(value) == 2 and all(type(v) is int for v in value)
    if not whole or not 0 <= value[0] < value[1]:
        raise InputRefused(
            f"{where}: {shown(value)} is no range of samples: write [first, last], first included, last not"
        )
    return value[0], value[1]


def _segments(value: Any, where: str) -> bool | int:
    if isinstance(value, bool) or (isinstance(value, int) and value > 0):
        return value
    raise InputRefused(
        f"{where}: {shown(value)} is neither true (jumps of time separate the segments) nor a number of samples of each"
    )


def _one_of(accepted: tuple[str, ...]) -> Callable[[Any, str], str]:
    return lambda value, where: choice(value, accepted, where)


# How the value of a key is read; the text says where it stands.
_READ: Mapping[str, Callable[[Any, str], Any]] = {
    "sample_rate_hz": partial(number, above=0.0), "rise_time_s": partial(number, above=0.0), "start": _start,
    "periodic": flag, "input": _one_of(INPUTS), "jumps_at_s": _times, "segments": _segments,
    "ports": lambda value, where: named_of(value, "input", where), "axes": axes_of, "sensor": sensor_of,
    "outputs": lambda value, where: named_of(value, "output", where), "offset": _one_of(OFFSETS),
    "slice": _slice, "use": _one_of(USES), "name": label,
}  # fmt: skip


def _known(value: Any, name: str) -> dict[str, Anchor]:
    anchors = {}
    for key, said in mapping(value if value is not None else {}, f"{name}: known").items():
        anchor = label(key, f"{name}: known")
        where = f"{name}: known: {anchor}"
        content = mapping({"value": said} if isinstance(said, int | float) else said, where)
        keys_of(content, ("value", "std", "unit"), where)
        if "value" not in content:
            raise InputRefused(
                f"{where}: no value: write {{value: ..., std: ...}} in SI units, or with a unit, such as unit: g"
            )
        std = number(content.get("std", 0.0), f"{where}: std")
        if std < 0.0:
            raise InputRefused(f"{where}: std {std:g} is negative: give the standard deviation, 0 or more")
        factor, si = _si(content.get("unit"), f"{where}: unit")
        anchors[anchor] = Anchor(factor * number(content["value"], f"{where}: value"), factor * std, si)
    return anchors


def _si(value: Any, where: str) -> tuple[float, str]:
    """Factor to SI and SI unit of an anchor's unit; without one it is in SI units already."""
    if value is None:
        return 1.0, ""
    found = find_unit(text(value, where))
    if found is None or found.offset:
        raise InputRefused(f"{where}: {shown(value)} is no unit of a parameter: write one such as g, N/mm or uF")
    return found.factor, found.si


def _setup(value: Any, name: str, homes: Sequence[Path], outside: bool) -> Mapping[str, Any]:
    if value is None:
        return DEFAULT_SETUP
    where = f"{name}: setup"
    if isinstance(value, str):
        value = {"model": value} if value in MODELS else {"network": value}
    content = dict(mapping(value, where))
    keys_of(content, ("model", "network", "hysterons"), where)
    if "network" in content:
        return {
            **content,
            "network": _network_file(text(content["network"], f"{where}: network"), where, homes, outside),
        }
    content.setdefault("model", DEFAULT_SETUP["model"])
    choice(content["model"], MODELS, f"{where}: model", "or `network: FILE.yaml` for a network of your own")
    if content["model"] in ("piezo_actuator", "hrc"):
        content.setdefault("hysterons", DEFAULT_SETUP["hysterons"])
    count = content.get("hysterons", 0)
    if count not in HYSTERESES and (type(count) is not int or not 0 <= count <= LIMITS.hysterons):
        raise InputRefused(
            f"{where}: hysterons {shown(count)} is neither a whole number from 0 to {LIMITS.hysterons} nor one of "
            f"{', '.join(HYSTERESES)}: give one"
        )
    return content


def _network_file(file: str, where: str, homes: Sequence[Path], outside: bool) -> str:
    for home in homes:
        if os.path.lexists(home / file):
            return str(named_file(home / file, homes, where, outside=outside).path)
    raise InputRefused(
        f"{where}: {shown(file)} is neither a model ({', '.join(MODELS)}) nor a network file beside the manifest: "
        f"name one of these"
    )
