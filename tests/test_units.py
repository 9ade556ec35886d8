"""Quantities for people."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phnn.units import quantity


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (3.2e-7, "s", "320 ns"),
        (5e-6, "s", "5 µs"),
        (24579.0, "N", "24.6 kN"),
        (0.0, "s", "0 s"),
        (-2.5e-3, "m", "-2.5 mm"),
        (1.0, "V", "1 V"),
        (999.0, "V", "999 V"),
        (1e12, "Hz", "1e+03 GHz"),
        (1e-18, "F", "0.001 fF"),
        (1.11e-3, "kg", "0.00111 kg"),
        (24579.0, "N/m", "24.6 kN/m"),
        (9.25e-5, "m/s", "92.5 µm/s"),
        (999.9e3, "N/m", "1 MN/m"),
        (math.nan, "N/m", "nan N/m"),
        (2.0e4, "°C/s", "2e+04 °C/s"),
        (24579.0, "N s/m", "2.46e+04 N s/m"),
        (0.02, "1", "0.02"),
        (math.inf, "s", "inf s"),
        (math.nan, "V", "nan V"),
    ],
)
def test_quantity(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


_PREFIX = {"f": -15, "p": -12, "n": -9, "µ": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}


@given(st.floats(1e-14, 1e11), st.booleans())
def test_prefix_and_number_give_the_value_back(size: float, negative: bool) -> None:
    value = -size if negative else size
    number, unit = quantity(value, "V").split()
    assert float(number) * 10.0 ** _PREFIX[unit[:-1]] == pytest.approx(value, rel=6e-3)
    assert 1.0 <= abs(float(number)) <= 1000.0
