"""A finished diagnosis: the whole path from recordings to verdict, as one value."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from phnn.diagnosis.confirm import confirmed
from phnn.diagnosis.criteria import CRITERIA, Criteria
from phnn.diagnosis.distil import Distilled, distil, has_grammar
from phnn.diagnosis.distil.refitted import refitted_formula
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.following import NextExperiment
from phnn.diagnosis.judge import Judgement, judge
from phnn.diagnosis.propose import propose
from phnn.diagnosis.questions import questions
from phnn.diagnosis.retest import fit_with
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.held_out import NUMERICS, NumericsCase
from phnn.diagnosis.scored import Scored, scored
from phnn.effects import Effect, catalogue, effect, in_all_forms
from phnn.effects.learned import learned_elements
from phnn.effects.places import attached
from phnn.ensemble import Executor, executor
from phnn.identification.base import Options, Progress, identify_base, quiet, refined, single
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.identification.numerics import NumericalError
from phnn.integrate.residual import check
from phnn.recordings.recording import Campaign
from phnn.setup import Setup


@dataclass(frozen=True)
class Diagnosis:
    """Attributes:
    campaign: what was diagnosed; base: the fitted base model; error: its numerical error.
    judgement: verdict, location, effects, remainder.
    before, after: scores of the base and the final model on all recordings, held-out ones among them.
    proposal: the next recording, where something is tied or has no name.
    kernel_residual: largest relative residual that the torch module finds in the compiled simulations of both models.
    options, seconds: how it was made; criteria: with which thresholds.
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
    ground, found = judgement.final_ground, judgement.findings

    def formula(finding: Finding) -> Distilled | None:
        element, fit = finding.effect, ground.fit
        if has_grammar(element.kind.name):
            return distil(ground, element)
        others = [f for f in found if f is not finding]
        alone = fit_with(judgement.ground.fit, others, fit.setup.values()) if others else judgement.ground.fit
        return None if alone is None else refitted_formula(fit, alone, element, executor, criteria)

    return replace(judgement, findings=tuple(replace(f, description=formula(f)) if f.learned else f for f in found))


def diagnose(
    campaign: Campaign,
    options: Options | None = None,
    progress: Progress = quiet,
    effects: Sequence[Effect] | None = None,
    on_base: Callable[[Fit], None] | None = None,
) -> Diagnosis:
    """Fit the base model, locate what it misses, name it, refit, judge and confirm.

    Args:
        campaign: recordings with their identification and confirmation parts.
        options: how hard to try.
        progress: called with a line of text at every stage.
        effects: the catalogue to use; all that can exist otherwise.
        on_base: called with the base fit as soon as there is one, so that it can be kept whatever comes.

    Raises:
        InputRefused: a criterion is not known, the executor is not understood or does not answer, an effect to do
            without is not in the catalogue, or recordings have several inputs or outputs;
            nothing has been fitted yet then.
    """
    began = time.monotonic()
    chosen = options or Options()
    criteria = CRITERIA.with_values(chosen.criteria)
    most = criteria.selection.numerical_score
    refits, without = executor(chosen.executor), [effect(name) for name in chosen.without]
    single(campaign.recordings, "a diagnosis follows one input to one output")
    base, error = identify_base(campaign, chosen, progress)
    catalogue_ = list(effects) if effects is not None else available(campaign, base.setup, without)
    progress(f"base model: residual {base.chi2**0.5:.3g} × noise; locate and name")
    if on_base is not None:
        on_base(base)

    terminals = input_measured(campaign, base.setup)
    found = scored(base, catalogue_, chosen.seed, error, terminals, criteria)
    for _ in range(2):
        if found.naming.numerical <= most:
            break
        progress(f"numerical error could score {found.naming.numerical:.2g}: finer steps")
        base, error = refined(base, chosen)
        found = scored(base, catalogue_, chosen.seed, error, terminals, criteria)
    progress(f"largest score {found.naming.statistic:.3g}: locate and name")
    judgement = judge(
        found, catalogue_, chosen.seed, max(1, chosen.max_effects), campaign.held_out_is_new, refits, criteria,
        _possible(campaign, base.setup, learned_elements().values()), progress,
    )  # fmt: skip
    progress(f"verdict {judgement.verdict}; confirm on held-out recordings")

    def score_again(fitted: Fit) -> Scored:
        return scored(fitted, catalogue_, chosen.seed, terminals=terminals, criteria=criteria)

    judgement, before, after = confirmed(judgement, base, campaign, criteria, score_again)
    judgement = _distilled(judgement, refits, criteria)
    if judgement.verdict == "named":
        record = Record(list(judgement.rules))
        decided = record.decide(NUMERICS, NumericsCase(judgement.naming.numerical, criteria))
        verdict = judgement.verdict if decided is None else decided.outcome
        judgement = replace(judgement, verdict=verdict, rules=tuple(record.asked))
    grounds = {id(g): g for g in (judgement.ground, judgement.final_ground)}.values()
    residual = max(check(t) for g in grounds for t in g.trajectories)
    proposal = propose(questions(judgement, criteria), judgement.ground, criteria.selection.tie)
    seconds = time.monotonic() - began
    return Diagnosis(
        campaign, base, error, judgement, before, after, proposal, residual, chosen, seconds, criteria
    )  # fmt: skip
