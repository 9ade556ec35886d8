"""From a folder to a first manifest that `phnn check` reads: what was found, and the keys that may be wanted.

Time, input and output columns of an unknown table and their units are guessed from the names, the units and, where
these say nothing, the values and the order of the columns. What was guessed is said, one line each.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused, OutputRefused
from phnn.intake.limits import LIMITS
from phnn.parameters import quantity
from phnn.recordings import checks, read
from phnn.recordings.checks import ACTUATORS
from phnn.recordings.folder import READERS, Files
from phnn.recordings.manifest import DEFAULT_SETUP, TOP_KEYS, Entry, Manifest
from phnn.recordings.table import Table
from phnn.recordings.units import QUANTITIES, find_unit, parse_name, split_unit
from phnn.results import message, printable, refusal

Array = NDArray[np.float64]

TIME, INPUT, OUTPUT = "time", "input", "output"


def _of(words: str) -> frozenset[str]:
    return frozenset(words.split())


# Words of column names by the role that they suggest.
_WORDS: Mapping[str, frozenset[str]] = {
    TIME: _of("time t zeit timestamp temps sec seconds"),
    INPUT: _of("u in input v voltage volt volts vin drive driving command cmd ref reference setpoint excitation force")
    | _of("torque pwm power heater pump inflow spannung eingang"),
    OUTPUT: _of("y out output vout displacement disp deflection stroke position pos q x z d sensor response level")
    | _of("height angle speed velocity acceleration strain temperature weg ausgang auslenkung"),
}
# Words that say of an input or an output that the system is no piezo actuator.
_OTHER_SYSTEMS = _of("force torque pwm level height angle speed velocity acceleration pressure flow excursion")
# Row counters are no times.
_COUNTERS = _of("index idx sample samples row nr no number n")
# Further quantities, which are neither input nor output where there is anything else.
_FURTHER = ("current", "charge", "temperature")
# Steps of a time may differ by so much of their median and still be a time; `phnn check` then says more.
_UNEVEN = 0.5
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


def known_unit(text: str | None) -> tuple[str, float] | None:
    """SI unit and factor of a unit; None where phnn does not know it."""
    found = find_unit(text) if text else None
    return (found.si, found.factor) if found is not None else None


def _si(text: str | None) -> str:
    """Return the SI unit of a unit; empty where phnn does not know it."""
    return (known_unit(text) or ("", 1.0))[0]


@dataclass(frozen=True, eq=False)
class Seen:
    """One column of numbers.

    Attributes:
        index: in the table; name: in the header, empty where there is none.
        values: (N,) as they stand in the file.
    """

    index: int
    name: str
    values: Array

    @cached_property
    def _parts(self) -> tuple[str, str | None]:
        """The name without its unit, and the unit in the spelling of the table of units."""
        return split_unit(self.name)

    @property
    def unit(self) -> str | None:
        """The unit that the name gives, where phnn knows it."""
        return self._parts[1] if known_unit(self._parts[1]) is not None else None

    @property
    def words(self) -> frozenset[str]:
        """The words of the name, in small letters, and its quantity."""
        known = parse_name(self.name) if self.name else None
        words = re.findall(r"[^\W\d_]+", self._parts[0].lower())
        return frozenset([*words, *([known[0]] if known is not None else [])])

    @property
    def constant(self) -> bool:
        """It never changes."""
        return bool(np.ptp(self.values) == 0.0)

    @property
    def advances(self) -> bool:
        """It grows by nearly equal steps, as a time does."""
        steps = np.diff(self.values)
        middle = float(np.median(steps)) if steps.size else 0.0
        return middle > 0.0 and bool(np.all(np.abs(steps - middle) < _UNEVEN * middle))

    @property
    def counts(self) -> bool:
        """It counts rows."""
        return bool(self.words & _COUNTERS) or bool(np.all(np.diff(self.values) == 1.0))


@dataclass(frozen=True)
class Role:
    """A column and what it is taken for.

    Attributes:
        column: which; unit: SI or a multiple that phnn knows.
        by_name: its name says the role, not only its place.
        unit_known: its name says the unit.
    """

    column: Seen
    unit: str
    by_name: bool
    unit_known: bool


@dataclass(frozen=True)
class Layout:
    """What the columns of one file are taken for.

    Attributes:
        time: None where no column is one.
        input, output: of the system.
        actuator: they may be the voltage and the displacement of a piezo actuator.
        others: columns that serve as nothing.
    """

    time: Role | None
    input: Role
    output: Role
    actuator: bool
    others: tuple[Seen, ...]


def columns_seen(table: Table) -> list[Seen]:
    """The columns of a table that hold finite numbers of the most frequent length."""
    found = []
    for i, name in enumerate(table.names):
        try:
            values = table.numbers(i)
        except InputRefused:
            continue
        if values.size > 1 and bool(np.isfinite(values).all()):
            found.append(Seen(i, name, values))
    if table.by_name:
        # Variables stand in a file in any order.
        found.sort(key=lambda c: c.name)
    sizes = [c.values.size for c in found]
    return [c for c in found if c.values.size == max(set(sizes), key=lambda s: (sizes.count(s), s))]


def layout_of(table: Table) -> Layout | None:
    """The roles of a table's columns; None where it has fewer than two columns that may be input and output."""
    columns = columns_seen(table)
    time = _time(columns)
    rest = [c for c in columns if (time is None or c is not time.column) and not (c.words & _COUNTERS)]
    moving = [c for c in rest if not c.constant]
    free = [c for c in moving if not (c.words & set(_FURTHER))]
    free = free if len(free) >= 2 else moving
    if len(free) < 2:
        return None
    source = _by_words(free, INPUT, "voltage")
    answer = _by_words([c for c in free if c is not source], OUTPUT, "displacement")
    u = source or next(c for c in free if c is not answer)
    y = answer or next(c for c in free if c is not u)
    if (_si(u.unit), _si(y.unit)) == ("V", "A"):
        u, y, source, answer = y, u, answer, source  # what is imposed on a cell or a coil is a current
    actuator = _like_an_actuator(u, y)
    return Layout(
        time,
        Role(u, u.unit or ("V" if actuator else "1"), source is not None, u.unit is not None),
        Role(y, y.unit or (_length(y) if actuator else "1"), answer is not None, y.unit is not None),
        actuator,
        tuple(c for c in rest if c not in (u, y)),
    )


