"""Effects that a user registers: refused where they are unsound, and found by a diagnosis where they are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_homes import ACTUATOR, BASE
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import phnn
from phnn.diagnosis import diagnose
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


def test_a_base_model_of_the_user_serves_as_well() -> None:
    with registered(GUIDE, ACTUATOR):
        assert effect("guide_damping").can_be_added_to(BASE)


# The user's rig: eqs. (3) to (6) of an actuator with two hysterons, written down anew, and a guide that brakes.
Array = NDArray[np.float64]
RIG = {
    "m": 1.05e-3, "k": 2.3e4, "b": 3.4, "alpha": 0.044,
    "C": np.array([5.6e-7, 5.1e-7]), "rho": np.array([0.58, 1.2e-4]), "d": np.array([14.0, 8.8]),
}  # fmt: skip
FORCE, SPEED, REACH = 0.25, 0.1, 1.2e-4
NOISE, STEP = 6e-8, 1e-4


def moved(volts: Callable[[float], float], t: Array) -> Array:
    """Displacement [m] at the times ``t`` [s] under a voltage."""
    r = RIG

    def rate(time: float, z: Array) -> Array:
        q, v, e = z[2], z[3] / r["m"], z[:2] / r["C"]
        slipping = r["rho"] * (e - np.clip(e, -0.5 * r["d"], 0.5 * r["d"]))
        braking = FORCE * abs(q) / REACH * v / SPEED
        force = r["alpha"] * (volts(time) - e.sum()) - r["k"] * q - r["b"] * v - braking
        return np.array([*(r["alpha"] * v - slipping), v, force])

    scale = np.array([1e-6, 1e-6, 1e-4, 1e-4])
    found = solve_ivp(rate, (0.0, t[-1]), np.zeros(4), "LSODA", t, rtol=1e-8, atol=1e-9 * scale, max_step=STEP)
    assert found.success
    return np.asarray(found.y[2])


def sine(frequency: float, amplitude: float, offset: float = 0.0) -> Callable[[float], float]:
    """A sine that grows from rest over two hundredths of a second."""
    return lambda t: min(t / 0.02, 1.0) * (offset + amplitude * np.sin(2.0 * np.pi * frequency * t))


RECORDINGS = {
    "slow": (sine(10.0, 75.0), 0.3),
    "fast": (sine(100.0, 75.0), 0.2),
    "faster": (sine(300.0, 40.0), 0.1),
    "aside": (sine(200.0, 25.0, 45.0), 0.1),
    "small": (sine(50.0, 50.0), 0.2),
    "resonant": (sine(500.0, 30.0), 0.1),
}


def write_rig(folder: Path) -> None:
    rng = np.random.default_rng(20)
    entries = []
    for name, (volts, duration) in RECORDINGS.items():
        t = np.arange(round(duration / STEP)) * STEP
        y = moved(volts, t) + NOISE * rng.standard_normal(t.size)
        columns = np.column_stack([t, [volts(x) for x in t], 1e6 * y])
        np.savetxt(folder / f"{name}.csv", columns, "%.9g", ",", header="time_s,voltage_V,displacement_um", comments="")
        entries.append(f"- file: {name}.csv\n  name: {name}\n  start: {{state: rest, input_before: 0.0}}\n")
    manifest = "setup: {model: piezo_actuator, hysterons: 2}\n" + f"known: {{m: {{value: {RIG['m']}, std: 1.0e-5}}}}\n"
    (folder / "recordings.yaml").write_text(manifest + "voltage: command\nrecordings:\n" + "".join(entries))


@pytest.mark.slow
def test_a_diagnosis_finds_locates_and_names_a_registered_effect(tmp_path: Path) -> None:
    write_rig(tmp_path)
    campaign = phnn.read(tmp_path)
    with registered(GUIDE):
        diagnosis = diagnose(campaign)
    judgement = diagnosis.judgement
    assert judgement.location.name == "mechanical"
    assert judgement.verdict == "named"
    (finding,) = judgement.findings
    assert finding.effect == GUIDE
    values = judgement.final.setup.values()
    assert values["F_h"] / values["v_h"] * values["c_right"] == pytest.approx(FORCE / SPEED / REACH, rel=0.05)
    (missing,) = document(diagnosis)["missing"]
    assert (missing["effect"], missing["location"], missing["place"]) == ("guide_damping", "mechanical", "q")
    assert "The guide brakes" in missing["statement"]
