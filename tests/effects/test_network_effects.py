"""Effects against equations written down anew and closed forms: hysteresis of other forms, and the measuring chain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from effect_homes import (
    ACTUATOR,
    BASE,
    LEARNED,
    OF_ACTUATOR,
    OTHERS,
    SCALES,
    added,
    base,
    elementary,
    is_sound,
    march_against_radau,
    point,
    run,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import differences, recording

from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.effects import Chain, Effect, catalogue, effect, kinds
from phnn.effects.hysteresis import CELLS
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused, SolverFailed
from phnn.integrate.program import compile_network
from phnn.integrate.scheme import PATH
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.models.actuator import hrc
from phnn.models.network_file import load_network
from phnn.recordings.recording import Recording, Start
from phnn.setup import Setup
from phnn.trajectory import driven, measured, simulate


def test_exact_symmetries_are_known() -> None:
    """What leaves nothing once base parameters, zero and initial state are projected out: no recording can name it."""
    trajectory = base(ACTUATOR)
    taken = np.column_stack([output_derivatives(trajectory, list(BASE.free)), np.ones(trajectory.y.size)])
    basis = np.linalg.svd(taken / np.abs(taken).max(axis=0), full_matrices=False)
    basis_ = basis[0][:, basis[1] > 1e-9 * basis[1][0]]
    silent = set()
    for member in OF_ACTUATOR:
        change = added(member, point(member)).y - trajectory.y
        left = change - basis_ @ (basis_.T @ change)
        if np.linalg.norm(left) < 1e-6 * np.linalg.norm(change):
            silent.add(member.name)
    # With the voltage switched on beforehand an offset of the amplifier is a constant load.
    assert silent - {"amplifier_offset"} == {"constant_load"}


def test_a_load_on_a_spring_is_there_before_the_recording_and_has_no_rest_without_one() -> None:
    load = effect("constant_load")
    loaded = added(load, {"F_0": 0.5})
    np.testing.assert_allclose(loaded.y[0], 0.5 / BASE.parameters["k"].value, rtol=1e-12)
    np.testing.assert_allclose(loaded.y - loaded.y[0], base(ACTUATOR).y, atol=1e-9 * np.abs(loaded.y).max())
    free = load.add_to(OTHERS["mass"], {"F_0": 0.5})
    with pytest.raises(SolverFailed, match="start: unknown"):
        run(free)
    fallen = simulate(free, ACTUATOR.drive, initial=np.zeros(len(free.network.state_names)))
    assert np.isfinite(fallen.y).all()


@pytest.mark.parametrize("gap", [-3e-5, 3e-5])
def test_a_stop_acts_on_the_side_of_its_gap_alone_and_keeps_it(gap: float) -> None:
    stop = effect("contact_stop")
    setup = stop.add_to(BASE, {"k_c": 1e5, "g_c": gap})
    p = setup.parameters["g_c"]
    assert p.lower * p.upper > 0.0
    assert p.lower < p.value < p.upper
    reach, free = run(setup).y, base(ACTUATOR).y
    side = np.sign(gap)
    assert (side * reach).max() < 0.9 * (side * free).max()
    # Up to the first contact nothing has happened.
    first = int(np.argmax(side * free > abs(gap)))
    np.testing.assert_array_equal(reach[:first], free[:first])


def test_factors_of_one_ratio_multiply() -> None:
    setup = BASE
    for name in ("displacement_coupling", "depolarisation", "self_heating"):
        member = effect(name)
        setup = member.add_to(setup, member.scaled(point(member), 3.0))
    assert [m.ratio for m in setup.network.modulations] == ["alpha"] * 3
    is_sound(setup)
    trajectory = run(setup)
    names = ["alpha", "kappa_a", "delta_z", "kappa_T"]
    got = output_derivatives(trajectory, names)
    for k, name in enumerate(names):
        wanted = differences(setup, ACTUATOR.drive, name)
        assert (np.abs(got[:, k] - wanted) > 1e-4 * np.abs(wanted).max()).mean() < 0.05, name


BOUC_WEN = effect("bouc_wen_hysteresis")
SHAPE = {"n_B": 1.4, "c_B": 0.4, "a_B": 0.3}
FORMS = tuple(f for f in (BOUC_WEN, *BOUC_WEN.forms) if not isinstance(f.adds, Chain))
DISTRIBUTED = effect("distributed_hysteresis")
# Stiffness, force, exponent and what the way back changes; velocities and states over what makes them slip.
LAWS = st.tuples(st.floats(0.1, 1e5), st.floats(1e-3, 1e3), st.floats(1.0, 3.0), st.floats(0.0, 5.0))
SIZES = st.builds(lambda e, s: s * 10.0**e, st.floats(-6.0, 2.5), st.sampled_from([1.0, -1.0]))


def law_of(form: Effect) -> str:
    """The law of the slipping spring."""
    return next(r.law for r in form.add_to(BASE, form.grid(SCALES)[0]).network.resistors if r.name == "slip_B")


@pytest.mark.parametrize("form", FORMS, ids=law_of)
def test_a_slipping_spring_is_that_of_its_equation(form: Effect) -> None:
    setup = form.add_to(BASE, form.scaled(form.grid(SCALES)[0], 300.0) | SHAPE)
    assert compile_network(setup.network).rules["z_B"] == PATH
    v, rate = setup.values(), elementary(setup)

    def with_spring(voltage: float, z: np.ndarray) -> np.ndarray:
        speed, pull, strain = z[3] / v["m"], z[4], abs(z[4]) / v["F_B"]
        loads = speed * pull > 0.0
        if form is BOUC_WEN:
            stiffness = 1.0 + v["c_B"] * strain - (strain ** v["n_B"] if loads else 0.0)
        else:
            strain /= 1.0 + v["a_B"] * np.sign(speed)
            stiffness = 1.0 - strain ** v["n_B"] if loads else 1.0 + v["c_B"] * strain ** v["n_B"]
        return np.array([*rate(voltage, z[:4], lambda q, s: pull), v["k_B"] * stiffness * speed])

    # The force follows from the state of the network's storage by the law of its spring.
    spring = next(s for s in setup.network.storages if s.name == "z_B")

    def force(state: np.ndarray) -> np.ndarray:
        return np.asarray(STORAGE_LAWS[spring.law].mean_effort(state, state, *(v[n] for n in spring.parameters)))

    march_against_radau(setup, with_spring, ("Q_1", "Q_2", "q", "p", "z_B"), {"z_B": force})


def test_cells_yield_at_travels_that_follow_the_displacement() -> None:
    setup = DISTRIBUTED.add_to(BASE, DISTRIBUTED.scaled(DISTRIBUTED.grid(SCALES)[0], 300.0))
    v, names = setup.values(), list(setup.network.state_names)
    trajectory = simulate(setup, ACTUATOR.drive, 4)
    q = trajectory.states[:, names.index("q")]
    middle = 0.5 * (q[1:] + q[:-1])
    for cell in CELLS:
        bent = [0.0]
        for step, at in zip(np.diff(q), middle, strict=True):
            grown = v[f"x_{cell}"] + v["g_D"] * at**2
            lean = v["a_D"] * at**2
            bent.append(min(max(bent[-1] + step, -(grown - lean)), grown + lean))
        found = trajectory.states[:, names.index(f"s_{cell}")]
        np.testing.assert_allclose(found, bent, atol=1e-4 * np.abs(bent).max())


@pytest.mark.parametrize("name", ["bouc_wen", "duhem"])
@given(LAWS, SIZES, SIZES, st.floats(-0.9, 0.9))
def test_no_step_along_a_path_gives_energy(
    name: str, values: tuple[float, float, float, float], at: float, way: float, lean: float
) -> None:
    stiffness, force, exponent, back = values
    law = RESISTOR_LAWS[name]
    energy = STORAGE_LAWS[law.spring or "spring"].energy
    given_ = (stiffness, force, back) if law.spring else (stiffness,)
    x, current = at * force / stiffness, way * force / stiffness
    assert law.path is not None
    shape = (force, exponent, back, *((lean,) if name == "bouc_wen" else ()))
    end, mean = law.path(x, current, 1.0, stiffness, *shape, 1.0)
    before, after, work = energy(x, *given_), energy(end, *given_), current * mean
    assert work - (after - before) >= -1e-12 * (abs(work) + before + after)


# Stiffness of the spring, then the values of the law.
ON_A_PATH = {"bouc_wen": (1.3, 0.7, 1.6, 0.4, 0.3), "duhem": (1.3, 0.7, 1.6, 0.4), "lugre": (1.3, 0.7, 0.5, 0.4)}


def along(name: str, x: Any, current: Any, h: float) -> Any:
    path = RESISTOR_LAWS[name].path
    assert path is not None
    return path(x, current, h, *ON_A_PATH[name], 1.0)


@pytest.mark.parametrize("name", ON_A_PATH)
@pytest.mark.parametrize("at", [-0.9, -0.2, 0.0, 0.2, 0.9])
def test_who_rests_on_a_path_stays_in_number_and_tensor(name: str, at: float) -> None:
    values, spring = ON_A_PATH[name], RESISTOR_LAWS[name].spring
    effort = STORAGE_LAWS[spring or "spring"].mean_effort(at, at, *((*values[:2], values[3]) if spring else values[:1]))
    for x in (at, torch.tensor(at, dtype=torch.float64)):
        assert [float(v) for v in along(name, x, 0.0 * x, 1.0)] == pytest.approx([at, effort], abs=1e-15)


def sine(amplitude: float = 75.0, offset: float = 0.0, start: Start | None = None) -> Recording:
    t = np.arange(401) * 1e-4
    return recording(t, offset + amplitude * np.sin(2.0 * np.pi * 50.0 * t), start)


def with_effect(name: str, values: dict[str, float], setup: Setup = BASE) -> Setup:
    return effect(name).add_to(setup, values)


def moved(y: np.ndarray, base: np.ndarray) -> np.ndarray:
    """A change of the output without the zero of the displacement."""
    return y - base - (y - base).mean()


@pytest.mark.parametrize("start", [Start("rest", 0.0), Start("rest", 15.0), Start("unknown")])
def test_an_offset_of_the_amplifier_is_a_zero_of_the_plain_actuator_and_no_more(start: Start) -> None:
    run = sine(offset=15.0 if start.input_before else 0.0, start=start)
    base, shifted = simulate(BASE, run).y, simulate(with_effect("amplifier_offset", {"V_0": 8.0}), run).y
    size = np.abs(base).max()
    assert np.abs(shifted - base).min() > 1e-2 * size
    np.testing.assert_allclose(moved(shifted, base), 0.0, atol=1e-9 * size)
    # To first order as well, from rest without an input on.
    column = output_derivatives(simulate(with_effect("amplifier_offset", {"V_0": 0.0}), run), ["V_0"])[:, 0]
    np.testing.assert_allclose(column, 0.046311 / 24579.0, rtol=1e-6)


def test_an_offset_has_no_rest_without_a_spring() -> None:
    free = Setup(load_network(config_folder() / "network" / "mass_damper.yaml"))
    t = np.arange(50) * 1e-3
    at_rest, unknown = (recording(t, np.sin(30.0 * t), Start(state)) for state in ("rest", "unknown"))
    pushed = with_effect("amplifier_offset", {"V_0": 1.0}, free)
    with pytest.raises(SolverFailed, match="nothing holds"):
        simulate(pushed, at_rest)
    with pytest.raises(SolverFailed, match="nothing holds"):
        output_derivatives(simulate(with_effect("amplifier_offset", {"V_0": 0.0}, free), at_rest), ["V_0"])
    # Where the initial state is given, nothing need rest.
    column = output_derivatives(simulate(pushed, unknown, initial=np.zeros(2)), ["V_0"])[:, 0]
    ends = [simulate(pushed.with_values({"V_0": 1.0 + s}), unknown, initial=np.zeros(2)).y for s in (1e-4, -1e-4)]
    np.testing.assert_allclose(column, (ends[0] - ends[1]) / 2e-4, atol=1e-4 * np.abs(column).max())


def test_a_delay_of_the_voltage_is_a_delay_of_the_output() -> None:
    # Seven samples: the delayed output is the earlier one.
    base, late = simulate(BASE, sine()).y, simulate(with_effect("delay", {"tau_d": 7e-4}), sine()).y
    np.testing.assert_allclose(late[7:], base[:-7], atol=1e-6 * np.abs(base).max())
    assert (late[:8] == 0.0).all()


def test_a_linear_lag_before_and_behind_a_linear_network_are_one() -> None:
    linear = Setup(hrc(0))
    before = simulate(with_effect("amplifier_lowpass", {"tau_a": 1e-3}, linear), sine(), substeps=16).y
    behind = simulate(with_effect("sensor_lag", {"tau_y": 1e-3}, linear), sine(), substeps=16).y
    np.testing.assert_allclose(behind, before, atol=1e-3 * np.abs(before).max())


def test_base_motion_is_probed_in_both_phases_at_a_frequency_to_be_searched() -> None:
    member = effect("base_motion")
    points = member.grid(SCALES)
    assert member.searched == "f_b"
    assert [(p["A_c"] == 0.0, p["A_s"] == 0.0) for p in points] == [(False, True), (True, False)]


def test_pickup_adds_lines_and_nothing_to_the_simulation() -> None:
    noisy = with_effect("mains_pickup", {"f_m": 60.0})
    assert noisy.own.lines == (60.0, 120.0, 180.0)
    assert "f_m" not in noisy.free
    assert noisy.with_values({"k": 2e4}).own.lines == noisy.own.lines
    np.testing.assert_array_equal(simulate(noisy, sine()).y, simulate(BASE, sine()).y)


every = pytest.mark.parametrize("element", LEARNED, ids=[e.name for e in LEARNED])
PASSIVE = [e for e in LEARNED if e.passive]
FOLLOWED = {kinds.THRESHOLD_BY_DISPLACEMENT, kinds.THRESHOLD_BY_RATE, kinds.THRESHOLD_OVER_TIME}


def strong(element: Effect, sizes: list[float]) -> Setup:
    """The base model with an element whose strengths are multiples of typical ones, inside their bounds."""
    setup = element.add_to(BASE, element.grid(SCALES)[0])
    chosen = {}
    for name, size in zip(element.all_strengths, sizes, strict=False):
        p = setup.parameters[name]
        chosen[name] = min(max(size * p.typical, p.lower), p.upper)
    return setup.with_values(chosen)


# Nothing, and from a thousandth to a thousand times what is noticeable, of both signs.
STRENGTHS = st.lists(
    st.one_of(st.just(0.0), st.builds(lambda e, s: s * 10.0**e, st.floats(-3.0, 3.0), st.sampled_from([1.0, -1.0]))),
    min_size=10,
    max_size=10,
)


@every
def test_it_has_few_strengths_and_fixed_shapes(element: Effect) -> None:
    assert element.name not in catalogue()
    assert 0 < len(element.all_strengths) <= 12
    assert element.strength == element.all_strengths[0]
    points = element.grid(SCALES)
    assert 2 <= len(points) <= 4
    for values in points:
        setup = element.add_to(BASE, values)
        # The period of a wave is sought in the residual, and refined by the fit; so are the times of what fades,
        # and where a cushion begins.
        shapes = set(setup.free) - set(BASE.free) - set(element.all_strengths)
        assert shapes <= {element.wavelength, "tau_H1", "tau_H2", "s_D"}
        nonzero = {abs(values[name]) for name in element.all_strengths} - {0.0}
        assert max(nonzero) <= 10.0 * min(nonzero) * (1.0 + 1e-12)
        # A start is small against what is noticeable.
        assert all(abs(values[n]) <= 0.1 * setup.parameters[n].typical for n in element.all_strengths)


@every
def test_it_stands_beside_every_effect_of_the_catalogue(element: Effect) -> None:
    for other in OF_ACTUATOR:
        if {other.kind, element.kind} <= FOLLOWED:
            # A dead zone follows one state.
            continue
        first, second = other.add_to(BASE, point(other)), element.add_to(BASE, point(element))
        assert element.can_be_added_to(first), other.name
        assert other.can_be_added_to(second), other.name
        both = element.add_to(first, point(element)), other.add_to(second, point(other))
        assert set(both[0].parameters) == set(both[1].parameters)
        if other.location == element.location:
            is_sound(both[1])


@pytest.mark.parametrize("offset", [0.0, 40.0])
def test_what_ages_begins_anew_in_every_recording(offset: float) -> None:
    element = learned_elements()["learned_ratio_over_time"]
    losses = {"a_A1": 0.1, "a_A2": 0.0, "a_A3": -0.2}
    setup = element.add_to(BASE, point(element) | losses)
    given = sine(offset=offset)
    trajectory = simulate(setup, given, 4)
    for i in "123":
        age = trajectory.states[:, setup.network.state_names.index(f"age_{i}")]
        turns = 0.25 * given.dt / setup.parameters[f"tau_A{i}"].value * np.arange(age.size)
        np.testing.assert_allclose(age, 1.0 - np.exp(-turns), atol=1e-12)
    # What has aged at once is a weaker coupling; what takes for ever is none.
    for tau, share in ((1e-9, 0.9 * 1.2), (1e9, 1.0)):
        soon = setup.with_values({f"tau_A{i}": tau for i in "123"})
        weaker = BASE.with_values({"alpha": share * BASE.parameters["alpha"].value})
        apart = simulate(soon, given, 4).y[1:] - simulate(weaker, given, 4).y[1:]
        assert np.abs(apart).max() < 1e-3 * np.ptp(trajectory.y)


def test_all_learned_elements_stand_beside_each_other() -> None:
    setup = BASE
    for element in LEARNED:
        setup = element.add_to(setup, point(element))
    is_sound(setup)


@pytest.mark.parametrize("element", PASSIVE, ids=[e.name for e in PASSIVE])
@settings(max_examples=15, deadline=None)
@given(sizes=STRENGTHS)
def test_no_strengths_make_it_active(element: Effect, sizes: list[float]) -> None:
    is_sound(strong(element, sizes))


@given(sizes=STRENGTHS)
@settings(max_examples=50, deadline=None)
def test_characteristics_of_amplifier_and_sensor_never_fall(sizes: list[float]) -> None:
    rising = np.linspace(-3.0, 3.0, 2001)
    amplifier = strong(learned_elements()["learned_amplifier"], sizes)
    fine = np.repeat(rising[:, None] * SCALES.voltage, 3, axis=1)
    volts, _ = driven(amplifier, fine, np.full(rising.size, 1e-4), 0.0, 0)
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
