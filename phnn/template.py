"""From a folder to a first manifest that `phnn check` reads: what was found, and the keys that may be wanted.

Time, input and output columns of an unknown table and their units are guessed from the names, the units and, where
these say nothing, the values and the order of the columns. What was guessed is said, one line each.
"""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phnn.errors import InputRefused, OutputRefused
from phnn.intake import LIMITS, plain_values
from phnn.recordings import checks, read
from phnn.recordings.manifest import DEFAULT_SETUP, Manifest
from phnn.recordings.reader import Files
from phnn.recordings.table import Table
from phnn.recordings.units import QUANTITIES, find_unit, parse_name, split_unit, suits
from phnn.results import message, printable, refusal

TIME, INPUT, OUTPUT = "time", "input", "output"


def _of(words: str) -> frozenset[str]:
    return frozenset(words.split())


# Words of column names by the role that they suggest.
_WORDS: Mapping[str, frozenset[str]] = {
    TIME: _of("time t zeit zeitstempel sekunden timestamp temps tiempo tempo sec seconds"),
    INPUT: _of("u in input v voltage volt volts vin drive driving command cmd ref reference setpoint excitation force")
    | _of("torque pwm power heater pump inflow spannung kraft eingang"),
    OUTPUT: _of("y out output vout displacement disp deflection stroke position pos q x z d sensor response level")
    | _of("height angle speed velocity acceleration strain temperature weg ausgang auslenkung"),
}
# Words that say of an input or an output that the system is no piezo actuator; row counters are no times; further
# quantities are neither input nor output where there is anything else.
_OTHER_SYSTEMS = _of("force kraft torque pwm level height angle speed velocity acceleration pressure flow excursion")
_COUNTERS = _of("index idx sample samples row nr no number n")
_FURTHER = _of("current charge temperature")
# Words that say of a column in C that this is no coulomb.
_WARM = _of("temp temperature temperatur")
# Ready models by the SI units of input and output, with what these units say.
_BY_UNITS: Mapping[tuple[str, str], tuple[str, str]] = {
    ("N", "m"): ("mass_spring_damper", "a force moves a mass; mass_damper if no spring holds it, two_masses for two"),
    ("N", "m/s"): ("mass_damper", "a force moves a mass; mass_spring_damper if a spring holds it"),
    ("V", "rad"): ("motor", "a voltage turns a shaft"),
    ("V", "rad/s"): ("motor", "a voltage turns a shaft"),
    ("V", "m"): ("voice_coil", "a voltage moves more than a piezo actuator does"),
    ("V", "m/s"): ("voice_coil", "a voltage moves more than a piezo actuator does"),
    ("W", "K"): ("heated_body", "a power heats; room if a wall and the outdoor temperature count"),
    ("V", "V"): ("rc", "a voltage follows another one; first_order if the gain is not one"),
    ("A", "V"): ("battery", "a current is imposed and a voltage measured"),
    ("m³/s", "m"): ("tank", "a flow fills to a level"),
    ("m", "N"): ("friction_rig", "a motion is imposed and a force measured"),
    ("m/s", "N"): ("friction_rig", "a motion is imposed and a force measured"),
    ("K", "K"): ("first_order", "a temperature follows another one"),
}
# Steps of a time may differ by so much of their median and still be a time; `phnn check` then says more.
_UNEVEN = 0.5
# The sample rate that is written where no column is a time.
_RATE = 1000.0
# Keys that a user may want, in the order in which they are shown.
_WANTED: tuple[tuple[str, str, str], ...] = (
    ("setup", "{network: FILE.yaml}", "another system: a network of your own in a file beside the recordings"),
    ("known", "{m: {value: 1.11, std: 0.01, unit: g}}", "known parameters; without a unit in SI"),
    ("voltage", "terminals", "the voltage was measured at the actuator, behind the amplifier"),
    ("sensor", "{rectified: true}", "what is known of the sensor"),
    ("offset", "shared", "the zero of the output is the same in all recordings"),
    ("sample_rate_hz", "1000", "where there is no column of time"),
    ("start", "{state: rest, input_before: 0.0}", "at rest before the first sample; or unknown, or periodic"),
    ("periodic", "false", "the input does not repeat, though it looks as if it did"),
    ("input", "zero_order", "the input between samples: zero_order, linear, cubic or band_limited"),
    ("segments", "true", "a file holds several recordings, told apart by jumps of time"),
    ("outputs", "{q_1: {column: 2, unit: um}}", "several outputs, by the storages of a network"),
    ("ports", "{force_2: {column: 3, unit: N}}", "inputs at further ports of a network"),
)  # fmt: skip


