"""One case, opened and graded: what was concealed, what was answered, whether that is right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phnn.demo import Sealed
from phnn.prove.cases import Task
from phnn.prove.coverage import base_errors, effect_errors, noise_errors
from phnn.prove.settings import FAST

# A class or a set of locations larger than this helps nobody.
CLASS, TIED = 4, 3
EXACT, IN_CLASS, WRONG = "exact", "class", "wrong"
# What V → q determines whatever the common factor of all impedances, as products of powers of parameters.
_GROUPS = {
    "m/alpha": {"m": 1, "alpha": -1},
    "k/alpha": {"k": 1, "alpha": -1},
    "b/alpha": {"b": 1, "alpha": -1},
    "C/alpha": {"C": 1, "alpha": -1},
    "d": {"d": 1},
}


@dataclass(frozen=True)
class Outcome:
    """A graded case; every field is plain, so that a row of a table holds it.

    Attributes:
        name, tier, group, seed, plan, stratum, form: which case.
        truth: concealed effects; places: their locations; withheld: catalogue entries taken away.
        level: residual over noise of what was concealed; delta: noncentrality of its own direction.
        base: residual over noise of the base fit.
        verdict, named, members, location, tied: the answer.
        dictionary: the location found before naming.
        statistic, p_value, remainder: scores.
        grade: ``exact``, ``class`` or ``wrong``; located: ``alone``, ``tied`` or ``no``.
        held_before, held_after: residual over noise on held-out recordings, root mean square.
        worst_before, worst_after: largest relative error of a scale-free group of parameters.
        seconds: of the diagnosis; failure: its message where there was no answer; reason: why it is wrong.
        family: of a null.
        base_errors, effect_errors: of estimates, as normal deviates of their intervals; see `phnn.prove.coverage`.
        base_by_noise, effect_by_noise: the same at the stated mass, in intervals that take it as exact.
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

    def row(self) -> dict[str, Any]:
        """For a table; sequences joined."""
        return {k: _joined(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}


def _joined(values: tuple[Any, ...]) -> str:
    if values and isinstance(values[0], float):
        return " ".join(f"{v:.4g}" for v in values)
    return "+".join(values)


def graded(task: Task, sealed: Sealed, answer: Mapping[str, Any]) -> Outcome:
    """Hold an answer against what was sealed.

    Args:
        answer: ``diagnosis.json``, or as much of it as the tier gives; ``{"failure": message}`` where there was none.
    """
    missing = answer.get("missing", [])
    named = tuple(m["effect"] for m in missing if m["effect"] != "unknown")
    classes = [(m["effect"], *m.get("equivalent_to", ())) for m in missing]
    location = answer.get("location") or {}
    own = tuple(m["location"] for m in missing if m.get("location"))
    place = str(location.get("name") or (own[0] if own else ""))
    tied = tuple(location.get("tied", ()))
    truth = expected(sealed)
    beside = tuple(n for n in sealed.background_effects if n not in truth)
    fit = answer.get("fit", {})
    held = [_held(fit, "before"), _held(fit, "after") if fit.get("after") else _held(fit, "before")]
    errors = [group_error(answer.get("models", {}).get(n, {}), sealed.base) for n in ("base", "model")]
    test = answer.get("test", {})
    verdict = str(answer.get("verdict", "failed"))
    told = [c for c in classes if c[0] not in beside]
    # A name of the background is right, but says nothing of what the case is about.
    about = "none" if classes and not told else verdict
    grade = _grade(sealed.stratum, truth, about, told, place, tied, sealed.location)
    if task.tier == FAST and grade == EXACT and len(classes) == 1 and len(classes[0]) > 1:
        grade = IN_CLASS
    return Outcome(
        task.name, task.tier, task.group, task.seed, task.plan, sealed.stratum, sealed.form, truth,
        tuple(sealed.location), tuple(sealed.withheld), sealed.strength_over_noise, sealed.delta,
        float(answer.get("base_residual_over_noise", _base(fit))), verdict, named,
        tuple(dict.fromkeys(n for c in classes for n in c)), place, tied,
        str((location.get("dictionary") or [place])[0]),
        float(test.get("statistic") or np.nan), float(test.get("p_value") or np.nan),
        str((answer.get("remainder") or {}).get("verdict", "")), grade, _located(place, tied, sealed.location),
        held[0], held[1], errors[0], errors[1], float(answer.get("seconds", np.nan)), str(answer.get("failure", "")),
        "" if grade != WRONG else _reason(verdict, named, truth, answer), task.family,
        tuple(base_errors(answer.get("estimates", {}), sealed).values()),
        tuple(effect_errors(missing, sealed).values()),
        *(tuple(errors.values()) for errors in noise_errors(answer.get("estimates", {}), missing, sealed)),
    )  # fmt: skip


def expected(sealed: Sealed) -> tuple[str, ...]:
    """What is missing from the base model: what was concealed, and a hysteron where the manifest states too few."""
    lacks = sealed.hysterons > sealed.stated_hysterons and "extra_hysteron" not in sealed.effects
    return (*sealed.effects, *(["extra_hysteron"] if lacks else []))


def _grade(
    stratum: str,
    truth: tuple[str, ...],
    verdict: str,
    classes: list[tuple[str, ...]],
    place: str,
    tied: tuple[str, ...],
    places: tuple[str, ...],
) -> str:
    if stratum == "none" and not truth:
        return EXACT if verdict == "none" else WRONG
    if stratum == "outside":
        return EXACT if verdict == "unknown" and _located(place, tied, places) != "no" else WRONG
    if verdict not in ("named", "equivalent") or len(classes) != len(truth):
        return WRONG
    if {c[0] for c in classes} == set(truth):
        return EXACT if all(len(c) == 1 for c in classes) else IN_CLASS
    found = all(any(t in c and len(c) <= CLASS for c in classes) for t in truth)
    return IN_CLASS if found else WRONG


def _located(place: str, tied: tuple[str, ...], places: tuple[str, ...]) -> str:
    if place in places and not tied:
        return "alone"
    return "tied" if len(tied) < TIED and set(places) & {place, *tied} else "no"


def _held(fit: Mapping[str, Any], which: str) -> float:
    scores = fit.get(which, {})
    found = [scores[n]["residual_over_noise"] for n in fit.get("held_out", ()) if n in scores]
    return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def _base(fit: Mapping[str, Any]) -> float:
    found = [s["residual_over_noise"] for n, s in fit.get("before", {}).items() if n not in fit.get("held_out", ())]
    return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def group_error(values: Mapping[str, float], true: Mapping[str, float]) -> float:
    """Largest relative error of the groups of parameters that voltage and displacement determine.

    Hysterons have no order of their own; they are compared in the order of their dead zones. Slopes ``ϱ⁻¹`` are left
    out: the recordings hardly know that of a fast hysteron.
    """
    if not values:
        return float("nan")
    worst = 0.0
    orders = [sorted((1, 2), key=lambda i: table[f"d_{i}"]) for table in (values, true)]
    for group in _GROUPS.values():
        indexed = bool({"C", "d"} & set(group))
        for pair in zip(*orders, strict=True) if indexed else [(0, 0)]:
            sizes = [
                np.prod([table[f"{n}_{i}" if n in ("C", "d") else n] ** power for n, power in group.items()])
                for table, i in zip((values, true), pair, strict=True)
            ]
            worst = max(worst, abs(float(sizes[0] / sizes[1]) - 1.0))
    return worst


def _reason(verdict: str, named: tuple[str, ...], truth: tuple[str, ...], answer: Mapping[str, Any]) -> str:
    """In a few words, from what the answer itself says."""
    if answer.get("failure"):
        return "the diagnosis failed"
    if verdict == "none":
        return "not noticed"
    if verdict == "unknown":
        return "noticed and located, not named" if truth else "something was seen where nothing is missing"
    extra = [n for n in named if n not in truth]
    lacking = [n for n in truth if n not in named]
    if not truth:
        return f"{', '.join(named)} named where nothing is missing"
    if not lacking:
        return f"{', '.join(extra)} named besides"
    return f"{', '.join(extra) or 'nothing'} named instead of {', '.join(lacking)}"
