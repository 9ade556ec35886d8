"""Hysteresis of other forms than hysterons: against equations written down anew, along paths, and at any strength."""

from __future__ import annotations

import numpy as np
import pytest
from effect_homes import ACTUATOR, BASE, SCALES, elementary, march_against_radau
from hypothesis import given
from hypothesis import strategies as st

from phnn.effects import Effect, effect
from phnn.integrate.program import compile_network
from phnn.integrate.tables import PATH
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.simulate import simulate

BOUC_WEN = effect("bouc_wen_hysteresis")
FORMS = (BOUC_WEN, *BOUC_WEN.forms)
DISTRIBUTED = effect("distributed_hysteresis")
# Stiffness, force, exponent and what the way back changes; velocities and states over what makes them slip.
LAWS = st.tuples(st.floats(0.1, 1e5), st.floats(1e-3, 1e3), st.floats(1.0, 3.0), st.floats(0.0, 5.0))
SIZES = st.builds(lambda e, s: s * 10.0**e, st.floats(-6.0, 2.5), st.sampled_from([1.0, -1.0]))


def law_of(form: Effect) -> str:
    """The law of the slipping spring."""
    return next(r.law for r in form.add_to(BASE, form.grid(SCALES)[0]).network.resistors if r.name == "slip_B")


@pytest.mark.parametrize("form", FORMS, ids=law_of)
def test_a_slipping_spring_is_that_of_its_equation(form: Effect) -> None:
    setup = form.add_to(BASE, form.scaled(form.grid(SCALES)[0], 300.0) | {"n_B": 1.7, "c_B": 0.4})
    assert compile_network(setup.network).rules["z_B"] == PATH
    v, rate = setup.values(), elementary(setup)
    elastic = form is BOUC_WEN

    def with_spring(voltage: float, z: np.ndarray) -> np.ndarray:
        speed, pull = z[3] / v["m"], z[4]
        strain = abs(pull) / v["F_B"]
        loads = speed * pull > 0.0
        if elastic:
            stiffness = 1.0 + v["c_B"] * strain - (strain ** v["n_B"] if loads else 0.0)
        else:
            stiffness = 1.0 - strain ** v["n_B"] if loads else 1.0 + v["c_B"] * strain ** v["n_B"]
        return np.array([*rate(voltage, z[:4], lambda q, s: pull), v["k_B"] * stiffness * speed])

    # The force follows from the state of the network's storage by the law of its spring.
    spring = next(s for s in setup.network.storages if s.name == "z_B")
    values = [v[n] for n in spring.parameters]

    def force(state: np.ndarray) -> np.ndarray:
        return np.asarray(STORAGE_LAWS[spring.law].mean_effort(state, state, *values))

    march_against_radau(setup, with_spring, ("Q_1", "Q_2", "q", "p", "z_B"), {"z_B": force})


def test_cells_yield_at_travels_that_follow_the_displacement() -> None:
    setup = DISTRIBUTED.add_to(BASE, DISTRIBUTED.scaled(DISTRIBUTED.grid(SCALES)[0], 300.0))
    v, names = setup.values(), list(setup.network.state_names)
    trajectory = simulate(setup, ACTUATOR.drive, 4)
    q = trajectory.states[:, names.index("q")]
    middle = 0.5 * (q[1:] + q[:-1])
    for cell in ("D1", "D2", "D3", "D4"):
        bent = [0.0]
        for step, at in zip(np.diff(q), middle, strict=True):
            grown = v[f"x_{cell}"] + v["g_D"] * at**2
            lean = v["a_D"] * at**2
            bent.append(min(max(bent[-1] + step, -(grown - lean)), grown + lean))
        found = trajectory.states[:, names.index(f"s_{cell}")]
        np.testing.assert_allclose(found, bent, atol=1e-6 * np.abs(bent).max())


@pytest.mark.parametrize("name", ["bouc_wen", "duhem"])
@given(LAWS, SIZES, SIZES)
def test_no_step_along_a_path_gives_energy(
    name: str, values: tuple[float, float, float, float], at: float, way: float
) -> None:
    stiffness, force, exponent, back = values
    law = RESISTOR_LAWS[name]
    energy = STORAGE_LAWS[law.spring or "spring"].energy
    given_ = (stiffness, force, back) if law.spring else (stiffness,)
    x, current = at * force / stiffness, way * force / stiffness
    assert law.path is not None
    end, mean = law.path(x, current, 1.0, stiffness, force, exponent, back, 1.0)
    before, after = energy(x, *given_), energy(end, *given_)
    assert current * mean - (after - before) >= -1e-12 * (abs(current * mean) + before + after)


@pytest.mark.parametrize("name", ["bouc_wen", "duhem"])
def test_the_end_of_a_path_does_not_depend_on_the_time(name: str) -> None:
    path = RESISTOR_LAWS[name].path
    assert path is not None
    for way in (0.3, -0.7, 2.0):
        ends = [path(0.2, way / h, h, 1.3, 0.7, 1.6, 0.4, 1.0) for h in (1e-3, 1.0, 1e3)]
        np.testing.assert_allclose(ends, np.broadcast_to(ends[0], (3, 2)), rtol=1e-12)


def test_a_path_of_two_halves_ends_nearly_where_the_whole_does() -> None:
    for name in ("bouc_wen", "duhem"):
        path = RESISTOR_LAWS[name].path
        assert path is not None
        given_ = (1.0, 1.3, 0.7, 1.6, 0.4, 1.0)
        errors = []
        for way in (0.04, 0.02):
            whole, _ = path(0.3, way, *given_)
            half, _ = path(0.3, 0.5 * way, *given_)
            errors.append(abs(path(half, 0.5 * way, *given_)[0] - whole))
        assert errors[1] < errors[0] / 6.0  # of third order in one step, hence of second along a path
