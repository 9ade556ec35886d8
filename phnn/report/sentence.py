"""The verdict in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from phnn.diagnose.words import fitted_in_words, vocabulary_of
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import Immaterial, Judgement
from phnn.diagnosis.place import in_another_form
from phnn.diagnosis.rules.composition import neighbour_acts_several_times
from phnn.diagnosis.rules.held_out import numerical_error_may_confound
from phnn.diagnosis.select import share_of
from phnn.identification.evaluate import Evaluation
from phnn.report.domain_words import MOVING, NETWORK
from phnn.report.formatting import listing, percent, ratio
from phnn.units import quantity

# Share of the excess that is worth a word about what is not the answer.
_NEAR = 0.5
# Rules by which a name stands for several copies of the effect, and by which it is not proven.
_COPIES = neighbour_acts_several_times.__name__
_NUMERICAL = numerical_error_may_confound.__name__
# Recordings that are listed by name.
_NAMED = 3


def sentence(diagnosis: Diagnosis) -> str:
    """State the verdict in a sentence or two."""
    j = diagnosis.judgement
    held = diagnosis.before.over_noise("confirmation"), diagnosis.after.over_noise("confirmation")
    bare = [r.name for r in diagnosis.campaign.recordings if not r.noise_found]
    change = f"On held-out recordings the residual goes from {ratio(held[0])} to {ratio(held[1])} × noise."
    if math.isnan(held[0]):
        change = "No recording was held out to confirm it."
    elif bare:
        fits = (mean_fit(e, "confirmation") for e in (diagnosis.before, diagnosis.after))
        change = (
            f"On held-out recordings the fit goes from {' to '.join(percent(f, 2) for f in fits)} %. {floorless(bare)}"
        )
    if j.immaterial is not None:
        return immaterial_statement(j.immaterial, diagnosis.campaign.recordings[0].units.output)
    if j.verdict == "none":
        stands = f"leaves {ratio(diagnosis.base.chi2**0.5)} × noise."
        if bare:
            stands = f"fits by {percent(mean_fit(diagnosis.before, 'identification'), 2)} %. {floorless(bare)}"
        return f"These recordings show nothing that is missing: the base model {stands}"
    if j.verdict == "unknown" and diagnosis.ended.early and not j.findings:
        return f"{_unfinished(j)} {_nearest(j)}{change}"
    if j.verdict == "unknown":
        return f"{unknown_statement(j)} {_nearest(j)}{change}"
    claimed = j.claimed
    names = " and ".join(_with_members(f) for f in claimed)
    others, applied = any(len(f.alike) > 1 for f in claimed), {r.rule for r in j.rules if r.applies}
    if j.verdict == "named":
        start = f"The model leaves out {names}."
    elif others:
        start = f"The model leaves out {names}; these recordings cannot exclude the effects in brackets."
    elif _COPIES in applied or any(in_another_form(f, j.findings) for f in claimed):
        start = f"The model leaves out {names}, in another form than the catalogue has."
    elif _NUMERICAL in applied:
        start = f"The model leaves out {names}, unless the numerical error of the simulation looks like it."
    else:
        why = (
            "do not exist, so that nothing confirms it"
            if math.isnan(held[0])
            else "are too short to prove it"
            if diagnosis.campaign.held_out_is_new
            else "bring nothing new to confirm it"
        )
        start = f"{names[0].upper()}{names[1:]} explains most of the mismatch, but the held-out samples {why}."
    level = diagnosis.criteria.selection.level
    left = j.remainder is not None and j.remainder.p_value < level and j.remainder_immaterial is None
    rest = " A significant remainder is left." if left else ""
    return f"{start} {change}{_provisional(j)}{rest}"


def mean_fit(scores: Evaluation, use: str) -> float | None:
    """Mean fit % over the parts of one use; None where it is defined for none."""
    found = [p.fit_percent for p in scores.parts if p.use == use and math.isfinite(p.fit_percent)]
    return sum(found) / len(found) if found else None


def floorless(names: Sequence[str]) -> str:
    """Say that recordings have no noise floor, in place of a ratio to the noise."""
    more = " and others" if len(names) > _NAMED else ""
    return (
        f"No noise floor was found in {listing(names[:_NAMED])}{more}, so that no residual is compared with the noise."
    )


def immaterial_statement(found: Immaterial, unit: str) -> str:
    """State an effect that is significant and too small to matter."""
    what = found.candidate.replace("_", " ") if found.candidate else "something"
    return (
        f"Nothing that matters is missing: {what} is statistically significant, but explains only "
        f"{quantity(found.rms, unit)} ({found.share_of_noise:.2g} × noise). The base model stands."
    )


def _provisional(judgement: Judgement) -> str:
    """The elements of the model whose names are not claimed."""
    names = [f.effect.name.replace("_", " ") for f in judgement.findings if f.provisional]
    if not names:
        return ""
    return f" The model also holds {' and '.join(names)}, whose name is not proven."


def _nearest(judgement: Judgement) -> str:
    """Name the effect that explains most, if it explains more than half; else return an empty text."""
    if judgement.findings:
        return ""
    best = min(judgement.tried, key=lambda t: t.cost, default=None)
    if best is None or best.fit is None:
        return ""
    share = share_of(judgement.linearised.fit, best.fit, judgement.naming)
    if share < _NEAR:
        return ""
    name = best.candidate.effect.name.replace("_", " ")
    left = f" and would leave {best.fit.chi2**0.5:.3g} × noise"
    if not all(r.noise_found for r in judgement.linearised.plan.recordings):
        left = ""
    explained = f"{100.0 * min(share, 1.0):.0f} % of the excess over the noise"
    return f"The nearest effect is {name}: it would explain {explained}{left}. "


def _with_members(finding: Finding) -> str:
    first, *others = [t.candidate.effect.name.replace("_", " ") for t in finding.alike]
    named = f"{first} (or {', '.join(others)})" if others else first
    return f"{named} in another form" if finding.laws else named


def unknown_statement(judgement: Judgement) -> str:
    """State where something is missing, and what the model describes it by, when no name is proven."""
    where, place = judgement.location, "an unknown location"
    if where is not None:
        first = judgement.places[0]
        place = f"the {first} location" + (f" ({where.detail})" if first == where.name else "")
        moves = vocabulary_of(judgement.linearised.fit.setup.network).output_unit in MOVING
        if first == "mechanical" and not moves:
            place = f"a location {NETWORK} ({where.detail})"
    real = f"Something is missing at {place}."
    held = [_element(f) for f in judgement.findings]
    if not held:
        return f"{real} No effect or learned element describes it, so the model is still the base model."
    listed = " and ".join(held) if len(held) < 3 else f"{', '.join(held[:-1])} and {held[-1]}"
    return f"{real} No name for it is proven. The model describes it by {listed}."


def _unfinished(judgement: Judgement) -> str:
    """State what is known after a search that has ended before it accepted an element."""
    stands = "The model is still the base model."
    if not judgement.naming.p_value < 1.0:
        return f"Whether something is missing is not known, because the test of the base model failed. {stands}"
    where = judgement.location
    place = "" if where is None else f" at the {where.name} location ({where.detail})"
    return f"Something is missing{place}. The search ended before it accepted an element. {stands}"


def _element(finding: Finding) -> str:
    """An element of a model whose name is not claimed, in words."""
    if not finding.learned:
        return f"an element that acts like {finding.effect.name.replace('_', ' ')}"
    name, found = finding.effect.name.replace("_", " "), finding.described
    return f"a {name}" if found is None else f"a {name} ({found.words.removesuffix('.')})"


def unknown_character(judgement: Judgement) -> str:
    """Describe the unknown element by the functions that were fitted at its location."""
    return "" if judgement.location is None else fitted_in_words(judgement.linearised, judgement.location)
