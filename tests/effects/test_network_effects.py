"""What single effects of the network promise beyond the contract of all."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effect_homes import ACTUATOR, BASE, OF_ACTUATOR, OTHERS, added, base, is_sound, point, run

from phnn.derivatives import output_derivatives
from phnn.effects import effect
from phnn.errors import SolverFailed
from phnn.integrate.program import compile_network
from phnn.integrate.quick import serves
from phnn.integrate.tables import EXACT, LOSSLESS
from phnn.simulate import simulate

torch.set_num_threads(1)


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


def test_leaks_keep_the_exact_flow_of_every_hysteron() -> None:
    setup = effect("charge_leakage").add_to(BASE, {"G": 1e-6})
    program = compile_network(setup.network)
    assert set(program.rules.values()) == {EXACT, LOSSLESS}
    assert serves(program)
    none = effect("charge_leakage").add_to(BASE, {"G": 1e-300})
    np.testing.assert_array_equal(run(none).y, base(ACTUATOR).y)


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
        step = 1e-5 * setup.parameters[name].value
        ends = [run(setup.with_values({name: setup.parameters[name].value + s})).y for s in (step, -step)]
        wanted = (ends[0] - ends[1]) / (2.0 * step)
        assert (np.abs(got[:, k] - wanted) > 1e-4 * np.abs(wanted).max()).mean() < 0.05, name
