"""The files that each target makes of a program: names and contents."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from phnn.exporting.c import c_header, c_source
from phnn.exporting.program import Program
from phnn.exporting.python import python

Files = Mapping[str, bytes]


def c_files(program: Program) -> Files:
    """A header and a source of C99."""
    return {f"{program.name}.h": c_header(program).encode(), f"{program.name}.c": c_source(program).encode()}


def python_files(program: Program) -> Files:
    """One module."""
    return {f"{program.name}.py": python(program).encode()}


def matlab_files(program: Program) -> Files:
    """Functions that initialise and step, and one for a MATLAB Function block of Simulink."""
    from phnn.exporting.matlab import matlab

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
