"""``phnn invert``: read a model and a reference, write the voltage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.inverse import Inverse, InverseOptions
from phnn.model import Model
from phnn.parameters import quantity
from phnn.predictor import load
from phnn.recordings import checks
from phnn.recordings.channels import select
from phnn.recordings.checks import like_an_actuator
from phnn.recordings.folder import reader_of
from phnn.recordings.recording import ACTUATOR, Units
from phnn.recordings.sampling import evenly, stamped
from phnn.recordings.table import Where
from phnn.recordings.units import known_unit
from phnn.report.figures import draw_trace
from phnn.report.figures.style import AFTER, BEFORE, FAINT, MEASURED, RC, new_figure, png, quiet_grid
from phnn.report.formatting import display_unit
from phnn.results import Place, claim

# Columns that may hold a reference, the first that is there counts.
_QUANTITIES = ("displacement", "output")


class Reference(NamedTuple):
    """Attributes:
    t: (N,) time, equally spaced, s.
    y: (N,) what is to be followed, SI.
    unit: SI unit of ``y``.
    notes: what was done to the samples, in sentences.
    """

    t: np.ndarray
    y: np.ndarray
    unit: str
    notes: tuple[str, ...]


def read_reference(path: Path, allow_outside: bool = False) -> Reference:
    """Read a table with a time and a displacement, of any format that recordings may have.

    Args:
        path: of the file; allow_outside: it may be a link, or refer to other files.

    Raises:
        InputRefused: with one message naming file, column, row, cause and remedy.
    """
    reader = reader_of(path)
    table = reader(named_file(path, (path.parent,), outside=allow_outside))
    channels = select(table, {}, {})
    quantity = next((q for q in _QUANTITIES if q in channels), None)
    columns = ", ".join(n for n in table.names if n) or "none with a name"
    for name, found, example in (("time", "time" in channels, "s"), ("displacement", quantity is not None, "um")):
        if not found:
            raise InputRefused(
                f"{table.where}: no {name} column among its columns ({columns}): name one {name}_{example}"
            )
    assert quantity is not None
    channel, time = channels[quantity], channels["time"]
    checks.enough_samples(channel.values.size, table.where)
    checks.output_moves(channel.values, f"{quantity} ({channel.label})", table.where)
    factor = known_unit(time.unit).factor
    times = stamped(time.values, factor, {quantity: channel.values}, table.where)
    dt, y = evenly(times.t, times.values[quantity])
    notes = tuple(f"The reference: {note}." for note in times.notes)
    return Reference(time.values[0] + dt * np.arange(y.size), y, known_unit(channel.unit).si, notes)


def draw_inverse(found: Inverse, input_unit: str, output_unit: str) -> Figure:
    """Draw three panels over time: output, error with what was out of reach marked, command."""
    figure = new_figure(9.6, 6.6)
    outputs, errors, commands = figure.subplots(3, 1, sharex=True)
    unit = display_unit(float(abs(found.reference).max()), output_unit)
    fine = display_unit(float(abs(found.error).max()), output_unit)
    for values, colour, width, text in (
        (found.reference, MEASURED, 3.0, "reference"),
        (found.reached, AFTER, 1.1, "reached by the model"),
    ):
        draw_trace(outputs, found.t, values, unit.scale, color=colour, linewidth=width, label=text)
    draw_trace(errors, found.t, found.error, fine.scale, color=AFTER, linewidth=1.0)
    for stretch in found.missed:
        if stretch.causes:
            errors.axvspan(stretch.start, stretch.end, color=BEFORE, alpha=0.12, linewidth=0.0)
    draw_trace(commands, found.t, found.voltage, color=AFTER, linewidth=1.1)
    for limit in found.options.limits or ():
        commands.axhline(limit, color=FAINT, linewidth=1.0)
    outputs.set_ylabel(f"output ({unit.name})")
    errors.set_ylabel(f"error ({fine.name})")
    commands.set_ylabel(f"command ({input_unit})")
    commands.set_xlabel("time (s)")
    figure.legend(*outputs.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    for axes in (outputs, errors, commands):
        quiet_grid(axes)
    return figure


# What `phnn invert` writes into its folder.
RESULTS = ("command.csv", "invert.json", "invert.png")
# By the unit of an input: what it is called in the head of a table.
_INPUTS = {"V": "voltage_V", "N": "force_N"}


def invert(
    model: Path,
    reference: Path,
    out: Path,
    options: Mapping[str, Any],
    outside: bool = False,
    overwrite: bool = False,
) -> None:
    """Find the command with which a stored model follows the reference of a file; writes `RESULTS`.

    Args:
        options: the fields of `phnn.inverse.InverseOptions`; None stands for the default.

    Raises:
        InputRefused: the model has no such inverse, or the reference cannot be used.
    """
    given = {f.name: options[f.name] for f in fields(InverseOptions) if options.get(f.name) is not None}
    if "limits" in given:
        given["limits"] = tuple(given["limits"])
    chosen = InverseOptions(**given)
    found = load(model, outside)
    if not isinstance(found, Model):
        raise InputRefused(
            f"{model}: a model of modes in a steady cycle has no inverse: give the model of an actuator, as phnn "
            "identify or phnn diagnose writes it"
        )
    network, wanted = found.setup.network, read_reference(reference, outside)
    measured = next(s.unit for s in network.storages if s.name == network.output)
    units = Units(next((p.unit for p in network.ports), ""), measured)
    if wanted.unit != units.output:
        raise InputRefused(
            f"{reference.name}: the reference is in {wanted.unit}, the output of the model in {units.output}: give a "
            "reference of what the model's sensor measures"
        )
    if units == ACTUATOR:
        like_an_actuator(float(np.ptp(wanted.y)), "displacement", "reference", Where(reference.name))
    with claim(out, "invert", [model, reference], RESULTS, overwrite=overwrite) as place:
        inverse = found.inverse(wanted.t, wanted.y, **given)
        _write(inverse, units, wanted.notes, place)
    low, high = float(inverse.voltage.min()), float(inverse.voltage.max())
    print(f"command: {low:.4g} to {high:.4g} {units.input}")
    if chosen.smooth is None:
        print(f"error of the model: {_size(inverse.error, units.output)}")
    else:
        print(f"error of the model against the smoothed reference: {_size(inverse.error, units.output)}")
        print(f"against the reference itself: {_size(inverse.error_of_given, units.output)}")
    for message in (*wanted.notes, *inverse.messages):
        print(message)
    print(f"results: {out / RESULTS[0]}")


def _size(error: NDArray[np.float64], unit: str) -> str:
    rms = float(np.sqrt(np.mean(error**2)))
    return f"at most {quantity(float(np.abs(error).max()), unit)}, {quantity(rms, unit)} rms"


def _write(inverse: Inverse, units: Units, notes: tuple[str, ...], place: Place) -> None:
    suffix = units.output.replace(" ", "")
    output = "displacement" if units.output == "m" else "output"
    table = pd.DataFrame(
        {
            "time_s": inverse.t,
            _INPUTS.get(units.input, f"input_{units.input.replace(' ', '')}"): inverse.voltage,
            f"{output}_{suffix}": inverse.reached,
            f"reference_{suffix}": inverse.reference,
            f"error_{suffix}": inverse.error,
            **({} if inverse.options.smooth is None else {f"given_{suffix}": inverse.given}),
        }
    )
    (place / "command.csv").write(table.to_csv(index=False).encode())
    content = inverse.document()
    (place / "invert.json").write_json({**content, "messages": [*notes, *content["messages"]]})
    with rc_context(RC):
        (place / "invert.png").write(png(draw_inverse(inverse, *units)))
