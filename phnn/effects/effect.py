"""The class of effects, one piece of physics that a model may have left out, and the catalogue of them."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from phnn.effects.additions import Addition
from phnn.effects.declaration import Declared, Plausible, always, in_own_units
from phnn.effects.kinds import Kind
from phnn.errors import InputRefused, meant
from phnn.setup import Setup

if TYPE_CHECKING:
    from phnn.effects.soundness import Home

Values = Mapping[str, float]
# Least factor of a strength that cannot be negative.
_LEAST = 1e-3


@dataclass(frozen=True)
class Scales:
    """Typical sizes in a campaign and its base model, from which effects take their grids.

    Attributes:
        voltage: largest input [V]; displacement: largest change of the output [m]; velocity: largest [m/s].
        stiffness: of the base model [N/m]; transducer: its ratio α [N/V].
        slowest, fastest: lowest and highest excited frequency [Hz].
        duration: longest recording [s].
        noise: typical noise floor [m].
        peaks: frequencies [Hz] at which the residual has most power.
        effort: largest force [N] if that is the output, the motion being imposed; 0 if the motion is the output.
    """

    voltage: float
    displacement: float
    velocity: float
    stiffness: float
    transducer: float
    slowest: float
    fastest: float
    duration: float
    noise: float
    peaks: tuple[float, ...] = ()
    effort: float = 0.0

    @property
    def sensed(self) -> float:
        """Largest output: of the displacement, or of the force that an imposed motion requires."""
        return self.effort or self.displacement

    @property
    def shortest(self) -> float:
        """Time in which the highest excited frequency turns by one radian [s]."""
        return 1.0 / (2.0 * math.pi * self.fastest)

    @property
    def sensed_rate(self) -> float:
        """Largest rate of the output."""
        return 2.0 * math.pi * self.fastest * self.effort if self.effort else self.velocity


class Points:
    """A grid that is written down, for laws of which single points are known.

    Args:
        points: values by parameter: a number, the name of a scale, or a factor of scales such as ``(0.1, "voltage")``
            and ``(1e-3, "noise", "1/duration")``.
    """

    def __init__(self, *points: Mapping[str, Any]) -> None:
        self.points = points

    def __call__(self, scales: Scales) -> list[dict[str, float]]:
        return [{name: self._value(given, scales) for name, given in point.items()} for point in self.points]

    @staticmethod
    def _value(given: Any, scales: Scales) -> float:
        value, *names = given if isinstance(given, tuple) else (1.0, given) if isinstance(given, str) else (given,)
        for name in names:
            size = float(getattr(scales, name.removeprefix("1/")))
            value = value / size if name.startswith("1/") else value * size
        return value


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A member of the catalogue.

    Its law is written for a displacement ``q`` that a momentum ``p`` moves, with stiffness ``k`` and damping ``b``, for
    a port ``voltage`` that acts on it with the ratio ``alpha``, and hysterons ``Q_i`` with ``C_i``, ``rho_i``, ``d_i``;
    `phnn.effects.places` finds the parts with these roles in a network of other names.

    Attributes:
        name: canonical name.
        kind: the local variables and the location through which it acts; effects of one kind act through the same ones.
        equation: LaTeX.
        statement: one or two sentences for readers; ``{parameter}`` is replaced by its value with unit.
        fingerprint: one sentence: the features of recordings that indicate the effect.
        separation: one sentence: the experiment that separates it from its neighbours.
        references: sources of the law.
        declares: its parameters.
        adds: its addition to a setup; see `phnn.effects.additions`.
        grid: values of all its parameters to probe, given the scales. Strengths are small there.
        applies: whether it can be added to a setup at all.
        neighbours: effects that ordinary recordings cannot always tell apart from it.
        equivalents: function from all values of a model with it to other values that explain as much, because parts of
            the model can be exchanged; a refit without the effect starts there too.
        searched: the parameter that is a frequency to be found in the spectrum of the residual.
        wavelength: the parameter that is a period to be found in the residual's spectrum along the measured position.
        rescale: how to multiply the strength, if that takes more than multiplying parameters.
        forms: the same physics by other laws, under the same name, at the same place and of the same kind.
        place: displacement of the motion on which it acts, if that is not the measured one.
        at_most: how many copies of it may act at one place, 1 to 3; which: "second" or "third", empty for the first.
        after: parameters of the previous copy, which the setup must already have.
        several_of: name of the effect of which a learned element is a sum of several copies.

    Two effects are equal if their data fields are equal. Functions are not compared, so that an effect that another
    process sends back is equal to the original.
    """

    name: str
    kind: Kind
    equation: str
    statement: str
    fingerprint: str
    separation: str
    references: tuple[str, ...]
    adds: Addition = field(compare=False)
    grid: Callable[[Scales], list[dict[str, float]]] = field(compare=False)
    declares: tuple[Declared, ...] = ()
    applies: Callable[[Setup], bool] = field(default=always, compare=False)
    neighbours: tuple[str, ...] = ()
    equivalents: Callable[[Values], list[dict[str, float]]] | None = field(default=None, compare=False)
    searched: str | None = None
    wavelength: str = ""
    rescale: Callable[[Values, float], dict[str, float]] | None = field(default=None, compare=False)
    forms: tuple[Effect, ...] = ()
    place: str = ""
    at_most: int = 1
    which: str = ""
    after: tuple[str, ...] = ()
    several_of: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.kind, Kind):
            raise InputRefused(
                f"effect {self.name}: its kind is {self.kind!r}: give one of those of phnn.effects.kinds, such as "
                "DISSIPATIVE, or a Kind of your own"
            )

    @property
    def location(self) -> str:
        """Return one of `phnn.effects.kinds.LOCATIONS`."""
        return self.kind.location

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return tuple(d.name for d in self.declares)

    @property
    def plausible(self) -> dict[str, Plausible]:
        """Plausible range of each of its parameters in real actuators."""
        return {d.name: d.plausible for d in self.declares}

    @property
    def all_strengths(self) -> tuple[str, ...]:
        """Return the parameters that are zero when the effect is absent."""
        return tuple(d.name for d in self.declares if d.strength)

    @property
    def strength(self) -> str | None:
        """Return the first parameter that is zero when the effect is absent; None where there is no such parameter."""
        return next(iter(self.all_strengths), None)

    @property
    def strengths(self) -> tuple[str, ...]:
        """Return all parameters that are zero when the effect is absent, where there are several of them."""
        return self.all_strengths if len(self.all_strengths) > 1 else ()

    @property
    def one_sided(self) -> bool:
        """Return whether only positive strengths are physical; the amplitudes of a nuisance may have either sign."""
        signs = all(d.lower >= 0.0 for d in self.declares if d.strength)
        return signs and not getattr(self.adds, "signless", False)

    @property
    def passive(self) -> bool:
        """Return whether adding it keeps ``J = −Jᵀ``, ``D ≥ 0`` and ``H`` bounded below."""
        return getattr(self.adds, "passive", True)

    @property
    def needs_command(self) -> bool:
        """Return whether it is meaningful only if the recorded voltage is the amplifier's command."""
        return self.location == "amplifier"

    @property
    def title(self) -> str:
        """Name in the catalogue and place, the same for all copies."""
        return self.name.removeprefix(f"{self.which} ") if self.which else self.name

    @property
    def canonical(self) -> str:
        """Name in the catalogue, the same at all places."""
        return self.title.removesuffix(f" at {self.place}") if self.place else self.title

    def is_neighbour_of(self, other: Effect) -> bool:
        """Return whether ordinary recordings cannot always tell the two apart, as one of them declares."""
        return self.title in other.neighbours or other.title in self.neighbours

    def or_as(self, **changes: object) -> Effect:
        """Return the effect with one more form, which differs in these fields."""
        return replace(self, forms=(*self.forms, replace(self, forms=(), **changes)))  # type: ignore[arg-type]

    def scaled(self, values: Values, factor: float) -> dict[str, float]:
        """Parameter values with the strengths multiplied, kept within a physical range.

        Args:
            values: a grid point.
            factor: estimated ratio of the strength to that of the grid point, to first order.
        """
        if self.rescale is not None:
            return self.rescale(values, factor)
        factor = max(factor, _LEAST) if self.one_sided else factor
        return dict(values) | {name: values[name] * factor for name in self.all_strengths}

    def can_be_added_to(self, setup: Setup) -> bool:
        """Return whether it can be added to the setup: its condition holds, the previous copy is there, and its own
        parameter names are free."""
        there = set(setup.parameters)
        return self.applies(setup) and set(self.after) <= there and not set(self.parameters) & there

    def build(self, setup: Setup, values: Values) -> Setup:
        """Return the setup with the effect's addition, its parameters at the given values [SI]."""
        built = self.adds(setup, {d.name: d.at(values[d.name], setup) for d in self.declares})
        network, before = built.network, setup.network.storage_names
        storages = tuple(
            s if s.name in before else replace(s, unit=in_own_units(s.unit, setup)) for s in network.storages
        )
        return replace(built, network=replace(network, storages=storages)) if storages != network.storages else built

    def add_to(self, setup: Setup, values: Values) -> Setup:
        """Return the setup with this effect at the given parameter values [SI], renamed to say so.

        Raises:
            InputRefused: it does not apply to the setup, or is in it already.
        """
        if not self.applies(setup) and not set(self.parameters) & set(setup.parameters):
            wanted = (self.applies.__doc__ or "").strip()
            raise InputRefused(f"{self.name} cannot be added to {setup.name}; it can be where this holds: {wanted}")
        return replace(self.build(setup, values), name=f"{setup.name}+{self.name}")


