"""Write a model as files of a target: names and contents, by target."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from phnn.errors import InputRefused
from phnn.exporting.build import HOLDS, Hold, build
from phnn.exporting.c import c_header, c_source
from phnn.exporting.languages import python
from phnn.exporting.program import Program
from phnn.intake.limits import LIMITS
from phnn.model import Model
from phnn.network.elements import Network
from phnn.predictor import loaded
from phnn.results import claim
from phnn.setup import Setup

if TYPE_CHECKING:
    from phnn.modal.store import StoredModes


Files = Mapping[str, bytes]


def c_files(program: Program) -> Files:
    """A header and a source of C99."""
    return {f"{program.name}.h": c_header(program).encode(), f"{program.name}.c": c_source(program).encode()}


def python_files(program: Program) -> Files:
    """One module."""
    return {f"{program.name}.py": python(program).encode()}


def matlab_files(program: Program) -> Files:
    """Functions that initialise and step, and one for a MATLAB Function block of Simulink."""
    from phnn.exporting.languages import matlab

    return {name: text.encode() for name, text in matlab(program).items()}


def fmu_files(program: Program) -> Files:
    """A functional mock-up unit."""
    from phnn.exporting.fmu import fmu

    return {f"{program.name}.fmu": fmu(program)}


TARGETS: dict[str, Callable[[Program], Files]] = {
    "c": c_files,
    "fmu": fmu_files,
    "python": python_files,
    "matlab": matlab_files,
}


# Sample time [s] where none is given: 10 kHz, a common rate of controllers of piezo stages.
SAMPLE_TIME = 1e-4


@dataclass(frozen=True)
class Wanted:
    """How a model is exported.

    Attributes:
        to: ``c``, ``fmu``, ``python`` or ``matlab``.
        dt: sample time [s].
        substeps: integration steps in it; those of the model if None.
        hold: the input between samples: ``linear`` or ``zero_order``.
        name: prefix of all that is made public; that of the model if empty.
        ports: further ports that are inputs; the others are zero.
        sensor: whether the sensor is included; without it the output is what the sensor senses.
        initial_input: constant input [SI of the first port] at whose rest a model begins that cannot compute it.
    """

    to: str
    dt: float = SAMPLE_TIME
    substeps: int | None = None
    hold: Hold = "linear"
    name: str = ""
    ports: tuple[str, ...] = ()
    sensor: bool = True
    initial_input: float = 0.0


def program_of(model: Model | Setup | Network | StoredModes, wanted: Wanted) -> Program:
    """The program of a model.

    Raises:
        InputRefused: a setting is out of range, or a law or block cannot be exported; names it.
    """
    setup, substeps = _setup_of(model)
    _check(wanted, setup)
    if not wanted.sensor:
        setup = replace(setup, sensor=())
    chosen = wanted.substeps if wanted.substeps is not None else substeps
    # What drives a unit of co-simulation holds its input during a communication step.
    hold = "zero_order" if wanted.to == "fmu" else wanted.hold
    return build(setup, wanted.dt, chosen, hold, wanted.name, wanted.ports, wanted.initial_input)


def write(
    model: Model | Setup | Network | StoredModes | str | Path,
    wanted: Wanted,
    out: str | Path,
    outside: bool = False,
    overwrite: bool | None = False,
) -> list[Path]:
    """Write the files of a target into a folder; returns their paths.

    Args:
        model: or the folder of a stored one, or of a diagnosis.
        outside: the model's file may be a link that leads out of its folder.
        overwrite: replace files of an earlier export even where they were changed since.

    Raises:
        InputRefused: there is no such model or target, or it cannot be exported, or the folder cannot be written to.
    """
    given = [Path(model)] if isinstance(model, str | Path) else []
    found = loaded(given[0], outside) if given else model
    program = program_of(found, wanted)  # type: ignore[arg-type]
    files = TARGETS[wanted.to](program)
    folder = Path(out)
    with claim(folder, "export", given, tuple(files), overwrite=overwrite, index=False) as place:
        for name, content in files.items():
            (place / name).write(content)
    return [folder / name for name in files]


def _setup_of(model: Model | Setup | Network | StoredModes) -> tuple[Setup, int]:
    if isinstance(model, Model):
        return model.setup, model.substeps
    if isinstance(model, Setup):
        return model, 1
    if isinstance(model, Network):
        return Setup(model), 1
    raise InputRefused(
        f"{type(model).__name__} cannot be exported: a model of phnn modes is a network first: "
        "export phnn.load(MODEL).to_network() from Python"
    )


def _check(wanted: Wanted, setup: Setup) -> None:
    """Refuse settings that no program can have."""
    if wanted.to not in TARGETS:
        raise InputRefused(f"to: {wanted.to!r} is no target: choose one of {', '.join(TARGETS)}")
    if wanted.hold not in HOLDS:
        raise InputRefused(f"input: {wanted.hold!r} between samples is not exported: choose {' or '.join(HOLDS)}")
    # Below the least normal number, a share of it or its reciprocal is lost.
    if not sys.float_info.min <= wanted.dt < math.inf:
        raise InputRefused(f"dt: {wanted.dt:g} s is no sample time: give a positive, finite one")
    if not math.isfinite(wanted.initial_input):
        raise InputRefused(f"initial_input: {wanted.initial_input:g}: give a finite number")
    if wanted.substeps is not None and not 1 <= wanted.substeps <= LIMITS.substeps:
        raise InputRefused(f"substeps: {wanted.substeps}: give 1 to {LIMITS.substeps}")
    _check_ports(wanted.ports, setup)


def _check_ports(ports: Sequence[str], setup: Setup) -> None:
    known = [p.name for p in setup.network.ports[1:]]
    for port in ports:
        if port not in known:
            raise InputRefused(f"ports: the network has no further port {port!r}; it has {', '.join(known) or 'none'}")
