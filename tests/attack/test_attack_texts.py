"""Hostile text recordings: bytes, shapes and numbers that no instrument writes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from attack_tools import HEADER, Attack, csv, each, put, quick, table

ROWS = csv().splitlines()
NUMBERS = [
    "nan", "inf", "9" * 400, "1e999999999", "1e-999999999", "1e-320", "1e308", "0x1p3", "1_000", "1/2", "2001-12-14",
    "__import__('os').system('touch ran')", "=cmd|'/c calc'!A0", '"', '""', "", " ", "50%", "\u0661\u0662", "\uff11",
    "\u22125", "1j", "True", "\0", "\x1b[31m5", "1\r2", "1\f2", "1\u20282", "x" * 90_000, "\ud800",
]  # fmt: skip
COLUMN = {"time": 0, "voltage": 1, "displacement": 2}


def cell(row: int, column: int, text: str) -> str:
    rows = list(ROWS)
    cells = rows[row + 1].split(",")
    cells[column] = text
    rows[row + 1] = ",".join(cells)
    return "\n".join(rows) + "\n"


def scaled(factors: tuple[float, float, float]) -> str:
    return csv(table() * np.array(factors))


def along(u: np.ndarray) -> str:
    """A recording whose output follows its input at once."""
    return csv(np.column_stack([table()[:, 0], u, 1e-6 * u]))


WHOLE: list[Callable[[], str | bytes]] = [
    lambda: "", lambda: np.random.default_rng(0).bytes(10_000), lambda: HEADER, lambda: "\n".join(ROWS[:2]),
    lambda: csv().encode("utf-16")[:-1], lambda: csv(header="time_s,voltage_V,displacement_\xb5m").encode("latin-1"),
    lambda: csv().encode() + b"\xff\xfe", lambda: ",".join("1" for _ in range(10**6)), lambda: "1" * 10**6,
    lambda: "\n".join(",".join("1" * 2000) for _ in range(100)),
    lambda: "\n".join([",".join("1" for _ in range(50_000))] * 20), lambda: "1\n" * 500_000,
    lambda: HEADER + "\n" * 500_000,
    lambda: ",".join(f"voltage_{i}_V" for i in range(500)) + "\n" + "\n".join([",".join("1" * 500)] * 60),
    lambda: "\n".join(",".join("1" * i) for i in range(1, 300)), lambda: csv().replace(",", '","'),
    lambda: csv().replace(",", ',"', 1), lambda: csv(header="\x1b[31mtime_s,voltage_V,displacement_m"),
    lambda: csv(header="time_s,voltage_V,displacement_m,\x9b31m").encode("latin-1").replace(b"\n", b",1\n")[:-2],
    lambda: csv(header="time_s,voltage_V,\u202edisplacement_m"),
    lambda: csv(header=",".join("x" * 30_000 for _ in range(3))), lambda: "# a\n" * 50_000 + csv(),
    lambda: "word " * 10_000 + "\n" + csv(), lambda: "import os\nos.system('touch ran')\n",
    lambda: b"\x80\x04\x95cos\nsystem\n(S'touch ran'\ntR.", lambda: b"\x1f\x8b\x08\0" + bytes(100),
    lambda: csv(np.ones((120, 3))), lambda: csv(np.column_stack([np.zeros(120), table()[:, 1:]])),
    lambda: scaled((1e-320, 1, 1)), lambda: scaled((1e-200, 1, 1)), lambda: scaled((1e25, 1, 1)),
    lambda: scaled((1, 1e-310, 1)), lambda: scaled((1, 1e27, 1)), lambda: scaled((1, 1, 1e33)),
    lambda: scaled((1, 1, 1e-300)), lambda: scaled((1e-290,) * 3), lambda: csv(table() + np.array([1e15, 0, 0])),
    lambda: csv(table() - np.array([1e3, 0, 0])), lambda: csv(table() + np.array([0, 1e15, 0])),
    lambda: csv(table() + np.array([0, 0, 1e12])), lambda: along(np.arange(120) >= 60),
    lambda: along((-1.0) ** np.arange(120)), lambda: csv(table() * np.array([1, 0, 0]) + np.eye(120, 3)[::-1] * 1e-6),
]  # fmt: skip


@pytest.mark.parametrize("case", range(len(WHOLE)))
@pytest.mark.parametrize("suffix", quick([".csv"], ".txt"))
def test_any_text(case: int, suffix: str, attack: Attack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    put(tmp_path / "data" / f"a{suffix}", WHOLE[case]())
    attack(tmp_path / "data")


@pytest.mark.parametrize("row", [0, 119])
@pytest.mark.parametrize("column", COLUMN)
def test_any_cell(column: str, row: int, attack: Attack, good: Path) -> None:
    def one(number: str) -> None:
        put(good / "a.csv", cell(row, COLUMN[column], number))
        attack(good)

    each(NUMBERS, one)


@pytest.mark.parametrize(("factor", "said"), [
    *((f, "setup: {model: linear}") for f in (1e-300, 1e-150, 1e-30, 1e30)),
    *((1.0, said) for said in (
        "sample_rate_hz: 1e-150", "sample_rate_hz: 1e150", "columns: {voltage: {column: 1, scale: 1e150}}",
        "columns: {voltage: {column: 1, scale: 1e-150}}", "columns: {displacement: {column: 2, scale: -1}}",
        "start: {state: rest, input_before: 1e150}", "segments: 1",
        "segments: 119", "segments: 60", "recordings: [{file: a.csv, slice: [0, 1]}]", "start: periodic",
        "periodic: true", "input: zero_order",
    )),
])  # fmt: skip
@pytest.mark.parametrize("named", [True, False])
def test_extreme_statements(factor: float, said: str, named: bool, attack: Attack, good: Path) -> None:
    rows = table() * np.array([1.0, factor, factor])
    put(good / "a.csv", csv(rows) if named else csv(rows[:, 1:], header="voltage_V,displacement_m"))
    put(good / "recordings.yaml", said)
    attack(good)