_CHAPTERS = tuple(
    f"phnn.effects.{chapter}"
    for chapter in ("amplifier", "electrical", "environment", "hysteresis", "mechanical", "sensor", "tanks")
)
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
# Names by which laws refer to existing parts: the moving part, its transducer and the hysterons.
_ROLES = re.compile(r"[kmb]|alpha|(C|rho|d)_\d+")
_registered: dict[str, Effect] = {}


def catalogue() -> dict[str, Effect]:
    """Return all effects by name, registered ones last."""
    return {**_own(), **_registered}


@cache
def _own() -> dict[str, Effect]:
    return gathered(*_CHAPTERS)


def gathered(*modules: str) -> dict[str, Effect]:
    """Return the effects that modules define under public names, by their own names in alphabetical order."""
    defined = [item for module in modules for item in vars(importlib.import_module(module)).items()]
    members = [member for name, member in defined if isinstance(member, Effect) and not name.startswith("_")]
    return {member.name: member for member in sorted(members, key=lambda member: member.name)}


def effect(name: str) -> Effect:
    """Return one effect by name.

    Raises:
        InputRefused: there is no such effect; the message lists those that exist.
    """
    if name not in catalogue():
        raise InputRefused(
            f"no effect called {name!r}{meant(name, catalogue())}: the catalogue has {', '.join(catalogue())}"
        )
    return catalogue()[name]


