"""One case, opened and graded: what was concealed, what was answered, whether that is right.

Nothing missing:
    ``none``. Beside a background its names are exact too, and ``unknown`` counts as a class if the held-out error
    really falls: a background is physics that acts in the recordings, but leaves less than the noise.
Effects missing:
    their names, or a stated class of at most `CLASS` with each of them; names of the background may stand beside, and
    so may elements of the model that claim no name.
Effects whose names are withheld:
    ``unknown`` at their location, tied with at most two others.
Another hysteresis than that of hysterons, nothing concealed:
    a mismatch that is located at the hysteron, or names of what acts there only, where the held-out error really falls;
    a class if the location is tied. ``none`` is right only where the fitted model is at the noise anyway.
Another hysteresis and effects:
    their names or a class, beside which what acts on the hysteron may stand; ``unknown`` at the location of the effect
    or at the hysteron counts as a class.

The held-out error really falls where it falls by more than the share that `phnn.criteria` calls material.

An error of an estimate is a normal deviate of the stated 95 % interval: 1.96 where the truth lies at one of its ends,
in proportion inside. Where no interval is stated the standard error takes its place.

Voltage and displacement leave one common factor of all impedances free, which the stated mass fixes. Where the stated
mass is exact, errors of what scales with it say nothing of its stated deviation: those parameters are left out there.
Where it is drawn, its error moves them all together, so that the base parameters of one case are hardly more than one
draw. `noise_errors` therefore compares with the truth at the stated mass, in intervals that take the mass as exact.
The mass itself is left out always, for its interval is the anchor's own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from phnn.criteria import Criteria
from studies.generator import Sealed
from studies.generator.cases import LOCATION
from studies.proof.cases import FAST, Task

# A class or a set of locations larger than this helps nobody.
CLASS, TIED = 4, 3
EXACT, IN_CLASS, WRONG = "exact", "class", "wrong"
# Held-out residual over noise up to which a model is at the noise; the target of a right diagnosis.
AT_NOISE = 1.1

Class = tuple[str, ...]


@dataclass(frozen=True)
class Said:
    """What an answer says.

    Attributes:
        verdict: ``none``, ``named``, ``equivalent``, ``unknown``, or ``failed``.
        classes: of each entry, its name and those that are stated as equivalent.
        locations: of each entry; empty where it states none.
        place, tied: where the mismatch lies, and where it may lie as well.
        before, after: residual over noise on held-out recordings; NaN without any.
    """

    verdict: str
    classes: tuple[Class, ...]
    locations: tuple[str, ...]
    place: str
    tied: tuple[str, ...]
    before: float
    after: float

    @property
    def names(self) -> bool:
        """Tell whether effects are named."""
        return self.verdict in ("named", "equivalent") and bool(self.classes)

    @property
    def gains(self) -> bool:
        """Tell whether the held-out error falls by more than the share that counts as material."""
        return self.after < (1.0 - Criteria().material_share) * self.before

    def located(self, places: Iterable[str]) -> str:
        """Tell whether the location is one of some places: ``alone``, ``tied`` or ``no``."""
        if self.place in places and not self.tied:
            return "alone"
        return "tied" if len(self.tied) < TIED and set(places) & {self.place, *self.tied} else "no"


def expected(sealed: Sealed) -> tuple[str, ...]:
    """Return what the base model lacks: what was concealed, and a hysteron where the manifest states too few."""
    lacks = sealed.hysterons > sealed.stated_hysterons and "extra_hysteron" not in sealed.effects
    return (*sealed.effects, "extra_hysteron") if lacks and not sealed.base_family else tuple(sealed.effects)


def true_places(sealed: Sealed) -> tuple[str, ...]:
    """Return where something is missing that a case is about."""
    return (*sealed.location, LOCATION) if sealed.base_family else tuple(sealed.location)


def grade(sealed: Sealed, said: Said) -> str:
    """Return ``exact``, ``class`` or ``wrong``, as the table above says."""
    truth = expected(sealed)
    background = set(sealed.background_effects) - set(truth)
    # Beside names, an element without one is a part of the model and claims nothing.
    told = [
        c
        for c, where in zip(said.classes, said.locations, strict=True)
        if (c[0] != "unknown" or not said.names) and not _beside(c, where, sealed, truth, background)
    ]
    if sealed.stratum == "outside":
        unknown = said.verdict == "unknown" and said.located(true_places(sealed)) != "no"
        return EXACT if unknown else WRONG
    if not truth:
        return _of_another_hysteresis(said, told) if sealed.base_family else _of_nothing(said, told, background)
    if sealed.base_family and said.verdict == "unknown":
        return IN_CLASS if said.located(true_places(sealed)) != "no" else WRONG
    return _of_effects(truth, told) if said.names else WRONG


def _beside(c: Class, where: str, sealed: Sealed, truth: tuple[str, ...], background: set[str]) -> bool:
    """Tell whether an entry is right, and says nothing of what the case is about."""
    if set(c) & set(truth):
        return False
    of_base = bool(sealed.base_family and sealed.effects) and where == LOCATION and c[0] != "unknown"
    return of_base or (bool(set(c) & background) and len(c) <= CLASS)


def _of_nothing(said: Said, told: list[Class], background: set[str]) -> str:
    if said.verdict == "none":
        return EXACT
    if said.names and not told:
        return EXACT if all(c[0] in background and len(c) == 1 for c in said.classes) else IN_CLASS
    nameless = said.verdict == "unknown" and all(c[0] == "unknown" for c in told)
    return IN_CLASS if nameless and background and said.gains else WRONG


def _of_another_hysteresis(said: Said, told: list[Class]) -> str:
    """Grade by place and held-out gain: the hysteresis itself has no name in the catalogue."""
    if said.verdict == "none":
        return EXACT if said.before <= AT_NOISE else WRONG
    located = said.located((LOCATION,)) if said.verdict == "unknown" else "no"
    if said.names and told:
        here = all(where == LOCATION for c, where in zip(said.classes, said.locations, strict=True) if c in told)
        located = "alone" if here else "no"
    if located == "no" or not said.gains:
        return WRONG
    return EXACT if located == "alone" else IN_CLASS


def _of_effects(truth: tuple[str, ...], told: list[Class]) -> str:
    if len(told) != len(truth):
        return WRONG
    if {c[0] for c in told} == set(truth):
        return EXACT if all(len(c) == 1 for c in told) else IN_CLASS
    return IN_CLASS if all(any(t in c and len(c) <= CLASS for c in told) for t in truth) else WRONG


_DEVIATE = float(norm.ppf(0.975))  # of the ends of the intervals that are stated
_REFERENCE = 100e-6  # m, displacement that strengths of a seal refer to

# The parameters of the catalogue that are compared, by effect. What the recordings know in products only, as of
# self-heating, is not.
_COMPARED = {
    "creep": ("k_s", "tau_s"), "extra_hysteron": ("C_x", "rho_x", "d_x"), "cubic_stiffness": ("kappa_3",),
    "coulomb_friction": ("F_c",), "quadratic_drag": ("c_2",), "hysteresis_asymmetry": ("kappa_d",),
    "electrostriction": ("epsilon",), "amplifier_lowpass": ("tau_a",), "amplifier_saturation": ("V_max",),
    "sensor_drift": ("drift_rate",), "contact_stop": ("k_c", "g_c"), "quadratic_stiffness": ("kappa_2",),
    "charge_leakage": ("G",), "rate_dependent_threshold": ("kappa_v",), "displacement_coupling": ("kappa_a",),
    "depolarisation": ("delta_z", "tau_z", "V_c"), "second_mode": ("m_2", "k_2", "b_2"), "delay": ("tau_d",),
    "slew_limit": ("S",), "sensor_lag": ("tau_y",), "sensor_nonlinearity": ("a_2", "a_3"),
    "output_backlash": ("delta_b",), "mains_pickup": ("f_m",), "base_motion": ("f_b",),
}  # fmt: skip
# Their names in a seal, where these are others.
_IN_SEAL = {"C_x": "C_3", "rho_x": "rho_3", "d_x": "d_3", "tau_a": "tau_V", "drift_rate": "rate", "g_c": "q_c"}
# The parameter that holds the reference displacement, and its power.
_REFERRED = {"kappa_3": ("q_0", 2), "kappa_d": ("q_d", 1), "kappa_2": ("q_2", 1), "kappa_a": ("q_a", 1)}
# Impedances, admittances and forces per volt: they scale with the common factor.
_SCALED = {"k", "b", "alpha", "k_s", "F_c", "c_2", "k_c", "m_2", "k_2", "b_2", "G", "C_x", "rho_x"}

Estimates = Mapping[str, Mapping[str, Any]]
# The estimate and the truth, by the name of the parameter.
Pairs = dict[str, tuple[Mapping[str, Any], float]]


def base_errors(estimates: Estimates, sealed: Sealed) -> dict[str, float]:
    """Return the error, as a normal deviate, of each base parameter that has an interval.

    Args:
        estimates: ``{"value", "std", "interval_95"}`` by name; hysterons have no order, they are compared in that of
            their dead zones, and nothing is compared where their numbers differ.
    """
    return _errors(_base_pairs(estimates, sealed), sealed)


def effect_errors(missing: Iterable[Mapping[str, Any]], sealed: Sealed) -> dict[str, float]:
    """Return the same of the parameters of each rightly named effect whose law has the form of the catalogue."""
    return _errors(_effect_pairs(missing, sealed), sealed)


def noise_errors(
    estimates: Estimates, missing: Iterable[Mapping[str, Any]], sealed: Sealed
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the same of base and effect parameters by the noise alone.

    The stated mass counts as exact, and what scales with it is compared with the truth times the factor by which the
    stated mass is wrong.

    Args:
        estimates: with ``"interval_95_anchors_exact"`` in place of the interval; those without it are left out.
    """
    factor = sealed.stated_mass / sealed.base["m"] if sealed.stated_mass > 0.0 else 1.0
    intervals = {n: ends for n, e in estimates.items() if (ends := e.get("interval_95_anchors_exact")) is not None}

    def alone(pairs: Pairs) -> dict[str, float]:
        return {
            name: _deviate(float(estimates[name]["value"]), intervals[name], true * factor if _scaled(name) else true)
            for name, (_, true) in pairs.items()
            if name in intervals
        }

    return alone(_base_pairs(estimates, sealed)), alone(_effect_pairs(missing, sealed))


