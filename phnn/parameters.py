"""Physical parameters: a value with its unit, its bounds and the scale on which it is estimated.

A `Domain` is the values of a law's parameter for which the law keeps its promise (a sector, an energy with a minimum).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from phnn.errors import InputRefused


@dataclass(frozen=True)
class Domain:
    """An interval that ends at zero or is the whole line.

    Attributes:
        lower: 0 or −∞.
        closed: whether ``lower`` itself is allowed.
        words: the condition as a message says it.
    """

    lower: float
    closed: bool
    words: str

    def __contains__(self, value: float) -> bool:
        return math.isfinite(value) and (value > self.lower or (self.closed and value == self.lower))

    def __and__(self, other: Domain) -> Domain:
        """Return the stricter of two domains."""
        return max(self, other, key=lambda d: (d.lower, not d.closed))


ANY = Domain(-math.inf, False, "finite")
NONNEGATIVE = Domain(0.0, True, "zero or positive")
POSITIVE = Domain(0.0, False, "positive")


@dataclass(frozen=True)
class Parameter:
    """One scalar physical parameter.

    Estimation works in the coordinate ``z``: ``z = log θ`` for ``positive`` parameters and
    ``z = θ / typical`` for the others, so that a step of one is a sensible step for every parameter.

    Attributes:
        name: canonical name, unique in a setup.
        value: value in SI units.
        unit: SI unit as text, ``"1"`` where there is none.
        lower, upper: bounds on the value; part of the parameter, never of the optimiser.
        positive: estimated on a logarithmic scale.
        typical: size of a noticeable change of a parameter that is not positive.
        fixed: never estimated (a constant of the model such as a reference displacement).
        description: what it is, for a person.
    """

    name: str
    value: float
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    positive: bool = False
    typical: float = 1.0
    fixed: bool = False
    description: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or isinstance(self.value, str):
            raise InputRefused(
                f"parameter {self.name!r}, {self.value!r}: give name, value, unit, such as Parameter('k', 2e4, 'N/m')"
            )
        if not math.isfinite(self.value):
            raise InputRefused(f"parameter {self.name} is {self.value}: give a finite value in {self.unit}")
        if not self.lower <= self.value <= self.upper:
            raise InputRefused(
                f"parameter {self.name} = {self.value:g} {self.unit} lies outside its bounds "
                f"[{self.lower:g}, {self.upper:g}]: give a value inside"
            )
        if not 0.0 < self.typical < math.inf:
            raise InputRefused(f"parameter {self.name}: its typical change is {self.typical:g}: give a positive number")
        if self.positive and self.value <= 0.0:
            raise InputRefused(
                f"parameter {self.name} = {self.value:g} {self.unit} must be positive: check its sign and unit"
            )

    def within(self, domain: Domain, where: str) -> Parameter:
        """Return the parameter with its bounds inside the domain that a law asks for.

        Args:
            where: the law and element, for the message.

        Raises:
            InputRefused: the value lies outside the domain.
        """
        if self.value not in domain:
            raise InputRefused(
                f"parameter {self.name} = {self.value:g} {self.unit} must be {domain.words} in {where}: with another "
                "value the model could deliver energy that it never took up; check its sign and unit"
            )
        inside = self.positive or self.lower > domain.lower or (domain.closed and self.lower == domain.lower)
        if self.fixed or inside or domain.lower < 0.0:
            return self
        # Where zero itself is no value, only a logarithmic scale keeps clear of it.
        return replace(self, lower=domain.lower, positive=not domain.closed)

    def to_coordinate(self, value: float) -> float:
        """Return the estimation coordinate ``z`` of a physical value."""
        return math.log(value) if self.positive else value / self.typical

    def from_coordinate(self, z: float) -> float:
        """Return the physical value of an estimation coordinate ``z``."""
        return math.exp(z) if self.positive else z * self.typical

    def slope(self, value: float) -> float:
        """Return ``dθ/dz`` at a physical value."""
        return value if self.positive else self.typical

    @property
    def coordinate_bounds(self) -> tuple[float, float]:
        """Return the bounds on ``z``."""
        if not self.positive:
            return self.lower / self.typical, self.upper / self.typical
        lower = math.log(self.lower) if self.lower > 0.0 else -math.inf
        return lower, math.log(self.upper) if math.isfinite(self.upper) else math.inf


def positive(name: str, value: float, unit: str, description: str = "", span: float = 1e6) -> Parameter:
    """Return a positive parameter that may move by a factor ``span`` either way."""
    return Parameter(name, value, unit, value / span, value * span, positive=True, description=description)


# How far parameters of the catalogue may move from where they are placed, where their usual range is narrower.
_FAR = 1e6


def signed(name: str, value: float, unit: str, reach: float, typical: float, description: str) -> Parameter:
    """Return a parameter of either sign, up to ``reach`` or a factor 10⁶ beyond the size it is placed with."""
    reach = max(reach, _FAR * abs(value))
    return Parameter(name, value, unit, -reach, reach, typical=typical, description=description)


def constant(name: str, value: float, unit: str, description: str = "") -> Parameter:
    """Return a parameter that is never estimated."""
    return Parameter(name, value, unit, fixed=True, description=description)


def as_table(parameters: Iterable[Parameter]) -> dict[str, Parameter]:
    """Return the parameters by name.

    Raises:
        InputRefused: two parameters share a name.
    """
    table: dict[str, Parameter] = {}
    for parameter in parameters:
        if parameter.name in table:
            raise InputRefused(f"two parameters are called {parameter.name}: rename one")
        table[parameter.name] = parameter
    return table


def with_values(table: Mapping[str, Parameter], values: Mapping[str, float]) -> dict[str, Parameter]:
    """Return the table with some values replaced, bounds widened where a stated value lies outside them.

    Raises:
        InputRefused: a name that the table does not have.
    """
    unknown = sorted(set(values) - set(table))
    if unknown:
        raise InputRefused(f"no parameter called {', '.join(unknown)}: this model has {', '.join(table)}")
    return {
        name: replace(p, value=float(v), lower=min(p.lower, float(v)), upper=max(p.upper, float(v)))
        if (v := values.get(name)) is not None
        else p
        for name, p in table.items()
    }


_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
# Symbols of more than two letters that take a prefix.
_LONG = ("rad", "ohm", "Ohm")


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write ``3.2e-7`` and ``s`` as ``320 ns``; in a quotient the first symbol takes the prefix, products take none."""
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
    """Return the exponent of the prefix with which a value has one to three digits before the point."""
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
    """Return a time as people say it: ``0.4 ms``, ``27 min``, ``3.5 h``."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.2g} {unit}"
    return quantity(float(f"{seconds:.2g}"), "s")
