"""Compile every kernel once, before many processes need them at the same time: ``python -m phnn.warm``.

Each of them would compile for a minute otherwise, all the same functions; afterwards they load what is cached.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import kernel, sweep
from phnn.integrate.cache import has_kept
from phnn.integrate.program import Program, compile_network
from phnn.models.actuator import hrc
from phnn.models.variants import hrlc
from phnn.network.elements import Network

Array = NDArray[np.float64]

_STEPS, _STEP = 4, 1e-5
_LATER = "later"


def warm_up() -> None:
    """Integrate and differentiate a network of the single-junction kernel, and one of the general kernel."""
    for network in (hrc(1), hrlc(1).network()):
        _differentiate(_march(network))


def compile_later_kernels() -> None:
    """Begin to compile, in a process of its own, the kernel that a diagnosis needs after the one of its base model.

    Where that has been done before, or no process can be started, nothing happens.
    """
    if has_kept("general"):
        return
    try:
        started = subprocess.Popen(
            [sys.executable, "-m", "phnn.warm", _LATER], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    except OSError:
        return
    atexit.register(started.terminate)


class _Marched(NamedTuple):
    """A march: what it was made with, and what it has filled."""

    program: Program
    theta: Array
    states: Array
    efforts: Array
    u: Array
    h: Array


def _march(network: Network) -> _Marched:
    program = compile_network(network)
    theta, size = program.theta(network), len(program.states)
    states, efforts = np.empty((_STEPS + 1, size)), np.empty((_STEPS, size))
    u, h = np.ones((_STEPS, len(network.ports))), np.full(_STEPS, _STEP)
    kernel.march(program, theta, np.zeros(size), u, h, states, efforts)
    return _Marched(program, theta, states, efforts, u, h)


def _differentiate(marched: _Marched) -> None:
    program, theta, states, efforts, u, h = marched
    size, active, none = len(program.states), np.array([0]), np.zeros(0, dtype=np.int64)
    start, empty = np.zeros((size, 1)), np.zeros((_STEPS, 0))
    sweep.sensitivities(
        program, theta, active, states, efforts, u, h, start, none, empty, none, empty, np.arange(_STEPS + 1)
    )
    sweep.adjoint(program, theta, active, states, efforts, u, h, np.zeros_like(states))


if __name__ == "__main__":
    if _LATER in sys.argv:
        _march(hrlc(1).network())
    else:
        warm_up()
