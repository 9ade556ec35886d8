"""The tables of a page in docs/, and whether they state the figures of a run.

The first cell of a row and the head of a column name a figure. Rows whose name begins with "published" quote the
literature.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[2] / "docs"
QUOTED = "published"
# A figure on a page may differ by this share from that of a run, for an optimiser stops within its tolerance; or by
# half a unit of its last digit, because it is rounded.
TOLERANCE, ROUNDED = 0.02, 0.501

_NUMBER = re.compile(r"[−-]?\d+(?:\.\d+)?")
_RULE = re.compile(r"^[|\s:-]+$")


def stated(page: Path) -> Iterator[tuple[str, str, str]]:
    """Row, column and text of every cell that states a figure."""
    heads: list[str] = []
    for line in page.read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            heads = []
            continue
        cells = [c.strip().strip("*") for c in line.strip().strip("|").split("|")]
        if not heads:
            heads = cells
        elif not _RULE.match(line) and not cells[0].startswith(QUOTED):
            yield from ((cells[0], head, c) for head, c in zip(heads[1:], cells[1:], strict=True) if c not in ("", "–"))


def differences(page: Path, figures: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What a page states otherwise than a run, in words; every cell has to be a figure of the run."""
    found = []
    for row, column, text in stated(page):
        run = figures.get(row, {}).get(column)
        if run is None:
            found.append(f"{row}, {column}: the page states {text!r}, the study has no such figure")
        elif not agrees(text, run):
            found.append(f"{row}, {column}: the page states {text!r}, the study gives {run!r}")
    return found


def agrees(text: str, run: Any) -> bool:
    """Whether a cell states a number, a number with its standard error, or a word of a run."""
    if isinstance(run, str):
        return text == run
    values = list(run) if isinstance(run, list | tuple) else [run]
    numbers = [Decimal(n.replace("−", "-")) for n in _NUMBER.findall(text)]
    return len(numbers) == len(values) and all(_near(n, float(v)) for n, v in zip(numbers, values, strict=True))


def _near(number: Decimal, value: float) -> bool:
    exponent = number.as_tuple().exponent
    unit = 10.0 ** int(exponent) if isinstance(exponent, int) else math.nan
    return abs(float(number) - value) <= max(ROUNDED * unit, TOLERANCE * abs(value))
