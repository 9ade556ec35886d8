"""The entries of ``missing`` in ``diagnosis.json``: one for every element of the model beyond the base."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from phnn.diagnose.formula import Distilled
from phnn.diagnose.words import is_effort, vocabulary_of
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import Judgement
from phnn.diagnosis.place import in_another_form
from phnn.effects.places import place_of
from phnn.identification.fit import Fit
from phnn.report.domain_words import forces_known
from phnn.report.sentence import unknown_character, unknown_statement
from phnn.units import FORCE_UNITS, quantity

_UP_TO_FACTOR = " Absolute values are known up to one common factor, because nothing anchors them."
_PROVISIONAL = " It is part of the model because it improves predictions; nothing proves that it is the physical cause."


def missing_entries(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the entries: empty for ``none``, one without a name if no element explains the mismatch."""
    j = diagnosis.judgement
    if j.verdict == "none":
        return []
    if not j.findings:
        return [_nameless(j, forces_known(diagnosis))]
    return [_entry(diagnosis, f) for f in j.findings]


def _entry(diagnosis: Diagnosis, finding: Finding) -> dict[str, Any]:
    final, anchored = diagnosis.judgement.final, forces_known(diagnosis)
    effect = finding.effect
    parameters = final.setup.parameters
    shown = {n: quantity(parameters[n].value, parameters[n].unit) for n in effect.parameters}
    # A provisional element belongs to the model, and its name is not claimed.
    claimed: dict[str, Any] = {"effect": finding.named_as.canonical, "status": _status(diagnosis, finding)}
    if finding.provisional:
        claimed = {
            "effect": "unknown",
            "status": "provisional",
            "nearest": None if finding.nameless else finding.named_as.canonical,
        }
    found = finding.described
    if found is not None:
        status = "described" if finding.provisional else claimed["status"]
        claimed |= {"status": status, "description": _description(found, effect.passive)}
    said = effect.statement.format(**shown) if found is None else found.words
    if finding.laws and not finding.provisional:
        laws = dict.fromkeys(t.candidate.effect.canonical.replace("_", " ") for t in finding.laws)
        said += f" It is {' or '.join(laws)} in another form than the catalogue gives it."
        claimed["form"] = effect.name
    names = effect.strengths if finding.learned else effect.parameters
    return claimed | {
        "held_out": _held_out(finding),
        "share_explained": finding.share,
        "location": effect.location,
        "place": place_of(effect, diagnosis.base.setup.network),
        "equivalent_to": list(dict.fromkeys(t.candidate.effect.title for t in finding.alike[1:])),
        "p_value": finding.evidence[1],
        "statement": said
        + ("" if anchored or not any(parameters[n].unit in FORCE_UNITS for n in effect.parameters) else _UP_TO_FACTOR)
        + (_PROVISIONAL if finding.provisional else ""),
        "equation": effect.equation if found is None else found.equation,
        "passive": effect.passive,
        "parameters": _estimates(final, names),
    }


def _status(diagnosis: Diagnosis, finding: Finding) -> str:
    """Status of a claimed element: the verdict, or ``named`` if this element alone is proven."""
    held, level = finding.held_out, diagnosis.criteria.confirmation.held_out_level
    proven = held is not None and held.falls is not None and held.falls < level
    form = in_another_form(finding, diagnosis.judgement.findings)
    alone = len(finding.alike) == 1 and not form and diagnosis.campaign.held_out_is_new
    return "named" if alone and proven else diagnosis.judgement.verdict


def _estimates(final: Fit, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Value, standard error and 95 % interval of parameters, SI; null where they were not estimated."""
    parameters, std = final.setup.parameters, final.std()
    return {
        n: {
            "value": parameters[n].value,
            "unit": parameters[n].unit,
            "std": std.get(n),
            "interval_95": final.interval(n),
        }
        for n in names
    }


def _held_out(finding: Finding) -> dict[str, Any] | None:
    """Describe the gain of an element on held-out recordings; null without held-out recordings."""
    found = finding.held_out
    if found is None:
        return None
    return {"before": found.before, "after": found.after, "p_value": found.falls, "rms": found.rms}


def _description(found: Distilled, passive: bool) -> dict[str, Any]:
    """The formula of a learned element; exponents by their symbols, each with its 95 % interval."""
    return {
        "kind": found.kind,
        "formula": found.equation,
        "words": found.words,
        "parameters": {n: {"value": value, "unit": unit} for n, (value, unit) in found.parameters.items()},
        "exponents": {n: list(interval) for n, (_, interval) in found.exponents.items()},
        "passive": passive,
        "others": list(found.others),
    }


def _nameless(j: Judgement, anchored: bool) -> dict[str, Any]:
    """Describe the mismatch if no element improves predictions.

    Args:
        anchored: forces are known in newtons, not only up to one common factor.
    """
    best = min(j.tried, key=lambda t: t.cost, default=None)
    # A refit that ended above the base model has failed, and is near to nothing.
    helps = best is not None and best.cost < j.linearised.fit.cost
    nearest = best.candidate.effect.name if best is not None and helps else None
    where = j.location
    free = where is not None and not anchored and is_effort(where)
    factor = _UP_TO_FACTOR if free and vocabulary_of(j.linearised.fit.setup.network).mechanical else ""
    return {
        "effect": "unknown",
        "status": "provisional",
        "nearest": nearest,
        "held_out": None,
        "share_explained": None,
        "location": where.name if where else "mechanical",
        "place": None,
        "equivalent_to": [],
        "p_value": j.naming.p_value,
        "statement": f"{unknown_statement(j)} {unknown_character(j)}".strip() + factor,
        "equation": "",
        "passive": False,
        "parameters": {},
    }
