"""What to record next where nothing has a name: models that compete for one element, and where they differ."""

from __future__ import annotations

import math
from functools import cache

import campaigns
import numpy as np
import pytest
from campaigns import recorded
from effect_homes import BASE, SCALES

from phnn.diagnose import proposal as path
from phnn.diagnose.linearised import LinearisedFit, prepare, tie
from phnn.diagnose.proposal import Experiment, Question, Rival, Stretch, propose, refitted_rival, shrinkage
from phnn.effects import effect
from phnn.effects.learned import learned_elements
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.recordings.recording import ACTUATOR, Recording
from phnn.setup import Setup

LOUD = 2e-7  # metres
KNOWN = {n: "held at its stated value" for n in BASE.free if n != "b"}
DAMPER = learned_elements()["learned_damper"]
RATE, SMALL = 1e4, 30.0  # samples per second; volts


def sine(amplitude: float, frequency: float = 100.0, periods: int = 6) -> Experiment:
    duration, name = periods / frequency, f"{amplitude:g} V at {frequency:g} Hz"
    return Experiment(name, name, (Stretch(0.0, duration, lines=((amplitude, frequency, 0.0),)),), RATE, ACTUATOR)


def plant() -> Setup:
    """The actuator with damping that grows with the square of the displacement."""
    point = DAMPER.grid(SCALES)[0]
    return DAMPER.add_to(BASE, point | dict.fromkeys(DAMPER.strengths, 0.0) | {"F_q": 0.5})


def measured(asked: Experiment, seed: int, noise: float) -> Recording:
    return recorded(plant(), asked.kind, asked.t, asked.u, noise, seed)


def plan_of(*asked: Experiment, noise: float = LOUD) -> Plan:
    return Plan(tuple(measured(e, i, noise) for i, e in enumerate(asked)), {e.kind: 4 for e in asked}, 1)


def by_position(plan: Plan) -> Fit:
    return fit(plant(), plan, ["b", "F_q"], KNOWN, 15)


def by_speed(plan: Plan) -> Fit:
    drag = effect("quadratic_drag").add_to(BASE, {"c_2": 5.0})
    return fit(drag, plan, ["b", "c_2"], KNOWN, 30)


@cache
def at_hand() -> tuple[Rival, Rival, LinearisedFit]:
    """Both kinds of damping, fitted to one sine of one amplitude, on which a linear damper can stand for a good part of
    either."""
    plan = plan_of(sine(SMALL))
    position, speed = by_position(plan), by_speed(plan)
    models = (refitted_rival("position", position, ("F_q",)), refitted_rival("speed", speed, ("c_2",)))
    return *models, prepare(position)


def test_a_larger_amplitude_tells_damping_of_the_position_from_that_of_the_speed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Equivalent linear dampers of one frequency: b + c A²/4 and b + c' ω A 8/(3π). At one A they are the same.
    position, speed, linearised = at_hand()
    offered = (sine(SMALL), sine(75.0))
    monkeypatch.setattr(path, "menu", lambda _: offered)
    found = propose([Question((position, speed), "learned_damper")], linearised)
    assert found is not None
    assert found.experiment is offered[1]
    assert found.menu[offered[1].kind] > 3.0 * found.menu[offered[0].kind]
    assert found.separation > found.needed
    assert (found.aim, found.separates) == ("separate", ("position", "speed"))
    # Refits to both recordings say the same; position is right.
    seen = []
    for asked in (sine(SMALL + 1e-3), offered[1]):
        joint = plan_of(sine(SMALL), asked)
        right, wrong = by_position(joint), by_speed(joint)
        assert wrong.cost - right.cost > tie(right)
        seen.append(math.sqrt(wrong.cost - right.cost - (speed.fit.cost - position.fit.cost)))
    assert seen[1] > 3.0 * seen[0]
    # What is foreseen is the smaller of both directions.
    assert seen[1] > 0.8 * found.separation


def test_an_element_without_a_rival_is_measured_where_its_numbers_show_most(monkeypatch: pytest.MonkeyPatch) -> None:
    position, _, linearised = at_hand()
    offered = (sine(5.0), sine(75.0))
    monkeypatch.setattr(path, "menu", lambda _: offered)
    found = propose([Question((position,), "learned_damper")], linearised)
    assert found is not None
    assert (found.aim, found.separates) == ("measure", ())
    assert found.experiment is offered[1]
    assert found.needed == pytest.approx(math.sqrt(2.0))
    # The standard error of a refit to both shrinks as foreseen.
    joint = by_position(plan_of(sine(SMALL), offered[1]))
    name = joint.variables.names.index("F_q")
    before, after = (np.linalg.inv(f.jacobian.T @ f.jacobian)[name, name] for f in (position.fit, joint))
    assert found.separation == pytest.approx(math.sqrt(before / after), rel=0.3)
    assert "No two models are left to be told apart" in found.why
    assert "To repeat all recordings at hand would give 1.4." in found.why


def test_standard_errors_shrink_as_information_adds() -> None:
    rng = np.random.default_rng(0)
    known, moved = rng.standard_normal((30, 4)), rng.standard_normal((50, 4))
    assert shrinkage(known, known, (0, 1, 2, 3)) == pytest.approx(math.sqrt(2.0))
    assert shrinkage(0.0 * moved, known, (1,)) == pytest.approx(1.0)
    before, after = np.linalg.inv(known.T @ known), np.linalg.inv(known.T @ known + moved.T @ moved)
    assert shrinkage(moved, known, (2,)) == pytest.approx(math.sqrt(before[2, 2] / after[2, 2]))


@pytest.mark.slow
def test_a_whole_diagnosis_without_a_name_says_what_to_record_next() -> None:
    # Drag is what is missing, and the catalogue holds a drift alone.
    made = campaigns.diagnosis("quadratic_drag", "sensor_drift")
    assert made.verdict == "unknown"
    assert made.claims and not any(c.claimed for c in made.claims)
    assert made.proposal is not None
    assert any(c.effect.name.replace("_", " ") in made.proposal.why for c in made.claims)
    # Drag shows at speed, whatever it is called.
    assert made.proposal.experiment.kind == "near-resonance sine"
