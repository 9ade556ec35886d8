"""Setups and the simulation of recordings: values, blocks, sources, starts, steps and derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from junctions import differences, recording
from scipy.integrate import solve_ivp

from phnn.configuration import config_folder
from phnn.derivatives import input_force, output_derivatives
from phnn.effects import effect
from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.integrate import kernel
from phnn.integrate.rest import equilibrium
from phnn.models.actuator import bouc_wen, from_paper, hrc
from phnn.models.network_file import load_network
from phnn.network.elements import Port
from phnn.parameters import Parameter, positive
from phnn.recordings.recording import Recording, Start
from phnn.setup import Block, Setup, Source
from phnn.trajectory import simulate

BASE = Setup(from_paper())


def sine(cycles: float = 2.0, offset: float = 0.0, **other: object) -> Recording:
    t = np.arange(round(100 * cycles) + 1) * 1e-4
    return recording(t, offset + 90.0 * np.sin(2 * np.pi * 100.0 * t), **other)  # type: ignore[arg-type]


def test_rest_under_a_voltage_stays_at_rest() -> None:
    t = np.arange(100) * 1e-4
    held = recording(t, np.full(100, 20.0), Start("rest", 20.0))
    for setup in (BASE, effect("cubic_stiffness").add_to(BASE, {"kappa_3": 0.3, "q_0": 1e-5})):
        y = simulate(setup, held).y
        np.testing.assert_allclose(y, y[0], rtol=1e-12)
        assert y[0] > 1e-5
    assert simulate(BASE, held).y[0] == pytest.approx(0.046311 * 20.0 / 24579.0)
    jump = simulate(BASE, recording(t, np.full(100, 20.0), Start("rest", 0.0))).y
    assert jump[0] == 0.0
    assert np.abs(jump).max() > 1e-6


def test_hysterons_hold_where_there_is_no_spring() -> None:
    base = from_paper()
    free = base.__class__(
        tuple(s for s in base.storages if s.name != "q"),
        base.resistors,
        tuple(c for c in base.couplings if c.to != "q"),
        base.ports,
        base.parameters,
        "Q_1",
    )
    edge = 0.5 * base.parameters["d_2"].value
    # Within their dead zones they share the voltage evenly, then the wider one takes the rest.
    for voltage, shares in ((8.0, (4.0, 4.0)), (10.0, (10.0 - edge, edge))):
        x = dict(zip(free.state_names, equilibrium(free, np.array([voltage, 0.0])), strict=True))
        for i, share in enumerate(shares, 1):
            assert x[f"Q_{i}"] / base.parameters[f"C_{i}"].value == pytest.approx(share, rel=1e-9)
    assert (equilibrium(free, np.zeros(2)) == 0.0).all()
    # Beyond them nothing holds the mass: it moves steadily, and there is no displacement to say how far.
    slow = dict(zip(free.state_names, equilibrium(free, np.array([60.0, 0.0])), strict=True))
    assert slow["p"] > 0.0


def test_blocks_act_in_their_order_and_the_sensor_on_the_output() -> None:
    limit = ("amplifier_saturation", {"V_max": 20.0})
    assert np.abs(simulate(chained(LOWPASS, limit), sine()).fine).max() == 20.0
    assert np.abs(simulate(chained(limit, LOWPASS), sine()).fine).max() < 20.0
    run = simulate(chained(DRIFT), sine())
    np.testing.assert_allclose(run.y, simulate(BASE, sine()).y + 1e-4 * run.t, rtol=1e-12)


def test_a_source_is_a_force_on_the_mass() -> None:
    linear = hrc(0)
    setup = chained(BASE_MOTION, start=Setup(linear))
    quiet = recording(np.arange(401) * 5e-5, np.zeros(401))
    p = linear.parameters

    def rate(t: float, x: np.ndarray) -> list[float]:
        force = 0.2 * np.cos(2.0 * np.pi * 170.0 * t) - 0.1 * np.sin(2.0 * np.pi * 170.0 * t)
        return [x[1], (force - p["k"].value * x[0] - p["b"].value * x[1]) / p["m"].value]

    exact = solve_ivp(rate, (0.0, 0.02), [0.0, 0.0], "DOP853", quiet.t, rtol=1e-10, atol=1e-16).y[0]
    run = simulate(setup, quiet, substeps=8)
    assert run.u.shape == (3200, 3)
    np.testing.assert_allclose(run.y, exact, atol=1e-3 * np.abs(exact).max())


def test_a_source_is_silent_during_a_run_in() -> None:
    run = simulate(chained(BASE_MOTION), periodic())
    steps = run.nodes[run.lead]
    assert (run.u[:steps, 2] == 0.0).all()
    assert (run.u[steps:, 2] != 0.0).all()
    np.testing.assert_array_equal(run.states[: steps + 1], simulate(BASE, periodic()).states[: steps + 1])


def test_settled_blocks_start_without_a_transient() -> None:
    t = np.arange(50) * 1e-4
    y = simulate(chained(LOWPASS), recording(t, np.full(50, 30.0), Start("unknown"))).y
    np.testing.assert_allclose(y, y[0], rtol=1e-12)


def chained(*parts: tuple[str, dict[str, float]], start: Setup = BASE) -> Setup:
    """A setup with effects one after the other."""
    for name, values in parts:
        start = effect(name).add_to(start, values)
    return start


def periodic() -> Recording:
    return sine(start=Start("periodic"), period=0.01)


def tanks() -> Setup:
    return Setup(load_network(config_folder() / "network" / "tanks.yaml"))


def pumped() -> Recording:
    t = np.arange(200) * 0.5
    return recording(t, 1e-4 * (1.0 + 0.5 * np.sin(0.2 * t)), Start("rest", 1e-4))


def jump() -> Recording:
    t = np.arange(200) * 1e-4
    return recording(t, np.where(np.arange(200) < 50, 0.0, 120.0))


LAG, PLAY = ("sensor_lag", {"tau_y": 3e-4}), ("output_backlash", {"delta_b": 4e-6})
OFFSET, LOWPASS = ("amplifier_offset", {"V_0": 2.0}), ("amplifier_lowpass", {"tau_a": 5e-4})
BENT, DELAY = ("sensor_nonlinearity", {"a_2": 300.0, "a_3": -2e6}), ("delay", {"tau_d": 2.34e-4})
DRIFT = ("sensor_drift", {"drift_rate": 1e-4})
BASE_MOTION = ("base_motion", {"A_c": 0.2, "A_s": -0.1, "f_b": 170.0})

CASES = {
    "actuator": (BASE, sine()),
    "from a bias": (BASE, sine(offset=20.0, start=Start("rest", 20.0))),
    "periodic": (BASE, periodic()),
    "jump": (BASE, jump()),
    "bouc_wen": (bouc_wen(), sine()),
    "chain": (chained(LOWPASS, ("amplifier_saturation", {"V_max": 80.0}), DRIFT), sine()),
    "delay of a jump": (chained(DELAY), jump()),
    "offset, then low-pass, from a bias": (chained(OFFSET, LOWPASS), sine(offset=20.0, start=Start("rest", 20.0))),
    "lag, periodic": (chained(LAG), periodic()),
    "play, periodic": (chained(PLAY), periodic()),
    "lag, then play": (chained(LAG, PLAY), sine()),
    "drift, then bent sensor, then lag": (chained(DRIFT, BENT, LAG), sine()),
    # What an amplifier changes does not reach these networks as a force on a junction alone.
    "low-pass, then a memory of the voltage": (
        chained(("depolarisation", {"delta_z": 0.2, "tau_z": 5e-3, "V_c": 30.0}), OFFSET, LOWPASS),
        sine(),
    ),
    "delay of a pump": (
        chained(("amplifier_offset", {"V_0": 1e-5}), ("delay", {"tau_d": 2.43}), LAG, start=tanks()),
        pumped(),
    ),
    "base motion, periodic, lag": (chained(BASE_MOTION, LAG), periodic()),
}


@pytest.mark.parametrize("case", CASES)
def test_derivatives_by_every_parameter_agree_with_finite_differences(case: str) -> None:
    setup, run = CASES[case]
    names = list(setup.free)
    got = output_derivatives(simulate(setup, run), names)
    size = np.abs(simulate(setup, run).y).max()
    for k, name in enumerate(names):
        wanted = differences(setup, run, name)
        rounding = 1e-14 * size / (1e-6 * abs(setup.parameters[name].value))
        # The march has kinks, which a finite difference may straddle: a few samples may differ.
        wrong = np.abs(got[:, k] - wanted) > 1e-4 * np.abs(wanted).max() + rounding
        assert wrong.mean() < 0.05, name
        assert np.abs(wanted).max() > 0.0, name


def test_derivatives_by_initial_states_and_forces() -> None:
    run = simulate(BASE, sine())
    n = run.h.size
    bump = np.zeros((n, 1))
    bump[40:60] = 1.0
    got = output_derivatives(run, ["k"], initial=[0, 2, 3], forces=bump)
    assert got.shape == (201, 5)
    for column, (place, step) in enumerate([(0, 1e-11), (2, 1e-11), (3, 1e-11)]):
        ends = [simulate(BASE, sine(), initial=s * step * np.eye(4)[place]).y for s in (1.0, -1.0)]
        wanted = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(got[:, 1 + column], wanted, atol=2e-4 * np.abs(wanted).max())
    # Through a sensor too.
    slow = chained(LAG, PLAY)
    through = output_derivatives(simulate(slow, sine()), ["tau_y"], initial=[2])
    ends = [simulate(slow, sine(), initial=s * 1e-11 * np.eye(4)[2]).y for s in (1.0, -1.0)]
    np.testing.assert_allclose(through[:, 1], (ends[0] - ends[1]) / 2e-11, atol=2e-4 * np.abs(through[:, 1]).max())
    # A force on the junction is a voltage over the transducer ratio.
    assert (got[:40, 4] == 0.0).all()
    np.testing.assert_allclose(input_force(run, np.ones(n)), 0.046311)
    whole = output_derivatives(run, [], forces=input_force(run, run.u[:, 0])[:, None])[:, 0]
    step = 1e-6
    ends = []
    for s in (step, -step):
        scaled = sine()
        ends.append(simulate(BASE, recording(scaled.t, (1.0 + s) * scaled.u)).y)
    wanted = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(whole, wanted, atol=1e-4 * np.abs(wanted).max())


def test_a_step_without_a_solution_names_recording_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "march", lambda *_: 30)
    with pytest.raises(SolverFailed, match=r"made: no solution of the step at t = 0\.0015 s; .* more sub-steps"):
        simulate(BASE, sine(), substeps=2)


def chain() -> Setup:
    tau = positive("tau_a", 1e-3, "s")
    return (
        Setup(from_paper())
        .with_block("amplifier", Block("lowpass", ("tau_a",)), (tau,))
        .with_block("sensor", Block("drift", ("rate",)), (Parameter("rate", 1e-7, fixed=True),))
    )


def test_values_reach_network_and_blocks() -> None:
    setup = chain()
    assert [b.kind for b in (*setup.amplifier, *setup.sensor)] == ["lowpass", "drift"]
    moved = setup.with_values({"tau_a": 2e-3, "k": 2e4})
    assert moved.values()["tau_a"] == 2e-3
    assert moved.network.parameters["k"].value == 2e4
    assert setup.values()["k"] == 24579.0
    assert "rate" not in setup.free
    assert {"tau_a", "k"} <= set(setup.free)
    assert list(setup.parameters)[:4] == ["m", "k", "b", "alpha"]
    assert moved.with_values(setup.values()) == setup


def test_names_that_are_not_there_or_twice_are_refused() -> None:
    with pytest.raises(StructureViolated, match="no parameter called tau in model"):
        chain().with_values({"tau": 1.0})
    with pytest.raises(InputRefused, match="two parameters are called m"):
        Setup(from_paper()).with_block("amplifier", Block("lowpass", ("m",)), (positive("m", 1.0, "s"),)).values()


def test_a_source_has_a_port_of_its_own() -> None:
    force = (Parameter("F_c", 1.0, "N"), Parameter("F_s", 0.0, "N"), positive("f", 50.0, "Hz"))
    names = tuple(p.name for p in force)
    setup = Setup(from_paper()).with_source(Source("tone", "force", names), force)
    assert set(names) <= set(setup.free)
    assert setup.with_values({"f": 60.0}).values()["f"] == 60.0
    for port in ("voltage", "base"):
        with pytest.raises(StructureViolated, match=f"'{port}': name one beside the recorded input, force"):
            Setup(from_paper()).with_source(Source("tone", port, names), force)
    one = from_paper()
    alone = Setup(one.__class__(one.storages, one.resistors, one.couplings, (Port("voltage", {"p": "alpha"}),),
                                one.parameters))  # fmt: skip
    with pytest.raises(StructureViolated, match="of which there is none"):
        alone.with_source(Source("tone", "force", names), force)
