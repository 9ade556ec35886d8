"""The verdict in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.number import Visited, is_learned
from phnn.diagnose.verdict import NAMED, NONE, UNKNOWN, Claim
from phnn.diagnose.words import vocabulary_of
from phnn.identification.evaluate import Evaluation
from phnn.report.document import Immaterial
from phnn.report.domain_words import MOVING, NETWORK
from phnn.report.formatting import likelihood, listing, percent, plain, ratio, words
from phnn.report.tried import immaterial, remains
from phnn.units import quantity

# Share of the excess that is worth a word about what is not the answer.
_NEAR = 0.5
# Recordings that are listed by name.
_NAMED = 3
# Probability below which a name is preceded by "perhaps".
_PROVEN = 0.95
# Why no name is proven, by the rule that gave the verdict.
_WHY = {
    "the_search_ended_early": "because the search ended early",
    "something_is_left": "because the model still leaves more than the noise",
    "an_element_is_learned": "because a learned element is part of the model",
    "held_out_recordings_deny_it": "because not every element improves the prediction of held-out recordings",
}
_NOT_NEW = "held_out_recordings_are_not_new"


def sentence(diagnosis: Diagnosis) -> str:
    """Return the verdict in a sentence or two."""
    word, claims = diagnosis.verdict, diagnosis.claims
    bare = [r.name for r in diagnosis.campaign.recordings if not r.noise_found]
    if word == NONE:
        small = immaterial(diagnosis)
        if small is not None:
            return immaterial_statement(small, diagnosis.campaign.recordings[0].units.output)
        stands = f"leaves {ratio(diagnosis.base.chi2**0.5)} × noise."
        if bare:
            stands = f"fits by {percent(mean_fit(diagnosis.before, 'identification'), 2)} %. {floorless(bare)}"
        return f"These recordings show nothing that is missing: the base model {stands}"
    held = diagnosis.before.over_noise("confirmation"), diagnosis.after.over_noise("confirmation")
    change = f"On held-out recordings the residual goes from {ratio(held[0])} to {ratio(held[1])} × noise."
    if math.isnan(held[0]):
        change = "No recording was held out to confirm it."
    elif bare:
        fits = (mean_fit(e, "confirmation") for e in (diagnosis.before, diagnosis.after))
        change = (
            f"On held-out recordings the fit goes from {' to '.join(percent(f, 2) for f in fits)} %. {floorless(bare)}"
        )
    if word == UNKNOWN:
        return f"{unknown_statement(diagnosis)} {_nearest_in_words(diagnosis)}{change}"
    names = listing(map(_name, claims))
    start = f"The model leaves out {names}."
    if diagnosis.outcome.rules and diagnosis.outcome.rules[-1].rule == _NOT_NEW:
        why = "do not exist, so that nothing confirms it" if math.isnan(held[0]) else "bring nothing new to confirm it"
        verb = "explains" if len(claims) == 1 else "explain"
        start = f"{names[0].upper()}{names[1:]} {verb} the mismatch, but the held-out samples {why}."
    elif any(c.alike for c in claims):
        start = f"The model leaves out {names}; these recordings cannot tell which."
    return f"{start} {change}{' A significant remainder is left.' if remains(diagnosis) else ''}"


def sure(probability: float) -> str:
    """Return a probability in words."""
    return f"{likelihood(probability).replace('>', 'more than').replace('<', 'less than')} sure"


def _name(claim: Claim) -> str:
    """Return the name of an element, or those of its class, with how sure it is."""
    names = list(dict.fromkeys(words(n) for n in (claim.name, *(e.title for e in claim.alike))))
    if claim.alike:
        return listing(names, "or")
    perhaps = "" if claim.status == NAMED or claim.probability >= _PROVEN else "perhaps "
    return f"{perhaps}{names[0]} ({sure(claim.probability)})"


def mean_fit(scores: Evaluation, use: str) -> float | None:
    """Return the mean fit % over the parts of one use; None where it is defined for none."""
    fits = [p.fit_percent for p in scores.parts if p.use == use and math.isfinite(p.fit_percent)]
    return sum(fits) / len(fits) if fits else None


def floorless(names: Sequence[str]) -> str:
    """Say that recordings have no noise floor, in place of a ratio to the noise."""
    more = " and others" if len(names) > _NAMED else ""
    return (
        f"No noise floor was found in {listing(names[:_NAMED])}{more}, so that no residual is compared with the noise."
    )


def immaterial_statement(small: Immaterial, unit: str) -> str:
    """State an effect that is significant and too small to matter."""
    size = f"{quantity(small.rms or 0.0, unit)} ({plain(small.share_of_noise, 2)} × noise)"
    return (
        f"Nothing that matters is missing: {words(small.candidate) or 'something'} is statistically significant, but "
        f"explains only {size}. The base model stands."
    )


def nearest(diagnosis: Diagnosis) -> Visited | None:
    """Return the model with one effect that leaves least, if it leaves less than the base model."""
    models = [m for m in diagnosis.visited.models if len(m.elements) == 1 and not is_learned(m.elements[0])]
    best = min(models, key=lambda m: m.fit.cost, default=None)
    return best if best is not None and best.fit.cost < diagnosis.base.cost else None


def _nearest_in_words(diagnosis: Diagnosis) -> str:
    """Name the effect that explains most, if the model has none and it explains more than half."""
    model, excess = nearest(diagnosis), diagnosis.base.beyond_noise
    if diagnosis.claims or model is None or not excess > 0.0:
        return ""
    share = (diagnosis.base.cost - model.fit.cost) / excess
    if share < _NEAR:
        return ""
    known = all(r.noise_found for r in diagnosis.base.plan.recordings)
    left = f" and would leave {ratio(model.left**0.5)} × noise" if known else ""
    explained = f"{100.0 * min(share, 1.0):.0f} % of the excess over the noise"
    return f"The nearest effect is {words(model.elements[0].name)}: it would explain {explained}{left}. "


def unknown_statement(diagnosis: Diagnosis) -> str:
    """State where something is missing, what the model describes it by, and why no name is proven."""
    claims, early = diagnosis.claims, diagnosis.ended.early
    if early and not claims and not diagnosis.significance()[1] < 1.0:
        return (
            "Whether something is missing is not known, because the base model was not tested. The model is still the "
            "base model."
        )
    proven = [c for c in claims if c.claimed]
    names = f"The model leaves out {listing(map(_name, proven))}. " if proven else ""
    if claims and len(proven) == len(claims):
        rest = "More may be missing, because the search ended early."
        return names + (rest if early else "What is left is more than the noise, and no element describes it.")
    real = f"{names}Something {'else ' if proven else ''}is missing{_place(diagnosis)}."
    if early and not claims:
        return f"{real} The search ended before it accepted an element. The model is still the base model."
    if not claims:
        return f"{real} No effect or learned element describes it, so the model is still the base model."
    rule = diagnosis.outcome.rules[-1].rule if diagnosis.outcome.rules else ""
    why = _WHY.get(rule, "because several explanations are about as probable")
    rest = listing(_element(diagnosis, c) for c in claims if not c.claimed)
    return f"{real} No name for it is proven, {why}. The model describes it by {rest}."


def _place(diagnosis: Diagnosis) -> str:
    """Return where the mismatch is; the name of a claimed element says it already."""
    if not diagnosis.places or any(c.claimed for c in diagnosis.claims):
        return ""
    first, kind = diagnosis.places[0], f" ({diagnosis.detail})" if diagnosis.detail else ""
    moves = vocabulary_of(diagnosis.base.setup.network).output_unit in MOVING
    place = f"a location {NETWORK}" if first == "mechanical" and not moves else f"the {first} location"
    return f" at {place}{kind}"


def _element(diagnosis: Diagnosis, claim: Claim) -> str:
    """Return an element of a model whose name is not claimed, in words."""
    if not claim.learned:
        return f"an element that acts like {words(claim.effect.name)} ({sure(claim.probability)})"
    formula = diagnosis.formulas.get(claim.effect.name)
    return f"a {words(claim.effect.name)}" + ("" if formula is None else f" ({formula.words.removesuffix('.')})")
