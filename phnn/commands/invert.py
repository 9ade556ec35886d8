"""``phnn invert``: read a model and a reference, write the voltage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib import rc_context
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.inverse import Inverse, InverseOptions
from phnn.model import Model
from phnn.predictor import loaded
from phnn.recordings.checks import like_an_actuator
from phnn.recordings.reference import Reference, read_reference
from phnn.recordings.table import Where
from phnn.report.figures.inverse import draw_inverse
from phnn.report.figures.style import RC, png
from phnn.report.formatting import quantity
from phnn.results import Place, claim

# What `phnn invert` writes into its folder.
RESULTS = ("command.csv", "invert.json", "invert.png")
# By the unit of an input: what it is called in the head of a table.
_INPUTS = {"V": "voltage_V", "N": "force_N"}


class _Units(NamedTuple):
    """SI units of a model's input and output."""

    input: str
    output: str


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
    found = loaded(model, outside)
    if not isinstance(found, Model):
        raise InputRefused(
            f"{model}: a model of modes in a steady cycle has no inverse: give the model of an actuator, as phnn "
            "identify or phnn diagnose writes it"
        )
    units, wanted = _units(found), read_reference(reference, outside)
    _check(reference, wanted, units)
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


def _units(model: Model) -> _Units:
    network = model.setup.network
    return _Units(
        next((p.unit for p in network.ports), ""), next(s.unit for s in network.storages if s.name == network.output)
    )


def _check(path: Path, wanted: Reference, units: _Units) -> None:
    """Refuse a reference in another unit than the model's output."""
    if wanted.unit != units.output:
        raise InputRefused(
            f"{path.name}: the reference is in {wanted.unit}, the output of the model in {units.output}: give a "
            "reference of what the model's sensor measures"
        )
    if units == ("V", "m"):
        like_an_actuator(float(np.ptp(wanted.y)), "displacement", "reference", Where(path.name))


def _write(inverse: Inverse, units: _Units, notes: tuple[str, ...], place: Place) -> None:
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
