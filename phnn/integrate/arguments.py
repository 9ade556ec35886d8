"""What travels together through the compiled functions of a march."""

from __future__ import annotations

from typing import Any, NamedTuple

from phnn.integrate.compiled import inline


class March(NamedTuple):
    """What is integrated: a table, the actions (n, P) of its ports and the steps' sizes; states and efforts are filled.

    For the shapes see `phnn.integrate.kernel.march`.
    """

    t: Any
    actions: Any
    h: Any
    states: Any
    efforts: Any


class Step(NamedTuple):
    """What the equations of one step are evaluated with: floats, or complex numbers with a tiny imaginary part.

    Attributes:
        t: table; theta: (M,) parameters.
        c, g, a: see `phnn.integrate.constants`; modulated gains are filled in where the equations are evaluated.
        x: (N,) state at the start, storages before memories; y: (m,) unknowns; h: size of the step [s].
        wj: (4, m) filled with ``v̄``, ``z − p``, ``F`` and the size of its terms.
    """

    t: Any
    theta: Any
    c: Any
    g: Any
    a: Any
    x: Any
    y: Any
    h: Any
    wj: Any


class Values(NamedTuple):
    """The numbers of a step, see `Step`, and ``wx`` (2, N): its end states and mean efforts."""

    theta: Any
    c: Any
    g: Any
    a: Any
    x: Any
    y: Any
    wj: Any
    wx: Any


class Room(NamedTuple):
    """Memory of the solver for several junctions, zero before the first step.

    Attributes:
        jacobian: (m, m); step: (m, 1) a Newton step.
        own: (7+m, m) rows as named in `phnn.integrate.solve`.
    """

    jacobian: Any
    step: Any
    own: Any


@inline
def step_of(t: Any, h: Any, v: Any) -> Any:
    """The step of size ``h`` with some values."""
    return Step(t, v.theta, v.c, v.g, v.a, v.x, v.y, h, v.wj)