def unstated(table: Table, stated: Sequence[str]) -> dict[str, tuple[int, str]]:
    """Column and guessed unit of quantities that the names of a table call for, but without a unit of theirs or by
    several columns: such names are refused unless the manifest says more.

    Args:
        stated: quantities that the manifest states already.
    """
    found: dict[str, list[tuple[int, str | None]]] = {}
    for i, name in enumerate(table.names):
        known = parse_name(name) if name else None
        if known is not None and known[0] not in stated:
            found.setdefault(known[0], []).append((i, known[1]))
    doubtful = {q: some for q, some in found.items() if len(some) > 1 or known_unit(some[0][1]) is None}
    return {
        q: (i, unit if unit is not None and known_unit(unit) is not None else QUANTITIES[q] or "1")
        for q, ((i, unit), *_) in doubtful.items()
    }


def _time(columns: Sequence[Seen]) -> Role | None:
    named = next((c for c in columns if c.words & _WORDS[TIME] and not c.constant), None)
    evenly = [c for c in columns if c.advances and not (c.words & (_COUNTERS | _WORDS[INPUT] | _WORDS[OUTPUT]))]
    found = named or next(iter(sorted(evenly, key=lambda c: c.counts)), None)
    if found is None:
        return None
    unit = known_unit(found.unit)
    known = unit is not None and unit[0] == "s"
    return Role(found, str(found.unit) if known else "s", named is not None, known)


def _by_words(columns: Sequence[Seen], role: str, first: str) -> Seen | None:
    """The column whose name says the role, that of quantity ``first`` before all others."""
    named = [c for c in columns if c.words & _WORDS[role]]
    exact = [c for c in named if (p := parse_name(c.name)) is not None and p[0] == first]
    return next(iter([*exact, *named]), None)


