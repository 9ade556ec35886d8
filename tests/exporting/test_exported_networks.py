"""Every network of the tests, each with its own laws and number of junctions: the steps of the compiled kernel."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from solve_paths import case_of, networks

from phnn.exporting.build import build
from phnn.exporting.languages import python
from phnn.integrate import kernel
from phnn.integrate.compilable import can_compile
from phnn.integrate.program import compile_network
from phnn.network.elements import Network
from phnn.setup import Setup

# Largest difference of a state, as a share of its largest value.
PROMISED = 1e-9


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
