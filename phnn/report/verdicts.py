"""The four verdicts in words, and a document in the words of the system that was recorded.

`mechanical` is a word for what moves. Values are absolute or known up to one common factor.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from phnn.recordings.units import scales_with_forces
from phnn.report.document import Document, Lost, Missing, Remainder
from phnn.report.formatting import finite, listing, number, p_value, quantity, ratio, words

if TYPE_CHECKING:
    from phnn.diagnose.diagnosis import Diagnosis


def forces_known(diagnosis: Diagnosis) -> bool:
    """Whether forces are known in newtons: one was measured or imposed, or a stated parameter fixes the factor."""
    setup, recording = diagnosis.base.setup, diagnosis.campaign.recordings[0]
    # An input of unknown gain is a force in no known unit.
    measured = (recording.units.output, *([recording.units.input] if recording.gain == "known" else []))
    stated = [p.unit for n, p in setup.parameters.items() if n in diagnosis.campaign.known or (p.fixed and p.value)]
    return bool(setup.network.senses) or any(map(scales_with_forces, (*measured, *stated)))


# Units of outputs that move, or of what moves them, and what the location `mechanical` is called where nothing does.
MOVING = ("m", "rad", "N", "N m")
NETWORK = "inside the network"


def in_own_words(document: Document) -> Document:
    """The document with its locations as they are said to a person; names in ``diagnosis.json`` stay as they are."""
    if document.output_unit in MOVING:
        return document

    def said(name: str) -> str:
        return NETWORK if name == "mechanical" else name

    where, left = document.location, document.remainder
    if where is not None:
        scores = tuple((said(name), score) for name, score in where.scores)
        where = replace(where, name=said(where.name), tied=tuple(map(said, where.tied)), scores=scores)
    return replace(
        document,
        location=where,
        remainder=None if left is None else replace(left, location=said(left.location)),
        missing=tuple(replace(m, location=said(m.location)) for m in document.missing),
    )


VERDICT_WORDS = {
    "named": "One missing effect was named.",
    "equivalent": "Something is missing: one of a class of effects that these recordings cannot tell apart.",
    "unknown": "Something is missing, and no name for it is proven.",
    "none": "Nothing is missing: the base model explains these recordings down to the noise.",
}


def headline(document: Document, sentence: str) -> str:
    """The verdict in a sentence: the one supplied, or the general one."""
    return sentence.strip() or VERDICT_WORDS[document.verdict]


def ended_sentence(document: Document) -> str:
    """Say how a search ended that did not come to its end; empty for one that did."""
    ended, best = document.ended, "The answer is the best that was finished until then."
    left = f" Not tried, or not to the end: {listing(ended.not_tried)}." if ended.not_tried else ""
    size = "" if ended.budget is None else f" of {ended.budget:g} s"
    ways = {
        "seconds": f"ended early, because its time{size} was used up",
        "evaluations": "ended early, because its number of evaluations was used up",
        "interrupted": "was interrupted",
        "failure": "ended early, because a part of it failed",
    }
    return f"The search {ways[ended.why]}. {best}{left}" if ended.why in ways else ""


def lost_sentence(lost: Lost) -> str:
    """State a part that failed."""
    what = f"{lost.part} of {words(lost.candidate)}" if lost.candidate else lost.part
    often = f" ({lost.times} times)" if lost.times > 1 else ""
    return f"{what[:1].upper()}{what[1:]} failed{often}: {lost.error}: {lost.message.rstrip('.')}."


def test_sentence(document: Document) -> str:
    """Explain the largest score."""
    if document.p_value is None:
        return ""
    lead = f", that of {words(document.candidate)}," if document.candidate else ""
    statistic = "" if document.statistic is None else f" {number(document.statistic)}"
    start, odds = f"The largest score of all candidates{lead} is", f"({p_value(document.p_value)})"
    if (small := document.immaterial) is not None:
        over = "" if small.share_of_noise is None else f", {number(small.share_of_noise)} × the noise"
        size = f"{quantity(small.rms, document.output_unit)}{over}"
        explained = f"What it explains has a root mean square of {size}."
        return f"{start}{statistic or ' there'}: significant {odds} and immaterial. {explained}"
    if document.verdict == "none":
        return f"{start}{statistic and f'{statistic},'} too small to be followed up {odds}."
    return f"{start}{statistic or ' significant'} {odds}."


def tied(document: Document) -> bool:
    """Whether these recordings leave a tie of effects or of places."""
    several = any(set(m.equivalent_to) - {m.effect} for m in document.missing)
    places = document.location is not None and bool(document.location.tied)
    return document.verdict != "none" and (several or places)


def no_proposal_sentence(document: Document, why: str) -> str:
    """Say why no further recording is proposed.

    Args:
        why: the reason where something is tied or has no proven name, as the diagnosis knows it.
    """
    if why:
        return why
    if not tied(document):
        return "No further recording is proposed: there are no two models to tell apart."
    return "No recording is proposed for the tie: there are no two refitted models to compare."


def equivalence_sentence(missing: Missing) -> str:
    """List the effects that these recordings cannot tell from this one."""
    others = [words(name) for name in missing.equivalent_to if name != missing.effect]
    if not others:
        return ""
    if missing.effect == "unknown":
        return f"{listing(others, 'or').capitalize()} would describe these recordings equally well."
    return f"These recordings cannot tell {words(missing.effect)} from {listing(others, 'or')}."


def missing_title(missing: Missing) -> str:
    """Title of a missing element: its name if that is claimed."""
    if missing.effect != "unknown":
        return words(missing.effect).capitalize()
    if missing.equation and missing.nearest:
        return f"Acts like {words(missing.nearest)}, not proven"
    return "A learned element" if missing.equation or missing.status == "described" else "Without a name"


def held_out_sentence(missing: Missing) -> str:
    """State the held-out residual without and with an element."""
    found = missing.held_out
    if found is None or found.before is None or found.after is None:
        return ""
    odds = "too few independent blocks of time for a test" if found.p_value is None else p_value(found.p_value)
    sizes = f"{ratio(found.before)} and {ratio(found.after)}"
    return f"Held-out residual without and with it: {sizes} × the noise ({odds})."


def passive_sentence(missing: Missing) -> str:
    """State whether the model stays passive with the element."""
    if missing.passive is None or (missing.effect == "unknown" and not missing.equation):
        return ""
    if missing.passive:
        return "The model with it stays passive."
    return "The element is not passive by itself. It is not part of the passive network."


def remainder_sentence(remainder: Remainder | None, immaterial: bool = False) -> str:
    """Describe the remainder.

    Args:
        immaterial: whether it is significant, and too small to matter.
    """
    if remainder is None:
        return "The remainder was not judged."
    value = finite(remainder.residual_over_noise)
    size = "" if value is None else f" The residual is {ratio(value)} × the noise"
    odds = "" if remainder.p_value is None else f" ({p_value(remainder.p_value)})"
    tail = f"{size}{odds}." if size or odds else ""
    if immaterial or remainder.immaterial is not None:
        return f"The remainder is significant, and too small to matter.{tail}"
    if remainder.verdict == "none":
        return f"No significant remainder is left.{tail}"
    if remainder.verdict != "unknown":
        return f"The remainder was not judged.{tail}"
    place = f" Its location: {words(remainder.location)}." if remainder.location else ""
    return f"A significant remainder is left without a name.{tail}{place}"
