"""``recordings.yaml``: what cannot be told from the files themselves, checked value by value."""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused, meant
from phnn.intake import LIMITS, load_yaml, named_file
from phnn.recordings.recording import PLAIN, Anchor, Sensor, Start
from phnn.recordings.units import QUANTITIES, Unit, check_unit, find_unit
from phnn.results import printable

# Beyond, squares and products of two values are no numbers any more, or nothing.
_LARGEST, _SMALLEST = 1e150, 1e-150
# Of long or nested values a message shows the beginning; with aliases the whole could be of any size.
_BRIEF = reprlib.Repr()
_BRIEF.maxstring = _BRIEF.maxother = 60


def shown(value: Any) -> str:
    """Return the beginning of a value, for messages."""
    return printable(_BRIEF.repr(value))


def mapping(value: Any, where: str, accepted: Iterable[str] | None = None) -> Mapping[str, Any]:
    """Return ``value`` as a mapping, of accepted keys alone where they are given. Raises InputRefused otherwise."""
    if not isinstance(value, Mapping):
        raise InputRefused(f"{where}: expected keys and values, found {shown(value)}: write `key: value` entries")
    names = list(accepted or ())
    if accepted is not None and (unknown := [key for key in value if key not in names]):
        cause = f"unknown key {shown(unknown[0])}{meant(str(unknown[0]), names)}"
        raise InputRefused(f"{where}: {cause}: accepted are {', '.join(names)}")
    return value


def choice(value: Any, accepted: tuple[str, ...], where: str, otherwise: str = "") -> str:
    """Return ``value`` if it is one of the accepted words. Raises InputRefused otherwise."""
    if value not in accepted:
        more = f" {otherwise}" if otherwise else ""
        raise InputRefused(f"{where}: {shown(value)} is not known: accepted are {', '.join(accepted)}{more}")
    return str(value)


def number(value: Any, where: str, above: float | None = None) -> float:
    """Return ``value`` as a finite float, greater than ``above`` where that is given. Raises InputRefused otherwise."""
    good = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _LARGEST
    good = good and (value == 0.0 or abs(value) >= _SMALLEST)
    if not good or (above is not None and value <= above):
        wanted = "a finite number" if above is None else f"a number greater than {above:g}"
        raise InputRefused(f"{where}: {shown(value)} is not {wanted}: give one")
    return float(value)


def flag(value: Any, where: str) -> bool:
    """Return ``value`` as a truth value. Raises InputRefused otherwise."""
    if not isinstance(value, bool):
        raise InputRefused(f"{where}: {shown(value)} is neither true nor false: write one of them")
    return value