def _base_pairs(estimates: Estimates, sealed: Sealed) -> Pairs:
    own = _in_order({n: float(e["value"]) for n, e in estimates.items()})
    true = _in_order(sealed.base)
    if len(own) != len(true) or not estimates:
        return {}
    names = {n: n for n in ("k", "b", "alpha")}
    names |= {f"{n}_{i}": f"{n}_{j}" for i, j in zip(own, true, strict=True) for n in ("C", "rho", "d")}
    return {n: (estimates[n], sealed.base[of]) for n, of in names.items() if n in estimates}


def _in_order(table: Mapping[str, float]) -> list[str]:
    """Return the numbers of the hysterons among the names of parameters, in the order of their dead zones."""
    return sorted(sorted(n[2:] for n in table if n.startswith("d_") and n[2:].isdigit()), key=lambda i: table[f"d_{i}"])


def _effect_pairs(missing: Iterable[Mapping[str, Any]], sealed: Sealed) -> Pairs:
    """Return nothing where the actuator has another hysteresis: no model is right then, no interval has to hold."""
    pairs: Pairs = {}
    if sealed.base_family:
        return pairs
    canonical = sealed.form == "canonical"
    truth = {**sealed.background, **(sealed.parameters if canonical else {})}
    concealed = (*(sealed.effects if canonical else ()), *sealed.background_effects)
    for entry in missing:
        estimates = entry.get("parameters") or {}
        for name in _COMPARED.get(str(entry["effect"]), ()) if entry["effect"] in concealed else ():
            of, (reference, power) = _IN_SEAL.get(name, name), _REFERRED.get(name, ("", 0))
            if of in truth and name in estimates:
                scale = (float(estimates[reference]["value"]) / _REFERENCE) ** power if power else 1.0
                pairs[name] = (estimates[name], truth[of] * scale)
    return pairs


