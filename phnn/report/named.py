"""Evidence for each element of the final model."""

from __future__ import annotations

import math
from collections.abc import Mapping

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.number import family, uid
from phnn.diagnose.verdict import Claim
from phnn.effects import Plausible
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


def _rivals(diagnosis: Diagnosis, claim: Claim) -> tuple[RivalRow, ...]:
    """List the visited models with another element in the place of one, and neighbours that were not fitted there."""
    others, alike = diagnosis.chosen.key - {uid(claim.effect)}, {family(e) for e in claim.alike}
    pairs = zip(diagnosis.visited.models, diagnosis.visited.shares, strict=True)
    rows: dict[str, RivalRow] = {}
    for model, share in sorted(pairs, key=lambda p: p[0].fit.cost):
        instead = [e for e in model.elements if uid(e) not in others]
        if not others <= model.key or len(instead) != 1 or family(instead[0]) == claim.name:
            continue
        more = model.fit.cost - diagnosis.final.cost
        excluded = "not excluded: " if family(instead[0]) in alike else ""
        excluded = excluded or ("" if model.converged else "not fitted to its end: ")
        outcome = f"sum of squares {number(abs(more))} {'larger' if more > 0.0 else 'smaller'}"
        told = f"{excluded}{outcome}, probability {likelihood(float(share))}"
        rows.setdefault(instead[0].name, RivalRow(instead[0].name, math.sqrt(model.left), told))
    scores = {c.effect.name: c.score for c in diagnosis.screened[0]}
    unfitted = [n for n in claim.effect.neighbours if n in scores and n not in rows]
    texts = [(n, f"not fitted: its score at the base model is {number(scores[n])}") for n in unfitted]
    return (*list(rows.values())[:_RIVALS], *(RivalRow(n, None, text) for n, text in texts))


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
