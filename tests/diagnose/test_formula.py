"""Learned elements are distilled to the formula that the plant had."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
import pytest
from campaigns import recorded
from effect_homes import BASE, SCALES
from matplotlib.mathtext import MathTextParser

from phnn.criteria import Criteria
from phnn.diagnose.formula import Distilled, distil
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.diagnose.refit import started
from phnn.diagnose.search import begin, refits
from phnn.effects import Effect, effect
from phnn.effects.formulas import formulas, formulas_for
from phnn.effects.learned import learned_elements
from phnn.identification.fit import fit
from phnn.identification.plan import Plan
from phnn.recordings.recording import Campaign
from phnn.setup import Setup

NOISE = 2e-8


NAMES = [n for n in BASE.free if n != "m"]


def recordings(plant: Setup, noise: float = NOISE) -> Plan:
    """Three sines that a plant was driven by."""
    t = np.arange(601) * 1e-4
    drives = ((100.0, 75.0, 0.0), (150.0, 40.0, 20.0), (50.0, 75.0, 0.0))
    return Plan(
        tuple(
            recorded(plant, f"sine_{i}", t, (a * np.sin(2 * np.pi * f * t) + o) * np.minimum(f * t, 1.0), noise, i)
            for i, (f, a, o) in enumerate(drives)
        ),
        {f"sine_{i}": 4 for i in range(len(drives))},
        1,
    )


def learned_linearised(plant: Setup, element: Effect, noise: float = NOISE) -> LinearisedFit:
    """The base model with a learned element, fitted to a plant's own recordings."""
    plan, names = recordings(plant, noise), [*NAMES, *element.strengths]
    setup = element.add_to(BASE, element.grid(SCALES)[0])
    begun, _ = started(setup, plan, names, element.strengths, None)
    return prepare(fit(begun, plan, names, {"m": "held"}, 20))


def damped(strengths: Mapping[str, float]) -> Setup:
    """The actuator with a damper of known strengths."""
    element = learned_elements()["learned_damper"]
    point = element.grid(SCALES)[0]
    return element.add_to(BASE, point | dict.fromkeys(element.strengths, 0.0) | dict(strengths))


def of_terms(plant: Setup, element: Effect, noise: float = NOISE) -> Distilled | None:
    """The formula of a learned spring or damper of a plant."""
    return distil(learned_linearised(plant, element, noise), element, None, lambda *_: [])


def test_damping_that_grows_with_the_square_of_the_displacement() -> None:
    element = learned_elements()["learned_damper"]
    plant = damped({"F_q": 0.5})
    found = of_terms(plant, element)
    assert found is not None
    assert found.equation == r"F = F_1\,(\left(\frac{q}{q_0}\right)^{2}\,\frac{v}{v_0})"
    assert "Viscous damping that grows with the square of the distance from zero" in found.words
    (n, _), (m, (low, high)) = found.exponents["n_1"], found.exponents["m_1"]
    assert (n, m) == (1.0, 2.0)
    assert low <= 2.0 <= high
    assert high - low < 0.2
    # F₁ (q/q₀)² v/v₀ is F_q (q/q_D)² v/v_D.
    values, (size, q_0, v_0) = plant.values(), (found.parameters[n][0] for n in ("F_1", "q_0", "v_0"))
    assert size / (q_0**2 * v_0) == pytest.approx(0.5 / (values["q_D"] ** 2 * values["v_Dq"]), rel=0.05)
    for text in (found.equation, *found.others):
        MathTextParser("path").parse(f"${text}$")


@pytest.mark.slow
def test_damping_that_differs_by_direction() -> None:
    element = learned_elements()["learned_damper"]
    found = of_terms(damped({"F_f3": 0.3}), element)
    assert found is not None
    assert r"[v > 0]" in found.equation
    size, v_0 = (found.parameters[n][0] for n in ("F_1", "v_0"))
    assert size / v_0 == pytest.approx(0.3 / SCALES.velocity, rel=0.05)
    MathTextParser("path").parse(f"${found.equation}$")


