"""The sentences of a diagnosis: the verdict in a line, its consequence, and its elements.

One number stands for the quality of a model everywhere: its error on held-out recordings, in units of the noise.
Without a noise floor the error is a share of the signal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from phnn.check import check, doubts
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.number import family, is_learned
from phnn.diagnose.search import material
from phnn.diagnose.verdict import EQUIVALENT, NAMED, NONE, UNKNOWN, Claim
from phnn.effects import Effect, Plausible
from phnn.effects.kinds import OVER_TIME
from phnn.identification.evaluate import Evaluation
from phnn.parameters import Parameter, quantity
from phnn.recordings.units import scales_with_forces
from phnn.report.formatting import likelihood, listing, plain, ratio, with_error, words
from phnn.report.words import vocabulary_of
from phnn.rescue import documents, warnings

# Letters of a verdict in one line: what fits a heading of two lines on a telephone.
LONGEST = 90
# Units of outputs that move, or of what moves them, and what the location `mechanical` is called where nothing does.
_MOVING = ("m", "rad", "N", "N m")
_INSIDE = "inside the network"
# What is missing at a location, where no name is proven.
_UNNAMED = {
    "mechanical": "A mechanical effect is missing", "electrical": "An electrical effect is missing",
    "hysteron": "Hysteresis has another form", "coupling": "The coupling has another form",
    "thermal": "A thermal effect is missing", "sensor": "The sensor does more than was modelled",
    "amplifier": "The amplifier does more than was modelled", "environment": "A disturbance acts from outside",
}  # fmt: skip
_CHANGING = {"hysteron": "Hysteresis", "coupling": "The coupling", "sensor": "The sensor"}
# Why no name is proven, by the rule that gave the verdict.
_WHY = {
    "the_search_ended_early": "because the search ended early",
    "something_is_left": "because the model still leaves more than the noise",
    "an_element_is_learned": "because a learned element is part of the model",
    "held_out_recordings_deny_it": "because not every element improves the prediction of held-out recordings",
}
# Least probability of a cause that is listed, and how many are.
_LEAST, _CAUSES = 0.01, 3
# File beside the report with the input of the next recording.
WAVEFORM = "next_experiment.csv"
# Recordings that are asked for at a time.
_LACKS = 3


@dataclass(frozen=True)
class Quality:
    """The error of the base model and of the final model on held-out recordings.

    Attributes:
        before, after: root mean square over the recordings, in `unit`; NaN where nothing was scored.
        unit: ``× noise``, or ``% of the signal`` where some recording has no noise floor.
        held_out: these are held-out recordings; otherwise those that were fitted, because no others exist.
    """

    before: float
    after: float
    unit: str
    held_out: bool

    @property
    def on(self) -> str:
        """Return the recordings in words."""
        return "held-out recordings" if self.held_out else "the fitted recordings (none was held out)"

    def show(self, value: float) -> str:
        """Return a value without its unit."""
        return ratio(value) if self.unit.startswith("×") else plain(value)

    def say(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{self.show(value)} {self.unit}"


def quality(diagnosis: Diagnosis) -> Quality:
    """Return the number by which the two models are compared."""
    uses = {p.use for p in diagnosis.before.parts}
    use = "confirmation" if "confirmation" in uses else "identification"
    both, known = (diagnosis.before, diagnosis.after), all(r.noise_found for r in diagnosis.campaign.recordings)
    before, after = (e.over_noise(use) if known else _share_of_signal(e, use) for e in both)
    return Quality(before, after, "× noise" if known else "% of the signal", use == "confirmation")


def _share_of_signal(scores: Evaluation, use: str) -> float:
    """Return the mean of ``100 − fit %`` over the parts of one use."""
    shares = [100.0 - p.fit_percent for p in scores.parts if p.use == use and math.isfinite(p.fit_percent)]
    return sum(shares) / len(shares) if shares else math.nan


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in a line of at most `LONGEST` letters."""
    word, claims = diagnosis.verdict, diagnosis.claims
    if word == NONE:
        return "Nothing is missing"
    if word == UNKNOWN:
        if diagnosis.ended.early and not claims and not diagnosis.significance()[1] < 1.0:
            return "Whether something is missing is not known: the base model was not tested"
        return f"{_nameless(diagnosis)}; no name is proven"
    names = [listing(class_of(c), "or") for c in claims]
    verb = "is" if len(names) == 1 else "are"
    many = f"{len(names)} effects are" if len(names) > 1 else f"One of {len(class_of(claims[0]))} effects is"
    sure = likelihood(min(c.probability for c in claims)).replace(">", "more than").replace("<", "less than")
    end = f" missing: {sure} sure"
    if any(c.alike for c in claims):
        end = " missing; these recordings cannot tell which"
    elif word == EQUIVALENT:
        end = " missing; no new recording confirms it"
    named = f"{capital(listing(names))} {verb}"
    return next(line for line in (f"{named}{end}", f"{named} missing", f"{many}{end}") if len(line) <= LONGEST)


