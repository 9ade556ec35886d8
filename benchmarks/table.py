"""Timing in turns, and what is written: the table on the terminal, the CSV, the picture, the machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from benchmarks.case import Array, Solve

RESULTS = Path(__file__).parent / "results"
ROUNDS = 25
# A run this short [s] is made once more before it is timed: what others did to the caches is not its own time.
_SHORT = 0.1
_PACKAGES = ("numba", "scipy", "torch", "torchdiffeq", "jax", "diffrax", "optimistix")


@dataclass(frozen=True)
class Contender:
    """One line of a table, before it is timed.

    Attributes:
        case: what is solved; the first contender of a case and target is what the others are compared with.
        target: relative error asked for.
        solver, setting: names in the table.
        error: measured relative error of what was matched; where nothing met the target, the least that was reached.
        solve: does the work; None where the target was not met.
        warm: it has run before, so that nothing is left to compile and its first run tells how long it takes.
    """

    case: str
    target: float
    solver: str
    setting: str
    error: float
    solve: Solve | None
    warm: bool = False


def timed(contenders: Sequence[Contender], budget: float = 4.0) -> tuple[list[float], list[Array | None]]:
    """Median times [s] (NaN where there is nothing to run) and values.

    Who may have to compile runs once before. Then all are judged, and take turns, so that a busy machine slows them
    alike; the slow take part in every few rounds only.

    Args:
        budget: seconds for the rounds of one contender.
    """
    values: list[Array | None] = [None] * len(contenders)
    seconds: list[list[float]] = [[] for _ in contenders]
    parts, short = [0] * len(contenders), [False] * len(contenders)
    for i, contender in enumerate(contenders):
        if contender.solve is not None:
            if not contender.warm:
                contender.solve()
            judged, values[i] = _run(contender.solve)
            short[i] = judged < _SHORT
            parts[i] = min(int(budget / judged), ROUNDS)
            # Nobody goes untimed: who has used up the budget has been timed by that.
            seconds[i] += [judged] if parts[i] == 0 else []
    for turn in range(ROUNDS):
        for i, contender in enumerate(contenders):
            # Spread over the rounds: `parts` of them in all.
            if contender.solve is not None and (turn + 1) * parts[i] // ROUNDS > turn * parts[i] // ROUNDS:
                if short[i]:
                    contender.solve()
                seconds[i].append(_run(contender.solve)[0])
    return [float(np.median(own)) if own else float("nan") for own in seconds], values


def _run(solve: Solve) -> tuple[float, Array]:
    begin = time.perf_counter()
    value = solve()
    return time.perf_counter() - begin, value


def rows(contenders: Sequence[Contender], seconds: Sequence[float]) -> pd.DataFrame:
    """The table: what was asked, what was reached, how long it took, and how many times longer than the first."""
    base: dict[tuple[str, float], float] = {}
    for contender, own in zip(contenders, seconds, strict=True):
        base.setdefault((contender.case, contender.target), own)
    return pd.DataFrame(
        {
            "case": [c.case for c in contenders],
            "target": [c.target for c in contenders],
            "solver": [c.solver for c in contenders],
            "setting": [c.setting for c in contenders],
            "error": [c.error for c in contenders],
            "seconds": list(seconds),
            "ratio": [s / base[c.case, c.target] for c, s in zip(contenders, seconds, strict=True)],
        }
    )


def text(column: str, value: object) -> str:
    """One cell for the terminal."""
    if not isinstance(value, float):
        return str(value)
    if not np.isfinite(value):
        return "not reached" if column == "seconds" else "-"
    formats = {"target": "{:.0e}", "seconds": "{:.4g}", "ratio": "{:.3g}", "cost": "{:.6g}"}
    formats |= dict.fromkeys(("slope", "slope_of_the_large"), "{:.3f}")
    return formats.get(column, "{:.2g}").format(value)


def show(table: pd.DataFrame, title: str) -> None:
    """A table on the terminal, a line between targets."""
    shown = Table(title=title, title_justify="left")
    for name in table.columns:
        shown.add_column(name, justify="left" if name in ("case", "solver", "setting") else "right", no_wrap=True)
    before = None
    for _, row in table.iterrows():
        if "target" in table and before not in (None, row["target"]):
            shown.add_section()
        before = row.get("target")
        shown.add_row(*(text(name, row[name]) for name in table.columns))
    Console(width=150).print(shown)


def write_csv(table: pd.DataFrame, path: Path) -> None:
    """The table as it is, six digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.6g")


def picture(table: pd.DataFrame, path: Path, title: str) -> None:
    """Time against the measured error, a line for each solver of the first case."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.8), layout="constrained")
    axes = figure.subplots()
    met = table[(table["case"] == table["case"].iloc[0]) & table["seconds"].notna()]
    for solver, own in met.groupby("solver", sort=False):
        ordered = own.sort_values("error")
        axes.loglog(ordered["error"], ordered["seconds"], marker="o", label=solver, lw=2.5 if "phnn" in solver else 1.2)
    axes.set(xlabel="relative error of the worst recording", ylabel="median time [s]", title=title)
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(fontsize=8)
    save(figure, path)


def save(figure: object, path: Path) -> None:
    """A figure as a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)  # type: ignore[attr-defined]


def goal(what: str, measured: float, least: float) -> None:
    """One line: a ratio and whether it meets its goal."""
    print(f"{what}: {measured:.3g} x (goal {least:g} x: {'met' if measured >= least else 'NOT met'})")


def machine() -> str:
    """Processor, system and versions, in one line."""
    names = Path("/proc/cpuinfo")
    lines = names.read_text(encoding="utf-8").splitlines() if names.exists() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())
    found = []
    for package in _PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"no {package}")
    return (
        f"{model}, {os.cpu_count()} processors, {platform.system()}, Python {platform.python_version()}, "
        + ", ".join(found)
    )
