"""A finished diagnosis: the whole path from recordings to verdict, as one value."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from phnn.criteria import CRITERIA, Criteria
from phnn.diagnose.formula import Distilled, distil, has_grammar, refitted_formula
from phnn.diagnose.linearised import LinearisedFit, prepare, tie
from phnn.diagnose.proposal import NextExperiment, propose
from phnn.diagnosis.confirm import confirmed, unconfirmed
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import Judgement, judge
from phnn.diagnosis.name import NOT_JUDGED
from phnn.diagnosis.questions import questions
from phnn.diagnosis.refit import refitted_effects
from phnn.diagnosis.retest import better_base, fit_with
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.held_out import NUMERICS, NumericsCase, numerical_limit
from phnn.diagnosis.scored import Scored
from phnn.diagnosis.search import Search, Visited
from phnn.effects import Effect, Scales, catalogue, effect, in_all_forms
from phnn.effects.learned import learned_elements
from phnn.effects.places import attached
from phnn.identification.base import Progress, identify_base, quiet
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit, fit
from phnn.identification.identified import Identified, model_of
from phnn.identification.options import Options
from phnn.identification.prepare import single
from phnn.identification.refinement import NumericalError, refined, with_bounded_error
from phnn.integrate.residual import check
from phnn.model import Model
from phnn.parallel import Executor, executor
from phnn.recordings.recording import Campaign
from phnn.rescue import Ended, accounted, attempt, deadline, extra, move, needed
from phnn.setup import Setup

# How often all steps are halved where the numerical error could be taken for physics.
_REFINEMENTS = 2
# Steps half as long leave a quarter of the error of the integration; more than this share is not its error.
_HELPS = 0.8
# How often a search begins again from a better optimum of the base model.
_BASES = 2


@dataclass(frozen=True)
class Diagnosis:
    """Attributes:
    campaign: what was diagnosed; base: the fitted base model; error: its numerical error.
    judgement: verdict, location, effects, remainder.
    before, after: scores of the base and the final model on all recordings, held-out ones among them.
    proposal: the next recording, where something is tied or has no name.
    kernel_residual: largest relative residual that the torch module finds in the compiled simulations of both models;
        NaN where it finds a step that is not solved, which is then among the warnings.
    options, seconds: how it was made; criteria: with which thresholds.
    ended: how the search ended, what was not tried, and what failed.
    """

    campaign: Campaign
    base: Fit
    error: NumericalError
    judgement: Judgement
    before: Evaluation
    after: Evaluation
    proposal: NextExperiment | None
    kernel_residual: float
    options: Options
    seconds: float
    criteria: Criteria = CRITERIA
    ended: Ended = field(default_factory=Ended)

    def __repr__(self) -> str:
        names = ", ".join(finding.effect.name for finding in self.judgement.findings) or "nothing"
        return f"<Diagnosis of {self.campaign.folder}: {self.verdict}, added to the model: {names}>"

    @property
    def verdict(self) -> str:
        """``named``, ``equivalent``, ``unknown`` or ``none``."""
        return self.judgement.verdict

    @property
    def model(self) -> Model:
        """The final model: base and every element that helps, whatever the verdict."""
        return model_of(self.judgement.final)


def available(campaign: Campaign, setup: Setup, without: Sequence[Effect] = ()) -> list[Effect]:
    """Effects that can exist in a setup, in all forms: with the voltage measured at the terminals the amplifier is no
    culprit.

    Args:
        without: effects that are left out.
    """
    return _possible(campaign, setup, [e for e in catalogue().values() if e not in without])


def _possible(campaign: Campaign, setup: Setup, effects: Iterable[Effect]) -> list[Effect]:
    """Those of some effects that can exist, in all forms and at every place."""
    found = in_all_forms(a for e in effects for a in attached(e, setup) if a.applies(setup))
    return [e for e in found if not (e.needs_command and input_measured(campaign, setup))]


def input_measured(campaign: Campaign, setup: Setup) -> bool:
    """Whether what the input does to the network was recorded: at the terminals, or as the motion that is imposed."""
    return campaign.voltage == "terminals" or bool(setup.network.senses)


def _distilled(judgement: Judgement, executor: Executor, criteria: Criteria) -> Judgement:
    """The judgement with a formula for every learned element of its model, where there is one."""
    linearised, found = judgement.final_linearised, judgement.findings

    def formula(finding: Finding) -> Distilled | None:
        element, fit = finding.effect, linearised.fit
        if has_grammar(element.kind.name):
            return distil(linearised, element)
        others = [f for f in found if f is not finding]
        alone = fit_with(judgement.linearised.fit, others, fit.setup.values()) if others else judgement.linearised.fit
        refits = partial(refitted_effects, executor=executor, criteria=criteria)
        return None if alone is None else refitted_formula(fit, alone, element, refits, criteria)

    def described(finding: Finding) -> Finding:
        part = f"formula of the {finding.effect.name.replace('_', ' ')}"
        return replace(finding, description=extra(part, partial(formula, finding), None))

    return replace(judgement, findings=tuple(described(f) if f.learned else f for f in found))


def _base(
    recorded: Campaign | Identified, options: Options, criteria: Criteria, progress: Progress
) -> tuple[Campaign, Fit, NumericalError]:
    """The recordings and their base model, fitted where that has not been done."""
    campaign = recorded.campaign if isinstance(recorded, Identified) else recorded
    single(campaign.recordings, "a diagnosis follows one input to one output")
    if isinstance(recorded, Identified):
        return campaign, recorded.fit, recorded.error
    return campaign, *identify_base(campaign, options, progress, criteria.selection.base_numerical_share)


def _judged(
    search: Search, options: Options, base: Fit, error: NumericalError, on_base: Callable[[Fit], None]
) -> tuple[Fit, NumericalError, Judgement]:
    """Search from a base model, and again from a better optimum of it where the search has come upon one.

    Returns:
        As `_judged_from`.
    """
    found = _judged_from(search, base, error)
    for _ in range(_BASES):
        better = extra("a better optimum of the base model", partial(better_base, found[0], found[2].final), None)
        if better is None:
            break
        search.progress(f"the base model itself fits better: residual {better.chi2**0.5:.3g} × noise; search again")
        bounded = partial(with_bounded_error, better, options.error_bound_sigma)
        begun = extra("finer steps of the better base model", partial(attempt, "finer steps", bounded, None), None)
        if begun is None:
            break
        on_base(begun[0])
        again = _judged_from(search, *begun)
        if again[2].final.cost > found[2].final.cost:
            # It has ended early.
            break
        found = again
    return found


def _judged_from(search: Search, base: Fit, error: NumericalError) -> tuple[Fit, NumericalError, Judgement]:
    """Search from a base model, refitted with finer steps where the numerical error alone has a score.

    Returns:
        The base model with these steps, its numerical error, and the judgement.
    """
    found = needed("test of the base model", partial(search.scored, base, error), None, ends=True)
    if found is None:
        return base, error, _untested(base)
    for _ in range(_REFINEMENTS):
        if found.naming.numerical <= numerical_limit(found.naming.statistic, search.criteria.selection):
            break
        search.progress(f"numerical error could score {found.naming.numerical:.2g}: finer steps")
        better = move("finer steps of the base model", partial(_finer, search, base), None)
        if better is None:
            break
        finer, again = better
        enough = numerical_limit(again.naming.statistic, search.criteria.selection)
        if again.naming.numerical > max(enough, _HELPS * found.naming.numerical):
            # It comes from the input between the samples, which finer steps do not know better.
            break
        (base, error), found = finer, again
    search.progress(f"largest score {found.naming.statistic:.3g}: locate and name")
    judgement = move("search", partial(judge, found, search), None)
    if judgement is None:
        location = needed("location of the mismatch", lambda: found.remaining, None)
        here = found.linearised
        judgement = Judgement("unknown", here, found.naming, location, base, here, (), (), found.naming, location)
    return base, error, judgement


def _finer(search: Search, base: Fit) -> tuple[tuple[Fit, NumericalError], Scored]:
    """The base model with finer steps, and its scores."""
    finer = refined(base)
    return finer, search.scored(*finer)


def _untested(base: Fit) -> Judgement:
    """The judgement where even the test of the base model failed: nothing is known of what it lacks."""
    bare = LinearisedFit(base, (), Scales(*(float("nan"),) * 9))
    linearised = needed("simulation of the base model", partial(prepare, base), bare)
    return Judgement("unknown", linearised, NOT_JUDGED, None, base, linearised, remainder=NOT_JUDGED)


def _best_so_far(judgement: Judgement, visited: Sequence[Visited]) -> Judgement:
    """The judgement of a search that has ended early, with the best model that it came upon: no name is claimed of it.

    What was fitted with coarse steps, or to some of the recordings, is simulated on all of them first.
    """
    base, final = judgement.linearised.fit, judgement.final
    if judgement.location is None:
        return judgement
    findings = judgement.findings
    for model in visited:
        names = [n for n in model.fit.variables.names if n in model.fit.setup.parameters]
        once = partial(fit, model.fit.setup, base.plan, names, base.held, 1, origin=model.fit)
        whole = attempt("simulation of a model that the search came upon", once, None)
        if whole is not None and whole.cost < final.cost - tie(final):
            findings, final = model.findings, whole
    if final is judgement.final:
        return judgement
    linearised = needed("simulation of the best model so far", partial(prepare, final), None)
    if linearised is None:
        return judgement
    return replace(
        judgement,
        verdict="unknown",
        findings=tuple(replace(f, provisional=True, others_alone=None) for f in findings),
        final=final,
        final_linearised=linearised,
        remainder=NOT_JUDGED,
        remainder_location=None,
    )


def _held_against_numerics(judgement: Judgement, criteria: Criteria) -> Judgement:
    """The judgement without a name that the numerical error alone could confound."""
    if judgement.verdict != "named":
        return judgement
    record = Record(list(judgement.rules))
    least = min((f.naming.statistic for f in judgement.claimed), default=judgement.naming.statistic)
    decided = record.decide(NUMERICS, NumericsCase(judgement.naming.numerical, least, criteria))
    verdict = judgement.verdict if decided is None else decided.outcome
    return replace(judgement, verdict=verdict, rules=tuple(record.asked))


def _kernel_residual(judgement: Judgement) -> float:
    """The largest relative residual that the torch module finds in the simulations of both models; NaN where it is too
    large."""
    fits = {id(g): g for g in (judgement.linearised, judgement.final_linearised)}.values()
    part = "check of the simulations against the equations"
    return max((needed(part, partial(check, t), float("nan")) for g in fits for t in g.trajectories), default=0.0)


def diagnose(
    recorded: Campaign | Identified,
    options: Options | None = None,
    progress: Progress = quiet,
    effects: Sequence[Effect] | None = None,
    on_base: Callable[[Fit], None] | None = None,
    learned: Sequence[Effect] | None = None,
    budget: float | None = None,
    answers: bool = False,
) -> Diagnosis:
    """Fit the base model, locate what it misses, name it, refit, judge and confirm.

    Nothing that was finished is lost: a model that cannot be fitted is no candidate, a part that fails is left out, and
    when the time is up, the best model so far is the answer. `Diagnosis.ended` tells all that.
    One fit of the base model and its test are finished in any case.

    Args:
        recorded: recordings with their identification and confirmation parts, or a base model identified from them.
        options: how hard to try; those of the identification where it has been done, defaults otherwise.
        progress: called with a line of text at every stage.
        effects: the catalogue to use; all that can exist otherwise.
        on_base: called with the base fit as soon as there is one, and before a search begins again from a better one,
            so that it can be kept whatever comes.
        learned: elements without a name that may be added; all that can exist otherwise.
        budget: seconds after which the search ends with the best so far; no bound if left out.
        answers: an interruption ends the search in the same way, and `Ended.interruption` holds it; it is raised
            otherwise, as by a study of many diagnoses.

    Raises:
        InputRefused: a criterion is not known, the executor is not understood or does not answer, an effect to do
            without is not in the catalogue, recordings have several inputs or outputs, or the budget is not positive;
            nothing has been fitted yet then.
    """
    began, until = time.monotonic(), deadline(budget)
    chosen = options or (recorded.options if isinstance(recorded, Identified) else Options())
    criteria = CRITERIA.with_values(chosen.criteria)
    refits, left_out = executor(chosen.executor), [effect(name) for name in chosen.without]
    with accounted(until, answers=answers) as account:
        campaign, base, error = _base(recorded, chosen, criteria, progress)
        catalogue_ = list(effects) if effects is not None else available(campaign, base.setup, left_out)
        progress(f"base model: residual {base.chi2**0.5:.3g} × noise; locate and name")
        tell = on_base or (lambda fitted: None)
        tell(base)
        nameless = _possible(campaign, base.setup, learned_elements().values()) if learned is None else learned
        search = Search(
            catalogue_, nameless, chosen.seed, max(1, chosen.max_effects), criteria, refits,
            input_measured(campaign, base.setup), campaign.held_out_is_new, progress,
        )  # fmt: skip
        base, error, judgement = _judged(search, chosen, base, error, tell)
        if account.ended().early:
            judgement = _best_so_far(judgement, search.visited)
        progress(f"verdict {judgement.verdict}; confirm on held-out recordings")
        confirm = partial(confirmed, judgement, base, campaign, criteria, search.scored)
        held_out = needed("test on held-out recordings", confirm, None)
        judgement, before, after = held_out or unconfirmed(judgement, base, campaign)
        named = needed("formulas", partial(_distilled, judgement, refits, criteria), judgement)
        judgement = needed("numerical error", partial(_held_against_numerics, named, criteria), named)
        residual = _kernel_residual(judgement)
        ask = partial(_proposed, judgement, criteria)
        proposal = extra("the next recording", ask, None)
    seconds, ended = time.monotonic() - began, account.ended(budget)
    return Diagnosis(
        campaign, base, error, judgement, before, after, proposal, residual, chosen, seconds, criteria, ended
    )  # fmt: skip


def _proposed(judgement: Judgement, criteria: Criteria) -> NextExperiment | None:
    """The next recording, where something is tied or has no name."""
    return propose(questions(judgement, criteria), judgement.linearised, criteria.selection.tie)
