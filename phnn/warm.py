"""Compile every kernel once, before many processes need them at the same time: ``python -m phnn.warm``.

Each of them would compile for a minute otherwise, all the same functions; afterwards they load what is cached.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from functools import cache

import numpy as np

from phnn.integrate import kernel, sweep
from phnn.integrate.cache import has_kept
from phnn.integrate.program import compile_network
from phnn.models.actuator import hrc
from phnn.models.variants import hrlc
from phnn.network.elements import Network

_STEPS, _STEP = 4, 1e-5
_LATER = "later"


def warm_up() -> None:
    """Integrate and differentiate a network of the single-junction kernel, and one of the general kernel."""
    for network in (hrc(1), hrlc(1).network()):
        _differentiate(_march(network))


@cache
def compile_later_kernels() -> None:
    """Begin to compile, in a process of its own, the kernel that a diagnosis needs after the one of its base model.

    Once in a run; where it has been done before, or no process can be started, nothing happens.
    """
    if has_kept("general"):
        return
    try:
        # -P: a folder of recordings may hold modules, which are not to be imported.
        started = subprocess.Popen(
            [sys.executable, "-P", "-m", "phnn.warm", _LATER],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError:
        return
    atexit.register(_end, started)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    process.wait()


def _march(network: Network) -> sweep.Integrated:
    program = compile_network(network)
    theta, size = program.theta(network), len(program.states)
    states, efforts = np.empty((_STEPS + 1, size)), np.empty((_STEPS, size))
    u, h = np.ones((_STEPS, len(network.ports))), np.full(_STEPS, _STEP)
    kernel.march(program, theta, np.zeros(size), u, h, states, efforts)
    return sweep.Integrated(program, theta, states, efforts, u, h)


def _differentiate(march: sweep.Integrated) -> None:
    active, none = np.array([0]), np.zeros(0, dtype=np.int64)
    by, start = sweep.by_parameters(active, _STEPS), np.zeros((len(march.program.states), 1))
    sweep.sensitivities(march, by, start, none, np.arange(_STEPS + 1))
    sweep.adjoint(march, active, np.zeros_like(march.states))


if __name__ == "__main__":
    if _LATER in sys.argv:
        _march(hrlc(1).network())
    else:
        warm_up()
