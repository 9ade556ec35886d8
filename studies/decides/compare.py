"""The cases of the study, and ways to weigh their visited models, compared offline from a log of `studies.sealed.run`.

Each way gives every model a number. The answer of a case is then a distribution over sets of effects, and a verdict by
the rules of `phnn.diagnose.verdict`. `studies.sealed.grade` holds both against what was concealed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, cycle, islice, repeat

import numpy as np

from phnn.criteria import Criteria
from phnn.diagnose.number import Misfit, Visited, Weighed, best_to_write, log_weight, weigh
from phnn.diagnose.verdict import NAMED, NONE, UNKNOWN, conclude
from studies.generator.cases import BOUC_WEN, DUHEM, PRANDTL_ISHLINSKII, Conditions
from studies.sealed.grade import CRITERIA, Answer, Case, is_learned_name
from studies.sealed.run import Task

Models = Sequence[Visited]
_BASES = {"plays": PRANDTL_ISHLINSKII, "Bouc-Wen": BOUC_WEN, "Duhem": DUHEM}
GROUPS: tuple[Task, ...] = (
    Task("none", 0, "none"),
    Task("none, process noise", 0, "none", noise="process:0.1"),
    Task("none, pink noise", 0, "none", noise="pink:0.1"),
    Task("none, heavy tails", 0, "none", noise="heavy"),
    Task("listed", 0, "same"),
    Task("listed, another form", 0, "other"),
    Task("outside the catalogue", 0, "outside"),
    Task("pair", 0, "pair"),
    Task("triple", 0, "triple"),
    Task("listed, with a background", 0, "same", conditions=Conditions(background=True)),
    *(Task(f"listed, base of {n}", 0, "same", conditions=Conditions(base=b)) for n, b in _BASES.items()),
    *(Task(f"none, base of {n}", 0, "none", conditions=Conditions(base=b)) for n, b in _BASES.items()),
    Task("unlisted", 0, "unlisted"),
)


def tasks(seed: int, cases: int, shares: Sequence[int], plan: str, levels: tuple[float, float]) -> list[Task]:
    """Return cases of consecutive seeds; the groups take turns, each as often in a round as its share."""
    turns = cycle(chain.from_iterable(map(repeat, GROUPS, shares)))
    return [replace(g, seed=seed + i, plan=plan, levels=levels) for i, g in enumerate(islice(turns, cases))]


def numbered(
    models: Models, rho: Mapping[str, float], criteria: Criteria = CRITERIA,
    change: Callable[[Visited], Visited] = lambda m: m,
) -> Weighed:  # fmt: skip
    """Return models with their numbers for a given ρ, computed from what a change makes of their misfits."""
    logs = np.array([log_weight(change(m), rho, criteria) for m in models])
    order = np.argsort(-logs, kind="stable")
    return Weighed(tuple(models[i] for i in order), logs[order])


def tolerance(models: Models, criteria: Criteria = CRITERIA, factor: float = 0.5) -> dict[str, float]:
    """Return ρ by recording with another share of the misfit than a half."""
    best, floor = numbered(models, {}, criteria).best, 0.5 * criteria.material**2
    return {r: max(floor, factor * (m.chi2 / m.samples - criteria.slack)) for r, m in best.fitted.items()}


def _pooled(model: Visited) -> Visited:
    each = model.fitted.values()
    return replace(model, fitted={"all": Misfit(sum(m.chi2 for m in each), sum(m.samples for m in each))})


def _unknown_variance(model: Visited) -> Visited:
    each = model.fitted.items()
    return replace(model, fitted={n: Misfit(m.samples * float(np.log(m.chi2 / m.samples)), m.samples) for n, m in each})


def _with_held_out(models: Models) -> Weighed:
    every = [replace(m, fitted={**m.fitted, **{f"held out {n}": x for n, x in m.held_out.items()}}) for m in models]
    back = {m.key: m for m in models}
    weighed = weigh(every, CRITERIA)
    return Weighed(tuple(back[m.key] for m in weighed.models), weighed.logs)


WAYS: dict[str, Callable[[Case], Weighed]] = {
    "BIC on all samples": lambda c: numbered(c.models, dict.fromkeys(c.models[0].fitted, 0.0)),
    "coarsened over all recordings together": lambda c: numbered(c.models, {}, change=_pooled),
    "coarsened by recording, with misfit": lambda c: weigh(c.models, CRITERIA),
    "the same with held-out recordings": lambda c: _with_held_out(c.models),
    "the same with unknown variance": lambda c: numbered(c.models, tolerance(c.models), change=_unknown_variance),
    "**with misfit; noise where nothing promises**": lambda c: c.weighed,
}
RULES_ALONE = "best BIC, named by rules"


def answered(case: Case, weighed: Weighed, criteria: Criteria = CRITERIA) -> Answer:
    """Return the answer of a case whose models have other numbers, with the facts of the search as they were logged."""
    facts, early = case.row["facts"], case.row["ended"] != "nothing left"
    promising = int(facts.get("promising", 1)), int(facts.get("remaining", 1))
    model = best_to_write(weighed.models, criteria)
    verdict = conclude(weighed, model, bool(facts.get("new", 1)), promising, criteria, early)
    claims = tuple((c.status, (c.name, *(e.canonical for e in c.alike))) for c in verdict.claims)
    return Answer(weighed.alternatives, verdict.probability, verdict.word, claims)


def by_rules(case: Case) -> Answer:
    """Return the answer of a table of rules: the model with the best BIC is certain, if the held-out error falls by 1 %
    with it and no more than the noise is left."""
    best = WAYS["BIC on all samples"](case).best
    base = next(m for m in case.models if not m.elements)
    falls = not best.held_out or best.left_held_out**0.5 < 0.99 * base.left_held_out**0.5
    if best.left > CRITERIA.explained or (best.elements and not falls):
        return Answer([], {}, UNKNOWN, ())
    claims = tuple((NAMED, (f,)) for f in best.families if not is_learned_name(f))
    word = NONE if not best.elements else NAMED if len(claims) == len(best.families) else UNKNOWN
    return Answer([(best.families, 1.0)], dict.fromkeys(best.families or (NONE,), 1.0), word, claims)