def _like_an_actuator(u: Seen, y: Seen) -> bool:
    """Whether nothing says that these are not voltage and displacement of a piezo actuator."""
    for column, name in ((u, "voltage"), (y, "displacement")):
        if column.words & _OTHER_SYSTEMS:
            return False
        known = known_unit(column.unit)
        if known is not None:
            least, most, unit = ACTUATORS[name]
            si, factor = known
            size = float(np.abs(column.values).max() if name == "voltage" else np.ptp(column.values))
            if si != unit or not least <= factor * size <= most:
                return False
    return True


def _length(column: Seen) -> str:
    """The unit in which the numbers of a column would be a stroke that piezo actuators have, micrometres first."""
    shortest, longest = 1e-9, 1e-3
    size = float(np.ptp(column.values))
    factors = {"um": 1e-6, "m": 1.0, "mm": 1e-3, "nm": 1e-9}
    return next((u for u, factor in factors.items() if shortest <= size * factor <= longest), "um")


# The sample rate that is written where no column is a time.
_RATE = 1000.0
# One recording in so many is proposed to be held out.
_HELD_OUT = 4
# Keys that a user may want, in the order in which they are shown; those that this version does not know are left out.
_WANTED: tuple[tuple[str, str, str], ...] = (
    ("setup", "{network: FILE.yaml}", "another system: a network of your own in a file beside the recordings"),
    (
        "known",
        "{m: {value: 1.06, std: 0.01, unit: g}}",
        "known parameters, such as a weighed mass; without a unit in SI",
    ),
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
)


@dataclass(frozen=True)
class Found:
    """One file that may be a recording.

    Attributes:
        file: its name; table, layout: None where it cannot be read, or its columns cannot be input and output.
        reason: why it is no recording; empty where it is one.
        name: of the recording where the file's name alone is not unique.
    """

    file: str
    table: Table | None = None
    layout: Layout | None = None
    reason: str = ""
    name: str = ""


def manifest_text(
    found: Sequence[Found], left: Sequence[str], folder: str, actuator: bool, with_uses: bool = True
) -> str:
    """The manifest.

    Args:
        found: files that may be recordings; those with a reason are commented out.
        left: other files and folders.
        folder: as the user calls it.
        actuator: input and output are taken for voltage and displacement of a piezo actuator.
        with_uses: propose which recordings are held out.
    """
    usable = [f for f in found if not f.reason]
    lines = [*_head(folder), *_setup(actuator, [f.layout for f in usable if f.layout is not None])]
    lines += [f"# {key}: {value}   # {why}" for key, value, why in _WANTED if key in TOP_KEYS]
    columns = [_columns(f, actuator) for f in usable]
    shared = bool(columns) and all(c == columns[0] for c in columns)
    if shared:
        lines += ["", "columns:", *(f"  {line}" for line in columns[0])]
    if any(f.layout is not None and f.layout.time is None for f in usable):
        lines += [f"sample_rate_hz: {_RATE:g}   # guessed: no column is a time; write the true rate"]
    if usable:
        lines += ["", "recordings:"]
    for i, f in enumerate(usable):
        held = with_uses and len(usable) >= _HELD_OUT
        use = ("confirmation" if i % _HELD_OUT == _HELD_OUT - 1 else "identification") if held else ""
        lines += _entry(f, use, [] if shared else columns[i], actuator)
    if usable and len(usable) < _HELD_OUT:
        lines += ["    # add `use: confirmation` to what is to be held out; left out, phnn chooses"]
    lines += _not_used(found, left)
    return "\n".join(lines) + "\n"


def _head(folder: str) -> list[str]:
    shown = _comment(folder)
    return [
        f"# A first manifest for {shown}, from what the files look like.",
        "# Correct what is marked as guessed. Save it as recordings.yaml in that folder, or give it by --manifest:",
        f"#   phnn check {shown} --manifest recordings.yaml",
        "",
    ]


