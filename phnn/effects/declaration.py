"""Declarations of effect parameters: name, unit, bounds, role, plausible range; and conditions on setups.

A condition says whether an effect can act in a setup; where it fails, its docstring is shown.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from phnn import parameters
from phnn.laws.other import THROUGH_A_RESISTOR
from phnn.network.bondgraph.description import effort_unit
from phnn.network.roles import hysterons
from phnn.parameters import Parameter
from phnn.setup import Setup

# Storage laws of a spring to which a nonlinear term can be added.
SPRINGS = ("spring", "quadratic_spring", "cubic_spring")


def always(setup: Setup) -> bool:
    """Any setup."""
    return True


def has_motion(setup: Setup) -> bool:
    """A momentum ``p`` moves the displacement ``q``: forces can act on it."""
    return any({c.to, c.of} == {"q", "p"} for c in setup.network.couplings)


def has_inertia(setup: Setup) -> bool:
    """A mass of constant inertia moves the displacement ``q``."""
    return has_motion(setup) and any(s.name == "p" and s.law == "capacitor" for s in setup.network.storages)


def inertia(setup: Setup) -> str:
    """The parameter by which the momentum ``p`` is a velocity, where `has_inertia` holds."""
    return next(s.parameters[0] for s in setup.network.storages if s.name == "p")


def has_spring(setup: Setup) -> bool:
    """The displacement ``q`` has a spring of its own, not only a storage that keeps the position."""
    stiffness = [s.parameters[0] for s in setup.network.storages if s.name == "q" and s.law in SPRINGS]
    return has_motion(setup) and any(setup.parameters[name].value > 0.0 for name in stiffness)


def has_dead_zones(setup: Setup) -> bool:
    """At least one resistor has a dead zone: there are hysterons."""
    return bool(hysterons(setup.network))


def has_plain_dead_zones(setup: Setup) -> bool:
    """At least one resistor has a dead zone that follows no state yet."""
    return any(r.law == "dead_zone" for r in setup.network.resistors)


def has_transducer(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio by which the voltage port acts on the momentum, not through a resistor."""
    ports = [p for p in setup.network.ports if p.law not in THROUGH_A_RESISTOR]
    return has_motion(setup) and any(p.name == "voltage" and p.on.get("p") == "alpha" for p in ports)


def has_tanks(setup: Setup) -> bool:
    """Stores of constant capacity drain into each other through resistors alone."""
    network = setup.network
    return all(s.law == "capacitor" for s in network.storages) and not network.couplings


# Metres and newtons in the unit of an effect.
_METRE, _NEWTON = re.compile(r"\bm(?=[\s/)²]|$)"), re.compile(r"\bN\b")


def in_own_units(unit: str, setup: Setup) -> str:
    """Return the unit of an effect in those of a setup's own motion: ``N/m`` is ``N m/rad`` of a shaft.

    Args:
        unit: for a motion ``q`` in metres and an input in volts; ``{sensed}`` in it stands for the unit of the sensor's
            quantity: of the output, or of the effort that an imposed motion requires.
        setup: with role names.
    """
    network = setup.network
    units = {s.name: s.unit for s in network.storages}
    sensed = next((effort_unit(p.unit) for p in network.ports if p.name == network.senses), units[network.output])
    source = network.ports[0].unit if network.ports else "V"
    for text, own in (("{sensed}", sensed), ("V", source)):
        if text in unit:
            plain = unit.replace(f"/{text}^2", "").replace(f"/{text}", "") if own == "1" else unit
            return plain.replace(text, own).replace("/s/s", "/s²")
    moved = units.get("q", "m")
    effort = effort_unit(f"{moved}/s")
    if moved == "m" or effort == "1":
        return unit
    inertia_of = {"kg": "kg m2" if moved == "rad" else f"{effort} s²/{moved}", "kg m/s": f"{effort} s"}
    if unit in inertia_of:
        return inertia_of[unit]
    return _NEWTON.sub(effort, _METRE.sub(moved, unit))


@dataclass(frozen=True)
class Plausible:
    """The plausible range of an effect's parameter in real piezo actuators.

    Attributes:
        lower, upper: ends of the range [SI].
        source: evidence for the range, as a sentence without its full stop; empty if no range is known.
        over: parameter of the base model by which the value is divided before the comparison, so that no anchor is
            needed.
        outside: meaning of a value above the range, as the rest of a sentence.
    """

    lower: float
    upper: float
    source: str
    over: str = ""
    outside: str = ""


NO_RANGE = Plausible(-math.inf, math.inf, "")


