"""The entries of ``missing`` in ``diagnosis.json``: one for every element of the model beyond the base."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.formula import Distilled
from phnn.diagnose.number import family
from phnn.diagnose.screen import chance
from phnn.diagnose.verdict import LEARNED, Claim
from phnn.diagnose.words import fitted_in_words, is_effort, vocabulary_of
from phnn.effects import Effect
from phnn.effects.mechanical import growth_per_decade
from phnn.effects.places import place_of, values_by_role
from phnn.identification.fit import Fit
from phnn.report.domain_words import forces_known
from phnn.report.sentence import nearest, unknown_statement
from phnn.units import FORCE_UNITS, quantity

_UP_TO_FACTOR = " Absolute values are known up to one common factor, because nothing anchors them."
_NOT_PROVEN = " It is part of the model because it improves predictions; nothing proves that it is the physical cause."


def missing_entries(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the entries: empty for ``none``, one without a name if no element explains the mismatch."""
    if diagnosis.verdict == "none":
        return []
    return [_entry(diagnosis, c) for c in diagnosis.claims] or [_nameless(diagnosis)]


def _entry(diagnosis: Diagnosis, claim: Claim) -> dict[str, Any]:
    effect, parameters = claim.effect, diagnosis.final.setup.parameters
    shown = {n: quantity(parameters[n].value, parameters[n].unit) for n in effect.parameters}
    names = list(dict.fromkeys(e.title for e in claim.alike))
    # An element whose name is not claimed belongs to the model all the same.
    entry: dict[str, Any] = {"effect": claim.name, "status": claim.status}
    if not claim.claimed:
        entry["effect"] = "unknown"
        entry["nearest"] = next(iter(names), None) if claim.learned else claim.name
    formula = diagnosis.formulas.get(effect.name)
    if formula is not None:
        status = "described" if claim.status == LEARNED else claim.status
        entry |= {"status": status, "description": _description(formula, effect)}
    free = not forces_known(diagnosis) and any(parameters[n].unit in FORCE_UNITS for n in effect.parameters)
    statement = effect.statement.format(**shown) if formula is None else formula.words
    network, scales = diagnosis.final.setup.network, diagnosis.linearised[0].scales
    stiffness, first, last = values_by_role(network).get("k"), 1.0 / scales.fastest, scales.duration
    # Neither a motion without a spring grows under a force, nor one that was recorded for less than a period.
    if effect.title == "creep" and stiffness and first < last:
        growth = growth_per_decade(network, stiffness, first, last)
        entry["percent_per_decade"] = growth
        statement += (
            f" From {quantity(first, 's')} to {quantity(last, 's')} it grows by {growth:.2g} % in every decade."
        )
    return entry | {
        "probability": round(claim.probability, 4),
        "held_out": _held_out(diagnosis, claim),
        "share_explained": claim.share,
        "location": effect.location,
        "place": place_of(effect, diagnosis.base.setup.network),
        "equivalent_to": names,
        "p_value": _p_value(diagnosis, claim),
        "statement": statement + (_UP_TO_FACTOR if free else "") + ("" if claim.claimed else _NOT_PROVEN),
        "equation": effect.equation if formula is None else formula.equation,
        "passive": effect.passive,
        "parameters": _estimates(diagnosis.final, effect.strengths if claim.learned else effect.parameters),
    }


def _p_value(diagnosis: Diagnosis, claim: Claim) -> float:
    """Return the p-value of an effect's own score in the residual of the base model, times the number of candidates."""
    candidates = diagnosis.screened[0]
    score = max((c.score for c in candidates if family(c.effect) == claim.name), default=0.0)
    return chance(score, candidates) if candidates else 1.0


def _estimates(final: Fit, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return value, standard error and 95 % interval of parameters, SI; null where they were not estimated."""
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


def _held_out(diagnosis: Diagnosis, claim: Claim) -> dict[str, Any] | None:
    """Return the gain of an element on held-out recordings; null without held-out recordings."""
    gain = diagnosis.gains[diagnosis.claims.index(claim)]
    if gain is None:
        return None
    return {"before": gain.before, "after": gain.after, "p_value": gain.falls, "rms": gain.rms}


def _description(formula: Distilled, effect: Effect) -> dict[str, Any]:
    """Return the formula of a learned element; exponents by their symbols, each with its 95 % interval."""
    return {
        "kind": effect.kind.name,
        "formula": formula.equation,
        "words": formula.words,
        "parameters": {n: {"value": value, "unit": unit} for n, (value, unit) in formula.parameters.items()},
        "exponents": {n: list(interval) for n, (_, interval) in formula.exponents.items()},
        "passive": effect.passive,
        "others": list(formula.others),
    }


def _nameless(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the entry of a mismatch that no element describes."""
    where, model = diagnosis.location, nearest(diagnosis)
    fitted = "" if where is None else fitted_in_words(diagnosis.linearised[0], where)
    free = where is not None and is_effort(where) and not forces_known(diagnosis)
    factor = _UP_TO_FACTOR if free and vocabulary_of(diagnosis.base.setup.network).mechanical else ""
    return {
        "effect": "unknown",
        "status": "provisional",
        "nearest": None if model is None else family(model.elements[0]),
        "probability": None,
        "held_out": None,
        "share_explained": None,
        "location": where.name if where else "mechanical",
        "place": None,
        "equivalent_to": [],
        "p_value": diagnosis.significance()[1],
        "statement": f"{unknown_statement(diagnosis)} {fitted}".strip() + factor,
        "equation": "",
        "passive": False,
        "parameters": {},
    }