class _Seen(NamedTuple):
    """A column of numbers."""

    place: int
    name: str
    unit: str | None  # where phnn knows it
    words: frozenset[str]  # of the name
    values: np.ndarray
    missing: int  # how many values were missing and lie between their neighbours now

    @property
    def moves(self) -> bool:
        """Return whether it changes at all."""
        return bool(np.ptp(self.values) > 0.0)

    @property
    def advances(self) -> bool:
        """Return whether it grows by nearly equal steps, as a time does."""
        steps = np.diff(self.values)
        middle = float(np.median(steps))
        return middle > 0.0 and bool(np.all(np.abs(steps - middle) < _UNEVEN * middle))

    @property
    def counts(self) -> bool:
        """Return whether it numbers the rows: whole numbers that grow, by its name or in steps of one."""
        steps = np.diff(self.values)
        if self.unit is not None or bool(np.any((steps < 0.0) | (steps != np.rint(steps)))):
            return False
        named = self.words & (_WORDS[TIME] | _WORDS[INPUT])
        return bool(self.words & _COUNTERS) or (bool(np.all(steps == 1.0)) and not named)

    @property
    def size(self) -> tuple[float, float, str]:
        """Return its largest size and its range in SI, and the SI unit; nothing of what has no unit."""
        unit = find_unit(self.unit) if self.unit else None
        factor = unit.factor if unit is not None else 0.0
        return factor * float(np.abs(self.values).max()), factor * float(np.ptp(self.values)), unit.si if unit else ""


class _Role(NamedTuple):
    """A column, the unit that it is taken to have, and what of this was guessed."""

    column: _Seen
    unit: str
    guessed: tuple[str, ...]


@dataclass(frozen=True)
class Found:
    """One file that may be a recording; it has no table where it cannot be read, no roles without input and output."""

    file: str
    table: Table | None = None
    roles: Mapping[str, _Role] = field(default_factory=dict)
    columns: tuple[_Seen, ...] = ()  # of numbers, in order
    actuator: bool = True  # it may be the recording of a piezo actuator
    reason: str = ""  # why it is no recording; empty where it is one
    name: str = ""  # of the recording where the file's name alone is not unique

    @property
    def named(self) -> dict[str, _Seen]:
        """Return its columns of numbers by what they are called."""
        return {_called(self.table, c.place): c for c in self.columns} if self.table is not None else {}


def _columns_seen(table: Table) -> list[_Seen]:
    """Return the columns of a table that hold numbers, of the most frequent length; between them where some miss."""
    columns = []
    for i, name in enumerate(table.names):
        try:
            values = table.numbers(i)
        except InputRefused:
            continue
        known = np.isfinite(values)
        if values.size > 1 and known.mean() > 0.5:
            values = np.interp(np.arange(values.size), np.flatnonzero(known), values[known])
            bare, unit = split_unit(name)
            unit = unit or table.units.get(name)
            words = _of(" ".join([*re.findall(r"[^\W\d_]+", bare.lower()), parse_name(name)[0]]))
            unit = unit if unit and find_unit(unit) is not None else None
            columns.append(_Seen(i, name, unit, words, values, int(np.sum(~known))))
    if table.by_name:
        # Variables stand in a file in any order.
        columns.sort(key=lambda c: c.name)
    sizes = [c.values.size for c in columns]
    return [c for c in columns if c.values.size == max(set(sizes), key=lambda s: (sizes.count(s), s))]


def _found(file: str, table: Table) -> Found:
    """Return the roles of a table's columns, with a reason where fewer than two may be input and output."""
    columns = _columns_seen(table)
    time = _time(columns, table)
    # An instrument may write the same numbers twice: those that state a unit are meant.
    stated = sorted(columns, key=lambda c: (c is not time, c.unit is None))
    first = {c.values.tobytes(): c for c in reversed(stated)}
    rest = [c for c in columns if first[c.values.tobytes()] is c is not time]
    rest = [c for c in rest if not c.counts and c.name not in table.stamps]
    free = [c for c in rest if c.moves and not c.words & _FURTHER]
    free = free if len(free) >= 2 else [c for c in rest if c.moves]
    if len(free) < 2:
        return Found(file, table, reason="fewer than two columns of numbers that change: no input and output in it")
    source = _by_words(free, INPUT, "voltage")
    answer = _by_words([c for c in free if c is not source], OUTPUT, "displacement")
    u = source or next(c for c in free if c is not answer)
    y = answer or next(c for c in free if c is not u)
    if (u.size[2], y.size[2]) == ("V", "A"):
        u, y, source, answer = y, u, answer, source  # what is imposed on a cell or a coil is a current
    actuator = _is_of_actuator(u, y)
    roles = {
        INPUT: _role(u, "V" if actuator else "1", source, y),
        OUTPUT: _role(y, _length(y) if actuator else "1", answer, u),
    }
    if time is not None:
        known = suits("time", time.unit)
        roles[TIME] = _role(time if known else time._replace(unit=None), "s", known or time.words & _WORDS[TIME])
        if time.name in table.stamps:
            roles[TIME] = _Role(time, "s", ())
    return Found(file, table, roles, tuple(columns), actuator)


