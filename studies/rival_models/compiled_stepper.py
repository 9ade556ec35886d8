"""A port-Hamiltonian model sample by sample, as the C program of `phnn export` after a compiler."""

from __future__ import annotations

import ctypes
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from phnn.exporting import Wanted
from phnn.exporting.c import c_header, c_source
from phnn.exporting.fmu import compiled
from phnn.exporting.write import program_of
from phnn.model import Model
from studies.rival_models.loops import ExportedStepper, settling
from studies.rival_models.rival import State, Stepper

Array = NDArray[np.float64]

_NAME = "stepped"
# A state is handed over as 64-bit words, which are aligned like the structure that they hold.
_LOOP = f"""
#include "{_NAME}.h"
#include <string.h>
#define VISIBLE __attribute__((visibility("default")))
VISIBLE long words(void) {{ return (long)((sizeof({_NAME}_state) + 7) / 8); }}
VISIBLE void begin({_NAME}_state *s) {{
    memset(s, 0, sizeof *s);
    {_NAME}_init(s, 0.0);
}}
VISIBLE long run({_NAME}_state *s, long n, const double *u, double *y) {{
    for (long k = 0; k < n; k++)
        if (!{_NAME}_step(s, u[k], &y[k])) return k;
    return n;
}}
"""


class CompiledStepper(Stepper):
    """The C program of a model; a state is an array that holds the program's structure.

    Args:
        library: a shared library with the program and the loop over samples.
        dt: sampling interval, s.
    """

    def __init__(self, library: bytes, dt: float) -> None:
        self.dt = dt
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"{_NAME}.so"
            path.write_bytes(library)
            self._library = ctypes.CDLL(str(path))
        pointer = ctypes.POINTER(ctypes.c_double)
        self._library.words.restype = self._library.run.restype = ctypes.c_long
        self._library.begin.argtypes = [pointer]
        self._library.run.argtypes = [pointer, ctypes.c_long, pointer, pointer]

    def rest(self, u: float) -> State:
        state = np.zeros(self._library.words())
        self._library.begin(_pointer(state))
        return self.run(state, np.full(settling(self.dt), u))[0]

    def step(self, state: State, u: float) -> tuple[State, float]:
        state, y = self.run(state, np.array([u]))
        return state, float(y[0])

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        """Step through many samples; see `Stepper.run`.

        Raises:
            ArithmeticError: a step has no solution.
        """
        state, u, y = state.copy(), np.ascontiguousarray(u, dtype=np.float64), np.empty(u.size)
        done = self._library.run(_pointer(state), u.size, _pointer(u), _pointer(y))
        if done < u.size:
            raise ArithmeticError(f"sample {done} of {u.size}: a step has no solution: is the input finite?")
        return state, y


def _pointer(values: Array) -> object:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def compiled_stepper(model: Model, dt: float) -> Stepper:
    """The model compiled from C; the exported Python program, some hundred times slower, where nothing compiles.

    Args:
        model: to export; dt: sampling interval, s.

    Raises:
        InputRefused: the model cannot be exported.
        OutputFailed: the compiler does not accept the program.
    """
    program = program_of(model, Wanted("c", dt=dt, name=_NAME))
    sources = {f"{_NAME}.h": c_header(program), f"{_NAME}.c": c_source(program), "loop.c": _LOOP}
    library = compiled(_NAME, sources)
    return ExportedStepper(model, dt) if library is None else CompiledStepper(library, dt)
