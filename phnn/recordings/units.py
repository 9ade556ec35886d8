"""Units at the boundary: everything inside the package is SI. The library `pint` knows the units."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from phnn.errors import InputRefused
from phnn.intake import LIMITS

if TYPE_CHECKING:
    import pint

# quantity -> its SI unit; None: any unit (systems other than the actuator)
QUANTITIES: dict[str, str | None] = {
    "time": "s", "voltage": "V", "displacement": "m", "current": "A", "charge": "C", "force": "N", "temperature": "K",
    "input": None, "output": None,
}  # fmt: skip

# Spellings that pint does not know, or knows as something else: newton metre is "number_meter", a textile unit, to it.
_WORDS = {"sec": "s", "second": "s", "seconds": "s", "volt": "V", "volts": "V", "micron": "um", "microns": "um",
          "rpm": "rpm", "u/min": "rpm", "deg": "deg", "deg c": "degC", "deg f": "degF", "watt": "W", "watts": "W",
          "amp": "A", "amps": "A", "vdc": "V", "psi": "psi", "n-m": "Nm", "n-cm": "Ncm", "n-mm": "Nmm", "MM": "mm",
          "mil": "thou", "mils": "thou"}  # fmt: skip
_NEWTON_METRE = re.compile(r"(?<![A-Za-z])([munkM]?)N([cm]?m)(?![A-Za-z])")
# Symbols that are constants of nature to pint: a column output_c is hardly in multiples of the speed of light.
_CONSTANT = re.compile(r"(?<![A-Za-z_])[cek](?![A-Za-z_])")
# Names of SI units for people; other units are written in powers of them, such as m³/s.
_SI = ("s", "m", "kg", "A", "K", "rad", "mol", "cd", "Hz", "N", "Pa", "J", "W", "C", "V", "ohm", "S", "F", "H", "T",
       "Wb")  # fmt: skip

# Multiples of the SI units of recordings are known without pint, whose definitions take half a second to load.
_MULTIPLES = {"": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9, "k": 1e3}

_NAME = re.compile(r"^\s*([A-Za-z]+)\s*(?:_(\S+)|[\[(]\s*([^\])]*?)\s*[\])])?\s*$")
_BRACKETED = re.compile(r"^(.*?)[\s_]*[\[(]\s*([^\])]*?)\s*[\])]\s*$", re.DOTALL)
# A unit behind a name as people write it beside an axis: `Kraft / N`, `Weg in mm`, `Time, s`.
_BESIDE = re.compile(r"(?:(.*\S)(?: / ?| in |, )|([^\s/_]+)/)\s*(\S+(?: \S+)?)\s*")
# Units of one letter that the end of a column's name may be.
_SYMBOLS = "smVANCKW"
# A product such as `kg m2`, with exponents of one digit, so that no power is large; then what it is divided by.
_FACTOR = r"(?:[A-Za-zΩÅ°%]+(?:_[A-Za-z0-9]+)*(?:(?:\^|\*\*)?-?[1-9]|[²³])?)"
_PRODUCT = rf"{_FACTOR}(?: ?[*·. ] ?{_FACTOR})*"
_UNIT = re.compile(rf"(?:1|{_PRODUCT})(?: ?/ ?(?:{_FACTOR}|\({_PRODUCT}\)))*(?: ?[*·. ] ?{_FACTOR})*")
_POWER = re.compile(r"(?<=[A-Za-zΩÅ°])(-?[1-9])")


@dataclass(frozen=True)
class Unit:
    """A unit as it was written: SI value = ``factor`` × number + ``offset``, in the SI unit ``si``."""

    si: str
    factor: float
    offset: float


_COMMON = {f"{p}{si}": Unit(si, factor, 0.0) for si in QUANTITIES.values() if si for p, factor in _MULTIPLES.items()}


def spelled(unit: str) -> str:
    """Return one spelling of a unit: both Unicode micro signs become ``u``, ``°C`` becomes ``degC``, words symbols."""
    bare = unit.strip().replace("\u00b5", "u").replace("\u03bc", "u").replace("\u00b0C", "degC")
    bare = bare.replace("\u03a9", "ohm").replace("\u2126", "ohm")
    return _WORDS.get(bare, _WORDS.get(bare.lower(), bare))


@lru_cache(maxsize=256)
def find_unit(text: str) -> Unit | None:
    """Return the unit of a text such as ``um``, ``m3/s`` or ``N s/m``; None if it is not a unit.

    The text is a product of names with exponents of one digit; pint never sees anything else.
    """
    name = spelled(text)
    if name in _COMMON:
        return _COMMON[name]
    if len(name) > LIMITS.unit_characters or _UNIT.fullmatch(name) is None or _CONSTANT.search(name):
        return None
    registry = _registry()
    try:
        # As pint reads it: powers with stars, a newton metre as a product.
        text = _POWER.sub(r"**\1", _NEWTON_METRE.sub(r"\1N*\2", name)).replace("²", "**2").replace("³", "**3")
        return _as_si(registry.Unit(text.replace("·", "*").replace(".", "*").replace("****", "**")))
    except Exception:  # pint has several of its own for a text that is no unit, and raises those of Python besides
        return None


def _as_si(unit: pint.Unit) -> Unit | None:
    """Return the unit in SI; None where numbers in it are not proportional to SI values (decibels)."""
    registry = _registry()
    si = registry.Unit("dimensionless")
    for name, power in unit._units.items():
        # With a name of its own where it has one: N for lbf.
        si *= _alike(_base(str(name).removeprefix("delta_")), _SI) ** power
    if len(unit._units) != 1:
        si = _alike(si, ("dimensionless", *filter(None, QUANTITIES.values())))
    zero, one, two = (float(registry.Quantity(x, unit).to(si).magnitude) for x in (0.0, 1.0, 2.0))
    if abs((two - one) - (one - zero)) > 1e-9 * abs(two - zero):
        return None
    factor = one if zero == 0.0 else float((registry.Quantity(1.0, unit) - registry.Quantity(0.0, unit)).to(si).m)
    return Unit(format(si, "~P") or "1", factor, zero)


def _alike(unit: pint.Unit, names: Iterable[str]) -> pint.Unit:
    """Return the first of some SI units that is of the same kind as another; that one itself where none is."""
    base = _base(unit)
    return next((u for u in map(_registry().Unit, names) if _base(u) == base), unit)


def _base(unit: pint.Unit | str) -> pint.Unit:
    """Return a unit in powers of kilogram, metre, second, …"""
    registry = _registry()
    return registry.Unit(registry.get_base_units(registry.Unit(unit))[1])


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[Any]:
    import pint  # takes a second with its definitions: only where something is read

    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    registry.formatter.default_sort_func = None  # N·m, as it was written
    return registry


def parse_name(header: str) -> tuple[str, str | None]:
    """Return quantity and unit of a column name such as ``displacement_um`` or ``voltage [V]``.

    The quantity is empty where the name is no known one, or is numbered; the unit is ``None`` where the name has none.
    """
    match = _NAME.match(_with_brackets(header))
    if match is None or match[1].lower() not in QUANTITIES or (match[2] or "").isdecimal():
        return "", None
    unit = match[2] or match[3]
    return match[1].lower(), spelled(unit) if unit else None


def split_unit(header: str) -> tuple[str, str | None]:
    """Return a column's name without the unit at its end, and that unit as it is spelled: ``pos [nm]``, ``pos_nm``.

    What stands in brackets is a unit whatever it says; a last word is one if it is known.
    """
    header = _with_brackets(header)
    bracketed = _BRACKETED.match(header)
    if bracketed is not None:
        return bracketed[1], spelled(bracketed[2])
    head, _, tail = header.rpartition("_")
    # A single letter is more often a place or a number than a year or an are.
    alike = len(tail) > 1 or tail in _SYMBOLS
    return (head, spelled(tail)) if head and alike and find_unit(tail) is not None else (header, None)


def _with_brackets(header: str) -> str:
    """Return a column's name with a known unit in brackets, where it stands behind a stroke, a comma or the word in."""
    match = _BESIDE.fullmatch(header)
    if match is None or find_unit(match[3]) is None:
        return header
    name = match[1] or match[2]
    # A time over seconds, not tonnes a second; but metres a second.
    return f"{name} [{match[3]}]" if find_unit(header) is None or name in "tuUF" else header


