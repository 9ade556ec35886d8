"""Compile the kernels before they are needed, in two processes at once: ``python -m phnn.warm`` compiles all of them.

A process that finds no machine code compiles for a minute, and many processes would all compile the same functions.
Afterwards they load what is kept.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from functools import cache
from typing import NamedTuple

import numpy as np

from phnn.integrate import kernel, sweep
from phnn.integrate.cache import has_kept
from phnn.integrate.program import compile_network
from phnn.laws.identity import registered_outside
from phnn.models.actuator import hrc
from phnn.models.variants import hrlc
from phnn.network.elements import Network

_STEPS, _STEP = 4, 1e-5
_LOOK = 0.05  # s between two looks for machine code that another process compiles


class Part(NamedTuple):
    """A kernel that can be compiled beforehand.

    Attributes:
        function: the compiled function as ``module.name``, by which its machine code is kept.
        use: calls it once with arguments of the types that all networks have.
    """

    function: str
    use: Callable[[], object]


def _at_rest(network: Network) -> sweep.Integrated:
    """A few steps of a network at rest."""
    program = compile_network(network)
    states, efforts = (np.zeros((_STEPS + more, len(program.states))) for more in (1, 0))
    u, h = np.ones((_STEPS, len(network.ports))), np.full(_STEPS, _STEP)
    return sweep.Integrated(program, program.theta(network), states, efforts, u, h)


def _integrate(network: Network) -> None:
    program, theta, states, efforts, u, h = _at_rest(network)
    kernel.march(program, theta, np.zeros(states.shape[1]), u, h, states, efforts)


def _differentiate() -> None:
    steps, active, none = _at_rest(hrc(1)), np.array([0]), np.zeros(0, dtype=np.int64)
    start = np.zeros((steps.states.shape[1], 1))
    sweep.sensitivities(steps, sweep.by_parameters(active, _STEPS), start, none, np.arange(_STEPS + 1))


def _pull_back() -> None:
    steps = _at_rest(hrc(1))
    sweep.adjoint(steps, np.array([0]), np.zeros_like(steps.states))


PARTS = {
    "steps": Part("quick._steps", lambda: _integrate(hrc(1))),
    "general steps": Part("general._steps", lambda: _integrate(hrlc(1).network())),
    "sensitivities": Part("recursion.sensitivity_steps", _differentiate),
    "adjoint": Part("recursion.adjoint_steps", _pull_back),
}
# What an identification and a diagnosis need, in this process and in another. Both kinds of steps have many functions
# in common, which one process compiles once.
_HERE, _ELSEWHERE = ("steps", "general steps"), "sensitivities"


def is_kept(name: str) -> bool:
    """Whether a part is compiled, or no machine code can be kept at all."""
    return has_kept(PARTS[name].function)


def warm_up(names: Iterable[str] = tuple(PARTS)) -> None:
    """Compile parts in this process, or load them where they are kept."""
    for name in names:
        PARTS[name].use()


@cache
def begin_elsewhere(*names: str) -> subprocess.Popen[bytes] | None:
    """Begin to compile parts in a process of its own, which ends with this one.

    Returns:
        The process, the same for every call; None where all is kept or no process can be started.
    """
    left = [name for name in names if not is_kept(name)]
    # Another process knows nothing of laws that were registered in this one.
    if not left or registered_outside():
        return None
    try:
        # -P: a folder of recordings may hold modules, which are not to be imported.
        started = subprocess.Popen(
            [sys.executable, "-P", "-m", "phnn.warm", *left],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError:
        return None
    atexit.register(_end, started)
    return started


def begin_for_diagnosis() -> subprocess.Popen[bytes] | None:
    """Begin to compile, in another process, what a diagnosis needs after its first simulation."""
    return begin_elsewhere(_ELSEWHERE)


def compile_for_diagnosis(progress: Callable[[str], object]) -> None:
    """Compile what identification and diagnosis need, in two processes; ``progress`` is told if there is anything."""
    left = [name for name in _HERE if not is_kept(name)]
    process = begin_for_diagnosis()
    if left or process is not None:
        progress("compile the simulation, once on this machine")
    warm_up(left)
    while process is not None and process.poll() is None and not is_kept(_ELSEWHERE):
        time.sleep(_LOOK)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    process.wait()


def compile_everything() -> None:
    """Compile all parts in two processes."""
    process = begin_elsewhere(_ELSEWHERE, "adjoint")
    warm_up(_HERE)
    if process is not None:
        process.wait()
    # Nothing is left to compile, unless the other process failed.
    warm_up()


if __name__ == "__main__":
    if names := sys.argv[1:]:
        warm_up(names)
    else:
        compile_everything()