def consequence(diagnosis: Diagnosis) -> str:
    """Return what follows from the verdict, in one sentence with the error on held-out recordings."""
    q = quality(diagnosis)
    if diagnosis.final is diagnosis.base:
        start = "The base model" if diagnosis.verdict == NONE else "The model is still the base model: it"
        return f"{start} predicts {q.on} to {q.say(q.after)}."
    if diagnosis.verdict == UNKNOWN:
        start = "The model" if doubts(diagnosis.campaign) else "Use the model all the same: it"
        return f"{start} predicts {q.on} to {q.say(q.after)} instead of {q.show(q.before)}."
    with_it = "it" if len(diagnosis.claims) == 1 and not diagnosis.claims[0].alike else "the final model"
    verb = "falls" if q.after < q.before else "goes"
    return f"With {with_it}, the error on {q.on} {verb} from {q.show(q.before)} to {q.say(q.after)}."


def summary(diagnosis: Diagnosis) -> str:
    """Return the whole answer as a few lines of text."""
    lines = [headline(diagnosis), consequence(diagnosis), *notes(diagnosis)]
    lines.append(f"verdict: {diagnosis.verdict}")
    elements = ((element(diagnosis, c), parameters_in_words(diagnosis, c)) for c in diagnosis.claims)
    lines += [f"  {name}: {values}" if values else f"  {name}" for name, values in elements]
    if diagnosis.verdict == UNKNOWN:
        lines.append(acts_like(diagnosis))
    lines.append("probability: " + ", ".join(f"{n} {likelihood(p)}" for n, p in causes(diagnosis)))
    return "\n".join([*lines, *filter(None, [next_recording(diagnosis)])])


def notes(diagnosis: Diagnosis) -> list[str]:
    """Return what restricts the answer: doubtful recordings, a search that ended early, parts that failed, the rest."""
    sentences = [f"Before you believe the rest, correct the recordings. {d}" for d in doubts(diagnosis.campaign)]
    sentences += [early] if (early := early_ending(diagnosis)) else []
    sentences += [failure(f) for f in documents((*diagnosis.ended.warnings, *warnings()))]
    if diagnosis.verdict not in (NONE, UNKNOWN) and remains(diagnosis):
        sentences.append("A significant remainder is left without a name.")
    return sentences


def early_ending(diagnosis: Diagnosis) -> str:
    """Say how a search ended that did not come to its end; empty for one that did."""
    ended = diagnosis.ended
    if not ended.early:
        return ""
    size = "" if ended.budget is None else f" of {ended.budget:g} s"
    ways = {
        "seconds": f"ended early, because its time{size} was used up",
        "evaluations": "ended early, because its number of evaluations was used up",
        "interrupted": "was interrupted",
    }
    untried = f" Not tried, or not to the end: {listing(ended.not_tried)}." if ended.not_tried else ""
    way = ways.get(ended.why, "ended early, because a part of it failed")
    return f"The search {way}. The answer is the best that was finished until then.{untried}"


def failure(failed: Mapping[str, Any]) -> str:
    """Describe a part that failed, an entry of `phnn.rescue.documents`."""
    what = f"{failed['part']} of {words(failed['candidate'])}" if failed["candidate"] else failed["part"]
    often = f" ({failed['times']} times)" if failed["times"] > 1 else ""
    return f"{capital(what)} failed{often}: {failed['error']}: {failed['message'].rstrip('.')}."


def _nameless(diagnosis: Diagnosis) -> str:
    """Return what is missing, by its location; without one where locations are tied, or where the effect that alone
    explains most is at another one."""
    places, alike = diagnosis.places, likenesses(diagnosis)
    if not places or (not diagnosis.claims and len(places) > 1):
        return "Something is missing"
    if alike and alike[0][0].location not in places:
        return "Something is missing"
    if places[0] == "mechanical" and location_name(diagnosis, places[0]) == _INSIDE:
        return f"Something is missing {_INSIDE}"
    timely = [c.effect.location for c in diagnosis.claims if c.effect.kind in OVER_TIME]
    return f"{_CHANGING[places[0]]} changes with time" if places[0] in timely else _UNNAMED[places[0]]


def location_name(diagnosis: Diagnosis, name: str) -> str:
    """Return a location as a person calls it: nothing is mechanical where nothing moves."""
    moves = vocabulary_of(diagnosis.base.setup.network).output_unit in _MOVING
    return words(name) if moves or name != "mechanical" else _INSIDE


def capital(text: str) -> str:
    """Return a text that begins with a capital letter."""
    return text[:1].upper() + text[1:]


