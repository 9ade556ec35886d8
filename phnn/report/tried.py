"""The candidates that were tried for the model, each with the reason why it was kept or rejected."""

from __future__ import annotations

from phnn.diagnose.linearised import tie
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.name import Candidate
from phnn.report.evidence import CandidateRow


def tried_rows(diagnosis: Diagnosis) -> list[CandidateRow]:
    """Every effect with its score, its refit and its outcome."""
    j, level = diagnosis.judgement, diagnosis.criteria.selection.level
    ended = diagnosis.ended
    failed = {f.candidate: f"no candidate: {f.error}: {f.message}" for f in (*ended.failed, *ended.warnings)}
    refits = {t.candidate.effect.name: t for t in j.tried if t.fit is not None}
    added = {f.effect.name for f in j.findings}
    members = {t.candidate.effect.name for f in j.findings for t in f.members} - added
    forms = {t.candidate.effect.name for f in j.findings for t in f.laws} - added
    samples = j.linearised.fit.residual.size

    def outcome(c: Candidate) -> str:
        name = c.effect.name
        if name in added:
            return "added"
        if name in forms:
            return "can nearly replace the learned element: the same in another form"
        if name in members:
            return "explains as much as the one added"
        if j.immaterial is not None and name == j.immaterial.candidate:
            return "significant, but immaterial"
        if name not in refits and name in failed:
            return failed[name]
        if name not in refits and diagnosis.ended.early and not j.tried and c.p_value < level:
            return "not refitted to the end: the search ended early"
        if name not in refits:
            return "not significant" if c.p_value >= level else "others score higher: not refitted"
        # With its strength at zero it is the base model, so that it cannot fit worse.
        if refits[name].cost > j.linearised.fit.cost + tie(j.linearised.fit):
            return "the refit failed: it ended above the base model, its special case"
        if not j.findings:
            moved = refits[name].cost < j.linearised.fit.cost - tie(j.linearised.fit)
            return "refitted; explains too little" if moved else "refitted; leaves as much as the base model"
        return "refitted; fits worse"

    return [
        CandidateRow(
            c.effect.name,
            c.effect.location,
            c.score,
            c.p_value,
            refits[c.effect.name].cost / samples if c.effect.name in refits else None,
            outcome(c),
        )
        for c in j.naming.by_name.values()
    ]
