"""Put the figures of the last run into the documentation.

    python -m benchmarks.document

What stands between the two marks in ``docs/benchmarks.md`` is replaced by tables made from ``results/*.csv``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from benchmarks.table import RESULTS, machine, text
from studies.results import fill, stamped

PAGE = Path(__file__).parent.parent / "docs" / "benchmarks.md"


def markdown(table: pd.DataFrame) -> str:
    """A table in markdown, numbers to the right."""
    cells = [[text(name, row[name]) for name in table.columns] for _, row in table.iterrows()]
    rule = ["---:" if is_numeric_dtype(kind) else "---" for kind in table.dtypes]
    return "\n".join(f"| {' | '.join(line)} |" for line in ([str(c) for c in table.columns], rule, *cells))


def by_target(table: pd.DataFrame) -> pd.DataFrame:
    """One line for each solver, its time and ratio under every target."""
    targets = sorted(table["target"].unique(), reverse=True)
    lines = []
    for solver, own in table.groupby("solver", sort=False):
        cells = {t: _cell(line) for t, (_, line) in zip(own["target"], own.iterrows(), strict=True)}
        lines.append([solver, *(cells.get(t, "") for t in targets)])
    return pd.DataFrame(lines, columns=["solver", *(f"{t:.0e}" for t in targets)])


def _cell(line: pd.Series) -> str:
    if not np.isfinite(line["seconds"]):
        return f"not reached ({line['error']:.0e})"
    ratio = f"{line['ratio']:.3g}" if line["ratio"] < 1e3 else f"{line['ratio']:,.0f}"
    beside = f"; {line['gradient_error']:.0e}" if "gradient_error" in line else ""
    return f"{_duration(line['seconds'])} ({ratio}×{beside})"


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 0.9995 else f"{seconds:.3g} s"


def sections() -> Iterator[str]:
    """The measured part of the page, paragraph by paragraph."""
    yield f"Measured on: {machine()}."
    for name, what, beside in (
        ("forward", "Displacements", ""),
        ("gradient", "Gradients by ten parameters", "; error of the gradient"),
    ):
        for case, own in pd.read_csv(RESULTS / f"{name}.csv").groupby("case", sort=False):
            yield f"{what}, {case}: time (ratio to the first line{beside}) by target"
            yield markdown(by_target(own))
    yield "Identification of nine parameters (excess: final cost over the least, minus one)"
    identified = pd.read_csv(RESULTS / "identify.csv")
    yield markdown(identified[["solver", "seconds", "first_call", "ratio", "excess"]])
    yield "Growth: slopes of log time against log size"
    yield markdown(pd.read_csv(RESULTS / "slopes.csv"))
    memory = pd.read_csv(RESULTS / "memory.csv").iloc[0]
    yield f"Peak memory of forward and gradient at {memory['samples']:,.0f} samples: {memory['peak_GiB']:.2f} GiB."
    yield "Rules for a reducible storage, one step in the general kernel: time and relative errors by sub-steps"
    yield markdown(pd.read_csv(RESULTS / "leaves.csv"))
    yield "A fresh process, without and with compiled code in the cache"
    yield markdown(pd.read_csv(RESULTS / "startup.csv"))


def main() -> int:
    """Rewrite the page."""
    fill(PAGE, "measured", stamped("\n\n".join(sections())))
    return 0


if __name__ == "__main__":
    sys.exit(main())
