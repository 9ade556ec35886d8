"""Every effect that can be concealed: it acts, it vanishes with its strength, and it is drawn as it states."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from studies.generator import effects
from studies.generator.cases import STRATA, choices
from studies.generator.effects import FORMS, FURTHER_UNLISTED, LISTED, UNLISTED, Concealed, may_be_paired
from studies.generator.make import concealing
from studies.generator.plans import plan_of
from studies.generator.world import NEUTRAL, TABLE, simulate_all

PLAN = plan_of("short")
ALL = [*LISTED, *UNLISTED, *FURTHER_UNLISTED, *FORMS, "stop of the demonstration", "drift of the demonstration"]


def _effect(chosen: str) -> tuple[str, Concealed]:
    rng = np.random.default_rng(1)
    if chosen in FORMS:
        name, drawn_in_form = FORMS[chosen]
        assert name in LISTED
        return name, drawn_in_form(rng, TABLE, PLAN)
    if chosen not in effects.LOCATIONS:
        name = "contact_stop" if chosen.startswith("stop") else "sensor_drift"
        return name, effects.draw(name, rng, TABLE, PLAN)
    return chosen, effects.drawn(chosen, rng, TABLE, PLAN)


@cache
def undisturbed() -> tuple[np.ndarray, ...]:
    """The outputs of the actuator in which nothing is concealed."""
    return tuple(simulate_all(TABLE, PLAN))


@pytest.mark.parametrize("chosen", ALL)
def test_it_changes_the_output_and_vanishes_with_its_strength(chosen: str) -> None:
    name, effect = _effect(chosen)
    assert effect.name == name
    assert set(effect.law(effect.guess)) <= set(NEUTRAL)
    # A seal is JSON, which has no infinity.
    stated = effects.described(effect, effect.guess)
    assert stated and all(np.isfinite(value) for value in stated.values())

    def change(strength: float) -> float:
        moved = concealing(TABLE, PLAN, [(effect, strength)])
        return max(float(np.ptp(a - b)) for a, b in zip(moved, undisturbed(), strict=True))

    seen = change(effect.guess)
    assert seen > 1e-8
    assert change(effect.guess * 1e-3) < 0.05 * seen


def test_pairs_are_of_different_kinds() -> None:
    assert may_be_paired("creep", "delay")
    assert not may_be_paired("delay", "delay")
    assert not may_be_paired("delay", "sensor_lag")
    assert not may_be_paired("slew_limit", "amplifier_saturation")
    assert set().union(*effects.ALIKE) <= set(LISTED)
    assert len({*LISTED, *UNLISTED, *FURTHER_UNLISTED}) == len(LISTED) + len(UNLISTED) + len(FURTHER_UNLISTED)
    assert set(effects.LOCATIONS.values()) == {
        "amplifier", "electrical", "hysteron", "coupling", "mechanical", "thermal", "sensor", "environment"
    }  # fmt: skip


def test_further_unlisted_effects_have_a_stratum_of_their_own() -> None:
    own = choices("unlisted")
    assert [(c.effects, c.form) for c in own] == [((name,), "unlisted") for name in FURTHER_UNLISTED]
    assert [c for s in STRATA for c in choices(s) if {*c.effects, *c.withheld} & {*FURTHER_UNLISTED}] == [*own]
