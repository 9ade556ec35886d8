"""The level of a search is spent once, however many elements it adds and whatever it says of the remainder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.diagnosis import select
from phnn.diagnosis.finding import effects_of
from phnn.diagnosis.name import Candidate, Naming, _null_of_supremum, tail
from phnn.diagnosis.scored import SIGNIFICANT, Scored
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect, effect
from phnn.identification.fit import Fit

SIZE, STRONG, RUNS = 300, 30.0, 3000
EFFECTS = tuple(effect(n) for n in ("creep", "delay", "coulomb_friction", "sensor_lag", "second_mode", "contact_stop"))
# What every candidate does to the output; neighbours are correlated.
DIRECTIONS = np.random.default_rng(1).standard_normal((SIZE, len(EFFECTS)))
DIRECTIONS[:, 1:] += 0.4 * DIRECTIONS[:, :-1]


@cache
def rest(added: frozenset[int]) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Candidates beside those that are added, their unit directions without these, and the null of the supremum."""
    basis = np.linalg.qr(DIRECTIONS[:, sorted(added)])[0]
    others = [i for i in range(len(EFFECTS)) if i not in added]
    left = DIRECTIONS[:, others] - basis @ (basis.T @ DIRECTIONS[:, others])
    left /= np.linalg.norm(left, axis=0)
    return others, left, _null_of_supremum(left.T @ left, np.zeros(len(others), dtype=bool), 0)


class LinearWorld:
    """Models whose elements add known directions to the output, beside white noise."""

    def __init__(self, y: np.ndarray) -> None:
        self.y = y
        self.added: dict[int, frozenset[int]] = {}
        self.kept: list[Fit] = []

    def fit(self, added: frozenset[int]) -> Fit:
        columns = DIRECTIONS[:, sorted(added)]
        left = self.y - columns @ np.linalg.lstsq(columns, self.y, rcond=None)[0] if added else self.y
        made = replace(campaigns.base(), residual=left, jacobian=columns)
        self.added[id(made)] = added
        self.kept.append(made)
        return made

    def scored(self, fitted: Fit) -> Scored:
        """The scores that a search asks for, against the null that it draws."""
        others, directions, null = rest(self.added[id(fitted)])
        scores = np.abs(directions.T @ fitted.residual)
        best_first = sorted(zip(scores, others, strict=True), reverse=True)
        candidates = tuple(Candidate(EFFECTS[i], {}, (), float(s), tail(null, float(s))) for s, i in best_first)
        naming = Naming(candidates, candidates[0].score, candidates[0].p_value, 0.0, 0.0)
        return Scored(mock.Mock(fit=fitted), mock.Mock(), naming)

    def trials(self, _: object, base: Scored, last: select.Selected) -> list[Trial]:
        before = self.added[id(last.model.linearised.fit)]
        able = [c for c in last.model.naming.candidates if c.p_value < SIGNIFICANT]
        fits = [Trial(c, self.fit(before | {EFFECTS.index(c.effect)})) for c in able]
        return sorted(fits, key=lambda t: t.cost)


@contextmanager
def searching(world: LinearWorld) -> Iterator[None]:
    """The search itself, with refits and scores of a linear world and everything at its place."""
    with (
        mock.patch("phnn.diagnosis.search.scored", lambda fitted, *_: world.scored(fitted)),
        mock.patch.object(select, "_refitted", world.trials),
        mock.patch.object(select, "exact", lambda fitted, *_: fitted),
        mock.patch.object(select, "retested", lambda base, place, findings, fitted, *_: (findings, fitted)),
        mock.patch.object(select, "misplaced", lambda *_: False),
        mock.patch.object(select, "_in_another_form", lambda *_: False),
        mock.patch.object(select, "_kept", lambda *_: True),
        mock.patch("phnn.diagnosis.scored.locate", lambda *_: mock.Mock()),
    ):
        yield


def found(rng: np.random.Generator, true: frozenset[int]) -> tuple[list[Effect], bool]:
    """What a search names, and whether it says that more remains."""
    strengths = STRONG * np.array([i in true for i in range(len(EFFECTS))]) / np.linalg.norm(DIRECTIONS, axis=0)
    world = LinearWorld(DIRECTIONS @ strengths + rng.standard_normal(SIZE))
    with searching(world):
        begun = world.scored(world.fit(frozenset()))
        if not begun.significant:
            return [], False
        selected, _ = select.select(begun, Search(EFFECTS, max_effects=4))
    return effects_of(selected.findings), selected.model.significant


@pytest.mark.parametrize("true", [(), (2,), pytest.param((0, 4), marks=pytest.mark.slow)])
def test_a_search_says_too_much_no_more_often_than_its_level(true: tuple[int, ...]) -> None:
    rng, names = np.random.default_rng(7), {EFFECTS[i] for i in true}
    wrong = missed = 0
    for _ in range(RUNS):
        named, remains = found(rng, frozenset(true))
        wrong += bool(set(named) - names) or remains
        missed += bool(names - set(named))
    assert missed == 0
    assert wrong / RUNS < SIGNIFICANT + 3.0 * np.sqrt(SIGNIFICANT * (1.0 - SIGNIFICANT) / RUNS)
    assert wrong > 0
