"""Every effect that can be concealed: it acts, it vanishes with its strength, and it is drawn as it states."""

from __future__ import annotations

import math

import numpy as np
import pytest
from concealments import moves_and_vanishes

from studies.generator.effects import (
    ALIKE,
    FORMS,
    LISTED,
    LOCATIONS,
    UNLISTED,
    Concealed,
    described,
    draw,
    drawn,
    may_be_paired,
)
from studies.generator.plans import Excitation, Piece, plan_of
from studies.generator.world import TABLE

PLAN = plan_of("short")
ALL = [*LISTED, *UNLISTED, *FORMS, "stop of the demonstration", "drift of the demonstration"]


def _effect(chosen: str) -> tuple[str, Concealed]:
    rng = np.random.default_rng(1)
    if chosen in FORMS:
        name, drawn_in_form = FORMS[chosen]
        assert name in LISTED
        return name, drawn_in_form(rng, TABLE, PLAN)
    if chosen not in LOCATIONS:
        name = "contact_stop" if chosen.startswith("stop") else "sensor_drift"
        return name, draw(name, rng, TABLE, PLAN)
    return chosen, drawn(chosen, rng, TABLE, PLAN)


@pytest.mark.parametrize("chosen", ALL)
def test_it_changes_the_output_and_vanishes_with_its_strength(chosen: str) -> None:
    name, effect = _effect(chosen)
    assert effect.name == name
    moves_and_vanishes(effect, PLAN)


def test_mains_lines_have_phases_of_their_own() -> None:
    effect = drawn("mains_pickup", np.random.default_rng(3), TABLE, PLAN)
    stated = described(effect, 1e-6)
    waves = [np.exp(-2j * math.pi * stated["f_m"] * e.t) for e in PLAN[:2]]
    first, second = (effect.added(1e-6, e) for e in PLAN[:2])
    assert np.max(np.abs(first)) <= sum(v for n, v in stated.items() if n != "f_m") + 1e-12
    assert abs(np.angle(np.sum(first * waves[0])) - np.angle(np.sum(second * waves[1]))) > 1e-3


def test_drifts_of_other_kinds() -> None:
    walk = FORMS["random_walk_drift"][1](np.random.default_rng(0), TABLE, PLAN)
    paths = [walk.added(2e-6, e) for e in PLAN]
    for excitation, path in zip(PLAN, paths, strict=True):
        assert np.std(np.diff(path)) == pytest.approx(2e-6 * math.sqrt(excitation.dt), rel=0.08)
    assert abs(np.corrcoef(paths[0], paths[2])[0, 1]) < 0.999
    settled = FORMS["exponential_drift"][1](np.random.default_rng(0), TABLE, PLAN)
    stated = described(settled, 1e-6)
    late = Excitation("late", (Piece(0.0, 100.0),), 1.0, 100)
    assert settled.added(1e-6, late)[-1] == pytest.approx(stated["A"], rel=1e-9)
    assert abs(stated["A"]) == 1e-6


def test_pairs_are_of_different_kinds() -> None:
    assert may_be_paired("creep", "delay")
    assert not may_be_paired("delay", "delay")
    assert not may_be_paired("delay", "sensor_lag")
    assert not may_be_paired("slew_limit", "amplifier_saturation")
    assert set().union(*ALIKE) <= set(LISTED)
    assert not set(LISTED) & set(UNLISTED)
    assert set(LOCATIONS.values()) == {
        "amplifier", "electrical", "hysteron", "coupling", "mechanical", "thermal", "sensor", "environment"
    }  # fmt: skip
