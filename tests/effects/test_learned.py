"""What learned elements owe beyond the contract of all effects."""

from __future__ import annotations

import numpy as np
import pytest
from effect_homes import BASE, LEARNED, OF_ACTUATOR, SCALES, elementary, is_sound, march_against_radau, point
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.effects import Effect, catalogue
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused
from phnn.laws import RESISTOR_LAWS
from phnn.setup import Setup
from phnn.trajectory import amplified, measured

every = pytest.mark.parametrize("element", LEARNED, ids=[e.name for e in LEARNED])
PASSIVE = [e for e in LEARNED if e.passive]


def strong(element: Effect, sizes: list[float]) -> Setup:
    """The base model with an element whose strengths are multiples of typical ones, inside their bounds."""
    setup = element.add_to(BASE, element.grid(SCALES)[0])
    chosen = {}
    for name, size in zip(element.strengths, sizes, strict=False):
        p = setup.parameters[name]
        chosen[name] = min(max(size * p.typical, p.lower), p.upper)
    return setup.with_values(chosen)


# Nothing, and from a thousandth to a thousand times what is noticeable, of both signs.
SIZES = st.lists(
    st.one_of(st.just(0.0), st.builds(lambda e, s: s * 10.0**e, st.floats(-3.0, 3.0), st.sampled_from([1.0, -1.0]))),
    min_size=10,
    max_size=10,
)


@every
def test_it_has_few_strengths_and_fixed_shapes(element: Effect) -> None:
    assert element.name not in catalogue()
    assert 0 < len(element.strengths) <= 12
    assert element.strength == element.strengths[0]
    points = element.grid(SCALES)
    assert 2 <= len(points) <= 4
    for values in points:
        setup = element.add_to(BASE, values)
        # The period of a wave is sought in the residual, and refined by the fit; so are the times of what fades,
        # and where a cushion begins.
        shapes = set(setup.free) - set(BASE.free) - set(element.strengths)
        assert shapes <= {element.wavelength, "tau_H1", "tau_H2", "s_D"}
        nonzero = {abs(values[name]) for name in element.strengths} - {0.0}
        assert max(nonzero) <= 10.0 * min(nonzero) * (1.0 + 1e-12)
        # A start is small against what is noticeable.
        assert all(abs(values[n]) <= 0.1 * setup.parameters[n].typical for n in element.strengths)


@every
def test_it_stands_beside_every_effect_of_the_catalogue(element: Effect) -> None:
    for other in OF_ACTUATOR:
        first, second = other.add_to(BASE, point(other)), element.add_to(BASE, point(element))
        assert element.can_be_added_to(first), other.name
        assert other.can_be_added_to(second), other.name
        both = element.add_to(first, point(element)), other.add_to(second, point(other))
        assert set(both[0].parameters) == set(both[1].parameters)
        if other.location == element.location:
            is_sound(both[1])


def test_all_learned_elements_stand_beside_each_other() -> None:
    setup = BASE
    for element in LEARNED:
        setup = element.add_to(setup, point(element))
    is_sound(setup)


@pytest.mark.parametrize("element", PASSIVE, ids=[e.name for e in PASSIVE])
@settings(max_examples=15, deadline=None)
@given(sizes=SIZES)
def test_no_strengths_make_it_active(element: Effect, sizes: list[float]) -> None:
    is_sound(strong(element, sizes))


@given(sizes=SIZES)
@settings(max_examples=50, deadline=None)
def test_characteristics_of_amplifier_and_sensor_never_fall(sizes: list[float]) -> None:
    rising = np.linspace(-3.0, 3.0, 2001)
    amplifier = strong(learned_elements()["learned_amplifier"], sizes)
    fine = np.repeat(rising[:, None] * SCALES.voltage, 3, axis=1)
    volts, _ = amplified(amplifier, fine, np.full(rising.size, 1e-4), 0.0)
    assert (np.diff(volts[:, 0]) >= -1e-9).all()
    sensor = strong(learned_elements()["learned_sensor"], sizes)
    seen = measured(sensor, rising * SCALES.displacement, np.arange(rising.size) * 1e-4)
    assert (np.diff(seen) > 0.0).all()


def test_strengths_beyond_their_bounds_are_refused_and_scaled_ones_stay_inside() -> None:
    for name, values in (("learned_amplifier", {"a_C1": 1.1}), ("learned_spring", {"k_R1": -1.0})):
        element = learned_elements()[name]
        with pytest.raises(InputRefused, match="outside its bounds"):
            element.add_to(BASE, element.grid(SCALES)[0] | values)
    for element in LEARNED:
        for factor in (-1e6, 1e6):
            element.add_to(BASE, element.scaled(element.grid(SCALES)[0], factor))


def test_a_damper_with_direction_and_position_is_that_of_its_formula() -> None:
    element = learned_elements()["learned_damper"]
    setup = strong(element, [0.0, 0.0, 0.0, 3.0, 1.0, 0.5, 2.0, 2.0, 1.0, 3.0, 0.0, 0.0])
    v, rate = setup.values(), elementary(setup)

    def force(q: float, speed: float) -> float:
        z, s = speed / v["v_D3"], q / v["q_D"]
        ahead = v["F_f3"] * z + v["F_f4"] * z * abs(z) if speed > 0.0 else v["F_b3"] * z + v["F_b4"] * z * abs(z)
        return float(ahead + (v["F_q"] * s * s + v["F_qR"] * max(s, 0.0) + v["F_qL"] * max(-s, 0.0)) * z)

    march_against_radau(setup, lambda voltage, z: rate(voltage, z, force), ("Q_1", "Q_2", "q", "p"))


def test_powers_of_the_speed_are_friction_viscous_damping_and_drag() -> None:
    damper = RESISTOR_LAWS["power_damper"].flow
    speed = np.array([-2.0, -0.3, 0.5, 3.0])
    sides = np.where(speed > 0.0, 0.7, 0.4)
    for exponent in (0.0, 0.5, 1.0, 2.0):
        wanted = sides * np.sign(speed) * np.abs(speed) ** exponent
        np.testing.assert_allclose(damper(speed, 0.0, 0.7, 0.4, exponent, 1.0), wanted, rtol=1e-3)
