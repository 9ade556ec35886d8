"""Declarations of effect parameters: name, unit, bounds, role, plausible range; and conditions on setups.

A condition says whether an effect can act in a setup; where it fails, its docstring is shown.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

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
    """Return whether a momentum ``p`` moves the displacement ``q``: forces can act on it."""
    return any({c.to, c.of} == {"q", "p"} for c in setup.network.couplings)


def has_inertia(setup: Setup) -> bool:
    """Return whether a mass of constant inertia moves the displacement ``q``."""
    return has_motion(setup) and any(s.name == "p" and s.law == "capacitor" for s in setup.network.storages)


def inertia(setup: Setup) -> str:
    """Return the parameter by which the momentum ``p`` is a velocity, where `has_inertia` holds."""
    return next(s.parameters[0] for s in setup.network.storages if s.name == "p")


def has_spring(setup: Setup) -> bool:
    """Return whether the displacement ``q`` has a spring of its own, not only a storage that keeps the position."""
    stiffness = [s.parameters[0] for s in setup.network.storages if s.name == "q" and s.law in SPRINGS]
    return has_motion(setup) and any(setup.parameters[name].value > 0.0 for name in stiffness)


def has_dead_zones(setup: Setup) -> bool:
    """Return whether at least one resistor has a dead zone: there are hysterons."""
    return bool(hysterons(setup.network))


def has_plain_dead_zones(setup: Setup) -> bool:
    """Return whether at least one resistor has a dead zone that follows no state yet."""
    return any(r.law == "dead_zone" for r in setup.network.resistors)


def has_transducer(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio by which the voltage port acts on the momentum, not through a resistor."""
    ports = [p for p in setup.network.ports if p.law not in THROUGH_A_RESISTOR]
    return has_motion(setup) and any(p.name == "voltage" and p.on.get("p") == "alpha" for p in ports)


def has_tanks(setup: Setup) -> bool:
    """Return whether stores of constant capacity, not of heat or charge, drain through resistors alone."""
    network = setup.network
    stores = all(s.law == "capacitor" and s.unit not in ("J", "K", "C") for s in network.storages)
    return stores and not network.couplings


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
    for text, replacement in (("{sensed}", sensed), ("V", source)):
        if text in unit:
            plain = unit.replace(f"/{text}^2", "").replace(f"/{text}", "") if replacement == "1" else unit
            return plain.replace(text, replacement).replace("/s/s", "/s²")
    moved = units.get("q", "m")
    effort = effort_unit(f"{moved}/s")
    if moved == "m" or (effort == "1" and re.search(r"N|kg", unit)):
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
        strength: whether the parameter is zero when the effect is absent.
        lower, upper: bounds that hold in every setup.
        scale: ``log`` (of positive values), ``linear``, or ``fixed`` for what is never estimated.
        usual: the range in which it may always move.
        span: it may also move by this factor from its start value; on a linear scale up to as many times its size.
        keeps_sign: on a linear scale it moves by the factor and keeps its sign.
        typical: size of a noticeable change on a linear scale; own_size: that change as a share of the start value's
            size, where that is not zero.
        plausible: range in real actuators; see `plausibly`.
    """

    name: str
    unit: str
    description: str
    strength: bool = False
    lower: float = -math.inf
    upper: float = math.inf
    scale: str = "linear"
    usual: tuple[float, float] = (-math.inf, math.inf)
    span: float = 1.0
    keeps_sign: bool = False
    typical: float = 1.0
    own_size: float = 0.0
    plausible: Plausible = NO_RANGE

    def plausibly(self, lower: float, upper: float, source: str, *, over: str = "", outside: str = "") -> Declared:
        """Return the parameter with its plausible range; for the arguments see `Plausible`."""
        return replace(self, plausible=Plausible(lower, upper, source, over, outside))

    def at(self, value: float, setup: Setup) -> Parameter:
        """Return the parameter with a value [SI], for a setup.

        Raises:
            InputRefused: the value is not finite or lies outside the bounds.
        """
        unit = in_own_units(self.unit, setup)
        if self.scale == "fixed":
            return Parameter(self.name, value, unit, fixed=True, description=self.description)
        positive, size = self.scale == "log", abs(value)
        if positive or self.keeps_sign:
            near, far = sorted((value / self.span, value * self.span))
        else:
            near, far = -self.span * size, self.span * size
        lower, upper = max(self.lower, min(self.usual[0], near)), min(self.upper, max(self.usual[1], far))
        typical = self.own_size * size or self.typical
        return Parameter(self.name, value, unit, lower, upper, positive, typical, description=self.description)


# Where no range is usual, and how far a parameter may move from its start value where the usual range is narrower.
_NONE, _FAR = (math.inf, -math.inf), 1e6


def positive(name: str, unit: str, description: str, span: float = _FAR, strength: bool = False) -> Declared:
    """A positive parameter, estimated on a logarithmic scale, bounded to a factor ``span`` in either direction."""
    return Declared(name, unit, description, strength, 0.0, scale="log", usual=_NONE, span=span)


def signed(
    name: str, unit: str, description: str, reach: float, typical: float, strength: bool = False, own_size: bool = False
) -> Declared:
    """Return a parameter on a linear scale, of either sign.

    Args:
        reach: largest size; at most a factor 10⁶ beyond the start value.
        typical: size of a noticeable change.
        own_size: a noticeable change is as large as the start value, unless that is zero.
    """
    usual = (-reach, reach)
    return Declared(
        name, unit, description, strength, usual=usual, span=_FAR, typical=typical, own_size=float(own_size)
    )


def nonnegative(name: str, unit: str, description: str, reach: float, typical: float) -> Declared:
    """Return a parameter on a linear scale that is zero or positive; for the arguments see `signed`."""
    return replace(signed(name, unit, description, reach, typical), lower=0.0)


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
    """Return a parameter between fixed bounds on a linear scale; ``typical`` is the size of a noticeable change."""
    return Declared(name, unit, description, strength, lower, upper, typical=typical)


def between(name: str, unit: str, description: str, lower: float, upper: float) -> Declared:
    """Return a positive parameter between fixed bounds, estimated on a logarithmic scale."""
    return Declared(name, unit, description, False, lower, upper, "log")


# A noticeable change of a gap, as a share of the gap.
_NOTICED = 0.02


def limit(name: str, unit: str, description: str, span: float, signed: bool = False) -> Declared:
    """Return a limit, level or gap; it keeps its sign, and is bounded to a factor ``span`` in either direction.

    Args:
        signed: it may be negative, and is estimated on a linear scale.
    """
    if not signed:
        return Declared(name, unit, description, scale="log", usual=_NONE, span=span)
    return Declared(name, unit, description, usual=_NONE, span=span, keeps_sign=True, typical=0.0, own_size=_NOTICED)


def time_constant(name: str, description: str, strength: bool = False) -> Declared:
    """Return a delay or lag [s]: from 1 ns to 10 s as in actuators, or a factor 10⁶ either way around its value.

    What drives a system gives the value a start, so that tanks that are sampled every few seconds have room as well.
    """
    return Declared(name, "s", description, strength, 0.0, scale="log", usual=(1e-9, 10.0), span=_FAR)


def constant(name: str, unit: str, description: str) -> Declared:
    """Return a parameter that is never estimated, such as a reference displacement."""
    return Declared(name, unit, description, scale="fixed")
