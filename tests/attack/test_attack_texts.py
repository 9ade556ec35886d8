"""Hostile text recordings: bytes, shapes and numbers that no instrument writes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from attack_tools import HEADER, Attack, csv, each, often, put, quick, table
from hypothesis import given
from hypothesis import strategies as st

ROWS = csv().splitlines()
NUMBERS = {
    "NaN": "nan", "infinite": "inf", "400 digits": "9" * 400, "a huge exponent": "1e999999999",
    "a tiny one": "1e-999999999", "denormal": "1e-320", "huge": "1e308", "hexadecimal": "0x1p3",
    "an underscore": "1_000", "a fraction": "1/2", "a date": "2001-12-14",
    "code": "__import__('os').system('touch ran')", "a formula": "=cmd|'/c calc'!A0", "a quote": '"',
    "two quotes": '""', "empty": "", "blank": " ", "a percent sign": "50%", "Arabic digits": "\u0661\u0662",
    "full-width digits": "\uff11", "a minus sign": "\u22125", "complex": "1j", "a flag": "True", "NUL": "\0",
    "an escape code": "\x1b[31m5", "a carriage return": "1\r2", "a form feed": "1\f2", "a line separator": "1\u20282",
    "a long text": "x" * 90_000, "a surrogate": "\ud800",
}  # fmt: skip
COLUMN = {"time": 0, "voltage": 1, "displacement": 2}


def cell(row: int, column: int, text: str) -> str:
    rows = list(ROWS)
    cells = rows[row + 1].split(",")
    cells[column] = text
    rows[row + 1] = ",".join(cells)
    return "\n".join(rows) + "\n"


def scaled(factors: tuple[float, float, float]) -> str:
    return csv(table() * np.array(factors))


WHOLE: dict[str, Callable[[], str | bytes]] = {
    "empty": lambda: "",
    "a line end": lambda: "\n",
    "only blanks": lambda: " \n" * 1000,
    "NULs": lambda: bytes(10_000),
    "random": lambda: np.random.default_rng(0).bytes(10_000),
    "only a header": lambda: HEADER,
    "header and end": lambda: HEADER + "\n",
    "only numbers": lambda: "\n".join(ROWS[1:]),
    "one row": lambda: "\n".join(ROWS[:2]),
    "UTF-8 mark": lambda: "\ufeff" + csv(),
    "UTF-16": lambda: csv().encode("utf-16"),
    "UTF-16, odd": lambda: csv().encode("utf-16")[:-1],
    "UTF-32": lambda: csv().encode("utf-32"),
    "Latin-1": lambda: csv(header="time_s,voltage_V,displacement_\xb5m").encode("latin-1"),
    "not UTF-8": lambda: csv().encode() + b"\xff\xfe",
    "a mark alone": lambda: b"\xff\xfe",
    "one line": lambda: ",".join("1" for _ in range(10**6)),
    "no line ends": lambda: "1" * 10**6,
    "many columns": lambda: "\n".join(",".join("1" * 2000) for _ in range(100)),
    "50,000 columns": lambda: "\n".join([",".join("1" for _ in range(50_000))] * 20),
    "many short lines": lambda: "1\n" * 500_000,
    "many blank lines": lambda: HEADER + "\n" * 500_000,
    "many names": lambda: ",".join(f"voltage_{i}_V" for i in range(500)) + "\n" + "\n".join([",".join("1" * 500)] * 60),
    "growing rows": lambda: "\n".join(",".join("1" * i) for i in range(1, 300)),
    "carriage returns": lambda: csv().replace("\n", "\r"),
    "both": lambda: csv().replace("\n", "\r\n"),
    "mixed": lambda: csv().replace("\n", "\r\n", 40),
    "vertical tabs": lambda: csv().replace("\n", "\v"),
    "quotes": lambda: csv().replace(",", '","'),
    "an open quote": lambda: csv().replace(",", ',"', 1),
    "all quoted": lambda: "\n".join(",".join(f'"{c}"' for c in r.split(",")) for r in ROWS),
    "a header of escape codes": lambda: csv(header="\x1b[31mtime_s,voltage_V,displacement_m"),
    "C1 codes": lambda: (
        csv(header="time_s,voltage_V,displacement_m,\x9b31m").encode("latin-1").replace(b"\n", b",1\n")[:-2]
    ),
    "a header of quotes": lambda: csv(header='"time_s","voltage_V","displacement_m"'),
    "a reversed header": lambda: csv(header="time_s,voltage_V,\u202edisplacement_m"),
    "a long header": lambda: csv(header=",".join("x" * 30_000 for _ in range(3))),
    "the header twice": lambda: HEADER + "\n" + csv(),
    "the file twice": lambda: csv() * 2,
    "comments": lambda: "# a\n" * 50_000 + csv(),
    "prose before": lambda: "word " * 10_000 + "\n" + csv(),
    "html": lambda: "<html><body>404</body></html>",
    "json": lambda: '{"a": [1, 2]}',
    "python": lambda: "import os\nos.system('touch ran')\n",
    "a pickle": lambda: b"\x80\x04\x95cos\nsystem\n(S'touch ran'\ntR.",
    "gzip": lambda: b"\x1f\x8b\x08\0" + bytes(100),
    "zip": lambda: b"PK\x03\x04" + bytes(100),
    "zeros": lambda: csv(np.zeros((120, 3))),
    "ones": lambda: csv(np.ones((120, 3))),
    "backwards": lambda: csv(table()[::-1]),
    "one time": lambda: csv(np.column_stack([np.zeros(120), table()[:, 1:]])),
    "tiny times": lambda: scaled((1e-320, 1, 1)),
    "very tiny times": lambda: scaled((1e-200, 1, 1)),
    "huge times": lambda: scaled((1e25, 1, 1)),
    "tiny voltage": lambda: scaled((1, 1e-310, 1)),
    "huge voltage": lambda: scaled((1, 1e27, 1)),
    "huge displacement": lambda: scaled((1, 1, 1e33)),
    "tiny displacement": lambda: scaled((1, 1, 1e-300)),
    "tiny everything": lambda: scaled((1e-290,) * 3),
    "far times": lambda: csv(table() + np.array([1e15, 0, 0])),
    "negative times": lambda: csv(table() - np.array([1e3, 0, 0])),
    "a far voltage": lambda: csv(table() + np.array([0, 1e15, 0])),
    "a far displacement": lambda: csv(table() + np.array([0, 0, 1e12])),
    "a step": lambda: csv(
        np.column_stack([table()[:, 0], np.r_[np.zeros(60), np.ones(60)], np.r_[np.zeros(60), np.ones(60)] * 1e-6])
    ),
    "alternating": lambda: csv(
        np.column_stack([table()[:, 0], (-1.0) ** np.arange(120), 1e-6 * (-1.0) ** np.arange(120)])
    ),
    "one pulse": lambda: csv(table() * np.array([1, 0, 0]) + np.eye(120, 3)[::-1] * 1e-6),
}


@pytest.mark.parametrize("case", WHOLE)
@pytest.mark.parametrize("suffix", quick([".csv"], ".txt"))
def test_any_text(case: str, suffix: str, attack: Attack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    put(tmp_path / "data" / f"a{suffix}", WHOLE[case]())
    attack(tmp_path / "data")


@pytest.mark.parametrize("row", [0, 119])
@pytest.mark.parametrize("column", COLUMN)
def test_any_cell(column: str, row: int, attack: Attack, good: Path) -> None:
    def one(number: str) -> None:
        put(good / "a.csv", cell(row, COLUMN[column], NUMBERS[number]))
        attack(good)

    each(NUMBERS, one)


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        *((f, "setup: {model: linear}") for f in (1e-300, 1e-150, 1e-30, 1e30)),
        *(
            (1.0, s)
            for s in (
                "sample_rate_hz: 1e-150",
                "sample_rate_hz: 1e150",
                "columns: {voltage: {column: 1, scale: 1e150}}",
            )
        ),
        *(
            (1.0, s)
            for s in (
                "columns: {voltage: {column: 1, scale: 1e-150}}",
                "columns: {displacement: {column: 2, scale: -1}}",
            )
        ),
        *(
            (1.0, s)
            for s in (
                "start: {state: rest, input_before: 1e150}",
                "rise_time_s: 1e150",
                "rise_time_s: 1e-150",
                "segments: 1",
            )
        ),
        *(
            (1.0, s)
            for s in ("segments: 119", "segments: 60", "recordings: [{file: a.csv, slice: [0, 1]}]", "start: periodic")
        ),
        *(
            (1.0, s)
            for s in ("recordings: [{file: a.csv, jumps_at_s: [1e150]}]", "periodic: true", "input: zero_order")
        ),
    ],
)
@pytest.mark.parametrize("named", [True, False])
def test_extreme_statements(factor: float, said: str, named: bool, attack: Attack, good: Path) -> None:
    rows = table() * np.array([1.0, factor, factor])
    put(good / "a.csv", csv(rows) if named else csv(rows[:, 1:], header="voltage_V,displacement_m"))
    put(good / "recordings.yaml", said)
    attack(good)


@often(100)
@given(
    at=st.integers(0, len(csv())),
    cut=st.integers(0, 40),
    piece=st.text(max_size=5) | st.sampled_from(list(NUMBERS.values())[:24]),
)
def test_texts_with_a_damaged_place(at: int, cut: int, piece: str, attack: Attack, good: Path) -> None:
    put(good / "a.csv", csv()[:at] + piece + csv()[at + cut :])
    attack(good)


LINES = st.lists(
    st.lists(
        st.sampled_from(["1", "2.5", "-3e-7", "", "x", "nan", '"', "1,5", "time_s", "voltage_V", "\u00b5m"]), max_size=5
    ),
    max_size=80,
)


@often(80)
@given(lines=LINES, separator=st.sampled_from([",", ";", "\t", " ", "|"]), header=st.booleans())
def test_tables_at_random(lines: list[list[str]], separator: str, header: bool, attack: Attack, good: Path) -> None:
    text = "\n".join(separator.join(line) for line in lines)
    put(good / "a.csv", (HEADER.replace(",", separator) + "\n" if header else "") + text)
    attack(good)