def _setup(actuator: bool, layouts: Sequence[Layout]) -> list[str]:
    """Return the lines of the proposed model: by the units of input and output, if they are the same in all files."""
    if actuator:
        said = f"{{model: {DEFAULT_SETUP['model']}, hysterons: {DEFAULT_SETUP['hysterons']}}}"
        return [f"setup: {said}   # guessed: mass, spring and damper, driven through so many hysterons"]
    units = {(_si(one.input.unit), _si(one.output.unit)) for one in layouts}
    pair = next(iter(units), ("", ""))
    if len(units) != 1 or pair not in _BY_UNITS:
        said = "{model: linear}   # guessed: mass, spring and damper; input and output are no voltage and stroke"
        return [f"setup: {said}"]
    model, why = _BY_UNITS[pair]
    moves = ["sensor: {derivative: true}   # the output is a velocity, that of the model a way"]
    said = f"setup: {{model: {model}}}   # guessed from {pair[0]} and {pair[1]}: {why}"
    return [said, *(moves if pair[1].endswith("/s") else [])]


def _columns(f: Found, actuator: bool) -> list[str]:
    """The lines of ``columns``, one for each role, with what was guessed."""
    assert f.layout is not None and f.table is not None
    names = {TIME: f.layout.time, INPUT: f.layout.input, OUTPUT: f.layout.output}
    keys = {TIME: TIME, INPUT: "voltage" if actuator else INPUT, OUTPUT: "displacement" if actuator else OUTPUT}
    lines = [_column(keys[r], role, f.table) for r, role in names.items() if role is not None]
    for key, (index, unit) in unstated(f.table, [keys[r] for r, role in names.items() if role is not None]).items():
        lines.append(f"{key}: {{column: {_place(f.table, index)}, unit: {unit}}}   # guessed: not in use")
    if f.layout.others:
        listed = ", ".join(_called(f.table, c.index) for c in f.layout.others)
        lines.append(f"# not used: {listed}")
    return lines


def _column(key: str, role: Role, table: Table) -> str:
    doubts = [*([] if role.by_name else ["the column"]), *([] if role.unit_known else ["the unit"])]
    guessed = f"; guessed: {' and '.join(doubts)}" if doubts else ""
    called = _called(table, role.column.index)
    return f"{key}: {{column: {_place(table, role.column.index)}, unit: {role.unit}}}   # {called}{guessed}"


def _place(table: Table, index: int) -> str:
    """Where a column stands: by its name, by its index where it has none of its own."""
    name = table.names[index]
    return _quoted(name) if name and table.names.count(name) == 1 else str(index)


def _called(table: Table, index: int) -> str:
    """A column in words that fit into a comment."""
    name = table.names[index]
    return _comment(name) if name else f"column {index}, without a name"


def _entry(f: Found, use: str, columns: Sequence[str], actuator: bool) -> list[str]:
    lines = [f"  # {_extent(f)}", f"  - file: {_quoted(f.file)}"]
    lines += [f"    name: {_quoted(f.name)}"] if f.name else []
    lines += [f"    use: {use}" + ("   # proposed: held out" if use == "confirmation" else "")] if use else []
    return lines + (["    columns:", *(f"      {line}" for line in columns)] if columns else [])


def _extent(f: Found) -> str:
    """Samples, sampling, and the sizes of input and output."""
    assert f.layout is not None
    u, y = f.layout.input, f.layout.output
    said = f"{u.column.values.size} samples"
    if f.layout.time is not None:
        unit = known_unit(f.layout.time.unit)
        step = float(np.median(np.diff(f.layout.time.column.values))) * (unit[1] if unit is not None else 1.0)
        said += f", one every {quantity(step, 's')}"
    sizes = (f"{what} {_range(role)}" for what, role in ((INPUT, u), (OUTPUT, y)))
    return f"{said}; {'; '.join(sizes)}"


def _range(role: Role) -> str:
    unit = "" if role.unit == "1" else f" {role.unit}"
    return f"{role.column.values.min():.4g} to {role.column.values.max():.4g}{unit}"


