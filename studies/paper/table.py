"""Table 3: the port-Hamiltonian and the Bouc–Wen model on every recording, refitted and as published."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from phnn.diagnosis.tested import score_on_all
from phnn.identification.base import Progress, identify_base, identify_bouc_wen, quiet
from phnn.identification.evaluate import Evaluation, PartScore
from phnn.identification.fit import Fit, fit
from phnn.identification.options import Options
from phnn.models.actuator import from_paper
from phnn.models.bouc_wen import bouc_wen
from phnn.recordings.recording import Campaign
from phnn.setup import Setup
from studies.paper.published import TABLE_3, Printed, line_of

REFITTED = ("phs", "bouc_wen")


@dataclass(frozen=True)
class Scored:
    """Attributes:
    fit: of the identification samples; of a published model only unknown initial states were estimated.
    evaluation: outputs and scores on all recordings.
    """

    fit: Fit
    evaluation: Evaluation


@dataclass(frozen=True)
class Row:
    """One part of a recording.

    Attributes:
        name, use: of the part.
        line: the line of the paper's Table 3 that it repeats, or None.
        scores: by model.
    """

    name: str
    use: str
    line: str | None
    scores: Mapping[str, PartScore]

    @property
    def printed(self) -> Printed | None:
        """What the paper has for it."""
        return TABLE_3[self.line] if self.line else None


@dataclass(frozen=True)
class Comparison:
    """Attributes:
    models: ``phs`` and ``bouc_wen``, and ``phs_published`` and ``bouc_wen_published`` where they were asked for.
    numerical_error: of the port-Hamiltonian fit over the identification samples, in standard deviations.
    """

    campaign: Campaign
    models: Mapping[str, Scored]
    numerical_error: float

    def rows(self) -> tuple[Row, ...]:
        """Table 3, in the order of the recordings."""
        lines = {part.name: line_of(r) for r in self.campaign.recordings for part in r.parts}
        parts = next(iter(self.models.values())).evaluation.parts
        return tuple(
            Row(p.name, p.use, lines[p.name], {n: m.evaluation.parts[i] for n, m in self.models.items()})
            for i, p in enumerate(parts)
        )


def compare(
    campaign: Campaign, options: Options | None = None, published: bool = True, progress: Progress = quiet
) -> Comparison:
    """Refit both models on the identification recordings by the flow of Fig. 9, and score them on all recordings.

    The flow: mechanical part → linear electrical part with closed dead zones → dead zones opened, nonlinear least
    squares from several starts (`phnn.identification.staged`). Bouc–Wen skips the linear part, as in the paper.

    Args:
        campaign: recordings with their uses; a weighed mass, where it has one, is held.
        options: how hard to try.
        published: score Tables 1 and 2 of the paper as well.
        progress: called with a line of text at every stage.

    Raises:
        InputRefused: the recordings cannot be used.
    """
    chosen = options or Options()
    actuator = {"model": "piezo_actuator", "hysterons": campaign.setup.get("hysterons", 2)}
    phs, error = identify_base(replace(campaign, setup=actuator), chosen, progress)
    fits = {"phs": phs, "bouc_wen": identify_bouc_wen(phs.plan, campaign, chosen, progress)}
    if published:
        progress("score the published parameters")
        fits["phs_published"] = fit(Setup(from_paper(), name="phs"), phs.plan, (), max_evaluations=15)
        fits["bouc_wen_published"] = fit(bouc_wen(), phs.plan, (), max_evaluations=15)
    models = {name: Scored(fitted, score_on_all(fitted, campaign)) for name, fitted in fits.items()}
    return Comparison(campaign, models, error.sigma)