def stated_by_name(header: str, quantity: str) -> str | None:
    """Return the unit of a quantity that a column's name states, whatever the column is called; None without one."""
    named, unit = parse_name(header)
    if named == quantity:
        return unit
    _, unit = split_unit(header)
    # Without brackets `pos_m` may be a measured position, and words such as `flow_in` or `temp_min` name no unit.
    symbol = unit and unit != "m" and (unit in _COMMON or not unit.islower() or unit in ("deg", "rad", "rpm", "bar"))
    return unit if (symbol or _BRACKETED.match(_with_brackets(header))) and suits(quantity, unit) else None


def suits(quantity: str, unit: str | None) -> bool:
    """Return whether a text is a unit of the quantity."""
    known = find_unit(unit) if unit else None
    return known is not None and QUANTITIES[quantity] in (None, known.si)


def same_kind(one: str, other: str) -> bool:
    """Return whether two texts are units of one kind, such as S and 1/ohm; a text that is no unit is like itself."""
    first, second = find_unit(one), find_unit(other)
    if first is None or second is None:
        return one == other
    return first.si == second.si or _base(first.si) == _base(second.si)


def powers(text: str) -> dict[str, float]:
    """Return the powers of the SI base units in a unit, without angles; none of a text that is no unit."""
    unit = find_unit(text)
    if unit is None or unit.si == "1":
        return {}
    base: dict[str, Any] = dict(_base(unit.si)._units)
    return {name: float(power) for name, power in base.items() if name != "radian"}


