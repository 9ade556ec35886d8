"""One case, opened and graded: what was concealed, what was answered, whether that is right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from studies.generator import Sealed
from studies.proof.cases import Task
from studies.proof.coverage import base_errors, effect_errors, hysterons_of, noise_errors
from studies.proof.grades import EXACT, IN_CLASS, WRONG, Said, expected, grade, true_places
from studies.proof.settings import FAST

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
        truth: missing effects; places: where something is missing; withheld: catalogue entries taken away.
        level: residual over noise of what was concealed; delta: noncentrality of its own direction.
        base: residual over noise of the base fit.
        verdict, named, members, location, tied: the answer.
        dictionary: the location found before naming.
        statistic, p_value, remainder: scores.
        grade: ``exact``, ``class`` or ``wrong``, see `studies.proof.grades`.
        located: ``alone``, ``tied`` or ``no``.
        held_before, held_after: residual over noise on held-out recordings, root mean square.
        worst_before, worst_after: largest relative error of a scale-free group of parameters.
        seconds: of the diagnosis; failure: its message where there was no answer; reason: why it is wrong.
        family: of a null.
        base_errors, effect_errors: of estimates, as normal deviates of their intervals; see
            `studies.proof.coverage`.
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
    said, truth, fit, test = _said(answer), expected(sealed), answer.get("fit", {}), answer.get("test", {})
    errors = [group_error(answer.get("models", {}).get(n, {}), sealed.base) for n in ("base", "model")]
    found = grade(sealed, said)
    if task.tier == FAST and found == EXACT and len(said.classes) == 1 and len(said.classes[0]) > 1:
        found = IN_CLASS
    location, places = answer.get("location") or {}, true_places(sealed)
    by_noise = [tuple(e.values()) for e in noise_errors(answer.get("estimates", {}), missing, sealed)]
    return Outcome(
        task.name, task.tier, task.group, task.seed, task.plan, sealed.stratum, sealed.form, truth,
        places, tuple(sealed.withheld), sealed.strength_over_noise, sealed.delta,
        float(answer.get("base_residual_over_noise", _base(fit))), said.verdict, named,
        tuple(dict.fromkeys(n for c in said.classes for n in c)), said.place, said.tied,
        str((location.get("dictionary") or [said.place])[0]),
        float(test.get("statistic") or np.nan), float(test.get("p_value") or np.nan),
        str((answer.get("remainder") or {}).get("verdict", "")), found, said.located(places),
        said.before, said.after, errors[0], errors[1], float(answer.get("seconds", np.nan)),
        str(answer.get("failure", "")),
        "" if found != WRONG else _reason(said, named, truth, sealed, answer), task.family,
        tuple(base_errors(answer.get("estimates", {}), sealed).values()),
        tuple(effect_errors(missing, sealed).values()), by_noise[0], by_noise[1], sealed.base_family,
    )  # fmt: skip


def _said(answer: Mapping[str, Any]) -> Said:
    """What an answer says, as far as its tier goes."""
    missing, fit = answer.get("missing", []), answer.get("fit", {})
    location = answer.get("location") or {}
    own = tuple(str(m.get("location") or "") for m in missing)
    return Said(
        verdict=str(answer.get("verdict", "failed")),
        classes=tuple((m["effect"], *m.get("equivalent_to", ())) for m in missing),
        locations=own,
        place=str(location.get("name") or next(filter(None, own), "")),
        tied=tuple(location.get("tied", ())),
        before=_held(fit, "before"),
        after=_held(fit, "after" if fit.get("after") else "before"),
    )


def _held(fit: Mapping[str, Any], which: str) -> float:
    scores = fit.get(which, {})
    found = [scores[n]["residual_over_noise"] for n in fit.get("held_out", ()) if n in scores]
    return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def _base(fit: Mapping[str, Any]) -> float:
    found = [s["residual_over_noise"] for n, s in fit.get("before", {}).items() if n not in fit.get("held_out", ())]
    return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def group_error(values: Mapping[str, float], true: Mapping[str, float]) -> float:
    """Largest relative error of the groups of parameters that voltage and displacement determine.

    Hysterons have no order of their own; they are compared in the order of their dead zones, where there are as many in
    both. Slopes ``ϱ⁻¹`` are left out: the recordings hardly know that of a fast hysteron.
    """
    if not values:
        return float("nan")
    worst = 0.0
    orders = [sorted(hysterons_of(table), key=lambda i, t=table: t[f"d_{i}"]) for table in (values, true)]  # type: ignore[misc]
    for group in _GROUPS.values():
        indexed = bool({"C", "d"} & set(group))
        if indexed and len(orders[0]) != len(orders[1]):
            continue
        for pair in zip(*orders, strict=True) if indexed else [("", "")]:
            sizes = [
                np.prod([table[f"{n}_{i}" if n in ("C", "d") else n] ** power for n, power in group.items()])
                for table, i in zip((values, true), pair, strict=True)
            ]
            worst = max(worst, abs(float(sizes[0] / sizes[1]) - 1.0))
    return worst


def _reason(
    said: Said, named: tuple[str, ...], truth: tuple[str, ...], sealed: Sealed, answer: Mapping[str, Any]
) -> str:
    """In a few words, from what the answer itself says."""
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
