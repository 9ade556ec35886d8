"""Hold answers against what was concealed: the one grading of all studies.

nothing concealed:   ``none`` is right; every name is wrong.
listed effects:      exactly their names are right. Each other name is wrong, but for what really acts beside them:
                     creep and asymmetry of a background, and anything at the hysteron where the hysteresis is another
                     one. There, and where the law has another form, learned elements may stand beside the names.
outside:             no name of the catalogue is right, and ``unknown`` is. The probability of being right is what the
                     surest name leaves.

Where nothing is concealed but something acts all the same, names of that are right, and so is ``unknown`` if the
held-out error falls, with another hysteresis at the hysteron. There ``none`` is right only of a model at the noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.stats import binomtest

from phnn.criteria import Criteria
from phnn.diagnose.number import Misfit, Visited, Weighed, best_to_write, family, uid, weigh
from phnn.diagnose.verdict import CLASS, EQUIVALENT, NAMED, NONE, UNKNOWN
from phnn.effects import catalogue, in_all_forms
from phnn.errors import InputRefused
from studies.generator.cases import CANONICAL, LOCATION
from studies.sealed.run import Row, rows_of

CRITERIA = Criteria()
_HELD, _DECLARED = "held", {uid(e) for e in in_all_forms(catalogue().values()) if e.parameters}
# What a background consists of.
BACKGROUND = ("creep", "hysteresis_asymmetry")
# Least probability of a statement that enters the calibration, and least one of the logarithmic score.
_STATED, _LEAST = 0.01, 1e-3
# Outcomes of a verdict.
RIGHT, PARTLY, WRONG, MISSED, OPEN = "right", "partly", "wrong", "missed", "open"
# Held-out residual over noise up to which a model is at the noise; locations that are still an answer.
AT_NOISE, TIED = 1.1, 3


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
    """What is said of a case.

    Attributes:
        alternatives: sets of effects with their probabilities, the largest first.
        probability: of each effect, and of ``none``.
        word: the verdict; claims: status of each element of the written model, and the names that it may have.
    """

    alternatives: Sequence[tuple[tuple[str, ...], float]]
    probability: Mapping[str, float]
    word: str
    claims: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(frozen=True)
class Case:
    """A row of the log."""

    row: Row

    @cached_property
    def models(self) -> list[Visited]:
        """All models that were visited."""
        return [_model(m) for m in self.row.get("models", ())]

    @cached_property
    def truth(self) -> frozenset[str]:
        """Names that are right; none where nothing was concealed, or nothing that the catalogue lists."""
        names = frozenset(() if self.outside else self.row["effects"])
        # A further hysteron whose law is that of Bouc and Wen may be called by either name.
        also = {c["effect"] for c in self.row.get("claims", ())} & {"bouc_wen_hysteresis"}
        return names - {"extra_hysteron"} | also if also and self.row["form"] == "bouc_wen_hysteron" else names

    @property
    def outside(self) -> bool:
        """Whether the catalogue does not hold what was concealed."""
        return bool(self.row["withheld"]) or self.row["form"] == "unlisted"

    @cached_property
    def background(self) -> frozenset[str]:
        """Names of the physics that acts beside what was concealed; rows of older logs tell it by their group."""
        return frozenset(self.row.get("background", BACKGROUND if "background" in self.row["group"] else ()))

    @property
    def another_base(self) -> bool:
        """Whether the hysteresis of the actuator is not one of hysterons."""
        return bool(self.row.get("base_family", " base of " in self.row["group"]))

    @cached_property
    def beside(self) -> frozenset[str]:
        """Names that are not wrong beside the right ones."""
        models = {family(e) for m in self.models for e in m.elements if e.location == LOCATION}
        claimed = {c["effect"] for c in self.row.get("claims", ()) if c.get("location") == LOCATION}
        return (self.background | (models | claimed if self.another_base else frozenset())) - self.truth

    @property
    def lenient(self) -> bool:
        """Whether something acts that learned elements may stand for."""
        return bool(self.background or self.another_base or self.row["form"] != CANONICAL)

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
        is missing) or ``open`` (no name although there is one, a doubt where nothing is missing, or no answer)."""
        if answer.word == NONE:
            at_noise = not self.another_base or self.held_out[0] <= AT_NOISE
            return RIGHT if at_noise and not self.row["effects"] else MISSED
        if answer.word not in (NAMED, EQUIVALENT):
            acts = self.background or (self.another_base and self.located != "no")
            gained = not self.row["effects"] and acts and self.gains
            return RIGHT if answer.word == UNKNOWN and (self.outside or gained) else OPEN
        every = [set(c) for status, c in answer.claims if status in (NAMED, EQUIVALENT)]
        classes = [c for c in every if c & self.truth or not c & self.beside or len(c) > CLASS]
        if any(not c & self.truth or len(c) > CLASS for c in classes) or self.outside or not every:
            return WRONG
        if not self.truth:
            return RIGHT if not self.another_base or self.gains else WRONG
        return RIGHT if self.truth <= set().union(*classes) else PARTLY

    @cached_property
    def weighed(self) -> Weighed:
        """All models with the numbers that the product gives them."""
        more = self.row["facts"].get("remaining", 1) or self.row["ended"] != "nothing left"
        return weigh(self.models, CRITERIA, None if more else best_to_write(self.models, CRITERIA))

    @cached_property
    def answer(self) -> Answer:
        """What the product said when it visited the models; no word where the diagnosis failed."""
        claims = tuple((c["status"], (c["effect"], *c["alike"])) for c in self.row.get("claims", ()))
        weighed = self.weighed.alternatives if self.models else []
        return Answer(weighed, self.row.get("probability", {}), self.row.get("verdict", ""), claims)

    @cached_property
    def grade(self) -> str:
        """Return ``exact``, ``class`` (the truth is in a stated class) or ``wrong``."""
        if self.outcome(self.answer) != RIGHT:
            return WRONG
        stated = [(status, names) for status, names in self.answer.claims if status in (NAMED, EQUIVALENT)]
        loose = any(status != NAMED or names[0] not in self.truth | self.beside for status, names in stated)
        doubted = self.answer.word == UNKNOWN and not (self.outside or self.located == "alone")
        return "class" if loose or doubted else "exact"

    @property
    def held_out(self) -> tuple[float, float]:
        """Residual over noise of held-out recordings, before and after; NaN without any."""
        before, after = self.row.get("held_out", (float("nan"),) * 2)
        return before, after

    @property
    def gains(self) -> bool:
        """Whether the held-out error falls by more than the share that counts as material."""
        return self.held_out[1] < (1.0 - CRITERIA.material_share) * self.held_out[0]

    @property
    def places(self) -> tuple[str, ...]:
        """Where something is missing that the case is about."""
        return (*self.row["locations"], *([LOCATION] if self.another_base else []))

    @property
    def located(self) -> str:
        """Whether the stated location is a true one: ``alone``, ``tied`` with at most two others, or ``no``."""
        stated = self.row.get("places", ())
        if not set(stated) & set(self.places) or len(stated) > TIED:
            return "no"
        return "alone" if len(stated) == 1 else "tied"