def text(value: Any, where: str) -> str:
    """Return ``value`` as a non-empty text; a plain number is taken as its digits. Raises InputRefused otherwise."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)) or str(value).strip() == "":
        raise InputRefused(f"{where}: {shown(value)} is no name: write a text")
    return str(value).strip()


def label(value: Any, where: str) -> str:
    """Return a name as `text`, printable and not too long. Raises InputRefused otherwise."""
    name = printable(text(value, where))
    if len(name) > LIMITS.name_characters:
        cause = f"{shown(name)}, a name of {len(name)} characters, at most {LIMITS.name_characters} are accepted"
        raise InputRefused(f"{where}: {cause}: write a shorter one")
    return name


DRIVING = ("input", "voltage", "force")
# What may be missing beside numbers: cells without a number, and one or two samples far off their neighbours.
EMPTY, GLITCHES = "empty", "glitches"
# Axes of an array of a periodic experiment, in the order in which it is read.
AXES = ("realisation", "period", "time", "channel")


@dataclass(frozen=True)
class Column:
    """Where a quantity is found and how it is read: SI value = unit(scale × number)."""

    place: int | str | None = None
    unit: str | None = None
    scale: float = 1.0
    gain: str = "known"  # or unknown: what drives the system is proportional to the number by an unknown factor
    unwrap: float | None = None  # the number by which a counter or an angle starts again
    # Numbers and texts that mark a missing value; EMPTY for empty cells, which texts are taken for; GLITCHES for
    # samples far off, alone or in pairs.
    missing: tuple[float | str, ...] = ()


def columns_of(value: Any, inherited: Mapping[str, Column], where: str, anew: bool) -> dict[str, Column]:
    """Return columns by quantity, laid over inherited ones.

    ``anew``: places given elsewhere no longer count (they describe other files), units still do."""
    columns = {q: replace(column, place=None) if anew else column for q, column in inherited.items()}
    for quantity, stated in mapping(value, where, QUANTITIES).items():
        columns[quantity] = _column(stated, columns.get(quantity, Column()), quantity, f"{where}: {quantity}")
    return columns


def named_of(value: Any, quantity: str, where: str) -> dict[str, Column]:
    """Return the columns by the name of a port or a storage."""
    columns = {}
    for key, stated in mapping(value, where).items():
        name = label(key, where)
        columns[name] = column = _column(stated, Column(), quantity, f"{where}: {name}")
        if name in QUANTITIES or column.place is None:
            cause = "is the name of a quantity" if name in QUANTITIES else "has no column"
            remedy = "write NAME: {column: ..., unit: ...}, NAME of the network's"
            raise InputRefused(f"{where}: {shown(name)} {cause}: {remedy}")
    return columns


def axes_of(value: Any, where: str) -> tuple[str, ...]:
    """Return what the axes of an array are."""
    axes = tuple(choice(v, AXES, where) for v in value) if isinstance(value, list) else ()
    if "time" not in axes or len(set(axes)) < len(axes):
        remedy = f"list the axes of the array in order, each once: {', '.join(AXES)}"
        raise InputRefused(f"{where}: {shown(value)}: {remedy}")
    return axes


def _column(stated: Any, inherited: Column, quantity: str, where: str) -> Column:
    if isinstance(stated, (int, str)) and not isinstance(stated, bool):
        stated = {"column": stated}
    gain = ("gain",) if quantity in DRIVING else ()
    content = mapping(stated, where, ("column", "unit", "scale", "unwrap", "missing", *gain))
    fields: dict[str, Any] = {}
    if "column" in content:
        place = content["column"]
        if isinstance(place, bool) or not isinstance(place, (int, str)) or (isinstance(place, int) and place < 0):
            cause = f"column {shown(place)} is neither an index from 0 on nor a name"
            raise InputRefused(f"{where}: {cause}: give one of them")
        fields["place"] = place
    if "unit" in content:
        fields["unit"] = check_unit(quantity, str(content["unit"]), where)
    if "gain" in content:
        fields["gain"] = choice(content["gain"], ("known", "unknown"), f"{where}: gain")
    if "unwrap" in content:
        fields["unwrap"] = number(content["unwrap"], f"{where}: unwrap", above=0.0)
    if "missing" in content:
        marks = content["missing"] if isinstance(content["missing"], list) else [content["missing"]]
        fields["missing"] = tuple(v if isinstance(v, str) else number(v, f"{where}: missing") for v in marks)
    if "scale" in content:
        fields["scale"] = number(content["scale"], f"{where}: scale")
        if fields["scale"] == 0.0:
            raise InputRefused(f"{where}: scale 0 would erase the column: give the factor from number to {quantity}")
    return replace(inherited, **fields)


def sensor_of(value: Any, where: str) -> Sensor:
    """Return what a manifest says under ``sensor``."""
    flags = ("rectified", "derivative", "second_derivative")
    content = mapping(value, where, ("saturates", *flags, "lag"))
    switches = {key: key in content and flag(content[key], f"{where}: {key}") for key in flags}
    saturates, unit = _limits(content, f"{where}: saturates")
    lag, time = _physical(content["lag"], f"{where}: lag", "2 ms") if "lag" in content else (0.0, "")
    if "lag" in content and (time != "s" or not lag > 0.0):
        raise InputRefused(f"{where}: lag: {shown(content['lag'])} is no time constant: write it as 2 ms")
    derivative = 2 if switches["second_derivative"] else switches["derivative"]
    return Sensor(saturates, switches["rectified"], lag, derivative, unit)


def check_unit_of_limits(sensor: Sensor, si: str, label: str, where: object) -> None:
    """Refuse limits in a unit that is not one of the output. Raises InputRefused."""
    if sensor.is_limited and sensor.unit != si:
        cause = f"{label} is in units of {si}, but recordings.yaml gives limits of the sensor in {sensor.unit}"
        remedy = f"give them in the unit of the output, sensor: {{saturates: [LEAST {si}, LARGEST {si}]}}"
        raise InputRefused(f"{where}: {cause}: {remedy}")


def _limits(content: Mapping[str, Any], where: str) -> tuple[tuple[float, float], str]:
    if "saturates" not in content:
        return PLAIN.saturates, ""
    limits = content["saturates"]
    if not isinstance(limits, list) or len(limits) != 2 or limits == [None, None]:
        cause = f"{shown(limits)} is no pair of limits"
        raise InputRefused(f"{where}: {cause}: write [0 V, 10 V], null for a side without a limit")
    ends = [None if limit is None else _physical(limit, where, "10 V") for limit in limits]
    units = {unit for pair in ends if pair is not None for unit in pair[1:]}
    lower, upper = (free if pair is None else pair[0] for pair, free in zip(ends, PLAIN.saturates, strict=True))
    if len(units) > 1 or not lower < upper:
        raise InputRefused(f"{where}: {shown(limits)}: write the lower limit first, both in one unit, as [0 V, 10 V]")
    return (lower, upper), units.pop()


def _physical(value: Any, where: str, example: str) -> tuple[float, str]:
    """Return the SI value and SI unit of a text such as ``10 V``."""
    size, _, unit = str(value).strip().partition(" ")
    known = find_unit(unit) if unit else None
    try:
        number = float(size)
    except ValueError:
        number = math.nan
    if known is None or not math.isfinite(number):
        cause = "has no unit" if not unit and math.isfinite(number) else "is no number with a unit"
        raise InputRefused(f"{where}: {shown(value)} {cause}: write it as {example}")
    return known.factor * number + known.offset, known.si


# Ready models; their networks stand in phnn/models/ready.yaml, but for the actuator's.
READY = (
    "first_order", "mass_damper", "mass_spring_damper", "two_masses", "motor", "voice_coil", "heated_body", "room",
    "rc", "battery", "tank", "friction_rig", "piezo_actuator",
)  # fmt: skip
MODELS = (*READY, "hrc", "linear", "bouc_wen")
STATES = ("rest", "unknown", "periodic")
INPUTS = ("cubic", "band_limited", "linear", "zero_order")
USES = ("identification", "confirmation")

_SHARED = (
    "columns", "variables", "sample_rate_hz", "start", "periodic", "input", "segments", "ports",
    "outputs", "axes", "sensor", "offset",
)  # fmt: skip
# What a manifest may say of the whole folder.
TOP_KEYS = ("setup", "known", "voltage", *_SHARED, "recordings")
_EACH = (*_SHARED, "slice", "use", "file", "name")


@dataclass(frozen=True)
class Entry:
    """What the manifest says about one recording; ``None`` means it says nothing."""

    files: tuple[str, ...] = ()  # whose columns stand side by side
    name: str | None = None
    columns: Mapping[str, Column] = field(default_factory=dict)
    sample_rate_hz: float | None = None
    slice: tuple[int, int] | None = None
    use: str | None = None
    start: Start | None = None
    periodic: bool | None = None
    input: str | None = None
    segments: bool | int = False  # several recordings follow one another, at jumps of time or of so many samples each
    ports: Mapping[str, Column] = field(default_factory=dict)  # inputs at further ports of the network
    outputs: Mapping[str, Column] = field(default_factory=dict)  # several, by the storage that is measured
    axes: tuple[str, ...] = ()  # of an array, of AXES
    sensor: Sensor = PLAIN
    offset: str = "own"  # or shared: the zero of the output


@dataclass(frozen=True)
class Manifest:
    """The manifest, validated. ``entries`` is ``None`` where it lists no recordings: then every file is one."""

    setup: Mapping[str, Any] = field(default_factory=lambda: DEFAULT_SETUP)
    known: Mapping[str, Anchor] = field(default_factory=dict)
    voltage: str = "command"
    common: Entry = Entry()
    entries: tuple[Entry, ...] | None = None
    path: Path | None = None


# What may stand in the place of a number of hysterons: the recordings choose, or another form of hysteresis.
HYSTERESES = ("auto", "distributed", "bouc_wen", "duhem")
DEFAULT_SETUP: Mapping[str, Any] = {"model": "piezo_actuator", "hysterons": 2}


def load_manifest(folder: Path, given: str | Path | Mapping[str, Any] | None, outside: bool = False) -> Manifest:
    """Return the manifest at a path or with a content, else that of ``folder/recordings.yaml``, else the defaults.

    Args:
        given: path or content; outside: what lies in ``folder``, or is named in the manifest, may lead out of it.

    Raises:
        InputRefused: a manifest that is absent, unreadable or says something that is not understood.
    """
    if given is not None and not isinstance(given, str | Path):
        return _manifest(given, "the manifest given", (folder,), outside)
    path, inside = (folder / "recordings.yaml", (folder,)) if given is None else (Path(given), ())
    if given is None and not os.path.lexists(path):
        return Manifest()
    source = named_file(path, inside, "manifest", "check the path given to --manifest", outside)
    return _manifest(load_yaml(source), source.name, (path.parent, folder), outside, path)


def _manifest(content: Any, name: str, homes: Sequence[Path], outside: bool, path: Path | None = None) -> Manifest:
    """Return the manifest with a content of plain values, as `load_manifest`; None says nothing. A network file may lie
    in one of the folders ``homes``, or ``outside``; ``name`` stands in messages."""
    top = mapping({} if content is None else content, name, TOP_KEYS)
    common = _entry({key: top[key] for key in _SHARED if key in top}, Entry(), name)
    listed = top.get("recordings")
    entries = None if listed is None else _entries(listed, common, name)
    setup, known = _setup(top.get("setup"), name, homes, outside), _known(top.get("known"), name)
    voltage = choice(top.get("voltage", "command"), ("command", "terminals"), f"{name}: voltage")
    return Manifest(setup, known, voltage, common, entries, path)


def _entries(listed: Any, common: Entry, name: str) -> tuple[Entry, ...]:
    if isinstance(listed, list) and len(listed) > LIMITS.recordings:
        raise InputRefused(f"{name}: {len(listed)} recordings, at most {LIMITS.recordings} are accepted: list fewer")
    if not isinstance(listed, list) or not listed:
        cause = f"recordings must be a list such as `- {{file: loops.csv}}`, not {shown(listed)}"
        remedy = "list the files, or leave `recordings` out to take every file of the folder"
        raise InputRefused(f"{name}: {cause}: {remedy}")
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
    mapping(item, where, _EACH)
    fields: dict[str, Any] = {}
    for key in (key for key in _EACH if key in item):
        value, place = item[key], f"{where}: {key}"
        if key in ("columns", "variables"):
            fields["columns"] = columns_of(value, fields.get("columns", common.columns), place, key == "variables")
        elif key == "file":
            files = value if isinstance(value, list) and value else [value]
            fields["files"] = tuple(text(file, place) for file in files)
        else:
            fields[key] = _READ[key](value, place)
    return replace(common, **fields)


def _start(value: Any, where: str) -> Start:
    content = mapping({"state": value} if isinstance(value, str) else value, where, ("state", "input_before"))
    state = choice(content.get("state", "rest"), STATES, f"{where}: state")
    if "input_before" in content and state != "rest":
        cause = f"input_before has a meaning only for a start at rest, not for {state!r}"
        raise InputRefused(f"{where}: {cause}: leave it out")
    return Start(state, number(content.get("input_before", 0.0), f"{where}: input_before"))


def _slice(value: Any, where: str) -> tuple[int, int]:
    whole = isinstance(value, list) and len(value) == 2 and all(type(v) is int for v in value)
    if not whole or not 0 <= value[0] < value[1]:
        cause = f"{shown(value)} is no range of samples"
        raise InputRefused(f"{where}: {cause}: write [first, last], first included, last not")
    return value[0], value[1]


def _segments(value: Any, where: str) -> bool | int:
    if isinstance(value, bool) or (isinstance(value, int) and value > 0):
        return value
    cause = f"{shown(value)} is neither true (jumps of time separate the segments) nor a number of samples of each"
    raise InputRefused(f"{where}: {cause}")


# How the value of a key is read; the text says where it stands.
_READ: Mapping[str, Callable[[Any, str], Any]] = {
    "sample_rate_hz": partial(number, above=0.0), "start": _start, "periodic": flag, "segments": _segments,
    "input": lambda value, where: choice(value, INPUTS, where), "axes": axes_of, "sensor": sensor_of,
    "ports": lambda value, where: named_of(value, "input", where), "slice": _slice, "name": label,
    "outputs": lambda value, where: named_of(value, "output", where),
    "offset": lambda value, where: choice(value, ("own", "shared"), where),
    "use": lambda value, where: choice(value, USES, where),
}  # fmt: skip


def _known(value: Any, name: str) -> dict[str, Anchor]:
    anchors = {}
    for key, item in mapping(value if value is not None else {}, f"{name}: known").items():
        anchor = label(key, f"{name}: known")
        where = f"{name}: known: {anchor}"
        content = mapping({"value": item} if isinstance(item, int | float) else item, where, ("value", "std", "unit"))
        if "value" not in content:
            remedy = "write {value: ..., std: ...} in SI units, or with a unit, such as unit: g"
            raise InputRefused(f"{where}: no value: {remedy}")
        std = number(content.get("std", 0.0), f"{where}: std")
        if std < 0.0:
            raise InputRefused(f"{where}: std {std:g} is negative: give the standard deviation, 0 or more")
        stated = content.get("unit")
        # Without a unit it is in SI units already.
        unit = Unit("", 1.0, 0.0) if stated is None else find_unit(text(stated, f"{where}: unit"))
        if unit is None or unit.offset:
            cause = f"{shown(stated)} is no unit of a parameter"
            raise InputRefused(f"{where}: unit: {cause}: write one such as g, N/mm or uF")
        size = number(content["value"], f"{where}: value")
        anchors[anchor] = Anchor(unit.factor * size, unit.factor * std, unit.si)
    return anchors


def _setup(value: Any, name: str, homes: Sequence[Path], outside: bool) -> Mapping[str, Any]:
    if value is None:
        return DEFAULT_SETUP
    where = f"{name}: setup"
    if isinstance(value, str):
        value = {"model": value} if value in MODELS else {"network": value}
    content = dict(mapping(value, where, ("model", "network", "hysterons")))
    if "network" in content:
        file = text(content["network"], f"{where}: network")
        home = next((home for home in homes if os.path.lexists(home / file)), None)
        if home is None:
            cause = f"{shown(file)} is neither a model ({', '.join(MODELS)}) nor a network file beside the manifest"
            raise InputRefused(f"{where}: {cause}: name one of these")
        return {**content, "network": str(named_file(home / file, homes, where, outside=outside).path)}
    content.setdefault("model", DEFAULT_SETUP["model"])
    choice(content["model"], MODELS, f"{where}: model", "or `network: FILE.yaml` for a network of your own")
    if content["model"] in ("piezo_actuator", "hrc"):
        content.setdefault("hysterons", DEFAULT_SETUP["hysterons"])
    count = content.get("hysterons", 0)
    if count not in HYSTERESES and (type(count) is not int or not 0 <= count <= LIMITS.hysterons):
        cause = f"hysterons {shown(count)} is neither a whole number from 0 to {LIMITS.hysterons}"
        raise InputRefused(f"{where}: {cause} nor one of {', '.join(HYSTERESES)}: give one")
    return content
