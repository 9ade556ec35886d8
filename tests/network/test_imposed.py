"""Imposed motion: a source of flow whose effort is measured."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from junctions import differences
from junctions import recording as made
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phnn.derivatives import output_derivatives
from phnn.errors import InputRefused, StructureViolated
from phnn.integrate.equations import check, power_balance
from phnn.models.network_file import ready
from phnn.network.bondgraph import Bond, BondGraph, C, I, R, Sf
from phnn.network.elements import Network
from phnn.network.roles import imposed, measured_displacement, motions
from phnn.parameters import as_table, positive
from phnn.recordings.recording import Recording, Start, Units
from phnn.setup import Setup
from phnn.trajectory import is_displacement, simulate

Array = NDArray[np.float64]

K, B, F_C, V_S, K_1, RHO, D = 2.0e4, 900.0, 150.0, 2e-2, 8.0e4, 1.0, 60.0
DT, W = 5e-4, 2 * np.pi * 7.0


def rig(mass: float = 0.0) -> Network:
    """A spring, a damper, dry friction and a hysteron between an imposed motion and a load cell."""
    known = [
        positive("k", K, "N/m"), positive("b", B, "N s/m"), positive("F_c", F_C, "N"), positive("v_s", V_S, "m/s"),
        positive("c_1", 1.0 / K_1, "m/N"), positive("rho_1", RHO, "m/(N s)"), positive("d_1", D, "N"),
    ]  # fmt: skip
    graph = BondGraph(
        {"rig": 1, "slip": 0},
        (
            C("q", "rig", "spring", ("k",), "m"),
            R("damper", "rig", "linear", ("b",), "resistance"),
            R("dry", "rig", "coulomb", ("F_c", "v_s"), "resistance"),
            C("z", "slip", "capacitor", ("c_1",), "m"),
            R("stick", "slip", "dead_zone", ("rho_1", "d_1"), "conductance"),
            *((I("p", "rig", "capacitor", ("m",), "kg m/s"),) if mass else ()),
            Sf("motion", "rig", "m/s"),
        ),
        (Bond("rig", "slip"),),
        as_table([*known, *([positive("m", mass, "kg")] if mass else [])]),
        "motion",
    )
    return graph.network()


def recording(u: Array, unit: str = "m", interpolation: str = "cubic") -> Recording:
    """A recording of an imposed motion."""
    start = Start("rest", float(u[0]) if unit == "m" else 0.0)
    return made(DT * np.arange(u.size), u, start, interpolation=interpolation, noise=1.0, units=Units(unit, "N"))


def displacement(t: NDArray[Any]) -> Array:
    """Two sines [m]; it begins where it is 1 mm, with a velocity."""
    return np.asarray(1e-3 + 2e-3 * np.sin(W * t) + 4e-4 * np.sin(3.3 * W * t))


def velocity(t: NDArray[Any] | float) -> Array:
    """Its rate [m/s]."""
    return np.asarray(W * (2e-3 * np.cos(W * t) + 3.3 * 4e-4 * np.cos(3.3 * W * t)))


def motion(size: int = 600) -> Array:
    """The displacement at samples `DT` apart."""
    return displacement(DT * np.arange(size))


def relative(error: NDArray[Any], to: NDArray[Any]) -> float:
    """Root mean square away from the ends, of which a spline knows least, over that of a signal."""
    return float(np.linalg.norm(error[5:-5]) / np.linalg.norm(to[5:-5]))


def test_the_force_is_the_sum_of_the_efforts() -> None:
    u = motion()
    found = simulate(Setup(rig()), recording(u), substeps=4)

    def slip(t: float, z: Array) -> Array:
        e = K_1 * z
        return np.asarray(velocity(t) - RHO * np.sign(e) * np.maximum(np.abs(e) - 0.5 * D, 0.0))

    t = DT * np.arange(u.size)
    exact = solve_ivp(slip, (0.0, t[-1]), [0.0], "Radau", t, rtol=1e-9, atol=1e-12, max_step=DT)
    speed = velocity(t)
    force = K * u + B * speed + F_C * np.tanh(speed / V_S) + K_1 * exact.y[0]
    assert relative(found.y - force, force) < 1e-3
    assert relative(found.mid_displacement[::4] - u[:-1], u) < 0.02
    assert relative(found.velocity[::4] - speed[:-1], speed) < 0.02


@pytest.mark.parametrize("mass", [0.0, 0.4])
def test_what_is_supplied_is_stored_or_dissipated(mass: float) -> None:
    found = simulate(Setup(rig(mass=mass)), recording(motion()), substeps=3)
    balance = power_balance(found)
    size = float(balance.supplied.abs().max())
    assert float(balance.dissipated.min()) >= -1e-14 * size
    assert float(balance.defect.abs().max()) <= 1e-10 * size
    check(found)
    # All energy comes in as force times displacement.
    impulse = np.diff(found.states[:, found.program.output])
    assert np.allclose(balance.supplied.sum(-1).numpy(), impulse * found.u[:, 0], rtol=0, atol=1e-10 * size)


@pytest.mark.parametrize("hold", ["zero_order", "cubic"])
def test_a_jump_of_an_imposed_current_belongs_to_its_side_of_the_sample(hold: str) -> None:
    # A resistance and a slow pair: the voltage jumps with the current, at the sample that has the new one already.
    cell = ready("battery", {"C_b": 0.9, "R_0": 0.3, "C_1": 0.02, "R_1": 0.5})
    u = np.repeat([0.0, 4.0, 0.0, -2.0, 3.0], 60)
    found = simulate(Setup(cell), replace(recording(u, "A", hold), units=Units("A", "V")), substeps=4)
    charge, pair, decay = np.zeros(u.size), np.zeros(u.size), np.exp(-DT / (0.5 * 0.02))
    for k in range(1, u.size):
        charge[k] = charge[k - 1] + DT * u[k - 1]
        pair[k] = decay * pair[k - 1] + (1.0 - decay) * 0.5 * u[k - 1]
    # A jump that is seen between two samples lies half a sample earlier than one at the sample.
    wanted = charge / 0.9 + pair + 0.3 * u
    np.testing.assert_allclose(found.y[:-1], wanted[:-1], atol=1e-4 if hold == "zero_order" else 0.1)
    check(found)


def test_a_mass_adds_its_inertia() -> None:
    u, t = motion(), DT * np.arange(600)
    without, having = (simulate(Setup(rig(mass=m)), recording(u), 8).y for m in (0.0, 0.4))
    acceleration = -(W**2) * (2e-3 * np.sin(W * t) + 3.3**2 * 4e-4 * np.sin(3.3 * W * t))
    assert relative(having - without - 0.4 * acceleration, 0.4 * acceleration) < 0.02


@pytest.mark.parametrize("name", ["k", "b", "F_c", "v_s", "c_1", "d_1"])
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    setup, given = Setup(rig()), recording(motion(200))
    found = output_derivatives(simulate(setup, given, 2), (name,))[:, 0]
    assert np.allclose(found, differences(setup, given, name, 2), rtol=0, atol=1e-5 * np.abs(found).max())


def test_a_velocity_is_taken_as_it_is() -> None:
    u, setup = motion(), Setup(rig())
    given = recording(velocity(DT * np.arange(u.size)), "m/s")
    assert is_displacement(setup, recording(u)) and not is_displacement(setup, given)
    from_velocity, from_displacement = simulate(setup, given, 4).y, simulate(setup, recording(u), 4).y
    # The spring's place is known of a displacement alone.
    assert relative(from_velocity + K * u[0] - from_displacement, from_displacement) < 1e-3


def test_a_steady_cycle_and_its_derivatives() -> None:
    size = 400
    u = 1e-3 + 2e-3 * np.sin(2 * np.pi / size * np.arange(2 * size))
    given = replace(recording(u), start=Start("periodic"), period=size * DT)
    setup = Setup(rig())
    found = simulate(setup, given, 2)
    assert np.abs(found.y[:size] - found.y[size:]).max() < 1e-4 * np.abs(found.y).max()
    for name in ("k", "c_1", "d_1"):
        slope = output_derivatives(found, (name,))[:, 0]
        assert np.allclose(slope, differences(setup, given, name, 2), rtol=0, atol=1e-5 * np.abs(slope).max())


def test_roles_of_what_is_imposed() -> None:
    network = rig()
    given = imposed(network)
    assert given is not None and network.senses == "motion"
    assert measured_displacement(network) == given.motion.displacement == "q"
    assert [m.displacement for m in motions(network)] == ["q"]
    bare = BondGraph(
        {"rig": 1},
        (R("damper", "rig", "linear", ("b",), "resistance"), Sf("motion", "rig", "m/s")),
        parameters=as_table([positive("b", B, "N s/m")]),
        output="motion",
    ).network()
    assert measured_displacement(bare) == "motion_travel"
    found = simulate(Setup(bare), recording(motion()), 4)
    assert relative(found.y - B * velocity(DT * np.arange(600)), found.y) < 1e-3


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputRefused, match="zero_order: a displacement that is held"):
        simulate(Setup(rig()), recording(motion(), interpolation="zero_order"))
    tank = BondGraph(
        {"tank": 0},
        (C("volume", "tank", "capacitor", ("A",), "m3"), Sf("pump", "tank", "m3/s")),
        parameters=as_table([positive("A", 1e-5, "m3/Pa")]),
        output="pump",
    )
    with pytest.raises(StructureViolated, match="0-junction tank: put it at a"):
        tank.network()
    with pytest.raises(StructureViolated, match="no such port"):
        replace(rig(), senses="table")
