"""The number of hysterons that an actuator needs, if the user does not state it.

Models with one, two, three, … hysterons are fitted to some of the identification recordings; the others choose
(`phnn.identification.left_out`). A further hysteron is taken as long as they are predicted clearly better with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from phnn.errors import PhnnError
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.identification.left_out import LeftOut, leave_out
from phnn.identification.plan import Plan
from phnn.identification.staged import identify_actuator
from phnn.recordings.recording import Anchor

MOST_HYSTERONS = 4
# Where none is better than the next, and where the recordings cannot be divided.
DEFAULT_HYSTERONS = 2
# A further hysteron has to take this share of the excess over the noise, and with such a p-value: three parameters
# more, chosen among few models. Too few independent blocks of time for a p-value leave the default.
_SHARE, _LEVEL, _FEWEST_BLOCKS = 0.05, 0.00135, 8


def hysterons_needed(
    plan: Plan, known: Mapping[str, Anchor], starts: int, seed: int, progress: Callable[[str], None]
) -> int:
    """The number of hysterons beyond which recordings that were left out are predicted no better, at most
    `MOST_HYSTERONS`.

    Args:
        plan: identification recordings.
        known: anchors; one of hysteron ``i`` asks for ``i`` hysterons at least.
        starts, seed: of every fit.
        progress: told what is tried.
    """
    least = max((int(n.rpartition("_")[2]) for n in known if n.startswith(("C_", "rho_", "d_"))), default=1)
    held = leave_out(plan, _FEWEST_BLOCKS)
    best: tuple[Fit, Evaluation] | None = None
    chosen = max(least, DEFAULT_HYSTERONS)
    for count in range(least, max(least, MOST_HYSTERONS) + 1):
        progress(f"how many hysterons: try {count}")
        try:
            fitted = identify_actuator(held.growth, known, count, starts, seed)
        except PhnnError:
            break
        further = fitted, held.scores(fitted)
        if best is not None and not _better(held, best, further, count):
            break
        best, chosen = further, count
        if held.over_noise(further[1]) <= 1.0:
            break
    return chosen


def _better(held: LeftOut, fewer: tuple[Fit, Evaluation], more: tuple[Fit, Evaluation], count: int) -> bool:
    """Whether one more hysteron, ``count`` of them then, predicts what was left out clearly better.

    Recordings too short for a test decide nothing: there the default stays, if it predicts no worse.
    """
    found = held.gain(fewer, more)
    taken, excess = found.takes, max(found.before**2 - 1.0, 0.0)
    if found.falls is None:
        return count <= DEFAULT_HYSTERONS and taken >= 0.0
    return taken > _SHARE * excess and found.falls is not None and found.falls < _LEVEL
