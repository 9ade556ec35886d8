"""The verdict: named, equivalent, unknown or none, and the same question about the remainder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from phnn.diagnose.ground import Ground, prepare
from phnn.diagnose.learn import learn
from phnn.diagnose.locate import Location, Responses, locate, responses
from phnn.diagnose.name import Naming, score
from phnn.diagnose.refit import Trial, class_of, refit, tie
from phnn.effects import Effect
from phnn.ensemble import SERIAL, Executor
from phnn.errors import PhnnError
from phnn.identify.fit import Fit
from phnn.identify.numerics import NumericalError
from phnn.identify.staged import fit_identified, stated_only

SIGNIFICANT = 0.01
_REFITS = 14
_RETESTED = 5
# Below this share of the excess residual explained, a catalogue entry imitates the truth rather than being it.
_EXPLAINS = 0.7
# What takes less than this share of what is left does not help to find what else is missing.
_EXPLAINS_SOME = 0.25
# Learned against named: how much less it must leave.
_CLEARLY = 0.8
# How much less a location must explain to be called another one.
_ELSEWHERE = 0.01
# A second effect must matter: it is looked for only where the residual exceeds the noise by this much.
_MATERIAL = 1.1


@dataclass(frozen=True)
class Finding:
    """One effect that was added, with everything that was tried for it."""

    trial: Trial
    members: tuple[Trial, ...]
    trials: tuple[Trial, ...]
    naming: Naming


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


def excess(fit: Fit) -> float:
    """Sum of squares above what noise of the stated floor leaves."""
    return fit.cost - (fit.residual.size - fit.jacobian.shape[1])


@dataclass(frozen=True)
class Scored:
    """A model with its scores: all that a verdict ``none`` needs."""

    ground: Ground
    generic: Responses
    naming: Naming

    @property
    def significant(self) -> bool:
        """Whether the model leaves more than chance would."""
        return self.naming.p_value < SIGNIFICANT

    def remaining(self) -> Location | None:
        """Where what it leaves seems to be; None where that is no more than chance."""
        return locate(self.ground, self.generic) if self.significant else None


def scored(
    fitted: Fit, effects: Sequence[Effect], seed: int, error: NumericalError | None = None, terminals: bool = False
) -> Scored:
    """Score the catalogue and the generic functions on a model.

    Args:
        fitted: the base model, or one with effects.
        effects: the catalogue entries that can exist in this setup.
        seed: of the null distribution.
        error: numerical error of the simulations, where what it could fake is asked.
        terminals: whether the input was measured at the port.
    """
    ground = prepare(fitted, terminals)
    generic = responses(ground)
    return Scored(ground, generic, score(ground, effects, generic, seed, error.error if error is not None else None))


def judge(
    found: Scored,
    effects: Sequence[Effect],
    seed: int,
    max_effects: int,
    new_in_held_out: bool,
    executor: Executor = SERIAL,
) -> Judgement:
    """Locate, name, refit and judge.

    Args:
        found: the scores of the base model.
        effects: the catalogue entries that can exist in this setup.
        seed: of the null distribution.
        max_effects: how many effects may be added one after the other.
        new_in_held_out: whether confirmation brings something new; without it the word is ``equivalent`` at most.
        executor: where candidates are refitted.
    """
    ground, naming = found.ground, found.naming
    location = found.remaining()
    if location is None:
        return Judgement("none", ground, naming, None, ground.fit, ground)
    selected, tried = _select(found, location, effects, seed, max_effects, executor)
    findings, here = selected.findings, selected.model
    final = here.ground.fit
    learned = None
    if not findings or here.significant:
        learned = learn(ground, location.detail) if location.name == "mechanical" else None
    # What a few generic functions at the location explain clearly better was imitated, not named; so was what leaves
    # something and lies elsewhere than where those functions explain most.
    imitated = learned is not None and learned.cost < _CLEARLY * final.cost
    if findings and here.significant:
        best = location.scores[location.name]
        imitated |= location.scores[findings[0].trial.candidate.effect.location] < best - _ELSEWHERE
    if not findings or imitated:
        return _unknown(ground, naming, location, tried, seed, learned)
    settled = new_in_held_out and all(len(f.members) == 1 for f in findings)
    verdict = "named" if settled else "equivalent"
    return Judgement(
        verdict, ground, naming, location, final, here.ground, findings, tried, here.naming, here.remaining()
    )  # fmt: skip


@dataclass(frozen=True)
class _Selected:
    """A step of the selection: the effects so far, the model with them, the share that the last one took."""

    findings: tuple[Finding, ...]
    model: Scored
    share: float


def _select(
    found: Scored,
    location: Location,
    effects: Sequence[Effect],
    seed: int,
    max_effects: int,
    executor: Executor,
) -> tuple[_Selected, tuple[Trial, ...]]:
    """Forward selection with backward deletion; and what was tried for the first effect.

    Of two effects of one size the first explains but half, so that one is tried upon another while each takes some of
    what is left. What is kept in the end either leaves nothing significant, or its last effect took most of what there
    was: several that nibble at one another's leavings are no explanation.
    """
    steps = [_Selected((), found, 1.0)]
    tried: tuple[Trial, ...] = ()
    while len(steps) <= max_effects and steps[-1].model.significant:
        last = steps[-1]
        left = [c for c in last.model.naming.candidates if c.p_value < SIGNIFICANT][:_REFITS]
        trials = _in_place(refit(last.model.ground.fit, left, executor), location)
        tried = tried or tuple(trials)
        if not trials or trials[0].fit is None:
            break
        step = _with(found.ground, last, trials, location, effects, seed, executor)
        if step.model.significant and step.share < _EXPLAINS_SOME:
            break
        steps.append(step)
        if step.model.ground.fit.chi2 < _MATERIAL**2:
            break
    while steps[-1].model.significant and len(steps) > 1 and steps[-1].share < _EXPLAINS:
        steps.pop()
    return steps[-1], tried


def _in_place(trials: list[Trial], location: Location) -> list[Trial]:
    """The trials with the one first that, of those which fit as well as the best, lies where most is explained."""
    if not trials or trials[0].fit is None:
        return trials
    members = class_of(trials, trials[0].fit.chi2 > _MATERIAL**2)
    first = max(members, key=lambda t: location.scores[t.candidate.effect.location])
    return [first, *(t for t in trials if t is not first)]


def _with(
    ground: Ground,
    last: _Selected,
    trials: Sequence[Trial],
    location: Location,
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
) -> _Selected:
    """The step with the best of some trials, what came before tested again."""
    best = trials[0]
    assert best.fit is not None
    model = scored(best.fit, effects, seed, terminals=ground.terminals)
    share = _share(last.model.ground.fit, best.fit, last.model.naming)
    members = tuple(class_of(trials, model.significant))
    findings = (*last.findings, Finding(best, members, tuple(trials), last.model.naming))
    findings, fitted = _retested(ground.fit, findings, best.fit, location, executor)
    if fitted is not best.fit:
        model = scored(fitted, effects, seed, terminals=ground.terminals)
    return _Selected(findings, model, share)


def _retested(
    base: Fit, findings: tuple[Finding, ...], fitted: Fit, location: Location, executor: Executor
) -> tuple[tuple[Finding, ...], Fit]:
    """Every earlier finding once more, now that the last one is there: superfluous, or better another one?"""
    place = 0
    while place < len(findings) - 1:
        others = (*findings[:place], *findings[place + 1 :])
        alone = _fit_with(base, others, fitted)
        if alone is None:
            place += 1
            continue
        if alone.cost - fitted.cost < tie(fitted):
            findings, fitted = others, alone
            continue
        used = {f.trial.candidate.effect.name for f in others}
        rivals = [t.candidate for t in findings[place].trials[:_RETESTED] if t.candidate.effect.name not in used]
        trials = _in_place(refit(alone, rivals, executor), location)
        best = trials[0]
        if best.fit is not None and best.cost <= fitted.cost + tie(fitted):
            again = Finding(best, tuple(class_of(trials, False)), tuple(trials), findings[place].naming)
            findings, fitted = (*findings[:place], again, *findings[place + 1 :]), best.fit
        place += 1
    return findings, fitted


def _fit_with(base: Fit, findings: Sequence[Finding], fitted: Fit) -> Fit | None:
    """The base model with some of the effects of a fit, fitted from where that one ended."""
    values = fitted.setup.values()
    setup = base.setup.with_values({n: values[n] for n in base.setup.free})
    for f in findings:
        setup = f.trial.candidate.effect.add_to(setup, values)
    own = [n for f in findings for n in f.trial.candidate.effect.parameters]
    try:
        return fit_identified(setup, base.plan, stated_only(base.held), origin=base, keep=own)
    except PhnnError:
        return None


def _share(before: Fit, after: Fit, scores: Naming) -> float:
    """Share of the explainable sum of squares that an effect has taken.

    Explainable is the excess over the noise, less its own spread, and at least what one direction would take.
    """
    spread = 2.0 * (2.0 * before.residual.size) ** 0.5
    explainable = max(excess(before) - spread, scores.statistic**2, 1e-300)
    return (before.cost - after.cost) / explainable


def _unknown(
    ground: Ground, naming: Naming, location: Location, tried: tuple[Trial, ...], seed: int, learned: Fit | None
) -> Judgement:
    """Real, and no element explains it: a learned passive one-port at the location where there is one."""
    # A dozen strengths lower any sum of squares: the drop must be of the size that the score promised.
    if learned is None or ground.fit.cost - learned.cost < 0.5 * naming.statistic**2:
        return Judgement("unknown", ground, naming, location, ground.fit, ground, (), tried, naming, location)
    after = scored(learned, (), seed, terminals=ground.terminals)
    return Judgement(
        "unknown", ground, naming, location, learned, after.ground, (), tried, after.naming, after.remaining(), True
    )  # fmt: skip
