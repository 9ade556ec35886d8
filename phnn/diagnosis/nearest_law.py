"""Effects of the catalogue that can nearly replace a learned element.

A learned element has no name. Where one effect of its own kind, in its place, takes nearly all that the element takes
from recordings which were left out, the physics is that effect in another form: a spring that hardens with the fifth
power of its deflection is a cubic spring in another form. Several relaxing springs are creep in another form,
however little one of them takes. Effects of other kinds that take as much are not excluded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phnn.diagnosis.finding import Finding
from phnn.diagnosis.name import first_by_name
from phnn.diagnosis.place import of_the_kind
from phnn.diagnosis.refit import refit
from phnn.diagnosis.retest import fit_with
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.composition import LAW, LawCase
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.identification.left_out import LeftOut


def with_nearest_laws(
    held: LeftOut, base: Fit, findings: Sequence[Finding], grown: Fit, search: Search, record: Record
) -> tuple[Finding, ...]:
    """The elements of a composed model, each learned one with the effects that can nearly replace it.

    Args:
        held: the identification recordings in two sets.
        base: the fit without any element, on the recordings that models are grown on.
        findings: the elements; grown: the fit with all of them there.
        search: the catalogue, and how refits are made.
        record: of the rules that are asked.
    """
    found = list(findings)
    for place, finding in enumerate(findings):
        others = [f for f in findings if f is not finding]
        able = _able(finding, others, search) if finding.learned else []
        if not able:
            continue
        alone = fit_with(base, others, grown.setup.values()) if others else base
        if alone is None:
            continue
        near = _near(held, (alone, held.scores(alone)), finding, able, search, record)
        if any(of_the_kind(t.candidate.effect, finding.effect) for t in near):
            found[place] = replace(finding, laws=near)
    return tuple(found)


def _able(finding: Finding, others: Sequence[Finding], search: Search) -> list[Effect]:
    """Effects of a learned element's kind, and with them those that explained as much when it was added; empty where
    no effect is of its kind."""
    taken = {f.effect.name for f in others}
    free = [e for e in search.effects if e.name not in taken]
    own = [e for e in free if of_the_kind(e, finding.effect)]
    tied = {t.candidate.effect.name for t in finding.members}
    return [*own, *(e for e in free if e.name in tied and e not in own)] if own else []


def _near(
    held: LeftOut,
    without: tuple[Fit, Evaluation],
    learned: Finding,
    effects: Sequence[Effect],
    search: Search,
    record: Record,
) -> tuple[Trial, ...]:
    """Effects that take nearly all that the learned element takes, the one that takes most first.

    Each is refitted on its own: in a race, one that is only a little worse would be dropped.
    """
    fitted, criteria = without[0], search.criteria
    naming = search.scores_of(fitted, effects).naming
    near: list[tuple[float, Trial]] = []
    for candidate in naming.candidates:
        (trial,) = refit(fitted, [candidate], search.executor, criteria=criteria)
        if trial.fit is None:
            continue
        takes = held.gain(without, (trial.fit, held.scores(trial.fit))).takes
        case = LawCase(takes, learned.takes, criteria, learned.effect.is_more_of(candidate.effect))
        if record.decide(LAW, case, candidate.effect.name) is not None:
            near.append((takes, trial))
    ordered = [trial for _, trial in sorted(near, key=lambda pair: -pair[0])]
    return tuple(first_by_name(ordered, lambda t: t.candidate.effect).values())
