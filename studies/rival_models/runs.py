"""Models in a closed loop with a compliant load.

A spring of stiffness ``k_L`` between the moving mass and a fixed frame pulls with ``−k_L q``, which a model from
voltage to displacement feels as the voltage ``−(k_L/α) q``. At every sample the loop is closed without delay,

    u_n = v_n − (k_L/α) y_n,        y_n = model(state, u_n)

solved for ``u_n`` by secants. A passive actuator with this spring is passive: once the voltage rests at zero, what
moves decays (van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, Ch. 2). All runs
begin at rest under another voltage than that at which the drive begins: a wrong initial state.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.comparison.models import Settings
from phnn.errors import InputRefused, OutputFailed, PhnnError, SolverFailed
from phnn.exporting.c import c_header, c_source
from phnn.exporting.write import compiled, program_of
from phnn.identification.base import Progress, quiet
from phnn.identification.identified import identify
from phnn.model import Model
from phnn.recordings import read
from phnn.report.formatting import markdown_table
from phnn.results import Place
from studies.generator.plans import PEAK
from studies.recordings import PHS, base_of, comparison_plan, write_truth
from studies.rival_models.names import HEADS, NAMES, rival
from studies.rival_models.rival import State, Stepper

Array = NDArray[np.float64]

DT = 1e-4  # sampling interval of models that take any, s
_SECANTS, _CLOSE, _TONES = 25, 1e-9, 3
_LENGTH, _HIGHEST_HZ = 0.4, 150.0  # of a run in a loop, s; of its drive
# A run has diverged where the output exceeds the largest static one by this factor.
FAR = 10.0
# Growth of the motion at rest, from the third quarter of a run to the fourth, that no decay has; and the least share of
# the largest output that counts as motion.
GROWS, MOVES = 1.05, 1e-3
# What a model that has diverged may raise.
FAILS = (PhnnError, ArithmeticError, ValueError)
_NAME, _REST = "stepped", 0.1  # of the compiled program; seconds of constant voltage before a rest ends
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
    """The C program of `phnn export` after a compiler; a state is an array that holds the program's structure.

    Args:
        model: to export; dt: sampling interval, s.

    Raises:
        InputRefused: the model cannot be exported.
        OutputFailed: there is no compiler, or it does not accept the program.
    """

    def __init__(self, model: Model, dt: float) -> None:
        program = program_of(model, "c", dt=dt, name=_NAME)
        sources = {f"{_NAME}.h": c_header(program), f"{_NAME}.c": c_source(program), "loop.c": _LOOP}
        library = compiled(_NAME, sources)
        if library is None:
            raise OutputFailed("the model cannot be stepped: install a C compiler (cc) on Linux on 64 bits")
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
        return self.run(state, np.full(max(1, round(_REST / self.dt)), u))[0]

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        """Step through many samples; see `Stepper.run`. Raises ArithmeticError where a step has no solution."""
        state, u, y = state.copy(), np.ascontiguousarray(u, dtype=np.float64), np.empty(u.size)
        done = self._library.run(_pointer(state), u.size, _pointer(u), _pointer(y))
        if done < u.size:
            raise ArithmeticError(f"sample {done} of {u.size}: a step has no solution: is the input finite?")
        return state, y


def _pointer(values: Array) -> object:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@dataclass(frozen=True)
class Loop:
    """What one run in a loop is given: the voltage (N,) [V], the input before it [V], and ``k_L/α`` [V/m]."""

    v: Array
    before: float
    pull: float


def drawn_loops(
    count: int, times: tuple[float, float], peak: float, highest_Hz: float, stiffness: float, seed: int
) -> list[Loop]:
    """Draw voltages of three sines from the decade below a frequency for half of each run, then zero.

    Args:
        times: length of a run and sampling interval, s.
        peak: largest voltage, V.
        stiffness: ``k/α`` of the actuator, V/m; the load has between a tenth and three times of it.
        seed: of all draws.
    """
    rng, drawn = np.random.default_rng(seed), []
    t = np.arange(round(times[0] / times[1])) * times[1]
    for _ in range(count):
        tones = highest_Hz * 10.0 ** -rng.uniform(0.0, 1.0, _TONES)
        v = np.sin(2.0 * np.pi * np.outer(t, tones) + rng.uniform(0.0, 2.0 * np.pi, _TONES)) @ rng.normal(size=_TONES)
        v *= peak * rng.uniform(0.1, 1.0) / np.abs(v).max()
        v[t.size // 2 :] = 0.0
        drawn.append(Loop(v, float(rng.uniform(-peak, peak)), 0.1 * 30.0 ** rng.uniform() * stiffness))
    return drawn


@dataclass(frozen=True)
class Counts:
    """What became of loops.

    Attributes:
        runs: how many; diverged: left the finite numbers or ten times the largest static output; unsolved: loop
            equation without a solution at some sample, counted among the diverged; gained: did not diverge, and moved
            more in the last quarter than in the one before, both without drive.
    """

    runs: int = 0
    diverged: int = 0
    unsolved: int = 0
    gained: int = 0


def closed(stepper: Stepper, runs: Sequence[Loop], gain: float) -> Counts:
    """Close the loop around a model.

    Args:
        gain: static displacement per volt of the actuator, m/V.
    """
    diverged = gained = unsolved = 0
    for run in runs:
        y, solved = closed_path(stepper, run, FAR * gain * max(float(np.abs(run.v).max()), abs(run.before)))
        if not solved or y.size < run.v.size:
            diverged += 1
            unsolved += not solved
        else:
            rest = y[y.size // 2 :] - y[-1]
            third, fourth = (float(np.sqrt(np.mean(part**2))) for part in np.array_split(rest, 2))
            gained += fourth > GROWS * third and fourth > MOVES * float(np.abs(y).max())
    return Counts(len(runs), diverged, unsolved, gained)


def closed_path(stepper: Stepper, run: Loop, far: float) -> tuple[Array, bool]:
    """Return the output until the end or until it is too far away, and whether every sample had a solution."""
    state, y = stepper.rest(run.before), np.empty(run.v.size)
    u = run.before
    for n, v in enumerate(run.v):
        try:
            solution = _solved(partial(stepper.step, state), float(v), run.pull, u)
        except FAILS:
            return y[:n], False
        if solution is None:
            return y[:n], False
        state, u, y[n] = solution
        if not abs(y[n]) < far:
            return y[:n], True
    return y, True


def _solved(
    step: Callable[[float], tuple[State, float]], v: float, pull: float, guess: float
) -> tuple[State, float, float] | None:
    """Return state, input and output with ``u = v − pull y(u)``; None where secants find none."""
    scale = abs(v) + abs(guess) + 1.0
    a, b = guess, guess - 1e-3 * scale
    error_a = a - v + pull * step(a)[1]
    for _ in range(_SECANTS):
        after, y = step(b)
        error_b = b - v + pull * y
        if not np.isfinite(error_b):
            return None
        if abs(error_b) <= _CLOSE * scale:
            return after, b, y
        slope = (error_b - error_a) / (b - a) if b != a else 1.0
        a, error_a = b, error_b
        b -= error_b / (slope or 1.0)
    return None


def loops(
    place: Place, settings: Settings, seeds: Sequence[int], noise_um: float, runs: int, progress: Progress = quiet
) -> pd.DataFrame:
    """Close the loop around each model of the paper's actuator; write ``loops.csv`` and ``loops.md``.

    Models that are neither ``phs`` nor a rival are left out: they have no form that takes single samples. A model that
    was not fitted or cannot be stepped has a row with the reason in ``why``.

    Raises:
        InputRefused: no model is left.
        SolverFailed: the actuator could not be simulated.
    """

    models = [m for m in settings.models if m in (PHS, *NAMES)]
    if not models:
        raise InputRefused(f"models: none of {', '.join(settings.models)} takes single samples: name {PHS} or a rival")
    began, rows = time.process_time(), list[dict[str, Any]]()
    for seed in seeds:
        folder = (place / f"{PHS}_{seed}" / "recordings").own_folder()
        write_truth(folder, PHS, seed, comparison_plan(), noise_um)
        campaign = read(folder)
        for model in models:
            progress(f"seed {seed}: {model}")
            row: dict[str, Any] = {"seed": seed, "model": model, "dt_s": math.nan, "why": ""}
            stiffness = base_of(seed)["k"] / base_of(seed)["alpha"]
            try:
                if model == PHS:
                    own = identify(None, campaign, replace(settings.options, seed=seed, workers=1)).model
                    stepper: Stepper = CompiledStepper(own, DT)
                else:
                    fitted = rival(model).fit(campaign.recordings, settings.budget, seed)
                    stepper = fitted.stepper(fitted.dt or DT)
                drawn = drawn_loops(runs, (_LENGTH, stepper.dt), PEAK, _HIGHEST_HZ, stiffness, seed)
                rows.append(row | {"dt_s": stepper.dt} | asdict(closed(stepper, drawn, 1.0 / stiffness)))
            except (SolverFailed, OutputFailed) as error:
                rows.append(row | {"why": str(error)})
            table, spent = pd.DataFrame(rows), f"{time.process_time() - began:.0f} processor seconds"
            (place / "loops.csv").write(table.to_csv(index=False).encode())
            (place / "loops.md").write(loops_page(table, settings, spent).encode())
    return pd.DataFrame(rows)


def loops_page(table: pd.DataFrame, settings: Settings, spent: str) -> str:
    """Return the page of counts by model."""
    counts = list(asdict(Counts()))
    sums = table.reindex(columns=["model", *counts]).groupby("model", sort=False)[counts].sum()
    body = [[HEADS[str(model)], *(f"{x:.0f}" for x in row)] for model, row in zip(sums.index, sums.values, strict=True)]
    listed = ", ".join(str(s) for s in dict.fromkeys(table["seed"]))
    words = (
        f"Each model was fitted to four recordings of the paper's actuator (seeds {listed}; {settings.budget:g} "
        "processor seconds for each rival) and then met a spring of a tenth to three times the "
        f"actuator's stiffness. Runs of {_LENGTH:g} s, from rest under another voltage than that at which the drive "
        f"begins; {spent}."
    )
    heads = ["model", "runs", "diverged", "of these without a solution", "moved more after the drive"]
    return "\n".join(["# Models in a loop with a compliant load", "", words, "", *markdown_table(heads, body), ""])