def class_of(claim: Claim) -> list[str]:
    """Return the name of an element and those of the effects that may stand in its place."""
    return list(dict.fromkeys(words(n) for n in (claim.name, *(e.title for e in claim.alike))))


def element(diagnosis: Diagnosis, claim: Claim) -> str:
    """Return an element with its location and probability: ``creep (mechanical, 97 %)``."""
    name = listing(class_of(claim), "or") if claim.claimed or claim.learned else f"acts like {words(claim.name)}"
    return f"{name} ({location_name(diagnosis, claim.effect.location)}, {likelihood(claim.probability)})"


def parameters_in_words(diagnosis: Diagnosis, claim: Claim) -> str:
    """Return the estimates of an element with their standard errors; the formula of a learned one."""
    formula = diagnosis.formulas.get(claim.effect.name)
    if formula is not None or claim.learned:
        return formula.words if formula is not None else ""
    known, std = diagnosis.final.setup.parameters, diagnosis.final.std()
    shown = (f"{n} = {with_error(known[n].value, std.get(n))} {shown_unit(known[n].unit)}" for n in claim.parameters)
    return ", ".join(map(str.rstrip, shown))


def shown_unit(unit: str) -> str:
    """Return a unit; empty for a plain number."""
    return "" if unit == "1" else unit


