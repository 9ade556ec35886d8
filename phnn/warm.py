"""Compile every kernel once, before many processes need them at the same time: ``python -m phnn.warm``.

Each of them would compile for a minute otherwise, all the same functions; afterwards they load what is cached.
"""

from __future__ import annotations

import numpy as np

from phnn.integrate import kernel, sweep
from phnn.integrate.program import Program, compile_network
from phnn.models.actuator import hrc
from phnn.models.variants import hrlc
from phnn.network.elements import Network

_STEPS, _STEP = 4, 1e-5


def warm_up() -> None:
    """Integrate and differentiate a network of the single-junction kernel, and one of the general kernel."""
    for network in (hrc(1), hrlc(1).network()):
        _exercise(compile_network(network), network)


def _exercise(program: Program, network: Network) -> None:
    theta = program.theta(network)
    size = len(program.states)
    states, efforts = np.empty((_STEPS + 1, size)), np.empty((_STEPS, size))
    u, h = np.ones((_STEPS, len(network.ports))), np.full(_STEPS, _STEP)
    kernel.march(program, theta, np.zeros(size), u, h, states, efforts)
    march = sweep.Marched(program, theta, states, efforts, u, h)
    active, none = np.array([0]), np.zeros(0, dtype=np.int64)
    by = sweep.by_parameters(active, _STEPS)
    sweep.sensitivities(march, by, np.zeros((size, 1)), none, np.arange(_STEPS + 1))
    sweep.adjoint(march, active, np.zeros_like(states))


if __name__ == "__main__":
    warm_up()
