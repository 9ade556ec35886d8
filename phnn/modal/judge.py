"""The verdict on what moves with amplitude, in the words of `phnn.diagnose`.

``none``: one linear model serves, or there is one amplitude alone. ``named``: one combination of elements explains
what moves. ``equivalent``: several do, and the recordings cannot tell which. ``unknown``: no element explains half of
it; the best model that helps is kept and its elements are described.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.modal.elements import PortElement
from phnn.modal.fit import ModalFit

Array = NDArray[np.float64]

NONE, NAMED, EQUIVALENT, UNKNOWN = "none", "named", "equivalent", "unknown"
# Of an element that stays in the model without a name; of one that is not even there.
DESCRIBED, PROVISIONAL = "described", "provisional"
# One linear model is as good as one for each amplitude up to this factor; elements are named that take away this
# share of what it costs to be linear; a further one must take away this share, and leave less of every experiment.
_AS_GOOD, _EXPLAINS, _FURTHER = 1.1, 0.5, 0.01
# What there is to explain is at least this share of what the linear model leaves.
_LEAST = 1e-3


@dataclass(frozen=True, eq=False)
class Candidate:
    """One model for all amplitudes.

    Attributes:
        fit: the fitted model.
        left: by amplitude, what it leaves of each experiment that chooses, over what was measured.
    """

    fit: ModalFit
    left: tuple[Array, ...]

    @property
    def element(self) -> PortElement:
        """What its ports have."""
        return self.fit.model.element

    @property
    def by_level(self) -> Array:
        """(L,) mean over the experiments of an amplitude."""
        return np.array([np.sqrt((x**2).mean()) for x in self.left])

    @property
    def error(self) -> float:
        """All amplitudes together."""
        return float(np.sqrt((self.by_level**2).mean()))


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is proven about the best model.

    Attributes:
        verdict: ``none``, ``named``, ``equivalent`` or ``unknown``.
        members: models that the verdict cannot tell from each other, the best first; where it is ``unknown``, the best
            model if one helps. Empty where the linear model stands.
        share_explained: of the squared error that one linear model leaves beyond one for each amplitude; None where
            there is nothing to explain. Above 1 where the model is better than those.
    """

    verdict: str
    members: tuple[Candidate, ...]
    share_explained: float | None


def judged(candidates: Sequence[Candidate], alone_by: Array) -> Judgement:
    """The verdict, and the models that it names, the best first.

    A further element counts where it is worth its room; models of one size belong to one class unless the best one
    leaves less of every single experiment.

    Args:
        candidates: the linear one first; alone_by: (L,) errors of a linear model for each amplitude.
    """
    linear = candidates[0]
    if alone_by.size == 1 or serves(linear, alone_by):
        return Judgement(NONE, (), None)
    best = linear
    for size in range(1, 1 + max(len(c.element.names) for c in candidates)):
        further = min((c for c in candidates if len(c.element.names) == size), key=lambda c: c.error, default=best)
        if worth(further, best, linear):
            best = further
    # One linear model may leave less over all amplitudes and more at one of them.
    wanted = max(linear.error**2 - float((alone_by**2).mean()), _LEAST * linear.error**2)
    share = (linear.error**2 - best.error**2) / wanted
    if best is linear or share < _EXPLAINS:
        return Judgement(UNKNOWN, () if best is linear else (best,), share)
    kin = [c for c in candidates if len(c.element.names) == len(best.element.names)]
    lowest = np.concatenate(best.left)
    members = [c for c in kin if c is best or (np.concatenate(c.left) <= lowest).any()]
    members.sort(key=lambda c: c.error)
    return Judgement(NAMED if len(members) == 1 else EQUIVALENT, tuple(members), share)


def worth(further: Candidate, best: Candidate, linear: Candidate) -> bool:
    """Whether a model with one more element is better for more than its freedom."""
    everywhere = bool((np.concatenate(further.left) < np.concatenate(best.left)).all())
    return everywhere and best.error**2 - further.error**2 >= _FURTHER * linear.error**2


def serves(linear: Candidate, alone_by: Array) -> bool:
    """Whether one linear model is as good as one for each amplitude."""
    return bool((linear.by_level <= _AS_GOOD * alone_by).all())
