"""The compiled kernels that integrate a program, and the choice of the fastest one.

All kernels take the same steps (`phnn.integrate.step`) and differ in speed alone. `phnn.integrate.sweep` differentiates
these steps, whichever kernel has integrated them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.integrate import general, quick
from phnn.integrate.actions import actions
from phnn.integrate.program import Program

Array = NDArray[np.float64]


class Kernel(NamedTuple):
    """A compiled way to integrate some programs.

    Attributes:
        name: short name.
        serves: whether it integrates a program.
        march: ``(program, theta, actions, h, states, efforts) -> solved``: fills states and efforts from the initial
            state in ``states[0]`` under the actions (n, P) of the ports; returns the number of solved steps.
    """

    name: str
    serves: Callable[[Program], bool]
    march: Callable[[Program, Array, Array, Array, Array, Array], int]


# The fastest first.
KERNELS = {
    "single junction": Kernel("single junction", quick.serves, quick.march),
    "general": Kernel("general", lambda program: True, general.march),
}


def kernel_for(program: Program, prefer: str | None = None) -> Kernel:
    """The fastest kernel that serves a program.

    Args:
        prefer: name of the kernel to use instead.

    Raises:
        InputRefused: no kernel has that name, or it does not serve the program.
    """
    if prefer is None:
        return next(kernel for kernel in KERNELS.values() if kernel.serves(program))
    if prefer not in KERNELS:
        raise InputRefused(f"kernel {prefer!r}: choose one of {', '.join(KERNELS)}")
    if not KERNELS[prefer].serves(program):
        raise InputRefused(f"kernel {prefer!r} does not serve this network: take the general one")
    return KERNELS[prefer]


def march(program: Program, theta: Array, x0: Array, u: Array, h: Array, states: Array, efforts: Array) -> int:
    """Integrate ``n`` steps of a program by the fastest kernel; returns the number of solved steps.

    Args:
        theta: (M,) parameters, see `Program.theta`.
        x0: (N,) initial state, in the order of the network: storages, then modulator states.
        u: (n, P) mean inputs of the steps; h: (n,) their sizes [s].
        states: (n+1, N) filled; efforts: (n, N) filled with the mean efforts of the storages and the mean drives of the
            modulator states.
    """
    states[0] = x0
    return kernel_for(program).march(program, theta, actions(program, theta, u), h, states, efforts)
