"""Steady states and cycles: nothing changes in them, they are reached, and what has none is refused by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import effect_homes
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import differences, march, recording
from subjects import laws, learned, learned_together

from phnn.configuration import config_folder
from phnn.derivatives import input_force, output_derivatives
from phnn.effects import Effect, effect
from phnn.effects.effect import in_all_forms
from phnn.errors import SolverFailed
from phnn.integrate.rest import equilibrium, equilibrium_derivative, equilibrium_slope
from phnn.models.actuator import from_paper, hrc
from phnn.models.network_file import load_network
from phnn.network import ModulatorState, MultiPort, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.parameters import Parameter, as_table, positive
from phnn.recordings.recording import Recording, Start
from phnn.setup import Setup
from phnn.trajectory import simulate

VOLTAGES = (3.0, 40.0)


def named(name: str) -> Network:
    return load_network(config_folder() / "network" / f"{name}.yaml")


# A constant force moves the one, and a constant velocity the other, for ever.
RESTLESS = ("mass_damper", "friction_rig")
NETWORKS = {p.stem: p.stem for p in (config_folder() / "network").glob("*.yaml") if p.stem not in RESTLESS}


def inputs(network: Network, first: float) -> np.ndarray:
    return np.array([first, *[0.0] * (len(network.ports) - 1)])


@pytest.mark.parametrize("first", VOLTAGES)
@pytest.mark.parametrize("name", sorted(NETWORKS))
def test_nothing_moves_in_a_steady_state(name: str, first: float) -> None:
    network = named(name)
    u = inputs(network, first)
    x = equilibrium(network, u)
    assert np.isfinite(x).all()
    assert x.any()
    # An independent witness: the compiled march stays where it is.
    steps = 50
    states = march(network, np.tile(u, (steps, 1)), np.full(steps, 1e-5), x).states
    np.testing.assert_allclose(states, np.tile(x, (steps + 1, 1)), rtol=1e-9, atol=1e-12 * np.abs(x).max())


@pytest.mark.parametrize("first", VOLTAGES)
def test_networks_with_the_same_map_rest_at_the_same_place(first: float) -> None:
    places = []
    for name in ("hrc", "series_rl", "series_rc", "parallel_rl"):
        network = named(name)
        x = equilibrium(network, inputs(network, first))
        places.append(x[network.state_names.index("q")])
    np.testing.assert_allclose(places, places[0], rtol=1e-12)
    # What flowed into a node stays there: its charges are those that the mass has moved.
    network = named("series_rc")
    x = dict(zip(network.state_names, equilibrium(network, inputs(network, first)), strict=True))
    alpha = network.parameters["alpha"].value
    for i in (1, 2):
        assert x[f"Q_C{i}"] + x[f"Q_{i}"] == pytest.approx(alpha * x["q"], rel=1e-12)


def test_currents_may_flow_in_a_steady_state() -> None:
    network, v = named("hrcl"), 40.0
    p = {n: q.value for n, q in network.parameters.items()}
    x = dict(zip(network.state_names, equilibrium(network, inputs(network, v)), strict=True))
    # All voltage is across the hysteron, which carries it into the inductor; the displacement forgets it.
    assert x["Q_1"] == pytest.approx(p["C_1"] * v, rel=1e-12)
    assert x["phi"] == pytest.approx(p["L"] * p["rho_1"] * (v - 0.5 * p["d_1"]), rel=1e-12)
    assert abs(x["q"]) < 1e-15 * v
    place = [network.state_names.index(name) for name in ("Q_1", "phi")]
    by, excess = equilibrium_derivative(network, inputs(network, v), ["C_1", "L", "rho_1", "d_1"]), v - 0.5 * p["d_1"]
    expected = [v, p["rho_1"] * excess, p["L"] * excess, -0.5 * p["L"] * p["rho_1"]]
    np.testing.assert_allclose([by[place[0], 0], *by[place[1], 1:]], expected, rtol=1e-10)
    slope = equilibrium_slope(network, inputs(network, v), 0)[place]
    np.testing.assert_allclose(slope, [p["C_1"], p["L"] * p["rho_1"]], rtol=1e-10)
    below = dict(zip(network.state_names, equilibrium(network, inputs(network, 3.0)), strict=True))
    assert abs(below["phi"]) < 1e-15


def test_tanks_fill_to_their_steady_state() -> None:
    network, pumped = named("tanks"), 2e-6
    p = {n: q.value for n, q in network.parameters.items()}
    second = pumped / p["g_out"]
    exact = np.array([p["A_1"] * (second + pumped / p["g"]), p["A_2"] * second])
    x = equilibrium(network, np.array([pumped]))
    np.testing.assert_allclose(x, exact, rtol=1e-12)
    filled = march(network, np.full((4000, 1), pumped), np.full(4000, 1.0), np.zeros(2)).states[-1]
    np.testing.assert_allclose(filled, x, rtol=1e-9)
    slope = equilibrium_derivative(network, np.array([pumped]), ["g_out", "g", "A_2"])
    outlet, pipe = -pumped / p["g_out"] ** 2, -pumped / p["g"] ** 2
    expected = [[p["A_1"] * outlet, p["A_1"] * pipe, 0.0], [p["A_2"] * outlet, 0.0, second]]
    np.testing.assert_allclose(slope, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max(axis=0).min())
    np.testing.assert_allclose(equilibrium_slope(network, np.array([pumped]), 0), exact / pumped, rtol=1e-12)


def subjects() -> Iterator[tuple[str, Callable[[], tuple[Network, float]]]]:
    """Every network that is shipped, law and effect, learned laws of every kind among them, each with an input."""
    yield from ((name, lambda name=name: (named(name), 40.0)) for name in sorted(NETWORKS))
    every = (*laws(), *learned(), *learned_together())
    yield from ((name, lambda make=make: (make().system.network, 0.3)) for name, make in every)
    effects = in_all_forms(effect_homes.EFFECTS)
    yield from ((f"{e.name} {e.canonical}", lambda e=e: with_effect(e)) for e in effects)


def with_effect(e: Effect) -> tuple[Network, float]:
    where = effect_homes.home(e)
    return e.add_to(where.setup, e.grid(where.scales)[0]).network, 0.4 * float(np.abs(where.drive.u).max())


@pytest.mark.parametrize("make", [pytest.param(make, id=name) for name, make in subjects()])
def test_derivatives_are_those_of_differences(make: Callable[[], tuple[Network, float]]) -> None:
    network, first = make()
    try:
        x = equilibrium(network, inputs(network, first))
    except SolverFailed as error:
        assert "for ever" in str(error) or "would not stand still" in str(error)
        return
    names = [n for n, p in network.parameters.items() if p.value]
    typical = np.abs(x) + 1e-9 * np.abs(x).max()

    def rest(share: float, name: str) -> np.ndarray:
        changed = {name: network.parameters[name].value * (1.0 + share)} if name else {}
        return equilibrium(network.with_values(changed), inputs(network, first * (1.0 + share * (not name))))

    u, values = inputs(network, first), [network.parameters[n].value for n in names]
    by_parameter, by_input = equilibrium_derivative(network, u, names) * values, equilibrium_slope(network, u, 0)
    found = np.column_stack([by_parameter, by_input * first])
    for change, name in zip(found.T, [*names, ""], strict=True):
        wanted = (rest(1e-5, name) - rest(-1e-5, name)) / 2e-5
        assert (np.abs(change - wanted) <= 1e-5 * typical + 1e-6 * np.abs(wanted)).all(), name


class Pipe(torch.nn.Module):
    def forward(self, effort: torch.Tensor) -> torch.Tensor:
        return 0.5 * (effort[..., :1] - effort[..., 1:]) * torch.tensor([1.0, -1.0], dtype=effort.dtype)


def test_what_a_law_on_several_efforts_conserves_stays() -> None:
    tanks = tuple(Storage(f"V_{k}", "capacitor", (f"A_{k}",)) for k in (1, 2))
    pipe, pump = MultiPort("pipe", Pipe(), ("V_1", "V_2")), Port("pump", {"V_1": -1.0, "V_2": 1.0})
    table = as_table(positive(f"A_{k}", value, "m5/J") for k, value in ((1, 1.0), (2, 3.0)))
    network = Network(tanks, (), (), (pump,), table, "V_1", multi_ports=(pipe,))
    np.testing.assert_allclose(equilibrium(network, np.ones(1)), [-1.5, 1.5], rtol=1e-12)


def test_the_beam_bends_as_its_stiffness_says() -> None:
    network, v = named("driven_beam"), 40.0
    x = torch.from_numpy(equilibrium(network, inputs(network, v)))
    system = PortHamiltonianSystem(network)
    efforts = dict(zip(network.state_names, system.efforts(x).tolist(), strict=True))
    # The joint carries what the actuator's own spring does not hold of the voltage's force.
    alpha = network.parameters["alpha"].value
    assert efforts["q"] + efforts["joint"] == pytest.approx(alpha * v, rel=1e-12)
    assert all(abs(efforts[n]) < 1e-12 * v for n in efforts if n.startswith(("Q_", "beam_p")))


def test_what_moves_for_ever_is_refused_by_name() -> None:
    network = named("mass_damper")
    with pytest.raises(SolverFailed, match=r"moves q for ever, nothing holds it.* declare start: unknown"):
        equilibrium(network, np.array([30.0]))
    assert not equilibrium(network, np.zeros(1)).any()
    # A warm body does not hide a slow motion.
    parts = {"C_T": 0.01, "R_T": 10.0, "T_a": 296.0, "T_ref": 293.0}
    table = {**network.parameters, **{n: Parameter(n, v) for n, v in parts.items()}}
    warm = replace(network, memories=(ModulatorState("warmth", "thermal", tuple(parts)),), parameters=table)
    with pytest.raises(SolverFailed, match="moves q for ever"):
        equilibrium(warm, np.array([1e-6]))


@pytest.mark.parametrize("force", [0.5, 30.0])
@pytest.mark.parametrize("exponent", [0.0, 0.5])
def test_friction_that_grows_with_the_distance_holds_nothing(exponent: float, force: float) -> None:
    # A speed that is small beside the place is none the less a speed; it was taken for rest at 1e7 to 1e55 m.
    bare = named("mass_damper")
    values = {"drag": 0.01, "square": 2.0, "v_d": 0.003, "F_h": 1e-3, "n_h": exponent, "v_h": 0.5, "c_h": -20.0}
    resistors = (
        Resistor("drag", "power_damper", {"p": 1.0}, ("drag", "drag", "square", "v_d")),
        Resistor("guide", "ramp_damper", {"p": 1.0}, ("F_h", "n_h", "v_h", "c_h"), "q"),
    )
    parameters = {**bare.parameters, **{n: Parameter(n, v) for n, v in values.items()}}
    network = replace(bare, resistors=resistors, parameters=parameters)
    with pytest.raises(SolverFailed, match=r"moves q.* for ever, nothing holds"):
        equilibrium(network, np.array([force]))
    assert not equilibrium(network, np.zeros(1)).any()


BASE = Setup(from_paper())
PERIOD = 100


def wave(cycles: int = 3, amplitude: float = 90.0, start: str = "periodic") -> Recording:
    """Two tones and a bias that repeat every 10 ms."""
    t = np.arange(PERIOD * cycles + 1) * 1e-4
    phase = 2.0 * np.pi * 100.0 * t
    u = amplitude * (np.sin(phase) + 0.4 * np.cos(3.0 * phase) + 0.2)
    return recording(t, u, Start(start), period=0.01)


def slow() -> Setup:
    """A memory of the voltage that takes 200 periods, and a creep of 30."""
    start = effect("depolarisation").add_to(BASE, {"delta_z": 0.2, "tau_z": 2.0, "V_c": 30.0})
    return effect("creep").add_to(start, {"k_s": 2500.0, "tau_s": 0.3})


def assert_repeats(y: np.ndarray) -> None:
    """The first period is the second, but that a spline ends a little differently in the last one."""
    np.testing.assert_allclose(y[:PERIOD], y[PERIOD : 2 * PERIOD], atol=1e-10 * np.ptp(y))


@pytest.mark.parametrize(("setup", "cycles"), [(BASE, 60), (slow(), 3000)], ids=["actuator", "slow memories"])
def test_a_long_march_ends_there(setup: Setup, cycles: int) -> None:
    found = simulate(setup, wave()).y
    marched = simulate(setup, wave(cycles, start="unknown")).y[-2 * PERIOD - 1 : -PERIOD - 1]
    np.testing.assert_allclose(found[:PERIOD], marched, atol=2e-6 * np.ptp(marched))
    assert_repeats(found)


def test_a_sharp_resonance_is_at_its_steady_amplitude() -> None:
    # Its motion takes some 10,000 periods to build up.
    linear = hrc(0)
    m = linear.parameters["m"].value
    setup = Setup(linear.with_values({"k": m * (2.0 * np.pi * 101.0) ** 2, "b": 2e-4 * m * 2.0 * np.pi * 101.0}))
    values = setup.values()
    t = np.arange(2 * PERIOD + 1) * 1e-4
    run = simulate(setup, recording(t, np.cos(2.0 * np.pi * 100.0 * t), Start("periodic"), period=0.01), substeps=16)
    s = 2.0j * np.pi * 100.0
    answer = values["alpha"] / (values["m"] * s**2 + values["b"] * s + values["k"])
    # The step errs in the frequency by less than a thousandth of its distance from the resonance.
    np.testing.assert_allclose(run.y, np.real(answer * np.exp(s * t)), atol=3e-3 * abs(answer))


def test_a_charge_that_nothing_moves_has_no_say() -> None:
    # Within both dead zones a charge follows the motion from wherever it began.
    run = simulate(BASE, wave(amplitude=0.5))
    assert_repeats(run.y)
    changes = output_derivatives(run, list(BASE.free))
    assert np.isfinite(changes).all()


def test_what_drifts_has_no_steady_cycle() -> None:
    drive = Setup(load_network(config_folder() / "network" / "mass_damper.yaml"))
    simulate(drive, recording(*_biased(0.0), Start("periodic"), period=1.0))
    with pytest.raises(SolverFailed, match=r"made: no steady cycle: q still changes by .* of its range in a period"):
        simulate(drive, recording(*_biased(30.0), Start("periodic"), period=1.0))


def _biased(force: float) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(201) * 1e-2
    return t, force + 100.0 * np.sin(2.0 * np.pi * t)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_every_actuator_has_one(seed: int) -> None:
    # Also where a hysteron only just slides.
    rng = np.random.default_rng(seed)
    values = {n: p.value * np.exp(rng.normal(0.0, 0.7)) for n, p in BASE.parameters.items() if not p.fixed}
    y = simulate(BASE.with_values(values), wave()).y
    np.testing.assert_allclose(y[:PERIOD], y[PERIOD : 2 * PERIOD], atol=3e-5 * np.ptp(y))


@pytest.mark.parametrize("size", [100.3, 37.4])
def test_a_period_need_not_be_a_whole_number_of_samples(size: float) -> None:
    linear = hrc(0)
    m, w = linear.parameters["m"].value, 2.0 * np.pi * 100.0
    setup = Setup(linear.with_values({"k": m * (1.05 * w) ** 2, "b": 0.002 * m * w}))
    values, dt = setup.values(), 0.01 / size
    t = np.arange(int(12 * size)) * dt
    made = recording(t, np.cos(w * t), Start("periodic"), period=0.01)
    assert made.cycle == (1003 if size > 50.0 else 187)
    s = 1.0j * w
    answer = values["alpha"] / (values["m"] * s**2 + values["b"] * s + values["k"])
    run = simulate(setup, made, substeps=8)
    np.testing.assert_allclose(run.y, np.real(answer * np.exp(s * t)), atol=0.01 * abs(answer))
    # Where no number of periods comes near a whole one of samples, the recording says nothing of its start.
    short = recording(t[: int(2.5 * size)], np.cos(w * t)[: int(2.5 * size)], Start("periodic"), period=0.01)
    assert short.cycle == 0


@pytest.mark.parametrize(("name", "values"), [
    ("sensor_lag", {"tau_y": 0.01}), ("amplifier_lowpass", {"tau_a": 0.01}),
    ("slew_limit", {"S": 3e4}), ("output_backlash", {"delta_b": 4e-6}),
])  # fmt: skip
def test_slow_blocks_of_the_chain_have_settled(name: str, values: dict[str, float]) -> None:
    setup = effect(name).add_to(BASE, values)
    y = simulate(setup, wave()).y
    np.testing.assert_allclose(y[:PERIOD], y[PERIOD : 2 * PERIOD], atol=1e-2 * np.ptp(y))


def test_one_period_is_enough() -> None:
    whole, one = wave(), wave(cycles=1)
    single = recording(one.t[:-1], one.u[:-1], Start("periodic"), period=0.01)
    assert single.cycle == single.t.size == PERIOD
    y, wanted = simulate(BASE, single).y, simulate(BASE, whole).y
    # A spline knows less of its ends.
    np.testing.assert_allclose(y, wanted[PERIOD : 2 * PERIOD], atol=2e-3 * np.ptp(wanted))
    got = output_derivatives(simulate(BASE, single), ["k", "alpha", "d_1"])
    both = output_derivatives(simulate(BASE, whole), ["k", "alpha", "d_1"])[PERIOD : 2 * PERIOD]
    np.testing.assert_allclose(got, both, atol=2e-2 * np.abs(both).max())


@pytest.mark.parametrize("setup", [BASE, slow()], ids=["actuator", "slow memories"])
def test_derivatives_by_parameters_follow_the_cycle(setup: Setup) -> None:
    names = list(setup.free)
    got = output_derivatives(simulate(setup, wave()), names)
    for k, name in enumerate(names):
        wanted = differences(setup, wave(), name)
        wrong = np.abs(got[:, k] - wanted) > 1e-4 * np.abs(wanted).max()
        assert wrong.mean() < 0.05, name


def test_perturbations_along_signals_follow_it_too() -> None:
    run = simulate(BASE, wave())
    ones = np.ones(run.h.size)
    got = output_derivatives(run, ["k", "C_1"], varied=[("k", ones), ("C_1", ones)])
    np.testing.assert_allclose(got[:, 2:], got[:, :2], rtol=1e-9, atol=1e-12 * np.abs(got).max())
    whole = output_derivatives(run, [], forces=input_force(run, run.u[:, 0])[:, None])[:, 0]
    step = 1e-6
    ends = [simulate(BASE, wave(amplitude=90.0 * (1.0 + s))).y for s in (step, -step)]
    wanted = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(whole, wanted, atol=1e-4 * np.abs(wanted).max())
    # Initial states stand between the parameters and what is perturbed along signals.
    force = input_force(run, run.u[:, 0])[:, None]
    with_state = output_derivatives(run, ["k"], initial=[0], forces=force)
    np.testing.assert_allclose(with_state[:, [0, 2]], np.column_stack([got[:, 0], whole]), rtol=1e-9, atol=1e-16)