def _model(logged: Mapping[str, Any]) -> Visited:
    elements: Any = tuple(map(_element, logged["elements"]))
    free = {n for e in elements for n in e.parameters} - {_HELD}
    parameters = {n: SimpleNamespace(fixed=False) for n in free}
    # Every sealed actuator follows its input.
    fit: Any = SimpleNamespace(setup=SimpleNamespace(parameters=parameters), explained=1.0)
    fitted, held_out = ({n: Misfit(*m) for n, m in logged[use].items()} for use in ("fitted", "held_out"))
    return Visited(elements, fit, fitted, held_out, logged["nuisances"], logged["converged"])


def _element(logged: Mapping[str, Any]) -> Element:
    name, equation = logged["form"].split(": ", 1)
    several = logged["name"] if is_learned_name(name) and not logged["learned"] else ""
    parameters = tuple(f"{name}.{i}" for i in range(logged["parameters"])) or (_HELD,) * (logged["form"] in _DECLARED)
    return Element(name, logged["name"], several, logged["location"], parameters, equation)


def is_learned_name(name: str) -> bool:
    """Whether a name is that of a learned element."""
    return name.startswith("learned_")


def cases_in(log: Path) -> tuple[list[Case], int]:
    """Return the cases of a log, and how many could not be diagnosed.

    Raises:
        InputRefused: there is no case in it.
    """
    rows = rows_of(log)
    cases = [Case(r) for r in rows if "failure" not in r]
    if not cases:
        raise InputRefused(f"{log}: no case in it: write one by python scripts/decides.py visit --out {log}")
    return cases, len(rows) - len(cases)


def calibration_error(statements: Sequence[tuple[float, bool]], bins: int = 10) -> float:
    """Return the expected calibration error: the mean distance of probability and frequency over equal bins, weighted
    by their counts (Naeini, Cooper & Hauskrecht 2015); NaN without statements."""
    if not statements:
        return float("nan")
    stated, true = np.array(statements, dtype=float).T
    own = np.minimum((stated * bins).astype(int), bins - 1)
    return sum(abs(float(np.sum(stated[own == b] - true[own == b]))) for b in range(bins)) / len(statements)


def log_score(case: Case, answer: Answer) -> float:
    """Return the logarithm of the probability of the right answer, and no less than that of a thousandth."""
    return float(np.log(max(case.right(answer), _LEAST)))


def share_interval(hits: int, cases: int) -> tuple[float, float]:
    """Return the exact 95 % interval of a probability (Clopper & Pearson 1934); all of it without cases."""
    if not cases:
        return 0.0, 1.0
    interval = binomtest(hits, cases).proportion_ci(0.95)
    return float(interval.low), float(interval.high)
