"""scipy on the case: Radau and LSODA, with compiled rates and the exact Jacobian."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numba
import numpy as np
from scipy.integrate import ODEintWarning, odeint, solve_ivp

from benchmarks.case import TRUTH, Array, Solve
from benchmarks.ladder import Solver
from benchmarks.reference import SCALE, jacobian, rates
from phnn.recordings.recording import Recording

TOLERANCES = tuple(float(10.0 ** (-0.5 * k)) for k in range(6, 21))
_MOST_STEPS = 100_000

# Displacement of a recording under parameters and a tolerance.
Path = Callable[[Recording, Array, float], Array]


@numba.njit(cache=True)
def _field(t: float, z: Array, u: Array, dt: float, theta: Array, scale: Array) -> Array:
    n = min(max(int(t / dt), 0), u.size - 2)
    return rates(z, u[n] + (u[n + 1] - u[n]) * (t / dt - n), theta, scale)


@numba.njit(cache=True)
def _slope(t: float, z: Array, u: Array, dt: float, theta: Array, scale: Array) -> Array:
    return jacobian(z, theta, scale)


def radau(recording: Recording, theta: Array, tolerance: float) -> Array:
    """(N,) displacement by scipy's Radau [m]; NaN where it gave up."""
    t = recording.t
    found = solve_ivp(
        _field, (0.0, t[-1]), np.zeros(4), "Radau", t, args=(recording.u, recording.dt, theta, SCALE), jac=_slope,
        rtol=tolerance, atol=tolerance,
    )  # fmt: skip
    return np.asarray(found.y[2] * SCALE[2]) if found.success else np.full(t.size, np.nan)


def lsoda(recording: Recording, theta: Array, tolerance: float, knots: bool = False) -> Array:
    """(N,) displacement by LSODA [m], through `odeint`, whose loop is compiled; NaN where it gave up.

    Args:
        knots: step on every sample.
    """
    t = recording.t
    with warnings.catch_warnings():
        warnings.simplefilter("error", ODEintWarning)
        try:
            path = odeint(
                _field, np.zeros(4), t, args=(recording.u, recording.dt, theta, SCALE), Dfun=_slope, rtol=tolerance,
                atol=tolerance, tcrit=t if knots else None, mxstep=_MOST_STEPS, tfirst=True,
            )  # fmt: skip
        except ODEintWarning:
            return np.full(t.size, np.nan)
    return np.asarray(path[:, 2] * SCALE[2])


def lsoda_on_samples(recording: Recording, theta: Array, tolerance: float) -> Array:
    """(N,) as `lsoda`, stepping on every sample."""
    return lsoda(recording, theta, tolerance, knots=True)


PATHS: dict[str, dict[str, Path]] = {
    "scipy Radau": {"": radau},
    "scipy LSODA": {"": lsoda, "stepping on samples": lsoda_on_samples},
}


def forward(recordings: Sequence[Recording], name: str) -> list[Solver]:
    """The variants of a solver for the displacements."""

    def solver(note: str, path: Path) -> Solver:
        def prepare(settings: Sequence[float]) -> Solve:
            return lambda: np.stack([path(r, TRUTH, s) for r, s in zip(recordings, settings, strict=True)])

        return Solver(name, TOLERANCES, prepare, note)

    return [solver(note, path) for note, path in PATHS[name].items()]
