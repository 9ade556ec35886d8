"""Evidence for each element that a diagnosis has found."""

from __future__ import annotations

import math
from collections.abc import Mapping

from phnn.diagnose.linearised import tie
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.trial import Trial
from phnn.effects import Plausible
from phnn.parameters import Parameter
from phnn.recordings.recording import ACTUATOR
from phnn.report.domain_words import forces_known
from phnn.report.fingerprint import fingerprint
from phnn.report.formatting import number
from phnn.report.support import PlausibleRow, RivalRow, Support
from phnn.units import FORCE_UNITS, quantity

# Rivals that are shown beside the neighbours.
_RIVALS = 6


def supports(diagnosis: Diagnosis) -> tuple[Support, ...]:
    """Return one entry for each element, in the order of ``missing``."""
    return tuple(_support(diagnosis, f) for f in diagnosis.judgement.findings)


def _support(diagnosis: Diagnosis, finding: Finding) -> Support:
    effect, final = finding.effect, diagnosis.judgement.final
    named = effect if finding.provisional else finding.named_as
    before = final.setup.parameters
    actuator = diagnosis.campaign.recordings[0].units == ACTUATOR
    anchored = forces_known(diagnosis)
    fitted = finding.trial.fit
    return Support(
        effect=named.name if named is effect else f"{named.name} in another form",
        expected=named.fingerprint,
        seen=fingerprint(diagnosis, named),
        leaves=math.sqrt(fitted.chi2) if fitted is not None else math.nan,
        rivals=_rivals(diagnosis, finding),
        separation=named.separation,
        references=named.references,
        plausible=tuple(
            plausible_row(before[n], effect.plausible[n], before, anchored, actuator)
            for n in effect.parameters
            if not before[n].fixed
        ),
    )


def _rivals(diagnosis: Diagnosis, finding: Finding) -> tuple[RivalRow, ...]:
    """List the related effects and the next best ones, with the residual of each."""
    effect = finding.effect
    base = diagnosis.judgement.linearised.fit
    members = {t.candidate.effect.name for t in finding.members}
    refits: dict[str, Trial] = {}
    for trial in sorted(finding.trials, key=lambda t: t.cost):
        if trial.fit is not None and trial.candidate.effect.name != effect.name:
            refits.setdefault(trial.candidate.effect.name, trial)
    scores = finding.naming.by_name
    neighbours = [n for n in effect.neighbours if n in refits or n in scores]
    rows = []
    for name in dict.fromkeys([*neighbours, *list(refits)[:_RIVALS]]):
        found = refits.get(name)
        if found is None or found.fit is None:
            own, best = scores[name].score, scores[effect.name].score if effect.name in scores else math.nan
            rows.append(RivalRow(name, None, f"not refitted: its score is {own:.3g}, the best is {best:.3g}"))
        elif name in members:
            rows.append(RivalRow(name, math.sqrt(found.fit.chi2), "not excluded: explains as much"))
        elif found.cost > base.cost + tie(base):
            rows.append(RivalRow(name, None, "not decided: its refit failed"))
        else:
            rows.append(RivalRow(name, math.sqrt(found.fit.chi2), _excluded(finding.trial, found)))
    return tuple(rows)


def _excluded(best: Trial, rival: Trial) -> str:
    """State by how much a rival fits worse, and the difference that would be a tie."""
    more = rival.cost - best.cost
    if best.fit is None or more <= 0.0:
        return "fits as well, but with terms of each recording that no model predicts"
    limit = number(tie(best.fit))
    return f"excluded: its error is larger, by {number(more)} in the sum of squares; up to {limit} would be a tie"


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
