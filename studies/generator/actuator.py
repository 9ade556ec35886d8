"""The concealed actuator from amplifier to sensor; its equations are in ``studies.generator.equations``.

LSODA solves them. Runge and Kutta's method does under a coarse converter or a random force, which would stop LSODA at
every step or sample.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import ODEintWarning, odeint

from phnn.errors import SolverFailed
from studies.generator.disturbance import CALM, Disturbance
from studies.generator.equations import Q_0, march, rates
from studies.generator.excitation import Excitation
from studies.generator.parameters import NEUTRAL, TABLE, Array, packed
from studies.generator.sensor import play, scaled

__all__ = ["NEUTRAL", "Q_0", "TABLE", "Array", "simulate", "simulate_all"]

_RELATIVE = 1e-8
_STEP = 1.5e-6  # s, with which the fast hysteron of any draw (0.6 µs) is stable
_SAME = 1e-12  # s; LSODA refuses times as close as that
_FINE = 5e-6  # s; a play turns between the samples, where the displacement does


def simulate(parameters: Mapping[str, float], excitation: Excitation, disturbance: Disturbance = CALM) -> Array:
    """Displacement as an ideal sensor reports it, from rest, at the sampling times.

    Args:
        parameters: those of ``TABLE``, and those of ``NEUTRAL`` that are not neutral; SI.
        excitation: continuous voltage; the solver stops and starts again where it jumps.
        disturbance: a random force, and errors of the sampling instants; none if left out.

    Returns:
        y, (samples,), m; the displacement q itself where no effect sits in the sensor.

    Raises:
        SolverFailed: LSODA gave up.
    """
    values = {**NEUTRAL, **parameters}
    w, sizes = packed(parameters)
    drive = excitation.delayed(values["tau_d"]) if values["tau_d"] > 0.0 else excitation
    parts = math.ceil(excitation.dt / _FINE) if values["delta_b"] > 0.0 else 1
    sampled, end = excitation.t * (1.0 - values["kappa_t"]), excitation.pieces[-1].end
    if disturbance.late.size > 0:
        sampled = np.clip(sampled + disturbance.late, 0.0, end)
    t = sampled
    if values["delta_b"] > 0.0:
        last = excitation.samples - (1 if disturbance.late.size == 0 else 0)
        t = np.minimum(np.arange(last * parts + 1, dtype=np.float64) * (excitation.dt / parts), end)
    q = _path(w, sizes, drive, t, disturbance.force)
    if values["delta_b"] > 0.0:
        q = play(q, values["delta_b"])
        q = q[::parts] if disturbance.late.size == 0 else np.interp(sampled, t, q)
    return scaled(q, excitation.t, values)


def _path(w: NDArray[np.void], sizes: Array, drive: Excitation, t: Array, force: Array) -> Array:
    """Displacement, delayed by a lagging sensor if there is one, at the times ``t``, (len(t),), m."""
    which = drive.piece_of(t)
    seen = int(w[0]["at_sensor"]) or 2
    q = np.empty(t.size)
    x = np.zeros(sizes.size)
    for i, piece in enumerate(drive.pieces):
        inside = which == i
        asked = np.where(np.abs(t[inside] - piece.start) < _SAME, piece.start, t[inside])
        asked = np.where(np.abs(asked - piece.end) < _SAME, piece.end, asked)
        times = np.unique(np.concatenate([[piece.start], asked, [piece.end]]))
        path = _solve(x, times, w, piece.as_array(), drive.name, sizes, force)
        q[inside] = path[np.searchsorted(times, asked), seen]
        x = path[-1]
    return q


def _solve(x: Array, times: Array, w: NDArray[np.void], drive: Array, name: str, sizes: Array, force: Array) -> Array:
    """States at ``times``, (len(times), states); the command is smooth on the whole stretch."""
    path: Array
    if w[0]["Delta_u"] > 0.0 or force.size > 0:
        path = march(x, times, w, drive, _STEP, force)
    else:
        path = _adaptive(x, times, w, drive, name, sizes)
    if not np.isfinite(path).all():
        first = times[int(np.argmin(np.isfinite(path).all(axis=1)))]
        raise SolverFailed(f"{name}: the simulation left the finite numbers at {first:g} s: draw another seed")
    return path


def _adaptive(x: Array, times: Array, w: NDArray[np.void], drive: Array, name: str, sizes: Array) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("error", ODEintWarning)
        try:
            path: Array = odeint(
                rates,
                x,
                times,
                args=(w, drive),
                rtol=_RELATIVE,
                atol=_RELATIVE * 1e-2 * sizes,
                mxstep=200_000,
                tfirst=True,
            )
        except ODEintWarning as warning:
            span = f"between {times[0]:g} s and {times[-1]:g} s"
            raise SolverFailed(f"{name}: LSODA stopped {span} ({warning}): draw another seed") from warning
    return path


def simulate_all(
    parameters: Mapping[str, float], plan: Sequence[Excitation], disturbances: Sequence[Disturbance] = ()
) -> tuple[Array, ...]:
    """``simulate`` for every recording of a plan; ``disturbances``, where given, are one for each."""
    each = disturbances or [CALM] * len(plan)
    return tuple(simulate(parameters, e, d) for e, d in zip(plan, each, strict=True))
