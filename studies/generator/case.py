"""A case of the benchmark: everything that is decided before anything is simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phnn.errors import InputRefused
from studies.generator.base import draw_base, with_hysterons
from studies.generator.conditions import PLAIN, Conditions
from studies.generator.excitation import Excitation
from studies.generator.families import of_family
from studies.generator.noise import Noise
from studies.generator.other_base import HYSTERONS, with_hysteresis
from studies.generator.plans import PLANS, VARIED, plan_of
from studies.generator.strata import STRATA, Choice, in_turn

_EACH = 2.0  # residual over noise that each effect of a pair or triple leaves at least
_COLOURED = 1.0 / 3.0  # of all cases
_COLOURS = (0.3, 0.8)  # coefficient of first-order noise
_HYSTERONS = 2  # of Table 1


@dataclass(frozen=True)
class Case:
    """What will be concealed, and in what recordings.

    Attributes:
        seed: everything follows from it and the stratum.
        stratum: one of ``STRATA``.
        choices: effects to conceal; the next one if no shape of the first can be made strong enough.
        plan: name of the set of recordings.
        base: parameters of the actuator, SI: the ten of Table 1, and those of a third and fourth hysteron or of
            another hysteresis.
        noise: of the sensor.
        targets: wanted of each effect alone: residual over noise, or noncentrality.
        by_delta: whether targets are noncentralities.
        family: of the noise, where one was asked for; empty otherwise.
        conditions: what else was asked for.
        hysterons: of the actuator, where it has them; stated_hysterons, stated_mass: as the manifest gives them, kg.
    """

    seed: int
    stratum: str
    choices: tuple[Choice, ...]
    plan: str
    base: Mapping[str, float]
    noise: Noise
    targets: tuple[float, ...]
    by_delta: bool
    family: str = ""
    conditions: Conditions = PLAIN
    hysterons: int = 2
    stated_hysterons: int = 2
    stated_mass: float = 0.0

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of what is concealed; empty for nothing."""
        return self.choices[0].effects

    @property
    def form(self) -> str:
        """Of the law: "canonical", the name of another form, or "unlisted"."""
        return self.choices[0].form

    @property
    def withheld(self) -> tuple[str, ...]:
        """Names of the catalogue that the diagnosis must do without."""
        return self.choices[0].withheld

    @property
    def recordings(self) -> tuple[Excitation, ...]:
        """What drives the recordings."""
        return plan_of(self.plan, self.stream("plan"))

    def stream(self, use: str, *index: int) -> np.random.Generator:
        """Random numbers of their own for each use, so that one draw more here changes nothing there."""
        return _stream(self.seed, self.stratum, use, *index)


def _stream(seed: int, stratum: str, use: str, *index: int) -> np.random.Generator:
    words = [int.from_bytes(word.encode(), "big") for word in (stratum, use)]
    return np.random.default_rng(np.random.SeedSequence([seed, *words, *index]))


def draw_case(
    seed: int,
    stratum: str,
    plan: str = "full",
    levels: tuple[float, float] = (1.5, 10.0),
    deltas: tuple[float, float] | None = None,
    noise: str | None = None,
    conditions: Conditions = PLAIN,
) -> Case:
    """Decide a case; nothing is simulated.

    Effects go round with the seed, so that consecutive seeds conceal each of them equally often; all else is drawn.

    Args:
        seed: 0 or more.
        stratum: "none": nothing; "same": one listed effect in the form the catalogue gives it;
            "other": one listed effect in another form;
            "pair", "triple": two or three listed effects that differ in kind;
            "outside": one that no catalogue lists, or a listed one whose name is withheld.
        plan: see `studies.generator.plans.plan_of`.
        levels: residual over noise that an effect alone leaves beyond a refit of the base model; log-uniform. Each
            effect of a pair or triple leaves at least twice the noise.
        deltas: noncentralities to draw from instead of ``levels``; log-uniform.
        noise: ``FAMILY`` or ``FAMILY:AMOUNT``, see `generator.noise.Noise`; if left out, one case in three has noise of
            first order, the others have white noise. Deviation and, but for the family ``quantised``, least step stay
            what they are without it.
        conditions: what else is asked for; all other draws stay what they are without.

    Raises:
        InputRefused: unknown stratum, plan or noise, a negative seed, or no range of positive numbers.
    """
    low, high = levels if deltas is None else deltas
    _check(seed, stratum, plan, low, high)
    order, rng = in_turn(stratum, seed, conditions.base), _stream(seed, stratum, "choices")
    effects = len(order[0].effects)
    if effects > 1 and deltas is None:
        low, high = max(low, _EACH), max(high, _EACH)
    base = draw_base(rng)
    deviation, step = float(rng.uniform(20e-9, 80e-9)), int(rng.integers(5, 21)) * 1e-9
    targets = tuple(float(np.exp(rng.uniform(math.log(low), math.log(high)))) for _ in range(max(effects, 2)))
    colour = float(rng.uniform(*_COLOURS)) if rng.random() < _COLOURED else 0.0
    plain = Noise(deviation, step, colour)
    made = plain if noise is None else of_family(noise, plain, _stream(seed, stratum, "noise"))
    hysterons = conditions.drawn_number(_stream(seed, stratum, "number"))
    base = _under(conditions, base, hysterons, seed, stratum)
    return Case(
        seed, stratum, order, plan, base, made, targets[:effects], deltas is not None, (noise or "").partition(":")[0],
        conditions, hysterons, conditions.stated_number(hysterons, _stream(seed, stratum, "order")),
        conditions.stated_mass(base["m"], _stream(seed, stratum, "anchor")),
    )  # fmt: skip


def _check(seed: int, stratum: str, plan: str, low: float, high: float) -> None:
    """Refuse a case that cannot be drawn; see `draw_case`."""
    if stratum not in STRATA:
        raise InputRefused(f"stratum = {stratum!r}: take one of {', '.join(STRATA)}")
    if plan not in (*PLANS, *VARIED):
        raise InputRefused(f"no plan called {plan!r}: take one of {', '.join((*PLANS, *VARIED))}")
    if seed < 0:
        raise InputRefused(f"seed = {seed}: give a whole number, 0 or more")
    if not 0.0 < low <= high < math.inf:
        raise InputRefused(f"from {low} to {high}: give two positive numbers, the smaller one first")


def _under(conditions: Conditions, base: dict[str, float], hysterons: int, seed: int, stratum: str) -> dict[str, float]:
    """The base actuator with the hysteresis or the number of hysterons that the conditions ask for."""
    if conditions.base != HYSTERONS:
        return with_hysteresis(base, conditions.base, _stream(seed, stratum, "hysteresis"))
    if hysterons != _HYSTERONS:
        return with_hysterons(base, hysterons, _stream(seed, stratum, "hysterons"))
    return base