def _errors(pairs: Pairs, sealed: Sealed) -> dict[str, float]:
    errors = {}
    for name, (estimate, true) in pairs.items():
        if sealed.stated_mass <= 0.0 and _scaled(name):
            continue
        std, value, ends = estimate.get("std"), float(estimate["value"]), estimate.get("interval_95")
        if ends is not None:
            errors[name] = _deviate(value, ends, true)
        elif std is not None and 0.0 < float(std) < math.inf:
            errors[name] = (value - true) / float(std)
    return errors


def _deviate(value: float, ends: Sequence[float], true: float) -> float:
    """Return the error over the part of a 95 % interval on the side of the truth, times 1.96."""
    reach = value - float(ends[0]) if true < value else float(ends[1]) - value
    return _DEVIATE * (value - true) / reach


def _scaled(name: str) -> bool:
    """Tell whether the common factor moves a parameter; hysterons are numbered."""
    kind, _, number = name.partition("_")
    return name in _SCALED or (kind in ("C", "rho") and number.isdigit())


def inside(errors: Iterable[float], share: float) -> list[bool]:
    """Tell of each normal interval of that probability whether it contains the truth."""
    return [abs(error) <= norm.ppf(0.5 + 0.5 * share) for error in errors]


@dataclass(frozen=True)
class Outcome:
    """A graded case; every field is plain, so that a row of a table holds it.

    Attributes:
        name, tier, group, seed, plan, stratum, form: which case.
        truth: missing effects; places: where something is missing; withheld: catalogue entries taken away.
        level: residual over noise of what was concealed; delta: noncentrality of its own direction.
        base: residual over noise of the base fit.
        verdict, named, members, location, tied: the answer.
        dictionary: the location found before naming.
        statistic, p_value, remainder: scores.
        grade: ``exact``, ``class`` or ``wrong``, see `grade`.
        located: ``alone``, ``tied`` or ``no``.
        held_before, held_after: residual over noise on held-out recordings, root mean square.
        worst_before, worst_after: largest relative error of a scale-free group of parameters.
        seconds: of the diagnosis; failure: its message where there was no answer; reason: why it is wrong.
        family: of a null.
        base_errors, effect_errors: of estimates, as normal deviates of their intervals.
        base_by_noise, effect_by_noise: the same at the stated mass, in intervals that take it as exact.
        base_family: hysteresis of the actuator where it is not one of hysterons.
    """

    name: str
    tier: str
    group: str
    seed: int
    plan: str
    stratum: str
    form: str
    truth: tuple[str, ...]
    places: tuple[str, ...]
    withheld: tuple[str, ...]
    level: float
    delta: float
    base: float
    verdict: str
    named: tuple[str, ...]
    members: tuple[str, ...]
    location: str
    tied: tuple[str, ...]
    dictionary: str
    statistic: float
    p_value: float
    remainder: str
    grade: str
    located: str
    held_before: float
    held_after: float
    worst_before: float
    worst_after: float
    seconds: float
    failure: str
    reason: str
    family: str = ""
    base_errors: tuple[float, ...] = ()
    effect_errors: tuple[float, ...] = ()
    base_by_noise: tuple[float, ...] = ()
    effect_by_noise: tuple[float, ...] = ()
    base_family: str = ""

    def row(self) -> dict[str, Any]:
        """Return the fields for a table; sequences joined."""
        return {k: _joined(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}


def _joined(values: tuple[Any, ...]) -> str:
    numbers = bool(values) and isinstance(values[0], float)
    return " ".join(f"{v:.4g}" for v in values) if numbers else "+".join(values)


def graded(task: Task, sealed: Sealed, answer: Mapping[str, Any]) -> Outcome:
    """Hold an answer against what was sealed.

    Args:
        answer: ``diagnosis.json``, or as much of it as the tier gives; ``{"failure": message}`` where there was none.
    """
    said, truth, places = _said(answer), expected(sealed), true_places(sealed)
    missing, fit, test = answer.get("missing", []), answer.get("fit", {}), answer.get("test", {})
    estimates, models, location = answer.get("estimates", {}), answer.get("models", {}), answer.get("location") or {}
    named = tuple(m["effect"] for m in missing if m["effect"] != "unknown")
    result = grade(sealed, said)
    if task.tier == FAST and result == EXACT and len(said.classes) == 1 and len(said.classes[0]) > 1:
        result = IN_CLASS
    held_out = fit.get("held_out", ())
    identified = [n for n in fit.get("before", {}) if n not in held_out]
    base_by_noise, effect_by_noise = noise_errors(estimates, missing, sealed)
    return Outcome(
        name=task.name, tier=task.tier, group=task.group, seed=task.seed, plan=task.plan, family=task.family,
        stratum=sealed.stratum, form=sealed.form, withheld=tuple(sealed.withheld), base_family=sealed.base_family,
        level=sealed.strength_over_noise, delta=sealed.delta, truth=truth, places=places,
        base=float(answer.get("base_residual_over_noise", _rms(fit, "before", identified))),
        verdict=said.verdict, named=named, members=tuple(dict.fromkeys(n for c in said.classes for n in c)),
        location=said.place, tied=said.tied, dictionary=str((location.get("dictionary") or [said.place])[0]),
        statistic=float(test.get("statistic") or np.nan), p_value=float(test.get("p_value") or np.nan),
        remainder=str((answer.get("remainder") or {}).get("verdict", "")),
        grade=result, located=said.located(places), held_before=said.before, held_after=said.after,
        worst_before=group_error(models.get("base", {}), sealed.base),
        worst_after=group_error(models.get("model", {}), sealed.base),
        seconds=float(answer.get("seconds", np.nan)), failure=str(answer.get("failure", "")),
        reason="" if result != WRONG else _reason(said, named, truth, sealed, answer),
        base_errors=tuple(base_errors(estimates, sealed).values()),
        effect_errors=tuple(effect_errors(missing, sealed).values()),
        base_by_noise=tuple(base_by_noise.values()), effect_by_noise=tuple(effect_by_noise.values()),
    )  # fmt: skip


def _said(answer: Mapping[str, Any]) -> Said:
    """Return what an answer says, as far as its tier goes."""
    missing, fit, location = answer.get("missing", []), answer.get("fit", {}), answer.get("location") or {}
    own = tuple(str(m.get("location") or "") for m in missing)
    return Said(
        verdict=str(answer.get("verdict", "failed")),
        classes=tuple((m["effect"], *m.get("equivalent_to", ())) for m in missing),
        locations=own,
        place=str(location.get("name") or next(filter(None, own), "")),
        tied=tuple(location.get("tied", ())),
        before=_rms(fit, "before", fit.get("held_out", ())),
        after=_rms(fit, "after" if fit.get("after") else "before", fit.get("held_out", ())),
    )


def _rms(fit: Mapping[str, Any], which: str, recordings: Iterable[str]) -> float:
    """Return the residual over noise on some recordings, root mean square; NaN without any."""
    scores = fit.get(which, {})
    ratios = [scores[n]["residual_over_noise"] for n in recordings if n in scores]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else float("nan")


def group_error(values: Mapping[str, float], true: Mapping[str, float]) -> float:
    """Return the largest relative error of what voltage and displacement determine, whatever the common factor.

    Hysterons have no order of their own; they are compared in the order of their dead zones, where there are as many in
    both. Slopes ``ϱ⁻¹`` are left out: the recordings hardly know that of a fast hysteron.
    """
    if not values:
        return float("nan")
    pairs = [(n, n) for n in ("m", "k", "b")]
    own, other = _in_order(values), _in_order(true)
    if len(own) == len(other):
        pairs += [(f"{n}_{i}", f"{n}_{j}") for i, j in zip(own, other, strict=True) for n in ("C", "d")]

    def size(table: Mapping[str, float], name: str) -> float:
        return table[name] if name.startswith("d") else table[name] * table["alpha"] ** -1

    return max(abs(float(size(values, a) / size(true, b)) - 1.0) for a, b in pairs)


def _reason(
    said: Said, named: tuple[str, ...], truth: tuple[str, ...], sealed: Sealed, answer: Mapping[str, Any]
) -> str:
    """Say in a few words why an answer is wrong, from what it says itself."""
    if answer.get("failure"):
        return "the diagnosis failed"
    if said.verdict == "none":
        return "not noticed"
    if sealed.base_family and not truth:
        where = "noticed elsewhere than at the hysteron"
        return where if said.gains else "noticed, but the held-out error does not fall"
    if said.verdict == "unknown":
        return "noticed and located, not named" if truth else "something was seen where nothing is missing"
    extra = [n for n in named if n not in (*truth, *sealed.background_effects)]
    lacking = [n for n in truth if n not in named]
    if not truth:
        return f"{', '.join(extra)} named where nothing is missing"
    if not lacking:
        return f"{', '.join(extra)} named besides"
    return f"{', '.join(extra) or 'nothing'} named instead of {', '.join(lacking)}"
