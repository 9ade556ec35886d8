"""The cases of a benchmark: which seed, what strength, which recordings, which noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, product

import numpy as np

from studies.benchmark.settings import GROUPS, Settings
from studies.generator import Case, Conditions, draw_case
from studies.proof.cases import seed_of

# Residual over noise that the effect alone leaves beyond a refit of the base model.
STRENGTHS = {"weak": (1.5, 3.0), "medium": (3.0, 6.0), "strong": (6.0, 20.0)}
# Sets of recordings by what they are called here: a single sweep, four recordings, twelve.
PLANS = {"one": "one", "four": "short", "twelve": "demo"}
# Distance of seeds, a prime: choices go round with the seed, and neighbours among them share an effect.
_APART = 7919
# Noise of the cases with nothing concealed.
NOISES = ("white", "first_order", "process:0.1", "pink:0.1", "heavy", "quantised", "jittered")


@dataclass(frozen=True)
class Entry:
    """One case.

    Attributes:
        name: of its folders; it does not tell the group.
        group: one of `studies.benchmark.settings.GROUPS`; seed: of the case.
        strength, plan: one of `STRENGTHS` and of `PLANS`; noise: one of `NOISES`, empty for that of the seed.
    """

    name: str
    group: str
    seed: int
    strength: str
    plan: str
    noise: str = ""

    def case(self) -> Case:
        """What is concealed; everything follows from the seed."""
        stratum = "same" if self.group == "background" else self.group
        conditions = Conditions(background=self.group == "background")
        return draw_case(
            self.seed, stratum, f"{PLANS[self.plan]}_exam", STRENGTHS[self.strength], noise=self.noise or None,
            conditions=conditions,
        )  # fmt: skip


def entries(settings: Settings) -> list[Entry]:
    """All cases, in an order that does not tell their groups."""
    found: list[tuple[str, int, str, str, str]] = []
    for group in GROUPS:
        seeds = _seeds(settings.seed, group, getattr(settings, group))
        for number, (seed, (strength, plan)) in enumerate(zip(seeds, _mixed(settings.seed, group), strict=False)):
            found.append((group, seed, strength, plan, NOISES[number % len(NOISES)] if group == "none" else ""))
    order = np.random.default_rng(np.random.SeedSequence([settings.seed, 1])).permutation(len(found))
    return [Entry(f"case_{i:03d}", *found[k]) for i, k in enumerate(order)]


def _mixed(seed: int, group: str) -> Iterator[tuple[str, str]]:
    """Strengths and plans, each pair of them once before any comes again, in orders that are drawn."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 2, GROUPS.index(group)]))
    every = list(product(STRENGTHS, PLANS))
    while True:
        yield from (every[k] for k in rng.permutation(len(every)))


def _seeds(seed: int, group: str, number: int) -> list[int]:
    """Seeds far apart, so that effects and pairs of them take turns in another order than that of their list; of the
    group outside those that withhold no name.

    A tool from elsewhere has a list of its own, from which no name can be taken away.
    """
    first = seed_of(seed, f"bench {group}", 0)
    if group != "outside":
        return [first + _APART * i for i in range(number)]
    found: list[int] = []
    for candidate in count(first, _APART):
        if len(found) == number:
            return found
        if not draw_case(candidate, group, "short").withheld:
            found.append(candidate)
    raise AssertionError