def scales_with_forces(unit: str) -> bool:
    """Return whether a quantity changes by the common factor of all forces and charges.

    Voltages and motions leave that factor open. Kilograms and amperes change by it, volts do not.
    """
    base = powers(unit)
    return base.get("kilogram", 0.0) + base.get("ampere", 0.0) != 0.0


def times_of_seconds(one: str, other: str) -> int | None:
    """Return the power of time by which the dimension of a unit differs from another's; None where more differs.

    Angles have no dimension. A text that is no unit differs from nothing.
    """
    if one == other or find_unit(one) is None or find_unit(other) is None:
        return 0
    first, second = powers(one), powers(other)
    ratio = {name: first.get(name, 0.0) - second.get(name, 0.0) for name in (*first, *second)}
    power = ratio.pop("second", 0.0)
    return int(power) if power.is_integer() and not any(ratio.values()) else None


def accepted(quantity: str) -> str:
    """Return the examples of the units that a quantity may have, for messages."""
    si = QUANTITIES[quantity]
    if si is None:
        return "V, N, m/s, rad, Pa, L/min, degC, 1 and any other physical unit"
    return "K, degC, degF" if si == "K" else f"{si}, m{si}, u{si}, n{si}, k{si} and any other unit of {si}"


def check_unit(quantity: str, unit: str | None, where: str) -> str:
    """Return the unit in its common spelling."""
    if unit is None:
        units = accepted(quantity)
        cause = f"no unit for the {quantity}, so its numbers are ambiguous"
        remedy = f"put the unit in the column's name ({quantity}_{units.split(',')[0]}) or write it in recordings.yaml"
        raise InputRefused(f"{where}: {cause}: {remedy}, columns: {{{quantity}: {{unit: ...}}}}; accepted: {units}")
    name, si = spelled(unit), QUANTITIES[quantity]
    known = find_unit(name)
    if known is None:
        cause = f"unknown unit {unit[: LIMITS.unit_characters]!r} for the {quantity}{_hint(quantity, name)}"
        raise InputRefused(f"{where}: {cause}: accepted are {accepted(quantity)}")
    if si is not None and known.si != si:
        cause = f"the {quantity} cannot be in {unit} (that is a unit of {known.si})"
        remedy = "a column that is proportional to it takes `scale` and the unit after scaling, in recordings.yaml"
        raise InputRefused(f"{where}: {cause}: accepted are {accepted(quantity)}; {remedy}")
    return name


def _hint(quantity: str, name: str) -> str:
    """Return the unit of the quantity that was probably meant, in brackets."""
    if len(name) > LIMITS.unit_characters:
        return ""
    si = QUANTITIES[quantity] or "V"
    common = [f"{prefix}{si}" for prefix in _MULTIPLES] if si != "K" else ["K", "degC", "degF"]
    known = [*common, *(n for n in dir(_registry()) if len(n) > 1 and n.isalpha())]
    alike = [u for u in known if u.lower() == name.lower()] or difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    meant = next((u for u in alike if suits(quantity, u)), None)
    return f" (did you mean {meant}?)" if meant else ""
