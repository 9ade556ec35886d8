"""Evidence for each element of the final model."""

from __future__ import annotations

import math
from collections.abc import Mapping

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.number import Visited, family, uid
from phnn.diagnose.verdict import Claim
from phnn.effects import Effect, Plausible
from phnn.parameters import Parameter
from phnn.recordings.recording import ACTUATOR
from phnn.report.domain_words import forces_known
from phnn.report.fingerprint import fingerprint
from phnn.report.formatting import likelihood, number
from phnn.report.support import PlausibleRow, RivalRow, Support
from phnn.units import FORCE_UNITS, quantity

# Rivals that are shown.
_RIVALS = 8


def supports(diagnosis: Diagnosis) -> tuple[Support, ...]:
    """Return one entry for each element, in the order of ``missing``."""
    return tuple(_support(diagnosis, c) for c in diagnosis.claims)


def _support(diagnosis: Diagnosis, claim: Claim) -> Support:
    effect, before = claim.effect, diagnosis.final.setup.parameters
    actuator = diagnosis.campaign.recordings[0].units == ACTUATOR
    anchored = forces_known(diagnosis)
    return Support(
        effect=effect.name,
        expected=effect.fingerprint,
        seen=fingerprint(diagnosis, effect),
        leaves=math.sqrt(diagnosis.chosen.left),
        rivals=_rivals(diagnosis, claim),
        separation=effect.separation,
        references=effect.references,
        plausible=tuple(
            plausible_row(before[n], effect.plausible[n], before, anchored, actuator)
            for n in effect.parameters
            if not before[n].fixed
        ),
    )


def rivals_of(diagnosis: Diagnosis, claim: Claim) -> dict[str, tuple[Effect, Visited]]:
    """Return the best visited model with each other effect in the place of an element, by name, the best first."""
    others = diagnosis.chosen.key - {uid(claim.effect)}
    rivals: dict[str, tuple[Effect, Visited]] = {}
    for model in sorted(diagnosis.visited.models, key=lambda m: m.fit.cost):
        instead = [e for e in model.elements if uid(e) not in others]
        if others <= model.key and len(instead) == 1 and family(instead[0]) != claim.name:
            rivals.setdefault(instead[0].name, (instead[0], model))
    return rivals


def _rivals(diagnosis: Diagnosis, claim: Claim) -> tuple[RivalRow, ...]:
    """List what stood in the place of an element, and its neighbours that were not fitted there."""
    alike = {family(e) for e in claim.alike}
    rows = []
    fitted = rivals_of(diagnosis, claim)
    for name, (effect, model) in list(fitted.items())[:_RIVALS]:
        more = model.fit.cost - diagnosis.final.cost
        excluded = "not excluded: " if family(effect) in alike else "" if model.converged else "not fitted to its end: "
        outcome = f"sum of squares {number(abs(more))} {'larger' if more > 0.0 else 'smaller'}"
        share = likelihood(float(diagnosis.visited.shares[diagnosis.visited.models.index(model)]))
        rows.append(RivalRow(name, math.sqrt(model.left), f"{excluded}{outcome}, probability {share}"))
    scores = {c.effect.name: c.score for c in diagnosis.screened[0]}
    rows += [
        RivalRow(n, None, f"not fitted: its score at the base model is {number(scores[n])}")
        for n in claim.effect.neighbours
        if n in scores and n not in fitted
    ]
    return tuple(rows)


def plausible_row(
    parameter: Parameter, known: Plausible, base: Mapping[str, Parameter], anchored: bool, actuator: bool
) -> PlausibleRow:
    """A parameter compared with its plausible range.

    Args:
        base: parameters of the model, of which the range may name one to divide by.
        anchored: something fixes the common factor of all forces.
        actuator: the recordings are those of a piezo actuator, for which the ranges hold.
    """
    name, value, unit = parameter.name, parameter.value, parameter.unit
    said = quantity(value, unit)
    if not known.source or not actuator or (known.over and known.over not in base):
        return PlausibleRow(name, f"{said}: no range known.", None)
    if known.over:
        other = base[known.over]
        value, unit = value / other.value, f"× {known.over}" if other.unit == unit else f"{unit}/{other.unit}"
        unit = "1/s" if unit == "S/F" else unit
        said = f"{said}, that is {value:.3g} {unit}"
    elif not anchored and unit in FORCE_UNITS:
        return PlausibleRow(
            name, f"{said}: known up to one common factor only, hence not comparable with a range.", None
        )
    lower = "0" if known.lower == 0.0 else quantity(known.lower, unit)
    limits = f"{lower} to {quantity(known.upper, unit)}"
    if known.lower <= value <= known.upper:
        return PlausibleRow(name, f"{said} is plausible: {limits} ({known.source}).", True)
    beyond = f" If it is real, {known.outside}." if known.outside and value > known.upper else ""
    side = "above" if value > known.upper else "below"
    return PlausibleRow(
        name, f"{said} is not plausible: it is {side} the range {limits} ({known.source}).{beyond}", False
    )
