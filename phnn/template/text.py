"""The text of a first manifest: what was found, what was guessed, and the keys that may be wanted, one line each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phnn.intake.limits import LIMITS
from phnn.recordings.manifest import DEFAULT_SETUP, TOP_KEYS
from phnn.recordings.table import Table
from phnn.results import message
from phnn.template.roles import INPUT, OUTPUT, TIME, Layout, Role, known_unit, unstated
from phnn.units import quantity

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
    lines = [*_head(folder), *_setup(actuator), *_wanted()]
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


def _setup(actuator: bool) -> list[str]:
    if actuator:
        said = f"{{model: {DEFAULT_SETUP['model']}, hysterons: {DEFAULT_SETUP['hysterons']}}}"
        return [f"setup: {said}   # guessed: mass, spring and damper, driven through so many hysterons"]
    return ["setup: {model: linear}   # guessed: mass, spring and damper; input and output are no voltage and stroke"]


def _wanted() -> list[str]:
    return [f"# {key}: {value}   # {why}" for key, value, why in _WANTED if key in TOP_KEYS]


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
