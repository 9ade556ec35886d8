"""The verdict: named, equivalent, unknown or none, and the same question about the remainder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from phnn.diagnose.criteria import CRITERIA, Criteria
from phnn.diagnose.finding import Finding
from phnn.diagnose.ground import Ground
from phnn.diagnose.learn import learn
from phnn.diagnose.locate import Location
from phnn.diagnose.name import Naming
from phnn.diagnose.place import located
from phnn.diagnose.rules import Applied, Record
from phnn.diagnose.rules.search import BASE, BaseCase
from phnn.diagnose.rules.verdict import LEARNED, VERDICT, LearnedCase, VerdictCase
from phnn.diagnose.scored import Scored, excess, scored
from phnn.diagnose.select import misplaced, select, share_of
from phnn.diagnose.trial import Trial
from phnn.effects import Effect
from phnn.ensemble import SERIAL, Executor
from phnn.identify.fit import Fit


@dataclass(frozen=True)
class Immaterial:
    """Something significant that is too small to matter.

    Attributes:
        candidate: the effect that explains it best, None where only a generic function does.
        rms: what it explains, root mean square, in the output's unit; share_of_noise: the same over the noise.
    """

    candidate: str | None
    rms: float
    share_of_noise: float


@dataclass(frozen=True)
class Judgement:
    """Attributes:
    verdict: ``named``, ``equivalent``, ``unknown`` or ``none``.
    ground, naming, location: of the base model; location is None for ``none``.
    findings: effects added, in order; empty for ``none`` and ``unknown``.
    tried: refits of a first effect, also where none was accepted.
    final: the last fit; the base fit for ``none``.
    remainder: scores on the final model's residual; None for ``none``.
    remainder_location: where what remains seems to be.
    learned: whether ``final`` contains a learned one-port.
    immaterial: for ``none``: what is significant all the same.
    remainder_immaterial: what of the remainder is significant, and too small to matter.
    rules: all that were asked, in order.
    """

    verdict: str
    ground: Ground
    naming: Naming
    location: Location | None
    final: Fit
    final_ground: Ground
    findings: tuple[Finding, ...] = ()
    tried: tuple[Trial, ...] = ()
    remainder: Naming | None = None
    remainder_location: Location | None = None
    learned: bool = False
    immaterial: Immaterial | None = None
    remainder_immaterial: Immaterial | None = None
    rules: tuple[Applied, ...] = ()


def judge(
    found: Scored,
    effects: Sequence[Effect],
    seed: int,
    max_effects: int,
    new_in_held_out: bool,
    executor: Executor = SERIAL,
    criteria: Criteria = CRITERIA,
) -> Judgement:
    """Locate, name, refit and judge.

    Args:
        found: the scores of the base model.
        effects: the catalogue entries that can exist in this setup.
        seed: of the null distribution.
        max_effects: how many effects may be added one after the other.
        new_in_held_out: whether confirmation brings something new; without it the word is ``equivalent`` at most.
        executor: where candidates are refitted.
        criteria: every threshold.
    """
    ground, naming, rule, record = found.ground, found.naming, criteria.selection, Record()
    record.decide(BASE, BaseCase(naming.p_value, rule))
    location = found.remaining
    if location is None:
        return Judgement("none", ground, naming, None, ground.fit, ground, rules=tuple(record.asked))
    selected, tried = select(found, location, effects, seed, max_effects, executor, criteria)
    record.asked.extend(selected.rules)
    findings, here = selected.findings, selected.model
    final, left = here.ground.fit, here.remaining
    share = share_of(ground.fit, final, naming)
    learned = None
    if location.name == "mechanical" and left is not None and share < rule.explains_well:
        learned = learn(ground, location.detail)
    case = VerdictCase(
        effects=len(findings),
        members=max((len(f.members) for f in findings), default=0),
        share=share,
        chi2=final.chi2,
        misplaced=bool(findings) and misplaced(selected, location, criteria),
        excess=excess(final),
        learned=excess(learned) if learned is not None else None,
        new_in_held_out=new_in_held_out,
        rule=rule,
    )
    decided = record.decide(VERDICT, case)
    assert decided is not None
    if decided.outcome == "unknown":
        if case.misplaced and share > rule.explains_further and left is not None and located(left, criteria.location):
            location = _also(location, left.name)
        judgement = _unknown(ground, naming, location, tried, seed, learned, criteria, record)
    else:
        judgement = Judgement(
            decided.outcome, ground, naming, location, final, here.ground, findings, tried, here.naming, left
        )  # fmt: skip
    return replace(judgement, rules=tuple(record.asked))


def _also(location: Location, name: str) -> Location:
    """The location with a further one beside it."""
    return location if name == location.name else replace(location, tied=tuple(dict.fromkeys((*location.tied, name))))


def unexplained(ground: Ground, naming: Naming, location: Location, tried: tuple[Trial, ...]) -> Judgement:
    """Real, and nothing to add to the base model."""
    return Judgement("unknown", ground, naming, location, ground.fit, ground, (), tried, naming, location)


def immaterial(judgement: Judgement, found: Immaterial) -> Judgement:
    """Nothing worth telling is missing: the base model stands, and what is significant is told with its size."""
    ground = judgement.ground
    return Judgement(
        "none", ground, judgement.naming, None, ground.fit, ground, tried=judgement.tried, immaterial=found
    )  # fmt: skip


def _unknown(
    ground: Ground,
    naming: Naming,
    location: Location,
    tried: tuple[Trial, ...],
    seed: int,
    learned: Fit | None,
    criteria: Criteria,
    record: Record,
) -> Judgement:
    """Real, and no element explains it: a learned passive one-port at the location where there is one."""
    if learned is None:
        return unexplained(ground, naming, location, tried)
    case = LearnedCase(ground.fit.cost - learned.cost, naming.statistic**2, criteria.selection)
    decided = record.decide(LEARNED, case)
    if decided is None or decided.outcome == "dropped":
        return unexplained(ground, naming, location, tried)
    after = scored(learned, (), seed, terminals=ground.terminals, criteria=criteria)
    return Judgement(
        "unknown", ground, naming, location, learned, after.ground, (), tried, after.naming, after.remaining, True
    )  # fmt: skip