def with_roles(file: Found, picked: Mapping[str, tuple[str, str]]) -> Found:
    """Return a file whose columns have the roles that a person gave them, as name and unit by role; a role that is not
    named is nobody's. Raises InputRefused without such a column or unit, or without input or output."""
    named, roles = file.named, {}
    for role, (name, unit) in picked.items():
        if name not in named:
            raise InputRefused(f"{file.file}: there is no column of numbers {name!r}: choose {', '.join(named)}")
        if find_unit(unit) is None:
            raise InputRefused(f"{file.file}: the unit {unit!r} of {name} is unknown: write one such as V, um or N")
        roles[role] = _Role(named[name]._replace(unit=unit), unit, ())
    if missing := [role for role in (INPUT, OUTPUT) if role not in roles]:
        raise InputRefused(f"{file.file}: no column is the {missing[0]}: choose one")
    return replace(file, roles=roles, actuator=_is_of_actuator(roles[INPUT].column, roles[OUTPUT].column))


def _role(column: _Seen, otherwise: str, named: object, other: _Seen | None = None) -> _Role:
    if column.unit == "C" and (column.words & _WARM or (other is not None and other.unit == "C")):
        column, otherwise = column._replace(unit=None), "degC"
    guessed = (*(() if named else ("the column",)), *(() if column.unit else ("the unit",)))
    return _Role(column, column.unit or otherwise, guessed)


def _time(columns: Sequence[_Seen], table: Table) -> _Seen | None:
    """Return the column that is the time: by its unit, as dates, by its name, or as it advances."""
    stamps = [c for c in columns if c.name in table.stamps]
    named = [c for c in columns if c.words & _WORDS[TIME] and c.moves]
    stated = [c for c in (*named, *columns) if c.advances and suits("time", c.unit) and c.name not in table.stamps]
    evenly = [c for c in columns if c.advances and not c.counts and not c.words & (_WORDS[INPUT] | _WORDS[OUTPUT])]
    return next(iter([*stated, *stamps, *named, *evenly]), None)


def _by_words(columns: Sequence[_Seen], role: str, first: str) -> _Seen | None:
    """Return the column whose name says the role, that of quantity ``first`` before all others."""
    named = [c for c in columns if c.words & _WORDS[role]]
    exact = [c for c in named if parse_name(c.name)[0] == first]
    return next(iter([*exact, *named]), None)


def _is_of_actuator(source: _Seen, answer: _Seen) -> bool:
    """Return whether nothing says that two columns are not input and output of a piezo actuator."""
    for column, name in ((source, "voltage"), (answer, "displacement")):
        least, most, unit = checks.ACTUATORS[name]
        largest, reach, si = column.size
        size = largest if name == "voltage" else reach
        if column.words & _OTHER_SYSTEMS or (si and (si != unit or not least <= size <= most)):
            return False
    return True


def _length(column: _Seen) -> str:
    """Return the unit in which a column would be a stroke that piezo actuators have, micrometres first."""
    size = float(np.ptp(column.values))
    factors = {"um": 1e-6, "m": 1.0, "mm": 1e-3, "nm": 1e-9}
    return next((u for u, factor in factors.items() if 1e-9 <= size * factor <= 1e-3), "um")


