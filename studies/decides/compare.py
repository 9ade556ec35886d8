"""Compare ways to weigh the visited models of sealed cases, offline, from a log of `studies.decides.visit`.

Each way gives every model a number. The answer of a case is then a distribution over sets of effects, and a verdict by
the rules of `phnn.diagnose.verdict`. Both are held against what was concealed:

nothing concealed:   ``none`` is right; every name is wrong.
listed effects:      exactly their names are right. Each other name is wrong, but for what really acts beside them:
                     creep and asymmetry of a background, and anything at the hysteron where the hysteresis is another
                     one. There, and where the law has another form, learned elements may stand beside the names.
outside:             no name of the catalogue is right. The probability of being right is what the surest name leaves.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import Criteria
from phnn.diagnose.number import Misfit, Visited, Weighed, best_to_write, log_weight, weigh
from phnn.diagnose.verdict import CLASS, EQUIVALENT, NAMED, NONE, UNKNOWN, conclude
from phnn.errors import InputRefused
from studies.decides.visit import GROUPS
from studies.generator.cases import CANONICAL, HYSTERONS, LOCATION

Array = NDArray[np.float64]
Models = Sequence[Visited]

CRITERIA = Criteria()
# Share of its misfit that the product tolerates.
HALF = 0.5
# What a background consists of.
BACKGROUND = frozenset({"creep", "hysteresis_asymmetry"})
# Least probability of a statement that enters the calibration, and least one of the logarithmic score.
_STATED, _LEAST = 0.01, 1e-3
# Outcomes of a verdict.
RIGHT, PARTLY, WRONG, MISSED, OPEN = "right", "partly", "wrong", "missed", "open"


@dataclass(frozen=True)
class Element:
    """An element of a logged model, as far as its number and its verdict need it."""

    name: str
    canonical: str
    several_of: str
    location: str
    parameters: tuple[str, ...]
    equation: str


@dataclass(frozen=True)
class Answer:
    """What one way says of a case.

    Attributes:
        alternatives: sets of effects with their probabilities, the largest first.
        probability: of each effect, and of ``none``.
        word: the verdict; claims: status of each element of the written model, and the names that it may have.
    """

    alternatives: list[tuple[tuple[str, ...], float]]
    probability: dict[str, float]
    word: str
    claims: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(frozen=True)
class Case:
    """A row of the log."""

    row: Mapping[str, Any]

    @cached_property
    def models(self) -> list[Visited]:
        """All models that were visited."""
        return [_model(m) for m in self.row["models"]]

    @cached_property
    def truth(self) -> frozenset[str]:
        """Names that are right; none where nothing was concealed, or nothing that the catalogue lists."""
        return frozenset() if self.outside else frozenset(self.row["effects"])

    @property
    def outside(self) -> bool:
        """Whether the catalogue does not hold what was concealed."""
        return bool(self.row["withheld"]) or self.row["form"] == "unlisted"

    @cached_property
    def beside(self) -> frozenset[str]:
        """Names that are not wrong beside the right ones."""
        group = next(g for g in GROUPS if g.name == self.row["group"])
        of_hysteron = {_family(e) for m in self.models for e in m.elements if e.location == LOCATION}
        other = of_hysteron if group.conditions.base != HYSTERONS else set()
        return frozenset((BACKGROUND if group.conditions.background else frozenset()) | other) - self.truth

    @property
    def lenient(self) -> bool:
        """Whether something acts that learned elements may stand for."""
        group = next(g for g in GROUPS if g.name == self.row["group"])
        return bool(group.conditions.background or group.conditions.base != HYSTERONS or self.row["form"] != CANONICAL)

    def counted(self, families: Iterable[str]) -> frozenset[str]:
        """Return the names of a set of effects that must be right."""
        return frozenset(f for f in families if f not in self.beside and not (self.lenient and is_learned_name(f)))

    def right(self, answer: Answer) -> float:
        """Return the probability of the right answer."""
        if self.outside:
            return 1.0 - max(
                (p for n, p in answer.probability.items() if n not in self.beside and not is_learned_name(n)),
                default=0.0,
            )
        return sum(p for families, p in answer.alternatives if self.counted(families) == self.truth)

    @property
    def visited(self) -> bool:
        """Whether the search fitted a right model: without it no way to weigh models can be right."""
        return any(not self.is_wrong_model(m.families) for m in self.models)

    def is_wrong_model(self, families: Sequence[str]) -> bool:
        """Whether a model is no right answer; outside the catalogue one that is all learned is right."""
        if self.outside:
            return not families or any(self.is_wrong(f) for f in families)
        return self.counted(families) != self.truth

    def in_class(self, answer: Answer) -> bool:
        """Whether a few alternatives together are proven, and the right one is among them."""
        enough = np.cumsum([p for _, p in answer.alternatives[:CLASS]])
        size = int(np.searchsorted(enough, CRITERIA.proven)) + 1
        proven = not self.outside and len(enough) > 0 and enough[-1] >= CRITERIA.proven
        return bool(proven and any(self.counted(f) == self.truth for f, _ in answer.alternatives[:size]))

    def is_wrong(self, name: str) -> bool:
        """Whether it is wrong to give a name."""
        return name not in self.truth and name not in self.beside and not is_learned_name(name) and name != NONE

    def statements(self, answer: Answer) -> list[tuple[float, bool]]:
        """Return probability and truth of every effect that is not hardly possible, and of ``none``."""
        stated = {n: p for n, p in answer.probability.items() if not is_learned_name(n) and n not in self.beside}
        nothing = not self.row["effects"]
        return [(p, nothing if n == NONE else n in self.truth) for n, p in stated.items() if p >= _STATED]

    def outcome(self, answer: Answer) -> str:
        """Return whether a verdict is right: ``right``, ``partly``, ``wrong``, ``missed`` (``none`` although something
        was concealed) or ``open`` (no name although there is one, or a doubt where nothing is missing)."""
        if answer.word == NONE:
            return MISSED if self.row["effects"] else RIGHT
        if answer.word == UNKNOWN:
            return RIGHT if self.outside else OPEN
        classes = [c for status, c in answer.claims if status in (NAMED, EQUIVALENT) and not set(c) & self.beside]
        if any(not set(c) & self.truth for c in classes) or not self.truth:
            return WRONG
        return RIGHT if self.truth <= {n for c in classes for n in c} else PARTLY


def _model(logged: Mapping[str, Any]) -> Visited:
    elements: Any = tuple(map(_element, logged["elements"]))
    free = {n for e in elements for n in e.parameters}
    fit: Any = SimpleNamespace(setup=SimpleNamespace(parameters={n: SimpleNamespace(fixed=False) for n in free}))
    fitted, held_out = ({n: Misfit(*m) for n, m in logged[use].items()} for use in ("fitted", "held_out"))
    return Visited(elements, fit, fitted, held_out, logged["nuisances"], logged["converged"])


def _element(logged: Mapping[str, Any]) -> Element:
    name, equation = logged["form"].split(": ", 1)
    several = logged["name"] if is_learned_name(name) and not logged["learned"] else ""
    parameters = tuple(f"{name}.{i}" for i in range(logged["parameters"]))
    return Element(name, logged["name"], several, logged["location"], parameters, equation)


def _family(element: Any) -> str:
    return str(element.several_of or element.canonical)


def is_learned_name(name: str) -> bool:
    """Whether a name is that of a learned element."""
    return name.startswith("learned_")


def cases_in(log: Path) -> tuple[list[Case], int]:
    """Return the cases of a log, and how many could not be diagnosed.

    Raises:
        InputRefused: there is no case in it.
    """
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    rows = [json.loads(line) for line in lines]
    cases = [Case(r) for r in rows if "failure" not in r]
    if not cases:
        raise InputRefused(f"{log}: no case in it: write one by python scripts/decides.py visit --out {log}")
    return cases, len(rows) - len(cases)


def numbered(
    models: Models, rho: Mapping[str, float], criteria: Criteria = CRITERIA,
    change: Callable[[Visited], Visited] = lambda m: m,
) -> Weighed:  # fmt: skip
    """Return models with their numbers for a given ρ, computed from what a change makes of their misfits."""
    logs = np.array([log_weight(change(m), rho, criteria) for m in models])
    order = np.argsort(-logs, kind="stable")
    return Weighed(tuple(models[i] for i in order), logs[order])


def tolerance(models: Models, criteria: Criteria, factor: float) -> dict[str, float]:
    """Return ρ by recording with another share of the misfit than a half."""
    best, floor = numbered(models, {}, criteria).best, 0.5 * criteria.material**2
    return {r: max(floor, factor * (m.chi2 / m.samples - criteria.slack)) for r, m in best.fitted.items()}


def _pooled(model: Visited) -> Visited:
    each = model.fitted.values()
    return replace(model, fitted={"all": Misfit(sum(m.chi2 for m in each), sum(m.samples for m in each))})


def _unknown_variance(model: Visited) -> Visited:
    def log_of(misfits: Mapping[str, Misfit]) -> dict[str, Misfit]:
        return {n: Misfit(m.samples * float(np.log(m.chi2 / m.samples)), m.samples) for n, m in misfits.items()}

    return replace(model, fitted=log_of(model.fitted))


def _with_held_out(models: Models) -> Weighed:
    every = [replace(m, fitted={**m.fitted, **{f"held out {n}": x for n, x in m.held_out.items()}}) for m in models]
    back = {m.key: m for m in models}
    weighed = weigh(every, CRITERIA)
    return Weighed(tuple(back[m.key] for m in weighed.models), weighed.logs)


WAYS: dict[str, Callable[[Models], Weighed]] = {
    "BIC on all samples": lambda m: numbered(m, dict.fromkeys(m[0].fitted, 0.0)),
    "coarsened over all recordings together": lambda m: numbered(m, {}, change=_pooled),
    "coarsened by recording, floor alone": lambda m: numbered(m, {}),
    "**coarsened by recording, with misfit**": lambda m: weigh(m, CRITERIA),
    "the same with held-out recordings": _with_held_out,
    "the same with unknown variance": lambda m: numbered(m, tolerance(m, CRITERIA, HALF), change=_unknown_variance),
}
RULES_ALONE = "best BIC, named by rules"
LOGGED = "the product when it visited"


def answered(case: Case, weighed: Weighed, criteria: Criteria = CRITERIA) -> Answer:
    """Return the answer of a case whose models have other numbers, with the facts of the search as they were logged."""
    facts, early = case.row["facts"], case.row["ended"] != "nothing left"
    promising = int(facts.get("promising", 1)), int(facts.get("remaining", 0))
    model = best_to_write(weighed.models, criteria)
    verdict = conclude(weighed, model, bool(facts.get("new", 1)), promising, criteria, early)
    claims = tuple((c.status, (c.name, *(e.canonical for e in c.alike))) for c in verdict.claims)
    return Answer(weighed.alternatives, verdict.probability, verdict.word, claims)


def by_rules(case: Case) -> Answer:
    """Return the answer of a table of rules: the model with the best BIC is certain, if the held-out error falls by 1 %
    with it and no more than the noise is left."""
    best = WAYS["BIC on all samples"](case.models).best
    base = next(m for m in case.models if not m.elements)
    falls = not best.held_out or best.left_held_out**0.5 < 0.99 * base.left_held_out**0.5
    if best.left > CRITERIA.explained or (best.elements and not falls):
        return Answer([], {}, UNKNOWN, ())
    claims = tuple((NAMED, (f,)) for f in best.families if not is_learned_name(f))
    word = NONE if not best.elements else NAMED if len(claims) == len(best.families) else UNKNOWN
    return Answer([(best.families, 1.0)], dict.fromkeys(best.families or (NONE,), 1.0), word, claims)


def logged_answer(case: Case) -> Answer:
    """Return what the product said when it visited the models."""
    claims = tuple((c["status"], (c["effect"], *c["alike"])) for c in case.row["claims"])
    return Answer(weigh(case.models, CRITERIA).alternatives, case.row["probability"], case.row["verdict"], claims)


def calibration_error(statements: Sequence[tuple[float, bool]], bins: int = 10) -> float:
    """Return the mean distance of probability and frequency over equal bins, weighted by their counts."""
    stated = np.array([p for p, _ in statements])
    true = np.array([t for _, t in statements], dtype=float)
    own = np.minimum((stated * bins).astype(int), bins - 1)
    gaps = [abs(float(np.sum(stated[own == b] - true[own == b]))) for b in range(bins)]
    return sum(gaps) / max(len(statements), 1)


def log_score(case: Case, answer: Answer) -> float:
    """Return the logarithm of the probability of the right answer, and no less than that of a thousandth."""
    return float(np.log(max(case.right(answer), _LEAST)))