@dataclass(frozen=True)
class Declared:
    """A parameter of an effect.

    Attributes:
        name: unique among the parameters of all effects.
        unit: SI, of a motion in metres; see `in_own_units`.
        description: text for readers.
        place: function that makes the parameter from ``name``, ``value``, ``unit`` and ``description``, with its
            bounds.
        strength: whether the parameter is zero when the effect is absent.
        lower, upper: bounds that hold in every setup.
        plausible: range in real actuators; see `plausibly`.
    """

    name: str
    unit: str
    description: str
    place: Callable[..., Parameter] = field(compare=False, repr=False)
    strength: bool = False
    lower: float = -math.inf
    upper: float = math.inf
    plausible: Plausible = NO_RANGE

    def plausibly(self, lower: float, upper: float, source: str, *, over: str = "", outside: str = "") -> Declared:
        """The parameter with its plausible range; for the arguments see `Plausible`."""
        return replace(self, plausible=Plausible(lower, upper, source, over, outside))

    def at(self, value: float, setup: Setup) -> Parameter:
        """The parameter with a value [SI], for a setup.

        Raises:
            InputRefused: the value is not finite or lies outside the bounds.
        """
        return self.place(
            name=self.name, value=value, unit=in_own_units(self.unit, setup), description=self.description
        )


def positive(
    name: str,
    unit: str,
    description: str,
    span: float = 1e6,
    strength: bool = False,
) -> Declared:
    """A positive parameter, estimated on a logarithmic scale, bounded to a factor ``span`` in either direction."""
    place = partial(parameters.positive, span=span)
    return Declared(name, unit, description, place, strength, lower=0.0)


def signed(
    name: str,
    unit: str,
    description: str,
    reach: float,
    typical: float,
    strength: bool = False,
    own_size: bool = False,
) -> Declared:
    """A parameter on a linear scale, of either sign.

    Args:
        reach: largest size; at most a factor 10⁶ beyond the start value.
        typical: size of a noticeable change.
        own_size: a noticeable change is as large as the start value, unless that is zero.
    """
    return Declared(name, unit, description, _OnLinearScale(reach, typical, own_size), strength)


def nonnegative(name: str, unit: str, description: str, reach: float, typical: float) -> Declared:
    """A parameter on a linear scale that is zero or positive; for the arguments see `signed`."""
    return Declared(name, unit, description, _OnLinearScale(reach, typical, lower=0.0), lower=0.0)


def bounded(
    name: str,
    unit: str,
    description: str,
    lower: float = -math.inf,
    upper: float = math.inf,
    typical: float = 1.0,
    *,
    strength: bool = False,
) -> Declared:
    """A parameter between fixed bounds on a linear scale.

    Args:
        typical: size of a noticeable change.
    """
    place = partial(Parameter, lower=lower, upper=upper, typical=typical)
    return Declared(name, unit, description, place, strength, lower, upper)


def between(name: str, unit: str, description: str, lower: float, upper: float) -> Declared:
    """A positive parameter between fixed bounds, estimated on a logarithmic scale."""
    place = partial(Parameter, lower=lower, upper=upper, positive=True)
    return Declared(name, unit, description, place, lower=lower, upper=upper)


def limit(name: str, unit: str, description: str, span: float, signed: bool = False) -> Declared:
    """A limit, level or gap; it keeps its sign, and is bounded to a factor ``span`` in either direction.

    Args:
        signed: it may be negative, and is estimated on a linear scale.
    """
    place = partial(_limit, span=span, signed=signed)
    return Declared(name, unit, description, place)


def time_constant(name: str, description: str, strength: bool = False) -> Declared:
    """A delay or lag [s]."""
    return Declared(name, "s", description, _time_constant, strength, lower=0.0)


def constant(name: str, unit: str, description: str) -> Declared:
    """A parameter that is never estimated, such as a reference displacement."""
    return Declared(name, unit, description, parameters.constant)


# Functions and classes of a module, not closures: an effect is sent to other processes.


@dataclass(frozen=True)
class _OnLinearScale:
    """The function behind `signed` and `nonnegative`; see there for the attributes."""

    reach: float
    typical: float
    own_size: bool = False
    lower: float = -math.inf

    def __call__(self, name: str, value: float, unit: str, description: str) -> Parameter:
        size = abs(value) if self.own_size else 0.0
        placed = parameters.signed(name, value, unit, self.reach, size or self.typical, description)
        return replace(placed, lower=max(self.lower, placed.lower))


def _limit(name: str, value: float, unit: str, description: str, span: float, signed: bool) -> Parameter:
    near, far = sorted((value * (1.0 / span), value * span))
    if not signed:
        return Parameter(name, value, unit, near, far, positive=True, description=description)
    return Parameter(name, value, unit, near, far, typical=_NOTICED * abs(value), description=description)


# A noticeable change of a gap, as a share of the gap.
_NOTICED = 0.02


def _time_constant(name: str, value: float, unit: str, description: str) -> Parameter:
    return parameters.time_constant(name, value, description)
