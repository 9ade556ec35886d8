"""Recordings that choose: some of those for identification are left out while a model is composed.

They are chosen like the held-out ones, inside the span of the rest; of a single recording it is the last third. A model
is grown on the rest and held against them. The held-out recordings of the campaign are not touched.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from phnn.identification.evaluate import Evaluation, evaluate
from phnn.identification.fit import Fit
from phnn.identification.gain import Gain, gain
from phnn.identification.plan import Plan
from phnn.recordings.excitation import excitation_of
from phnn.recordings.partition import candidate_of, divide
from phnn.recordings.recording import Recording

# Inside this module and its evaluations, the left-out samples serve as "confirmation" samples do.
_CHOOSES = "confirmation"


@dataclass(frozen=True)
class LeftOut:
    """Identification recordings in two sets.

    Attributes:
        growth: models are fitted to these.
        chosen: all of them, the left-out samples marked.
        fewest_blocks: with fewer nearly independent blocks of time a gain has no p-value.
    """

    growth: Plan
    chosen: Plan
    fewest_blocks: int

    def scores(self, fitted: Fit) -> Evaluation:
        """A model's outputs on all of them."""
        return evaluate(fitted.setup, self.chosen, fitted.initial_states)

    def gain(self, before: tuple[Fit, Evaluation], after: tuple[Fit, Evaluation]) -> Gain:
        """What one model gains over another on the left-out samples."""
        own = (before[0].setup.own, after[0].setup.own)
        found = gain(before[1], after[1], self.chosen.recordings, _CHOOSES, self.fewest_blocks, own)
        assert found is not None
        return found

    def over_noise(self, scores: Evaluation) -> float:
        """Residual over noise on the left-out samples."""
        return scores.over_noise(_CHOOSES)


def leave_out(plan: Plan, fewest_blocks: int) -> LeftOut:
    """Divide the identification recordings of a plan."""
    whole = [_identified(r) for r in plan.recordings]
    parts, _, _ = divide([candidate_of(r, excitation_of(r.drive, r.dt)) for r in whole])
    divided = tuple(replace(r, parts=parts[r.name]) for r in whole)
    growth = tuple(r for r in divided if r.mask("identification").any())
    return LeftOut(replace(plan, recordings=growth), replace(plan, recordings=divided), fewest_blocks)


def _identified(recording: Recording) -> Recording:
    """A recording up to the end of its identification samples."""
    last = max(p.last for p in recording.parts if p.use == "identification")
    return recording if last == recording.t.size else recording.only(slice(0, last))
