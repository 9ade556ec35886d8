"""Effects that a user registers: refused where they are unsound, and found by a diagnosis where they are not."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import cloudpickle
import pytest
from effect_homes import ACTUATOR, BASE
from guided_rig import FORCE, REACH, SPEED, write_rig

import phnn
from phnn.diagnose.diagnosis import diagnose
from phnn.effects import (
    Effect,
    Kind,
    Parts,
    Placed,
    Scales,
    at_sensor,
    catalogue,
    constant,
    effect,
    has_motion,
    kinds,
    positive,
    register,
    registered,
    unregister,
)
from phnn.effects.effect import Values
from phnn.errors import InputRefused
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.report.result import document
from phnn.setup import Setup

# Names of the law's parameters: force, exponent of the speed, and the sizes at which the force is reached.
_RIGHT, _LEFT = ("F_h", "n_h", "v_h", "c_right"), ("F_h", "n_h", "v_h", "c_left")


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    slope = 1.0 / scales.displacement
    force = 1e-4 * scales.stiffness * scales.displacement
    return [{"F_h": force, "n_h": 1.0, "v_h": scales.velocity, "c_right": slope, "c_left": -slope}]


GUIDE = Effect(
    name="guide_damping",
    kind=kinds.DAMPING_BY_DISPLACEMENT,
    equation=r"F = F_h\,c\,|q|\,v/v_h",
    statement="The guide brakes the more the farther it bends: with {F_h} at full displacement and {v_h}.",
    fingerprint="Damping grows with the amplitude at every frequency below the resonance.",
    separation="Small sines at the resonance about two offsets of the voltage: the peak is broader about the larger.",
    references=("Smith 2000, Flexures, ch. 4",),
    declares=(
        positive("F_h", "N", "braking force of the guide", 1e8, strength=True),
        constant("n_h", "1", "exponent of the speed"),
        constant("v_h", "m/s", "speed at which the guide brakes with its nominal force"),
        constant("c_right", "1/m", "inverse of the displacement at which it does"),
        constant("c_left", "1/m", "its mirror image"),
    ),
    adds=Parts(
        resistors=(
            Resistor("guide_right", "ramp_damper", {"p": 1.0}, _RIGHT, "q"),
            Resistor("guide_left", "ramp_damper", {"p": 1.0}, _LEFT, "q"),
        )
    ),
    grid=grid,
    applies=has_motion,
    neighbours=("quadratic_drag",),
)


def test_a_registered_effect_is_one_of_the_catalogue_until_it_is_taken_out() -> None:
    assert register(GUIDE) is GUIDE
    try:
        assert effect("guide_damping") is GUIDE
        assert list(catalogue())[-1] == "guide_damping"
        with pytest.raises(InputRefused, match="there already"):
            register(GUIDE)
    finally:
        unregister("guide_damping")
    assert "guide_damping" not in catalogue()
    with pytest.raises(InputRefused, match="was registered: there are none"):
        unregister("guide_damping")
    with registered(GUIDE):
        assert "guide_damping" in catalogue()
    assert "guide_damping" not in catalogue()


def test_an_effect_that_was_sent_to_another_process_is_the_same_one() -> None:
    # Functions of a notebook go by value, so that others come back.
    mine = replace(GUIDE, grid=lambda scales: grid(scales))
    again = pickle.loads(cloudpickle.dumps(mine))
    assert again.grid is not mine.grid
    assert again == mine
    assert hash(again) == hash(mine)
    assert again.grid(ACTUATOR.scales) == mine.grid(ACTUATOR.scales)
    assert again != replace(mine, equation="F = 0")


def weigh(setup: Setup, parameters: Placed) -> Setup:
    """A weight, which is a source of energy, beside the guide."""
    load = Parts((Storage("x_h", "weight", ("F_h",), "m"),), couplings=(Coupling("x_h", "p", 1.0),))
    return load(setup, parameters)


def undocumented(setup: Setup) -> bool:
    return has_motion(setup)


def on_nothing(setup: Setup) -> bool:
    """There is a flux capacitor."""
    return False


def growing(values: Values, factor: float) -> dict[str, float]:
    return {**values, "F_h": max(values["F_h"], 1e-3)}


def two_speeds(scales: Scales) -> list[dict[str, float]]:
    return [{**values, "v_i": 1.0} for values in grid(scales)]


ONE = GUIDE.declares[0]
UNSOUND: dict[str, tuple[dict[str, object], str]] = {
    "a name of another effect": ({"name": "creep"}, "there already"),
    "a name with blanks": ({"name": "guide damping"}, "lower-case words"),
    "a parameter of the base model": ({"declares": (replace(ONE, name="d_2"), *GUIDE.declares[1:])}, "the base model"),
    "a parameter of another effect": ({"declares": (replace(ONE, name="k_s"), *GUIDE.declares[1:])}, "to creep"),
    "a parameter twice": ({"declares": (*GUIDE.declares, ONE)}, "the effect twice"),
    "an unknown neighbour": ({"neighbours": ("gravity",)}, "not in the catalogue"),
    "a location that is none": ({"kind": Kind("wall", "dissipative")}, "no location is called 'wall'"),
    "no reference": ({"references": ()}, "no reference"),
    "two sentences": ({"fingerprint": "It brakes. Always."}, "no single sentence"),
    "no equation": ({"equation": r"\frac{1"}, "no LaTeX"),
    "an empty range": ({"declares": (ONE.plausibly(2.0, 1.0, "measured on one stage"), *GUIDE.declares[1:])}, "empty"),
    "a range without a source": ({"declares": (ONE.plausibly(0.0, 1.0, ""), *GUIDE.declares[1:])}, "not both"),
    "nowhere to be added": ({"applies": on_nothing}, "There is a flux capacitor"),
    "a condition without words": ({"applies": undocumented}, "no docstring"),
    "a statement of other things": ({"statement": "It brakes with {F_j}."}, "names .'F_j'., which it does not declare"),
    "an undeclared value": ({"grid": two_speeds}, "its grid gives"),
    "a source of energy": ({"adds": weigh}, "not passive, and says otherwise"),
    "a strength that does not vanish": ({"rescale": growing}, "does not vanish"),
    "a law that is none": ({"adds": at_sensor("wobble")}, "wobble"),
}


@pytest.mark.parametrize("name", UNSOUND)
def test_what_is_unsound_is_refused_with_its_cause(name: str) -> None:
    changes, cause = UNSOUND[name]
    before = list(catalogue())
    with pytest.raises(InputRefused, match=cause):
        register(replace(GUIDE, **changes))  # type: ignore[arg-type]
    assert list(catalogue()) == before


def test_a_kind_that_is_a_word_is_refused() -> None:
    with pytest.raises(InputRefused, match=r"its kind is 'dissipative': give one of those of phnn\.effects\.kinds"):
        replace(effect("creep"), kind="dissipative")  # type: ignore[arg-type]


def test_a_base_model_of_the_user_serves_as_well() -> None:
    with registered(GUIDE, ACTUATOR):
        assert effect("guide_damping").can_be_added_to(BASE)


@pytest.mark.slow
def test_a_diagnosis_finds_locates_and_names_a_registered_effect(tmp_path: Path) -> None:
    write_rig(tmp_path, power=1.0)
    campaign = phnn.read(tmp_path)
    with registered(GUIDE):
        diagnosis = diagnose(campaign)
    assert diagnosis.places == ("mechanical",)
    assert diagnosis.verdict == "named"
    (claim,) = diagnosis.claims
    assert claim.effect == GUIDE
    assert diagnosis.probability["guide_damping"] == claim.probability
    values = diagnosis.final.setup.values()
    assert values["F_h"] / values["v_h"] * values["c_right"] == pytest.approx(FORCE / SPEED / REACH, rel=0.05)
    (missing,) = document(diagnosis)["missing"]
    assert (missing["effect"], missing["location"], missing["place"]) == ("guide_damping", "mechanical", "q")
    assert "The guide brakes" in missing["statement"]
