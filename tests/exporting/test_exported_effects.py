"""Every effect of the catalogue: the exported program takes the steps of `phnn.trajectory`, or is refused by name."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from effect_homes import ACTUATOR, EFFECTS, FORMULAS, LEARNED, home, point
from exported import apart, exported, in_c, in_python, needs_compiler, reference
from solve_paths import case_of, networks

from phnn.effects import Effect, in_all_forms
from phnn.effects.soundness import Home
from phnn.errors import InputRefused
from phnn.exporting.build import build
from phnn.exporting.program import Program
from phnn.exporting.write import python
from phnn.integrate import kernel
from phnn.integrate.compilable import can_compile
from phnn.integrate.program import compile_network
from phnn.network.elements import Network
from phnn.setup import Setup

# Largest difference of a state, as a share of its largest value.


@cache
def exportable() -> dict[str, Network]:
    made = {name: make() for name, make in networks().items()}
    return {name: n for name, n in made.items() if can_compile(n) and n.ports and not n.senses}


def difference(network: Network) -> float:
    """Largest difference of the states of an exported program from those of the kernel, from a state at random."""
    case = case_of(network)
    h, program = np.full(case.h.size, case.h[0]), compile_network(network)
    wanted, efforts = np.empty((h.size + 1, case.x0.size)), np.empty((h.size, case.x0.size))
    assert kernel.march(program, program.theta(network), case.x0, case.u, h, wanted, efforts) == h.size
    found = build(Setup(network), float(h[0]), 1, further=[p.name for p in network.ports[1:]])
    scope: dict = {}
    exec(python(found), scope)
    state = scope["State"]()
    scope["init"](state, *[0.0] * len(network.ports))
    fields = [found.states[name] for name in network.state_names]
    for field, value in zip(fields, case.x0.tolist(), strict=True):
        setattr(state, field, value)
    path = [case.x0]
    for first, *others in case.u.tolist():
        assert scope["substep"](state, first, first, first, *others) == 1.0
        path.append(np.array([getattr(state, field) for field in fields]))
    scale = np.where(case.scale > 0.0, case.scale, 1.0)
    return float((np.abs(np.array(path) - wanted).max(0) / scale).max())


@pytest.mark.slow
def test_every_network_takes_the_steps_of_the_kernel() -> None:
    wrong = {name: d for name, n in exportable().items() if not (d := difference(n)) < PROMISED}
    assert len(exportable()) > 200
    assert wrong == {}


@pytest.mark.parametrize("name", ["leaf monotone", "nonlinear leaf coulomb", "leaf overflow and a leak"])
def test_storages_without_a_closed_step(name: str) -> None:
    assert difference(networks()[name]()) < PROMISED


# What is promised: the largest difference, as a share of the output's range.
PROMISED = 1e-9
# Sensors whose output needs what comes after it: half-way values by cubics, or a spline through all samples.
REFUSED = {"output_backlash", "sensor_lag", "sensor_clock", "learned_sensor_over_time"}
FORMS = in_all_forms([*EFFECTS, *FORMULAS, *LEARNED])
IDS = [f"{e.name}-{i}" for i, e in enumerate(FORMS)]
SUBSTEPS = 2


def drive(where: Home, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(n,) times and inputs of several frequencies, large enough to be felt by every effect."""
    if where is ACTUATOR:
        t = np.arange(n) * 5e-5
        return t, sum(a * np.sin(2.0 * np.pi * f * t) for a, f in ((30.0, 10.0), (25.0, 37.0), (15.0, 150.0)))
    t = np.arange(n) * 0.25
    swell, ripple = 1.0 - np.cos(2.0 * np.pi * 0.04 * t), np.sin(2.0 * np.pi * 0.013 * t)
    return t, 5e-5 * (swell + 0.2 * ripple)


@cache
def program_of(effect: Effect) -> Program:
    """The program of the effect's base model with it; of a drive it knows the sample time alone."""
    t, _ = drive(home(effect), 2)
    return exported(effect.add_to(home(effect).setup, point(effect)), t, SUBSTEPS)


def test_the_list_of_what_is_refused_is_complete() -> None:
    refused = set()
    for effect in FORMS:
        try:
            program_of(effect)
        except InputRefused as error:
            assert "cannot be exported" in str(error), error
            assert "--no-sensor" in str(error), error
            refused.add(effect.name)
    assert refused == REFUSED


@pytest.mark.parametrize(("target", "samples"), [pytest.param("c", 2001, marks=needs_compiler), ("python", 151)])
@pytest.mark.parametrize("effect", FORMS, ids=IDS)
def test_a_target_takes_the_steps_of_the_simulation(effect: Effect, target: str, samples: int, tmp_path: Path) -> None:
    if effect.name in REFUSED:
        pytest.skip("refused by name, see the list above")
    where, program = home(effect), program_of(effect)
    t, u = drive(where, samples)
    found = in_c(program, u, tmp_path) if target == "c" else in_python(program, u)
    assert apart(found, reference(effect.add_to(where.setup, point(effect)), t, u, SUBSTEPS)) < PROMISED