def _setup(usable: Sequence[Found], actuator: bool) -> list[str]:
    """Return the lines of the proposed model: by the units of input and output, if they are the same in all files."""
    if actuator:
        model = f"{{model: {DEFAULT_SETUP['model']}, hysterons: {DEFAULT_SETUP['hysterons']}}}"
        return [f"setup: {model}   # guessed: mass, spring and damper, driven through so many hysterons"]
    units = ([find_unit(f.roles[role].unit) for role in (INPUT, OUTPUT)] for f in usable)
    pairs = {(u.si, y.si) for u, y in units if u is not None and y is not None}
    pair = next(iter(pairs), ("", ""))
    if len(pairs) != 1 or pair not in _BY_UNITS:
        model = "{model: linear}   # guessed: mass, spring and damper; input and output are no voltage and stroke"
        return [f"setup: {model}"]
    model, why = _BY_UNITS[pair]
    lines = [f"setup: {{model: {model}}}   # guessed from {pair[0]} and {pair[1]}: {why}"]
    if pair[1].endswith("/s"):
        lines.append("sensor: {derivative: true}   # the output is a velocity, that of the model a way")
    return lines


def _columns(f: Found, actuator: bool) -> list[str]:
    """Return the lines of ``columns``, one for each role, with what was guessed, and one for each name that calls for a
    quantity without a unit of its own: such names are refused unless the manifest says more."""
    assert f.table is not None
    table = f.table
    keys = {TIME: TIME, INPUT: "voltage" if actuator else INPUT, OUTPUT: "displacement" if actuator else OUTPUT}
    lines = []
    for key, role in ((keys[r], f.roles[r]) for r in keys if r in f.roles):
        guessed = f"; guessed: {' and '.join(role.guessed)}" if role.guessed else ""
        place, called = _place(table, role.column.place), _called(table, role.column.place)
        masked = role.column.missing if role is f.roles[OUTPUT] else 0
        mask, note = (", missing: empty", f"; {masked} cells are empty and left out") if masked else ("", "")
        lines.append(f"{key}: {{column: {place}, unit: {role.unit}{mask}}}   # {called}{guessed}{note}")
    calls: dict[str, list[tuple[int, str | None]]] = {}
    for i, name in enumerate(table.names):
        quantity, unit = parse_name(name)
        if quantity and quantity not in [keys[r] for r in f.roles]:
            calls.setdefault(quantity, []).append((i, unit if unit and find_unit(unit) else None))
    for key, some in calls.items():
        index, unit = some[0]
        if len(some) > 1 or unit is None:
            unit = unit or QUANTITIES[key] or "1"
            lines.append(f"{key}: {{column: {_place(table, index)}, unit: {unit}}}   # guessed: not in use")
    used = [role.column.place for role in f.roles.values()]
    if others := [_called(table, c.place) for c in f.columns if c.place not in used]:
        lines.append(f"# not used: {', '.join(others)}")
    return lines


def _place(table: Table, index: int) -> str:
    """Return where a column stands: its name, its index where it has none of its own."""
    name = table.names[index]
    return _quoted(name) if name and table.names.count(name) == 1 else str(index)


def _called(table: Table, index: int) -> str:
    """Return a column in words that fit into a comment."""
    name = table.names[index]
    return _comment(name) if name else f"column {index}, without a name"


def _comment(text: str) -> str:
    """Return a text that ends with the line of a comment, whatever it holds."""
    return _escaped(message(text, LIMITS.message_characters))


def _quoted(text: str) -> str:
    """Return a text as yaml reads it back, on one printable line."""
    # Yaml knows json's escapes but for pairs of surrogates, so that letters stay as they are.
    return _escaped(json.dumps(text, ensure_ascii=False))


