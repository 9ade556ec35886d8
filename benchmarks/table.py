"""Timing, and what is written: the table on the terminal, the CSV and the picture."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

Array = NDArray[np.float64]

RESULTS = Path(__file__).parent / "results"
COLUMNS = ("solver", "target_error", "measured_error", "median_s", "ratio_to_phnn")


@dataclass(frozen=True)
class Contender:
    """One way to solve the case.

    Attributes:
        solver: its name in the table.
        target_error: what was asked of it, relative.
        solve: does the work and returns what is compared with the truth.
        repeats: in how many rounds it takes part; fewer for the slow.
    """

    solver: str
    target_error: float
    solve: Callable[[], Array]
    repeats: int = 15


@dataclass(frozen=True)
class Row:
    """One line of the table; ``ratio_to_phnn`` is how many times longer it takes than the compiled solver."""

    solver: str
    target_error: float
    measured_error: float
    median_s: float
    ratio_to_phnn: float


def relative_error(value: Array, truth: Array) -> float:
    """``‖value − truth‖ / ‖truth‖``."""
    return float(np.linalg.norm(value - truth) / np.linalg.norm(truth))


def measure(contenders: Sequence[Contender], truth: Array) -> list[Row]:
    """Errors and median times; the ratios are to the first contender.

    Everybody is run once to compile and to measure the error. Then all take turns, so that a busy machine
    slows them alike.
    """
    errors = [relative_error(c.solve(), truth) for c in contenders]
    seconds: list[list[float]] = [[] for _ in contenders]
    for turn in range(max(c.repeats for c in contenders)):
        for own, contender in zip(seconds, contenders, strict=True):
            if turn < contender.repeats:
                begin = time.perf_counter()
                contender.solve()
                own.append(time.perf_counter() - begin)
    medians = [float(np.median(own)) for own in seconds]
    return [
        Row(c.solver, c.target_error, e, s, s / medians[0]) for c, e, s in zip(contenders, errors, medians, strict=True)
    ]


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """The rows under the columns `COLUMNS`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame([[getattr(row, c) for c in COLUMNS] for row in rows], columns=list(COLUMNS))
    table.to_csv(path, index=False, float_format="%.6g")


def show(rows: Sequence[Row], title: str) -> None:
    """The rows as a table on the terminal."""
    table = Table(title=title, title_justify="left")
    table.add_column("solver", no_wrap=True)
    for heading in ("asked", "measured error", "median ms", "× phnn"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            row.solver,
            f"{row.target_error:.0e}",
            f"{row.measured_error:.1e}",
            f"{1e3 * row.median_s:.2f}",
            f"{row.ratio_to_phnn:.2f}",
        )
    Console(width=110).print(table)


def picture(rows: Sequence[Row], path: Path, title: str) -> None:
    """Time against measured error, a line for each family of solvers (the name up to the comma)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for family in dict.fromkeys(row.solver.split(",")[0] for row in rows):
        own = sorted((r.measured_error, r.median_s) for r in rows if r.solver.split(",")[0] == family)
        errors, seconds = np.array(own).T
        axes.loglog(errors, 1e3 * seconds, marker="o", label=family, lw=2.5 if family == "phnn" else 1.2)
    axes.set(xlabel="measured relative error", ylabel="median time [ms]", title=title)
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