def _not_used(found: Sequence[Found], left: Sequence[str]) -> list[str]:
    refused = [f for f in found if f.reason]
    lines = ["", "# These files cannot be used as they are:"] if refused else []
    for f in refused:
        lines += [f"#   - file: {_quoted(f.file)}", f"#     # {_comment(f.reason)}"]
    return lines + (["", f"# Left alone, no recordings: {_comment(', '.join(left))}"] if left else [])


def _comment(text: str) -> str:
    """A text that ends with the line of a comment, whatever it holds."""
    return "".join(c if c.isprintable() else _escape(c) for c in message(text, LIMITS.message_characters))


def _quoted(text: str) -> str:
    """A text as yaml reads it back, on one printable line."""
    # Yaml knows json's escapes but for pairs of surrogates, so that letters stay as they are.
    return "".join(c if c.isprintable() else _escape(c) for c in json.dumps(text, ensure_ascii=False))


def _escape(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


MANIFEST = "recordings.yaml"


def template(folder: Path, outside: bool = False) -> str:
    """The text of a first manifest for a folder whose layout nobody has described.

    Files that phnn cannot read, or not with these guesses, are listed in comments with the reason. Without them the
    manifest is one that `phnn check` reads.

    Args:
        folder: is only read; a manifest in it is left alone.
        outside: files in it may lead out of it.

    Raises:
        InputRefused: there is no such folder, or no file in it that may be a recording.
    """
    checks.folder_exists(folder)
    files = Files(folder, Manifest(DEFAULT_SETUP, {}, "command", Entry(), None, None), outside)
    candidates, left = files.possible()
    checks.any_recordings(candidates, left, folder)
    found = _named_apart([_found(files, path.name) for path in candidates])
    actuator = all(f.layout.actuator for f in found if f.layout is not None)
    # Numbers that no piezo actuator gives show only when the recordings are read.
    tried = [_readable(found, folder, kind, outside) for kind in ([True, False] if actuator else [False])]
    best = max(range(len(tried)), key=lambda i: sum(not f.reason for f in tried[i]))
    return manifest_text(tried[best], left, str(folder), actuator and best == 0)


def write_template(folder: Path, out: Path, outside: bool = False) -> None:
    """Write that text into a new file, which may lie in the folder of the recordings.

    Raises:
        InputRefused: as `template`; or there is a file, folder or link of that name, or the new one cannot be written.
        OutputFailed: the disk is full.
    """
    content = template(folder, outside).encode()
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


def _found(files: Files, name: str) -> Found:
    """One file as it stands."""
    try:
        source = files.source(name)
        table = READERS[source.suffix](source)
    except InputRefused as error:
        return Found(name, reason=str(error))
    layout = layout_of(table)
    if layout is None:
        return Found(name, table, reason="fewer than two columns of numbers that change: no input and output in it")
    return Found(name, table, layout)


def _named_apart(found: Sequence[Found]) -> list[Found]:
    """Files that share a name up to their endings get their whole names as those of their recordings."""
    shared = Counter(printable(Path(f.file).stem) for f in found if not f.reason)
    return [replace(f, name=f.file) if shared[printable(Path(f.file).stem)] > 1 else f for f in found]


def _readable(found: Sequence[Found], folder: Path, actuator: bool, outside: bool) -> list[Found]:
    """The files, those with a reason that the reader refuses with the guessed manifest."""
    usable = [f for f in found if not f.reason]
    if usable and not _refusal(usable, folder, actuator, outside):
        return list(found)
    return [f if f.reason else replace(f, reason=_refusal([f], folder, actuator, outside)) for f in found]


def _refusal(found: Sequence[Found], folder: Path, actuator: bool, outside: bool) -> str:
    """Why these files cannot be read with the guessed manifest; empty where they can."""
    text = manifest_text(found, (), str(folder), actuator, with_uses=len(found) > 1)
    with tempfile.TemporaryDirectory() as home:
        path = Path(home) / MANIFEST
        try:
            path.write_text(text, encoding="utf-8")
            read(folder, path, allow_outside=outside)
        except InputRefused as error:
            return str(error)
        except UnicodeEncodeError:
            return "its name is no text: rename it"
    return ""