def in_all_forms(effects: Iterable[Effect]) -> list[Effect]:
    """Effects and their other forms."""
    return [form for e in effects for form in (e, *e.forms)]


def register(effect: Effect, home: Home | None = None) -> Effect:
    """Add an effect of your own to the catalogue of this process, so that every diagnosis looks for it.

    It must pass the checks of the catalogue's own effects (`phnn.effects.soundness`). They simulate it on a small base
    model; this takes some seconds.

    Example:
        >>> from phnn.effects import Effect, register  # doctest: +SKIP
        >>> register(Effect(name="position_damping", ...))  # doctest: +SKIP

    Args:
        effect: see docs/write-your-own-effect.md.
        home: a base model to which it can be added, with sizes and a recording. The default is the piezo actuator of
            the paper, or a pair of tanks if the effect applies to these alone.

    Returns:
        The effect.

    Raises:
        InputRefused: a name is taken, the effect applies to no base model, or a check fails; nothing is registered.
    """
    from phnn.effects.soundness import check_effect, home_of

    _refuse_taken_names(effect)
    where = home or home_of(effect)
    if where is None:
        raise InputRefused(
            f"effect {effect.name} can be added to none of the base models, which all lack: "
            f"{(effect.applies.__doc__ or 'its condition').strip()} Give a base model with register(effect, home)"
        )
    check_effect(effect, where)
    _registered[effect.name] = effect
    return effect


def unregister(name: str) -> None:
    """Remove a registered effect from the catalogue.

    Raises:
        InputRefused: no effect of this name was registered.
    """
    if name not in _registered:
        raise InputRefused(f"no effect called {name!r} was registered: there are {', '.join(_registered) or 'none'}")
    del _registered[name]


@contextmanager
def registered(effect: Effect, home: Home | None = None) -> Iterator[Effect]:
    """Register an effect for the duration of a ``with`` block; see `register`."""
    register(effect, home)
    try:
        yield effect
    finally:
        unregister(effect.name)


def _refuse_taken_names(effect: Effect) -> None:
    from phnn.effects.formulas import formulas
    from phnn.effects.learned import learned_elements

    others = {**catalogue(), **learned_elements(), **formulas()}
    if effect.name in others:
        raise InputRefused(f"an effect called {effect.name!r} is there already: choose another name")
    if not _NAME.fullmatch(effect.name):
        raise InputRefused(f"effect {effect.name!r}: name it by lower-case words with underscores, position_damping")
    strange = [n for n in effect.neighbours if n not in catalogue()]
    if strange:
        raise InputRefused(f"effect {effect.name}: its neighbours {strange} are not in the catalogue: leave them out")
    if any((f.name, f.kind) != (effect.name, effect.kind) for f in effect.forms):
        raise InputRefused(f"effect {effect.name}: its forms have other names or kinds: derive them with or_as")
    owners = {n: e.name for e in in_all_forms(others.values()) for n in e.parameters}
    for form in in_all_forms([effect]):
        for name in form.parameters:
            if name in owners or _ROLES.fullmatch(name) or form.parameters.count(name) > 1:
                whose = owners.get(name, "the base model" if _ROLES.fullmatch(name) else "the effect twice")
                raise InputRefused(f"effect {effect.name}: the parameter {name!r} belongs to {whose}: rename it")