def causes(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """Return the likeliest effects with their probabilities, then what no effect of the catalogue explains, then none.

    The probability of an effect is the share of all fitted models that hold it, times the probability that the
    catalogue lists all that acts. While the verdict is open and the model holds no element, the last two are one: the
    weight of the base model says only that nothing that was tried is better.
    """
    of = diagnosis.probability
    likely = [(words(n), p) for n, p in of.items() if n != NONE and p >= _LEAST][:_CAUSES]
    best = max(of, key=lambda n: of[n])
    complete = of[best] / weight if (weight := diagnosis.visited.probability.get(best, 0.0)) > 0.0 else 1.0
    nothing = of.get(NONE, 0.0)
    if diagnosis.verdict == UNKNOWN and not diagnosis.claims:
        return [*likely, ("nothing that was tried", 1.0 - complete + nothing)]
    beyond = [("something else", 1.0 - complete)] if complete < 1.0 - _LEAST else []
    return [*likely, *beyond, ("nothing is missing", nothing)]


def likenesses(diagnosis: Diagnosis) -> list[tuple[Effect, float]]:
    """Return the effects that alone explain most, with the share of the excess over the noise that each explains; of
    effects of one family, the one that explains most."""
    excess = diagnosis.base.beyond_noise
    single = [m for m in diagnosis.visited.models if len(m.elements) == 1 and not is_learned(m.elements[0])]
    best: dict[str, tuple[Effect, float]] = {}
    for model in sorted(single, key=lambda m: m.fit.cost):
        share = (diagnosis.base.cost - model.fit.cost) / excess if excess > 0.0 else 0.0
        if share > 0.0:
            best.setdefault(family(model.elements[0]), (model.elements[0], min(share, 1.0)))
    return list(best.values())[:_CAUSES]


def acts_like(diagnosis: Diagnosis) -> str:
    """Say what a mismatch without a proven name acts like and by how much, and why no name is proven."""
    like = ""
    for effect, share in likenesses(diagnosis)[:1]:
        part = f"{100.0 * share:.0f} % of the excess over the noise"
        like = f"It acts most like {words(family(effect))}, which alone explains {part}. "
    if not diagnosis.claims and (nothing := diagnosis.base.nothing_statement()):
        return f"{nothing}."
    if not diagnosis.claims and diagnosis.ended.early:
        return f"{like}The search ended before it accepted an element."
    if not diagnosis.claims:
        return f"{like}No effect and no learned element is in the model, because none describes the recordings better."
    rule = diagnosis.outcome.rules[-1].rule if diagnosis.outcome.rules else ""
    why = _WHY.get(rule, "because several explanations are about as probable")
    parts = listing(_described(diagnosis, c) for c in diagnosis.claims)
    return f"{like}The model describes it by {parts}. No name is proven, {why}."


def _described(diagnosis: Diagnosis, claim: Claim) -> str:
    if not claim.learned:
        return words(claim.effect.name)
    formula = diagnosis.formulas.get(claim.effect.name)
    return f"a {words(claim.effect.name)}" + ("" if formula is None else f" ({formula.words.removesuffix('.')})")


def next_recording(diagnosis: Diagnosis) -> str:
    """Return the next recording in one line, or why none is proposed; empty where no name is open."""
    if diagnosis.verdict in (NAMED, NONE):
        return ""
    if diagnosis.proposal is not None:
        return f"Record next: {diagnosis.proposal.experiment.words}."
    tied = next((c for c in diagnosis.claims if c.alike), None)
    if tied is None and diagnosis.verdict != UNKNOWN:
        return ""
    members = () if tied is None else (tied.effect, *tied.alike)
    separations = [f"For {words(e.name)}: {e.separation}" for e in members[:2]]
    # Recordings whose absence `phnn check` reports.
    lacks = [a.record for a in check(diagnosis.campaign).abilities if not a.able][:_LACKS]
    also = [f"These recordings lack: {'; '.join(lacks)}."] if lacks else []
    if not separations and not also:
        return ""
    return " ".join(["No further recording within the range of these would decide.", *separations, *also])


def remains(diagnosis: Diagnosis) -> bool:
    """Return whether some candidate explains a part that matters of what the final model leaves."""
    if diagnosis.verdict == NONE:
        return False
    return any(material(c, diagnosis.final, diagnosis.criteria) for c in diagnosis.screened[1])


def immaterial(diagnosis: Diagnosis, after: bool = False) -> dict[str, Any] | None:
    """Return what is significant in the residual of a model that lacks nothing that matters; None where nothing is.

    Its root mean square is in SI, and a share of that of the noise.

    Args:
        after: of the final model, else of a base model that stands.
    """
    if remains(diagnosis) if after else diagnosis.verdict != NONE:
        return None
    best = max(diagnosis.screened[after], key=lambda c: c.score, default=None)
    if best is None or not best.score > diagnosis.criteria.score:
        return None
    fit = diagnosis.final if after else diagnosis.base
    share = math.sqrt(max(best.fall / fit.residual.size, 0.0))
    noise = [r.noise for r in fit.plan.recordings]
    rms = share * math.sqrt(sum(n**2 for n in noise) / len(noise))
    return {"candidate": best.effect.name, "rms": rms, "share_of_noise": share}


def remainder_in_words(diagnosis: Diagnosis) -> str:
    """Say whether the final model leaves more than noise."""
    if remains(diagnosis):
        where = diagnosis.remaining
        place = "" if where is None else f" Its location: {location_name(diagnosis, where.name)}."
        return f"The final model leaves a significant remainder.{place}"
    small = immaterial(diagnosis, after=True)
    if small is None:
        return "No candidate finds anything in what the final model leaves."
    size = quantity(small["rms"], diagnosis.campaign.recordings[0].units.output)
    return (
        f"{capital(words(small['candidate']))} is significant in what the final model leaves, but too small to matter: "
        f"{size}, {plain(small['share_of_noise'], 2)} × noise."
    )


def forces_known(diagnosis: Diagnosis) -> bool:
    """Return whether forces are known in newtons: one was measured or imposed, or an anchor fixes the factor."""
    setup, recording = diagnosis.base.setup, diagnosis.campaign.recordings[0]
    # An input of unknown gain is a force in no known unit.
    measured = (recording.units.output, *([recording.units.input] if recording.gain == "known" else []))
    stated = [p.unit for n, p in setup.parameters.items() if n in diagnosis.campaign.known or (p.fixed and p.value)]
    return bool(setup.network.senses) or any(map(scales_with_forces, (*measured, *stated)))


def plausibility(parameter: Parameter, known: Plausible, base: dict[str, Parameter], anchored: bool) -> str:
    """Compare a parameter of a piezo actuator with its plausible range; empty without a range.

    Args:
        base: parameters of the model, of which the range may name one to divide by.
        anchored: something fixes the common factor of all forces.
    """
    value, unit = parameter.value, parameter.unit
    subject = f"{parameter.name} = {quantity(value, unit)}"
    if not known.source or (known.over and known.over not in base):
        return ""
    if known.over:
        other = base[known.over]
        value, unit = value / other.value, f"× {known.over}" if other.unit == unit else f"{unit}/{other.unit}"
        unit = "1/s" if unit == "S/F" else unit
        subject = f"{subject}, that is {value:.3g} {unit},"
    elif not anchored and scales_with_forces(unit):
        return ""
    limits = f"{'0' if known.lower == 0.0 else quantity(known.lower, unit)} to {quantity(known.upper, unit)}"
    if known.lower <= value <= known.upper:
        return f"{subject} is plausible: {limits} ({known.source})."
    beyond = f" If it is real, {known.outside}." if known.outside and value > known.upper else ""
    side = "above" if value > known.upper else "below"
    return f"{subject} is not plausible: it is {side} the range {limits} ({known.source}).{beyond}"


def first_screen(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what the first screen of the report says, for ``diagnosis.json``."""
    q = quality(diagnosis)
    return {
        "headline": headline(diagnosis), "consequence": consequence(diagnosis), "error": asdict(q),
        "causes": dict(causes(diagnosis)), "next": next_recording(diagnosis) or None,
    }  # fmt: skip
