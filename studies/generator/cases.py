"""Cases of the benchmark: everything that is decided before anything is simulated.

The actuator of a case has the parameters of Table 1, each moved a little, and hysterons; or another hysteresis in their
place, as the voltage that opposes the displacement: then all of the mismatch lies there.

    prandtl_ishlinskii:  V_h = Σ c_i (q − w_i),  eight plays w_i between γ₋(q) − r_i and γ₊(q) + r_i,
                         γ∓(q) = q + (a ∓ δ) g(q),  g(q) = q_p (√(1 + (q/q_p)²) − 1)
    bouc_wen:            V_h = c z,  ż = v − |z/z_b|ⁿ (β |v| sgn z + (1 − β) v)
    duhem:               V_h = c z,  ż = v − |v| z/z₊ on the way up, z₋ on the way down

The lean ``a`` moves both envelopes and so makes the loop asymmetric, the gape ``δ`` parts them. The dissipated powers
``Σ c_i (q − w_i) ẇ_i`` and ``c z (v − ż)`` are not negative for r_i > (|a| + δ) g and β ≥ ½; parameters are drawn so.
Beside such a hysteresis the amplifier has a corner, and the little creep of a background follows the logarithm of time.

References: Al Janaideh, Rakheja, Su 2011 (plays with envelopes); Wen 1976; Dahl 1968 and Visintin 1994 (Duhem).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from phnn.errors import InputRefused
from studies.generator.effects import (
    FORMS,
    FURTHER_UNLISTED,
    LISTED,
    LOCATIONS,
    UNLISTED,
    Concealed,
    Plan,
    Rng,
    drawn,
    log_uniform,
    may_be_paired,
)
from studies.generator.noise import Noise, of_family
from studies.generator.plans import PLANS, VARIED, Excitation, plan_of
from studies.generator.world import ABSENT, FURTHER, TABLE, quasi_static_peak

Base = Mapping[str, float]

HYSTERONS, PRANDTL_ISHLINSKII, BOUC_WEN, DUHEM = "hysterons", "prandtl_ishlinskii", "bouc_wen", "duhem"
BASES = (HYSTERONS, PRANDTL_ISHLINSKII, BOUC_WEN, DUHEM)
LOCATION = "hysteron"  # where a base of another hysteresis differs from the model
MOST = 4  # hysterons of a base
ANCHOR = 0.01  # standard deviation of the weighed mass over the mass
CANONICAL = "canonical"

# What a refit of another hysteresis moves besides mass, stiffness, damping and coupling; q_play is a scale.
_MOVED = {
    PRANDTL_ISHLINSKII: (*(f"{n}_play_{i}" for n in ("c", "r") for i in range(1, 9)), "lean_play", "gape_play"),
    BOUC_WEN: ("c_bouc", "z_bouc", "n_bouc", "beta_bouc"),
    DUHEM: ("c_duhem", "up_duhem", "down_duhem"),
}
# Effects that act on hysterons, and have no meaning where there are none.
ON_HYSTERONS = (
    *("extra_hysteron", "hysteresis_asymmetry", "rate_dependent_threshold", "charge_leakage"),
    *("curved_capacitance", "threshold_drift"),
)

_SPREAD = 0.2  # each parameter of Table 1 moves by up to this part of itself
_SLIPS = 1.1  # charge at the largest voltage over that at which a hysteron slips, at least
_THRESHOLDS = tuple((0.1 * i + 0.02, 0.1 * i + 0.08) for i in range(1, 9))  # of plays, over the largest displacement
_EVEN = 4.0  # concentration of the shares of the plays in their stiffness
_LEAN, _GAPE = (0.4, 0.75), (0.05, 0.25)  # over the least threshold; their sum stays below 1: no cycle gives energy
_SATURATES = (0.25, 0.6)  # z_bouc, and the mean of the two of Duhem, over the largest displacement
_UNEVEN = (0.1, 0.4)  # half the difference of these two over their mean
_CORNER = (1e4, 3e4)  # Hz, of the amplifier before another hysteresis
_EXPONENT, _BETA = (1.0, 2.0), (0.55, 0.9)
_EACH = 2.0  # residual over noise that each effect of a pair or triple leaves at least
_COLOURED = 1.0 / 3.0  # of all cases
_COLOURS = (0.3, 0.8)  # coefficient of first-order noise


def draw_base(rng: Rng) -> dict[str, float]:
    """Draw Table 1 with every parameter moved by up to ±20 %, such that each hysteron slips at the largest voltage.

    A hysteron that never slips is a capacitor in series: its slope and width would be in no recording.
    """
    while True:
        base = {name: value * float(rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD)) for name, value in TABLE.items()}
        charge = base["alpha"] * quasi_static_peak(base)
        if all(charge / base[f"C_{i}"] > _SLIPS * 0.5 * base[f"d_{i}"] for i in (1, 2)):
            return base


def with_hysterons(base: Base, count: int, rng: Rng) -> dict[str, float]:
    """Return the base with 1 to 4 hysterons, all of which slip at the largest voltage.

    With one, the second is left out. The third and the fourth have a capacitance of 1 to 3 times ``C_1``, slip at 5 to
    40 % of the largest displacement and relax in 10 µs to 3 ms. They make the actuator stiffer: the widths of the first
    two shrink with the largest displacement, so that these slip as early in a cycle as before.
    """
    if count == 1:
        return {**base, "C_2": ABSENT, "rho_2": 0.0}
    values, peak = dict(base), quasi_static_peak(base)
    for number in FURTHER[: count - 2]:
        stiffness = float(rng.uniform(1.0 / 3.0, 1.0)) / base["C_1"]
        slips_at = float(rng.uniform(0.05, 0.4)) * peak
        tau = log_uniform(rng, 1e-5, 3e-3)
        values[f"inv_C_{number}"] = stiffness
        values[f"rho_{number}"] = 1.0 / (stiffness * tau)
        values[f"d_{number}"] = 2.0 * stiffness * base["alpha"] * slips_at
    shrunk = quasi_static_peak(values) / peak
    return values | {name: base[name] * shrunk for name in ("d_1", "d_2")}


def with_hysteresis(base: Base, family: str, rng: Rng) -> dict[str, float]:
    """Return the base with another hysteresis in the place of its hysterons, as stiff as they are while none slips.

    Args:
        base: parameters with two hysterons, SI.
        family: one of ``BASES``.
    """
    if family == HYSTERONS:
        return dict(base)
    peak = quasi_static_peak(base)
    stiff = base["alpha"] * (1.0 / base["C_1"] + 1.0 / base["C_2"])  # V/m
    none = {f"{n}_{i}": v for i in (1, 2) for n, v in (("C", ABSENT), ("rho", 0.0))}
    drawn = {PRANDTL_ISHLINSKII: _plays, BOUC_WEN: _bouc_wen, DUHEM: _duhem}[family](rng, peak, stiff)
    return {**base, **none, **drawn, "tau_V": 1.0 / (2.0 * math.pi * log_uniform(rng, *_CORNER))}


def _plays(rng: Rng, peak: float, stiff: float) -> dict[str, float]:
    reach = [float(rng.uniform(*span)) * peak for span in _THRESHOLDS]
    shares = rng.dirichlet([_EVEN] * len(reach))
    least = reach[0] / peak
    sign = float(rng.choice([-1.0, 1.0]))
    lean, gape = (least * float(rng.uniform(*span)) for span in (_LEAN, _GAPE))
    plays = {f"c_play_{i + 1}": stiff * float(share) for i, share in enumerate(shares)}
    plays |= {f"r_play_{i + 1}": r for i, r in enumerate(reach)}
    return plays | {"lean_play": sign * lean, "gape_play": gape, "q_play": peak}


def _bouc_wen(rng: Rng, peak: float, stiff: float) -> dict[str, float]:
    return {
        "c_bouc": stiff * log_uniform(rng, 0.6, 1.2),
        "z_bouc": float(rng.uniform(*_SATURATES)) * peak,
        "n_bouc": float(rng.uniform(*_EXPONENT)),
        "beta_bouc": float(rng.uniform(*_BETA)),
    }


def _duhem(rng: Rng, peak: float, stiff: float) -> dict[str, float]:
    mean, uneven = float(rng.uniform(*_SATURATES)) * peak, float(rng.uniform(*_UNEVEN)) * float(rng.choice([-1.0, 1.0]))
    ends = {"up_duhem": (1.0 + uneven) * mean, "down_duhem": (1.0 - uneven) * mean}
    return {"c_duhem": stiff * log_uniform(rng, 0.6, 1.2), **ends}


def _other_names(base: Base) -> tuple[str, ...]:
    """Return the names of another hysteresis of a base; empty where it has hysterons."""
    return next((names for names in _MOVED.values() if names[0] in base), ())


def acts_on(effect: str, family: str) -> bool:
    """Tell whether an effect has a meaning in an actuator of this hysteresis."""
    return family == HYSTERONS or effect not in ON_HYSTERONS


def moving(base: Base) -> list[str]:
    """Return the names of the parameters that a refit of the base model moves: those of the hysteresis it has."""
    absent = [f"{n}_{i}" for i in (1, 2) for n in ("C", "rho", "d") if base[f"C_{i}"] == ABSENT]
    further = [f"{n}_{number}" for number in FURTHER for n in ("inv_C", "rho", "d") if f"inv_C_{number}" in base]
    return [*(n for n in TABLE if n not in absent), *further, *_other_names(base)]


def as_stated(base: Base) -> dict[str, float]:
    """Return the parameters as a person would state them: ``C_3``, ``rho_3``, ``d_3`` of a third hysteron, etc."""
    other = (*_other_names(base), "q_play")
    stated = {n: base[n] for n in moving(base) if n in TABLE} | {n: base[n] for n in other if n in base}
    for i, number in enumerate(n for n in FURTHER if f"inv_C_{n}" in base):
        stated[f"C_{3 + i}"] = 1.0 / base[f"inv_C_{number}"]
        stated |= {f"{n}_{3 + i}": base[f"{n}_{number}"] for n in ("rho", "d")}
    return stated


@dataclass(frozen=True)
class Conditions:
    """How a case departs from a base of two hysterons that the manifest states rightly and beside which nothing acts.

    Attributes:
        background: a little creep and hysteresis asymmetry act in every recording, see
            `studies.generator.make.draw_background`.
        hysterons: of the actuator, 1 to 4; 0 draws their number.
        wrong_order: the manifest states one hysteron more or less than there are.
        anchor_error: the stated mass is drawn from a normal distribution about the true one, with the stated deviation.
        base: hysteresis of the actuator, one of `BASES`. Where it is not one of hysterons, ``hysterons`` is what the
            manifest states all the same.

    Raises:
        InputRefused: no number of hysterons from 0 to 4, an unknown base, or a wrong order where no order is right.
    """

    background: bool = False
    hysterons: int = 2
    wrong_order: bool = False
    anchor_error: bool = False
    base: str = HYSTERONS

    def __post_init__(self) -> None:
        if not 0 <= self.hysterons <= MOST:
            raise InputRefused(f"hysterons = {self.hysterons}: give 1 to {MOST}, or 0 to draw their number")
        if self.base not in BASES:
            raise InputRefused(f"base = {self.base!r}: take one of {', '.join(BASES)}")
        if self.wrong_order and self.base != HYSTERONS:
            raise InputRefused(
                f"wrong_order: {self.base} has no number of hysterons to state wrongly: set base=hysterons"
            )

    def stated_number(self, hysterons: int, rng: Rng) -> int:
        """Draw the hysterons that the manifest states; one hysteron cannot become none, nor four five."""
        if not self.wrong_order:
            return hysterons
        others = [n for n in (hysterons - 1, hysterons + 1) if 1 <= n <= MOST]
        return int(rng.choice(others))

    def stated_mass(self, mass: float, rng: Rng) -> float:
        """Draw the mass that the manifest states, kg."""
        return float(mass * (1.0 + ANCHOR * rng.standard_normal())) if self.anchor_error else mass


PLAIN = Conditions()


@dataclass(frozen=True)
class Choice:
    """What a case conceals.

    Attributes:
        effects: names; empty for nothing.
        form: of the law: "canonical", the name of another form, or "unlisted".
        withheld: names of the catalogue that the diagnosis must do without.
    """

    effects: tuple[str, ...] = ()
    form: str = CANONICAL
    withheld: tuple[str, ...] = ()

    @property
    def location(self) -> tuple[str, ...]:
        """Canonical location of each effect."""
        return tuple(LOCATIONS[name] for name in self.effects)

    def concealed(self, index: int, rng: Rng, base: Base, plan: Plan) -> Concealed:
        """Draw the shape of effect number ``index``."""
        if self.form in FORMS:
            return FORMS[self.form][1](rng, base, plan)
        return drawn(self.effects[index], rng, base, plan)


def _together(number: int) -> tuple[Choice, ...]:
    """Return the sets of listed effects of which any two may be paired."""
    sets = combinations(LISTED, number)
    return tuple(Choice(s) for s in sets if all(may_be_paired(*pair) for pair in combinations(s, 2)))


def _mixed(every: tuple[Choice, ...]) -> tuple[Choice, ...]:
    """Return an order, always the same, in which neighbours share no more effects than others do."""
    return tuple(every[i] for i in np.random.default_rng(0).permutation(len(every)))


_ROUNDS: dict[str, Callable[[], tuple[Choice, ...]]] = {
    "none": lambda: (Choice(),),
    "same": lambda: tuple(Choice((name,)) for name in LISTED),
    "other": lambda: tuple(Choice((name,), form) for form, (name, _) in FORMS.items()),
    "outside": lambda: (
        *(Choice((name,), withheld=(name,)) for name in LISTED),
        *(Choice((name,), "unlisted") for name in UNLISTED),
    ),
    "pair": lambda: _together(2),
    "triple": lambda: _mixed(_together(3)),
    "unlisted": lambda: tuple(Choice((name,), "unlisted") for name in FURTHER_UNLISTED),
}
STRATA = tuple(_ROUNDS)


@cache
def choices(stratum: str) -> tuple[Choice, ...]:
    """Return all that cases of a stratum can conceal."""
    return _ROUNDS[stratum]()


def in_turn(stratum: str, number: int, base: str = HYSTERONS) -> tuple[Choice, ...]:
    """Return what case ``number`` of a stratum conceals, and what instead where that cannot be made strong enough.

    What is withheld is known before a case is made; nothing takes the place of an effect whose name is withheld.

    Args:
        base: hysteresis of the actuator; what acts on hysterons is left out where there are none.
    """
    everything = tuple(c for c in choices(stratum) if all(acts_on(name, base) for name in c.effects))
    first = number % len(everything)
    order = everything[first:] + everything[:first]
    return tuple(choice for choice in order if choice.withheld == order[0].withheld)


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
    base: Base
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

    def stream(self, use: str, *index: int) -> Rng:
        """Return random numbers of their own for each use, so that one draw more here changes nothing there."""
        return _stream(self.seed, self.stratum, use, *index)


def _stream(seed: int, stratum: str, use: str, *index: int) -> Rng:
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
            "outside": one that no catalogue lists, or a listed one whose name is withheld;
            "unlisted": one of ten further ones that no catalogue lists.
        plan: see `studies.generator.plans.plan_of`.
        levels: residual over noise that an effect alone leaves beyond a refit of the base model; log-uniform. Each
            effect of a pair or triple leaves at least twice the noise.
        deltas: noncentralities to draw from instead of ``levels``; log-uniform.
        noise: ``FAMILY`` or ``FAMILY:AMOUNT``, see `studies.generator.noise.Noise`; if left out, one case in three has
            noise of first order, the others have white noise. Deviation and, but for the family ``quantised``, least
            step stay what they are without it.
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
    made = Noise(deviation, step, colour)
    if noise is not None:
        made = of_family(noise, made, _stream(seed, stratum, "noise"))
    hysterons = conditions.hysterons or int(_stream(seed, stratum, "number").integers(1, MOST + 1))
    if conditions.base != HYSTERONS:
        base = with_hysteresis(base, conditions.base, _stream(seed, stratum, "hysteresis"))
    elif hysterons != PLAIN.hysterons:
        base = with_hysterons(base, hysterons, _stream(seed, stratum, "hysterons"))
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
