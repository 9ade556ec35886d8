"""Parameters: coordinates, bounds and the tables they stand in; quantities for people."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phnn.errors import InputRefused
from phnn.parameters import Parameter, as_table, constant, positive, quantity, with_values

sizes = st.floats(-12.0, 12.0).map(lambda e: 10.0**e)


@given(sizes)
def test_a_positive_parameter_comes_back_from_its_coordinate(value: float) -> None:
    p = positive("C", value, "F")
    assert p.from_coordinate(p.to_coordinate(value)) == pytest.approx(value, rel=1e-13)
    step = 1e-6
    moved = p.from_coordinate(p.to_coordinate(value) + step)
    assert (moved - value) / step == pytest.approx(p.slope(value), rel=1e-5)


@given(st.floats(-1e3, 1e3), sizes)
def test_a_signed_parameter_comes_back_from_its_coordinate(value: float, typical: float) -> None:
    p = Parameter("gamma", value, typical=typical)
    assert p.from_coordinate(p.to_coordinate(value)) == pytest.approx(value, rel=1e-14)
    assert p.slope(value) == typical


def test_bounds_of_the_coordinate() -> None:
    assert positive("C", 2.0, "F", span=math.e).coordinate_bounds == pytest.approx(
        (math.log(2.0) - 1.0, math.log(2.0) + 1.0)
    )
    assert Parameter("C", 2.0, positive=True).coordinate_bounds == (-math.inf, math.inf)
    assert Parameter("C", 2.0, lower=0.0, upper=3.0, positive=True).coordinate_bounds == (-math.inf, math.log(3.0))
    assert Parameter("g", 0.0, lower=-2.0, upper=4.0, typical=0.5).coordinate_bounds == (-4.0, 8.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"value": math.nan, "unit": "F"}, "C is nan: give a finite value in F"),
        ({"value": 3.0, "upper": 2.0}, r"C = 3 1 lies outside its bounds \[-inf, 2\]"),
        ({"value": -1.0, "positive": True}, "must be positive"),
        ({"value": 0.0, "positive": True}, "must be positive"),
    ],
)
def test_impossible_values_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputRefused, match=message):
        Parameter("C", **arguments)  # type: ignore[arg-type]


def test_a_table_keeps_order_and_refuses_a_second_of_a_name() -> None:
    table = as_table([positive("m", 1.0, "kg"), constant("q_0", 2.0, "m")])
    assert list(table) == ["m", "q_0"]
    assert table["q_0"].fixed
    with pytest.raises(InputRefused, match="two parameters are called m"):
        as_table([*table.values(), positive("m", 2.0, "kg")])


def test_stated_values_widen_bounds_and_unknown_names_are_refused() -> None:
    table = as_table([positive("m", 1.0, "kg", span=2.0), Parameter("g", 0.0, lower=-1.0, upper=1.0)])
    moved = with_values(table, {"m": 5.0, "g": -3.0})
    assert (moved["m"].value, moved["m"].lower, moved["m"].upper) == (5.0, 0.5, 5.0)
    assert (moved["g"].value, moved["g"].lower) == (-3.0, -3.0)
    assert table["m"].value == 1.0
    assert with_values(table, {"g": 0.0})["g"].value == 0.0
    with pytest.raises(InputRefused, match="no parameter called k, z: this model has m, g"):
        with_values(table, {"z": 1.0, "k": 1.0})


def test_a_parameter_without_its_name_is_refused() -> None:
    with pytest.raises(InputRefused, match=r"give name, value, unit, such as Parameter\('k', 2e4, 'N/m'\)"):
        Parameter(100.0, "N/m")  # type: ignore[arg-type]


@pytest.mark.parametrize(("value", "unit", "text"), [
    (3.2e-7, "s", "320 ns"), (5e-6, "s", "5 µs"), (24579.0, "N", "24.6 kN"), (0.0, "s", "0 s"),
    (-2.5e-3, "m", "-2.5 mm"), (1.0, "V", "1 V"), (999.0, "V", "999 V"), (1e12, "Hz", "1e+03 GHz"),
    (1e-18, "F", "0.001 fF"), (1.11e-3, "kg", "0.00111 kg"), (24579.0, "N/m", "24.6 kN/m"),
    (9.25e-5, "m/s", "92.5 µm/s"), (999.9e3, "N/m", "1 MN/m"), (math.nan, "N/m", "nan N/m"),
    (2.0e4, "°C/s", "2e+04 °C/s"), (24579.0, "N s/m", "2.46e+04 N s/m"), (0.02, "1", "0.02"),
    (math.inf, "s", "inf s"), (math.nan, "V", "nan V"),
])  # fmt: skip
def test_quantity(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


_PREFIX = {"f": -15, "p": -12, "n": -9, "µ": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}


@given(st.floats(1e-14, 1e11), st.booleans())
def test_prefix_and_number_give_the_value_back(size: float, negative: bool) -> None:
    value = -size if negative else size
    number, unit = quantity(value, "V").split()
    assert float(number) * 10.0 ** _PREFIX[unit[:-1]] == pytest.approx(value, rel=6e-3)
    assert 1.0 <= abs(float(number)) <= 1000.0