def test_a_spring_that_hardens_with_the_cube() -> None:
    element = learned_elements()["learned_spring"]
    cubic = effect("cubic_stiffness")
    found = of_terms(cubic.add_to(BASE, {"kappa_3": 0.15, "q_0": SCALES.displacement}), element)
    assert found is not None
    assert found.exponents["n_1"][0] == 3.0
    assert found.words == "A force against the displacement that grows with its cube."
    MathTextParser("path").parse(f"${found.equation}$")


@pytest.mark.parametrize("share", [pytest.param(1e-2, marks=pytest.mark.slow), 10.0])
def test_a_fit_of_strengths_needs_few_steps_wherever_they_begin(share: float) -> None:
    element = learned_elements()["learned_damper"]
    plan, names = recordings(damped({"F_f3": 0.3})), [*NAMES, *element.strengths]
    setup = element.add_to(BASE, element.scaled(element.grid(SCALES)[0], share))
    before = fit(setup, plan, names, {}, 1)
    begun, _ = started(setup, plan, names, element.strengths, None)
    found = fit(begun, plan, names, {}, 6)
    assert np.sqrt(before.chi2) > 20.0
    assert np.sqrt(found.chi2) < 2.0
    done = fit(found.setup, plan, names, {}, 40)
    assert np.sqrt(done.chi2) < 1.05
    # What both directions have in common the base damper can take over.
    values = done.setup.values()
    assert values["F_f3"] - values["F_b3"] == pytest.approx(0.3, rel=0.05)
    # At the minimum there is no better start; a fit moves strengths off their bounds by its last digits.
    again = fit(started(done.setup, plan, names, element.strengths, None)[0], plan, names, {}, 1)
    assert again.cost <= done.cost * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("learned", "formula", "values", "said"),
    [
        ("learned_amplifier", "amplifier_dead_band", {"delta_U": 0.6, "a_U": 1.0}, "dead band"),
        pytest.param(
            *("learned_amplifier", "amplifier_knee", {"a_K": 0.15, "U_K": -45.0}, "beyond -45"), marks=pytest.mark.slow
        ),
        ("learned_sensor_over_time", "sensor_clock", {"kappa_Z": 3e-4, "one_Z": 1.0}, "clock"),
        pytest.param(
            *(
                "learned_sensor_over_time",
                "sensor_gain_drift",
                {"kappa_G": -0.02, "bend_G": 0.0, "early_G": 0.0, "T_G": 0.06},
                "gain",
            ),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_formula_of_the_measuring_chain_is_found_in_the_place_of_a_learned_element(
    learned: str, formula: str, values: Mapping[str, float], said: str
) -> None:
    element = learned_elements()[learned]
    plant = formulas()[formula].add_to(BASE, values)
    final = learned_linearised(plant, element)
    without = fit(BASE, final.plan, NAMES, {"m": "held"}, 20)
    campaign = Campaign(final.plan.recordings, {}, {}, "command", (), True, "made up")
    search = begin(campaign, without, [], [], Criteria())
    found = distil(final, element, without, partial(refits, search, search.base))
    assert found is not None
    assert said in found.words
    for name, (value, _) in found.parameters.items():
        assert value == pytest.approx(values[name], rel=0.03)


def test_a_learned_damper_that_no_formula_matches_stays_a_curve() -> None:
    # Friction that is smooth about another speed than that of the terms, beside damping that follows the position.
    assert of_terms(damped({"F_f1": 0.2, "F_b1": 0.2, "F_q": 0.3}), learned_elements()["learned_damper"]) is None


def test_formulas_that_fit_as_well_are_told() -> None:
    # Noise of a twentieth of the motion hides which formula it is.
    found = of_terms(damped({"F_q": 0.5}), learned_elements()["learned_damper"], 6e-6)
    assert found is not None
    assert found.others and found.equation not in found.others


def test_what_has_no_formula_stays_a_curve() -> None:
    assert not formulas_for(learned_elements()["learned_relaxation"])
