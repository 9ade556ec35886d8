"""The hysteresis that an actuator needs, if the user leaves it to the recordings.

Models with one and two hysterons, with the best of the other forms of hysteresis, and with more hysterons are fitted to
some of the identification recordings; the others choose (`LeftOut`). One that predicts them clearly better takes the
place of the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from phnn.errors import PhnnError
from phnn.identification.evaluate import Evaluation, evaluate
from phnn.identification.fit import Fit
from phnn.identification.gain import Gain, gain
from phnn.identification.plan import Plan
from phnn.identification.staged import identify_actuator, identify_form
from phnn.recordings.excitation import excitation_of
from phnn.recordings.partition import candidate_of, divide
from phnn.recordings.recording import Anchor, Recording

# They are chosen like the held-out ones, inside the span of the rest; of a single recording it is the last third. A
# model is grown on the rest and held against them. The held-out recordings of the campaign are not touched.

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


MOST_HYSTERONS = 4
# Where none is better than the next, and where the recordings cannot be divided.
DEFAULT_HYSTERONS = 2
# A further hysteron has to take this share of the excess over the noise, and with such a p-value: three parameters
# more, chosen among few models. Too few independent blocks of time for a p-value leave the default.
_SHARE, _LEVEL, _FEWEST_BLOCKS = 0.05, 0.00135, 8
# Chance does not take this share of the mean square: few large errors leave a test without power.
_LARGER = 0.5
# Residual over noise at which nothing further is tried.
_NOISE = 1.1


def hysteresis_needed(
    plan: Plan, known: Mapping[str, Anchor], starts: int, seed: int, progress: Callable[[str], None]
) -> tuple[int | str, Fit | None]:
    """The number of hysterons, at most `MOST_HYSTERONS`, or the form of hysteresis, beyond which recordings that were
    left out are predicted no better; and its fit to the others, None where none could be made.

    Args:
        plan: identification recordings.
        known: anchors; one of hysteron ``i`` asks for ``i`` hysterons at least, and for no other form.
        starts, seed: of every fit.
        progress: told what is tried.
    """
    stated = max((int(n.rpartition("_")[2]) for n in known if n.startswith(("C_", "rho_", "d_"))), default=0)
    held = leave_out(plan, _FEWEST_BLOCKS)
    best: tuple[Fit, Evaluation] | None = None
    chosen: int | str = max(stated, DEFAULT_HYSTERONS)
    counts = list(range(max(stated, 1), max(stated, MOST_HYSTERONS) + 1))
    left: list[int | None] = [*counts[:DEFAULT_HYSTERONS], *([] if stated else [None]), *counts[DEFAULT_HYSTERONS:]]
    while left:
        count = left.pop(0)
        progress("which hysteresis: try " + ("other forms" if count is None else f"{count} hysterons"))
        tried: int | str
        try:
            if count is not None:
                tried, fitted = count, identify_actuator(held.growth, known, count, starts, seed)
            elif best is not None:
                tried, fitted = identify_form(held.growth, known, best[0])
            else:
                continue
        except PhnnError:
            continue
        further = fitted, held.scores(fitted)
        if best is None or _better(held, best, further, tried):
            best, chosen = further, tried
            if held.over_noise(further[1]) <= _NOISE:
                break
        elif count is not None:
            # One more is no better: no further ones are tried.
            left = [n for n in left if n is None]
    return chosen, None if best is None else best[0]


def _better(held: LeftOut, before: tuple[Fit, Evaluation], after: tuple[Fit, Evaluation], tried: int | str) -> bool:
    """Whether what was left out is predicted clearly better with one more hysteron, or with another form.

    Recordings too short for a test decide nothing: there the default stays, if it predicts no worse.
    """
    found = held.gain(before, after)
    taken, excess = found.takes, max(found.before**2 - 1.0, 0.0)
    if found.falls is None:
        return isinstance(tried, int) and tried <= DEFAULT_HYSTERONS and taken >= 0.0
    return taken > _LARGER * found.before**2 or (taken > _SHARE * excess and found.falls < _LEVEL)
