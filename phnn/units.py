"""Quantities for people: a value with an SI prefix."""

from __future__ import annotations

import math

# Units of what a common factor of all forces and charges changes, where voltages and displacements stay as they are;
# with the power of that factor.
FORCE_UNITS = dict.fromkeys(
    ("kg", "N", "N/m", "N s/m", "N s²/m²", "N/V", "kg m/s", "N m", "N m/rad", "N m s/rad", "kg m²", "C", "C/m", "A",
     "F", "S"),
    1,
) | dict.fromkeys(("Ohm", "ohm", "H"), -1)  # fmt: skip
_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
# Symbols of more than two letters that take a prefix.
_LONG = ("rad", "ohm", "Ohm")


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """``3.2e-7`` and ``s`` become ``320 ns``; of a quotient the first symbol takes the prefix, products take none."""
    if "/" in unit:
        # What rounds up to the next power of a thousand has the next prefix.
        size, name = prefixed(float(f"{value:.{digits}g}"), unit)
        return f"{value / size:.{digits}g} {name}"
    if value == 0.0 or not math.isfinite(value) or unit == "1" or len(unit) > 2 or unit == "kg" or unit[-1] in "²³":
        return f"{value:.{digits}g}" if unit == "1" else f"{value:.{digits}g} {unit}"
    # What rounds up to the next power of a thousand has the next prefix.
    value = float(f"{value:.{digits}g}")
    power = _power(value)
    return f"{value / 10.0**power:.{digits}g} {_PREFIXES[power]}{unit}"


def _power(value: float) -> int:
    """The exponent of the prefix with which a value has one to three digits before the point."""
    return min(max(3 * math.floor(math.log10(abs(value)) / 3), -15), 9)


def prefixed(value: float, unit: str) -> tuple[float, str]:
    """Return the size and name of the unit in which a value reads well: ``3.2e-7`` and ``m/V`` give ``1e-9, "nm/V"``.

    The first symbol of a quotient takes the prefix; products, powers, ``kg`` and ``1`` take none.
    """
    first, bar, rest = unit.partition("/")
    simple = (len(first) <= 2 and first.isalpha() and first != "kg") or first in _LONG
    if value == 0.0 or not math.isfinite(value) or not simple:
        return 1.0, unit
    power = _power(value)
    return 10.0**power, f"{_PREFIXES[power]}{first}{bar}{rest}"


def duration(seconds: float) -> str:
    """A time as people say it: ``0.4 ms``, ``27 min``, ``3.5 h``."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.2g} {unit}"
    return quantity(float(f"{seconds:.2g}"), "s")
