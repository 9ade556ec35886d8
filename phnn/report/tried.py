"""Models that a diagnosis has fitted, and candidates in the residual of its base model and of its final one."""

from __future__ import annotations

import math

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.screen import Candidate
from phnn.diagnose.search import material
from phnn.diagnose.verdict import NONE
from phnn.report.document import Immaterial
from phnn.report.evidence import CandidateRow, ModelRow

# Models that are listed.
_MODELS = 25


def model_rows(diagnosis: Diagnosis) -> list[ModelRow]:
    """Return the models that were fitted, the most probable first."""
    pairs = zip(diagnosis.visited.models, diagnosis.visited.shares, strict=True)
    return [
        ModelRow(
            m.words, m.left, m.left_held_out, m.nuisances + sum(map(m.parameters_of, m.elements)), float(share),
            m.converged,
            m.key == diagnosis.chosen.key,
        )
        for m, share in list(pairs)[:_MODELS]
    ]  # fmt: skip


def candidate_rows(diagnosis: Diagnosis) -> list[CandidateRow]:
    """Return the candidates in the residual of the base model, the largest predicted fall of χ² first."""
    ended, samples = diagnosis.ended, diagnosis.base.residual.size
    failed = {f.candidate: f"{f.error}: {f.message}" for f in (*ended.failed, *ended.warnings) if f.candidate}
    fitted = {e.name for m in diagnosis.visited.models for e in m.elements}
    chosen = {c.effect.name for c in diagnosis.claims}

    def outcome(c: Candidate) -> str:
        if c.effect.name in chosen:
            return "in the final model"
        if c.effect.name in fitted:
            return "fitted"
        if c.effect.name in failed:
            return f"no candidate: {failed[c.effect.name]}"
        if material(c, diagnosis.base, diagnosis.criteria):
            return "not fitted: others promised more"
        significant = c.score > diagnosis.criteria.score
        return "significant, but immaterial" if significant else "not significant"

    return [
        CandidateRow(c.effect.name, c.effect.location, c.score, c.fall / samples, outcome(c))
        for c in diagnosis.screened[0]
    ]


def remains(diagnosis: Diagnosis) -> bool:
    """Return whether some candidate explains a part that matters of what the final model leaves."""
    if diagnosis.verdict == NONE:
        return False
    return any(material(c, diagnosis.final, diagnosis.criteria) for c in diagnosis.screened[1])


def immaterial(diagnosis: Diagnosis, after: bool = False) -> Immaterial | None:
    """Return what is significant in the residual of a model that lacks nothing that matters; None where nothing is.

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
    return Immaterial(best.effect.name, share * math.sqrt(sum(n**2 for n in noise) / len(noise)), share)
