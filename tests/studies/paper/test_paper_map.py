"""docs/paper.md: complete, and what it points to exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from studies.paper.published import TABLE_3, highest_fit, implied_amplitude

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ") and line.count("|") == 4]


def numbers(pattern: str) -> set[int]:
    """Numbers that first columns name, ranges included: ``(3)–(6)``, ``Figs. 10–12``, ``Figs. 2, 3``."""
    found: set[int] = set()
    for row in ROWS:
        first = row.split("|")[1]
        for match in re.finditer(pattern, first):
            digits = [int(d) for d in re.findall(r"\d+", match.group())]
            found |= set(range(digits[0], digits[-1] + 1)) if "–" in match.group() else set(digits)
    return found


def test_every_equation_figure_and_table_has_a_row() -> None:
    assert numbers(r"\(\d+\)(?:(?:–|, )\(\d+\))?") == set(range(1, 20))
    assert numbers(r"Figs?\. \d+(?:(?:–|, )\d+)?") == set(range(1, 16))
    assert numbers(r"Table \d") == {1, 2, 3}
    firsts = " ".join(row.split("|")[1] for row in ROWS)
    assert all(part in firsts for part in ("Prop. 1", "2.4.1", "2.4.2", "2.4.3", "2.4.4"))


@pytest.mark.parametrize("row", [row for row in ROWS if "in preparation" not in row])
def test_what_a_row_names_exists(row: str) -> None:
    for name in re.findall(r"`((?:phnn|tests|docs|configs|scripts)/[^`]+)`", row):
        path, _, test = name.partition("::")
        assert (ROOT / path).is_file(), name
        assert not test or f"def {test}(" in (ROOT / path).read_text(encoding="utf-8"), name


def test_amplitudes_are_those_of_table_3() -> None:
    rows = re.findall(r"\| (\d+ Hz) \| ([\d.]+) µm \| ([\d.]+) µm \| ([\d.]+) \| ([\d.]+) % \| ([\d.]+) % \|", PAGE)
    assert len(rows) == 7
    for line, recorded, model, ratio, highest, fit in rows:
        printed = TABLE_3[line]
        implied = 1e6 * implied_amplitude(printed.phs_fit, printed.phs_rmse)
        assert float(fit) == printed.phs_fit
        assert float(recorded) == pytest.approx(implied, abs=0.051)
        assert float(ratio) == pytest.approx(implied / float(model), abs=1e-3)
        assert float(highest) == pytest.approx(highest_fit(implied, float(model)), abs=0.1)
