"""The cases that a classifier is trained on: which effect, what strength, which recordings, which noise.

Case number ``n`` of a seed is always the same, however many are made. Groups, sets of recordings, strengths and effects
take turns in decks that are shuffled, so that any number of cases is nearly balanced. The groups have the shares that
``configs/bench.yaml`` gives them.

The seeds of a benchmark are hashes of 48 bits and small multiples added to them. Those of training lie above 2⁵²: no
case of training is one of a benchmark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from studies.benchmark.cases import NOISES, PLANS, STRENGTHS
from studies.generator import Case, Conditions, draw_case
from studies.generator.cases import choices
from studies.proof.cases import seed_of

Item = TypeVar("Item")

# Shares of the groups: those of configs/bench.yaml.
_GROUPS = ("none", "same", "same", "same", "other", "outside", "pair", "background")
# Twelve recordings take four times the time of one or four.
_PLANS = ("one", "one", "four", "four", "twelve")
# Above every seed of a benchmark.
_ABOVE = 2**52


@dataclass(frozen=True)
class Drawn:
    """One case of training.

    Attributes:
        number: of the case; seed: of its draws, above every seed of a benchmark.
        group: one of `studies.benchmark.settings.GROUPS`; plan: one of `studies.benchmark.cases.PLANS`;
            strength: one of `studies.benchmark.cases.STRENGTHS`.
        noise: as `studies.generator.draw_case` takes it; empty for that of the seed.
    """

    number: int
    seed: int
    group: str
    plan: str
    strength: str
    noise: str

    def case(self) -> Case:
        """What is concealed."""
        stratum = _stratum(self.group)
        conditions = Conditions(background=self.group == "background")
        return draw_case(
            self.seed, stratum, PLANS[self.plan], STRENGTHS[self.strength], noise=self.noise or None,
            conditions=conditions,
        )  # fmt: skip


def drawn(seed: int, number: int) -> Drawn:
    """Case ``number`` of the training with a seed."""
    deck = _shuffled(seed, "group", number // len(_GROUPS), _GROUPS)
    group, place = deck[number % len(_GROUPS)], number % len(_GROUPS)
    among = number // len(_GROUPS) * _GROUPS.count(group) + deck[:place].count(group)
    possible = choices(_stratum(group))
    # A list of the tool's own has no name that could be taken away from it.
    index = _in_turn(seed, group, among, [i for i, choice in enumerate(possible) if not choice.withheld])
    own = _ABOVE + seed_of(seed, f"training {group}", among)
    return Drawn(
        number,
        own - own % len(possible) + index,  # effects go round with the seed of a case
        group,
        _in_turn(seed, "plan", number, _PLANS),
        _in_turn(seed, "strength", number, tuple(STRENGTHS)),
        _in_turn(seed, "noise", among, NOISES) if group == "none" else "",
    )


def _stratum(group: str) -> str:
    return "same" if group == "background" else group


def _in_turn(seed: int, use: str, number: int, values: Sequence[Item]) -> Item:
    """Each value once before any comes again."""
    return _shuffled(seed, use, number // len(values), values)[number % len(values)]


def _shuffled(seed: int, use: str, deck: int, values: Sequence[Item]) -> list[Item]:
    rng = np.random.default_rng(seed_of(seed, f"training {use}", deck))
    return [values[i] for i in rng.permutation(len(values))]