def _escaped(text: str) -> str:
    """Return a text with an escape in the place of every character that yaml or a terminal may not show."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


MANIFEST = "recordings.yaml"


class Look(NamedTuple):
    """What a folder looks like."""

    folder: Path
    files: Sequence[Found]
    others: Sequence[str]  # files that are left alone
    actuator: bool  # a piezo actuator was recorded
    jumps: bool = False  # times jump within a file

    def text(self) -> str:
        """Return a first manifest; files with a reason are commented out."""
        usable, shown = [f for f in self.files if not f.reason], _comment(str(self.folder))
        lines = [
            f"# A first manifest for {shown}, from what the files look like.",
            "# Correct what is marked as guessed. Save it as recordings.yaml in that folder, or give it by --manifest:",
            f"#   phnn check {shown} --manifest recordings.yaml",
            "",
            *_setup(usable, self.actuator),
            *(["segments: true   # guessed: times jump within a file, which holds several recordings"] * self.jumps),
            *(f"# {key}: {value}   # {why}" for key, value, why in _WANTED if not (self.jumps and key == "segments")),
        ]
        columns = [_columns(f, self.actuator) for f in usable]
        shared = bool(columns) and all(c == columns[0] for c in columns)
        if shared:
            lines += ["", "columns:", *(f"  {line}" for line in columns[0])]
        if any(TIME not in f.roles for f in usable):
            lines += [f"sample_rate_hz: {_RATE:g}   # guessed: no column is a time; write the true rate"]
        lines += ["", "recordings:"] if usable else []
        for i, f in enumerate(usable):
            lines += [f"  - file: {_quoted(f.file)}"]
            if f.name:
                lines += [f"    name: {_quoted(f.name)}"]
            if not shared:
                lines += ["    columns:", *(f"      {line}" for line in columns[i])]
        if usable:
            lines += ["    # add `use: confirmation` to what is to be held out; left out, phnn chooses"]
        refused = [f for f in self.files if f.reason]
        lines += ["", "# These files cannot be used as they are:"] if refused else []
        for f in refused:
            lines += [f"#   - file: {_quoted(f.file)}", f"#     # {_comment(f.reason)}"]
        lines += ["", f"# Left alone, no recordings: {_comment(', '.join(self.others))}"] if self.others else []
        return "\n".join(lines) + "\n"

    def picked(self, roles: Mapping[str, tuple[str, str]]) -> Look:
        """Return the same where a person gave the columns of all files their roles, see `with_roles`."""
        files = [f if f.reason else with_roles(f, roles) for f in self.files]
        return self._replace(files=files, actuator=all(f.actuator for f in files if not f.reason))


def look(folder: Path, outside: bool = False) -> Look:
    """Return what the files of a folder look like, whose layout nobody has described.

    Files that phnn cannot read, or not with these guesses, have the reason. The folder is only read, and a manifest in
    it is left alone; with ``outside`` its files may lead out of it. Raises InputRefused where there is no such folder,
    or no file in it that may be a recording.
    """
    checks.folder_exists(folder)
    reader = Files(folder, Manifest(), outside)
    candidates, others = reader.possible()
    checks.any_recordings(candidates, others, folder)
    files = []
    for path in candidates:
        try:
            files.append(_found(path.name, reader.table(path.name)))
        except InputRefused as error:
            files.append(Found(path.name, reason=str(error)))
    # Files that share a name up to their endings get their whole names as those of their recordings.
    shared = Counter(printable(Path(f.file).stem) for f in files if not f.reason)
    files = [replace(f, name=f.file) if shared[printable(Path(f.file).stem)] > 1 else f for f in files]
    actuator = all(f.actuator for f in files if not f.reason)
    # Numbers that no piezo actuator gives show only when the recordings are read, and so do jumps of the time.
    refused, tried = sum(bool(f.reason) for f in files), []
    for kind, jumps in itertools.product([True, False] if actuator else [False], [False, True]):
        tried.append(_tried(Look(folder, files, others, kind, jumps), outside))
        if sum(bool(f.reason) for f in tried[-1].files) == refused:
            break
    return max(tried, key=lambda one: sum(not f.reason for f in one.files))


def write_new(out: Path, content: bytes) -> None:
    """Write a new file, which may lie in the folder of the recordings. Raises OutputRefused where something has that
    name or the file cannot be written, OutputFailed where the disk is full."""
    try:
        # Exclusive: nothing is replaced, and no link is followed.
        file = out.open("xb")
    except FileExistsError as error:
        raise OutputRefused(f"{out}: is there already and stays as it is: name a new file for --out") from error
    except (OSError, ValueError) as error:
        cause = getattr(error, "strerror", None) or str(error)
        raise OutputRefused(f"{out}: cannot be written ({cause}): name a file in a folder that exists") from error
    try:
        with file:
            file.write(content)
    except OSError as error:
        out.unlink(missing_ok=True)
        raise refusal(out, error) from error


def _tried(one: Look, outside: bool) -> Look:
    """Return the same, files with a reason that the reader refuses with the guessed manifest."""
    usable = [f for f in one.files if not f.reason]
    if usable and not _refusal(one._replace(files=usable), outside):
        return one
    reasons = [f.reason or _refusal(one._replace(files=[f]), outside) for f in one.files]
    return one._replace(files=[replace(f, reason=reason) for f, reason in zip(one.files, reasons, strict=True)])


def _refusal(one: Look, outside: bool) -> str:
    """Return why files cannot be read with the guessed manifest; empty where they can."""
    try:
        read(one.folder, plain_values(one._replace(others=()).text(), MANIFEST), allow_outside=outside)
    except InputRefused as error:
        return str(error)
    return ""
