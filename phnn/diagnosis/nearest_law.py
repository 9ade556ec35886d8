"""Laws of the catalogue that come near to a learned element.

A learned element has no name. Where one law of its own kind, in its place, takes nearly all that the element takes from
recordings which were left out, the physics is that of the law, and the element only draws its form more exactly:
a spring that hardens with the fourth power of its deflection is a cubic spring in another form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phnn.diagnosis.finding import Finding
from phnn.diagnosis.refit import refit
from phnn.diagnosis.retest import fit_with
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.composition import LAW, LawCase
from phnn.diagnosis.scored import scored
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.identification.left_out import LeftOut


def with_nearest_laws(
    held: LeftOut, base: Fit, findings: Sequence[Finding], grown: tuple[Fit, Evaluation], search: Search, record: Record
) -> tuple[Finding, ...]:
    """The elements of a composed model, each learned one with the laws that come near to it.

    Args:
        held: the identification recordings in two sets.
        base: the fit without any element, on the recordings that models are grown on.
        findings: the elements; grown: the fit with all of them there, and what it predicts.
        search: the catalogue, and how refits are made.
        record: of the rules that are asked.
    """

    def asked(finding: Finding) -> Finding:
        others = [f for f in findings if f is not finding]
        able = [e for e in search.effects if _same_kind(e, finding.effect, others)]
        alone = fit_with(base, others, grown[0].setup.values()) if others and able else base
        if not able or alone is None:
            return finding
        # What it gained when it was added beside elements that have gone since says nothing any more.
        without = alone, held.scores(alone)
        finding = replace(finding, gained=held.gain(without, grown))
        return replace(finding, laws=_near(held, without, finding, able, search, record))

    return tuple(asked(f) if f.learned else f for f in findings)


def _same_kind(effect: Effect, learned: Effect, others: Sequence[Finding]) -> bool:
    """Whether an effect acts as a learned element does, at its place, and is not in the model already."""
    alike = (effect.kind, effect.place) == (learned.kind, learned.place)
    return alike and all(effect.name != f.effect.name for f in others)


def _near(
    held: LeftOut,
    without: tuple[Fit, Evaluation],
    learned: Finding,
    effects: Sequence[Effect],
    search: Search,
    record: Record,
) -> tuple[Trial, ...]:
    """Effects that take nearly all that the learned element takes, the one that takes most first."""
    fitted, criteria = without[0], search.criteria
    naming = scored(fitted, effects, search.seed, None, search.terminals, criteria).naming
    near: list[tuple[float, Trial]] = []
    for trial in refit(fitted, naming.candidates, search.executor, criteria=criteria):
        if trial.fit is None:
            continue
        takes = held.gain(without, (trial.fit, held.scores(trial.fit))).takes
        if record.decide(LAW, LawCase(takes, learned.takes, criteria), trial.candidate.effect.name) is not None:
            near.append((takes, trial))
    return tuple(trial for _, trial in sorted(near, key=lambda pair: -pair[0]))
