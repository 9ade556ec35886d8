"""Exported programs run against `phnn.trajectory`, in C and in Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phnn.exporting.build import Builder, Hold
from phnn.exporting.c import c_header, c_source
from phnn.exporting.program import Program
from phnn.exporting.write import python
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.trajectory import simulate

COMPILER = shutil.which("cc") or shutil.which("gcc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler is installed")
FLAGS = ("-Wall", "-Werror", "-std=c99", "-O2")

_LOOP = """
#include "{name}.h"
#include <string.h>
int run(long n, const double *u, double *y);
int run(long n, const double *u, double *y) {{
    {name}_state s;
    memset(&s, {fill}, sizeof s);
    {name}_init(&s, u[0]);
    y[0] = {name}_output(&s);
    for (long k = 1; k < n; k++)
        if (!{name}_step(&s, u[k - {late}], &y[k])) return (int)k;
    return 0;
}}
"""


def reference(setup: Setup, t: np.ndarray, u: np.ndarray, substeps: int, hold: Hold = "linear") -> np.ndarray:
    """(N,) output of `phnn.trajectory` with the input joined or held between the samples."""
    return simulate(setup, replace(unrecorded("drive", t, u, input_before=float(u[0])), interpolation=hold), substeps).y


def in_c(program: Program, u: np.ndarray, folder: Path, fill: int = 0x55) -> np.ndarray:
    """(N,) output of the compiled program, whose state lies in memory filled with a byte."""
    name = program.name
    late = 0 if program.hold == "linear" else 1
    (folder / f"{name}.h").write_text(c_header(program), "utf-8")
    (folder / f"{name}.c").write_text(c_source(program), "utf-8")
    (folder / "loop.c").write_text(_LOOP.format(name=name, late=late, fill=fill), "utf-8")
    library = folder / "loop.so"
    assert COMPILER is not None
    files = [str(folder / f"{name}.c"), str(folder / "loop.c")]
    subprocess.run([COMPILER, *FLAGS, "-shared", "-fPIC", *files, "-o", str(library), "-lm"], check=True)
    run = ctypes.CDLL(str(library)).run
    pointer = ctypes.POINTER(ctypes.c_double)
    run.argtypes = [ctypes.c_long, pointer, pointer]
    given, y = np.ascontiguousarray(u), np.full(u.size, np.nan)
    failed = run(u.size, given.ctypes.data_as(pointer), y.ctypes.data_as(pointer))
    assert failed == 0, f"step {failed} has no solution"
    return y


def in_python(program: Program, u: np.ndarray) -> np.ndarray:
    """(N,) output of the program in Python."""
    scope: dict = {}
    exec(compile(python(program), program.name, "exec"), scope)
    model = scope["Model"](float(u[0]))
    late = 0 if program.hold == "linear" else 1
    return np.array([model.output, *(model.step(float(u[k - late])) for k in range(1, u.size))])


def apart(found: np.ndarray, wanted: np.ndarray) -> float:
    """Largest difference as a share of the range of what is wanted."""
    return float(np.abs(found - wanted).max() / np.ptp(wanted))


def exported(
    setup: Setup, t: np.ndarray, substeps: int, hold: Hold = "linear", name: str = "model", initial: float = 0.0
) -> Program:
    """The program of a setup at the sample time of a drive."""
    return Builder(setup, float(t[1] - t[0]), substeps, hold, name, ()).program(initial)
