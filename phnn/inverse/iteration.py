"""The inverse of a complete model, chain included.

The inverses of network and blocks, one after the other, are an operator ``P`` from an output to a command. It is exact
but for the discretisation, for what lies between the samples of the command, and for blocks whose inverse is
approximate. With ``G`` the complete model within its limits, the reference ``r`` is corrected by what is missed,

    u_k = P(z_k),      z_{k+1} = z_k + w (r − G(u_k)),      z_0 = r,

which converges where ``P ∘ G`` is near the identity: the error falls by the share by which it differs from it. The
weight ``w`` is zero where something is out of reach, and one elsewhere: what cannot be reached must not add up. The
command with the least error is kept. No formula of an effect occurs here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from phnn.inverse.options import InverseOptions
from phnn.inverse.plant import Attempt, Plant
from phnn.inverse.reference import begins_at_rest, checked, fast_share, judged, led_in, smoothed
from phnn.inverse.result import Inverse, Stretch, stretches
from phnn.network.elements import Network
from phnn.setup import Setup

Array = NDArray[np.float64]

# Share of the reference's range that counts as no error where the user says nothing.
_TOLERANCE = 1e-5
# The iteration ends where this many simulations in a row have not lowered the least error by this share of it.
_PATIENCE, _PROGRESS = 4, 0.02
# Samples over which a correction fades in beside what is out of reach.
_FADE = 8
# Stretches of error closer than this share of the whole time are told as one; at most so many are told.
_CLOSE, _TOLD = 0.02, 4


@dataclass(frozen=True)
class _Best:
    """The attempt with the least error so far, and how many simulations it took to find it."""

    attempt: Attempt
    error: float
    count: int


def invert(setup: Setup, substeps: int, t: Array, reference: Array, options: InverseOptions) -> Inverse:
    """Find the command with which a model's output follows a reference.

    Args:
        setup: the model; substeps: its integration steps in a sample interval.
        t: (N,) time [s], equally spaced; reference: (N,) wanted output [m].
        options: smoothing, limits and the like.

    Raises:
        InputRefused: the reference or the model cannot be used; names the cause and a remedy.
        SolverFailed: a step has no solution.
    """
    dt = checked(t, reference, _has_voltage_and_displacement(setup.network))
    given = led_in(reference, dt, options.lead_in)
    wanted = smoothed(given, dt, options.smooth)
    times = t[0] + dt * (np.arange(wanted.size) - (wanted.size - t.size))
    tolerance = options.tolerance or _TOLERANCE * float(np.ptp(wanted))
    plant = Plant(setup, substeps, dt, options)
    first, before, port = plant.backwards(wanted)
    messages = list(judged(fast_share(first.values), dt))
    if not begins_at_rest(wanted, dt):
        messages.append(
            "The reference begins in motion, and the model at rest, so that the beginning is missed: give a lead_in "
            "(--lead-in), for example of some periods."
        )
    best, count = _iterated(plant, wanted, tolerance, (plant.forwards(first, before), port))
    attempt = best.attempt
    missed = stretches(
        times, attempt.output - wanted, tolerance, attempt.command.lost, attempt.command.causes,
        _CLOSE * float(times[-1] - times[0]),
    )  # fmt: skip
    return Inverse(
        times, given, wanted, attempt.command.values, attempt.before, attempt.output, tolerance, count, missed,
        (*messages, *_told(missed, tolerance)), options,
    )  # fmt: skip


def _iterated(plant: Plant, wanted: Array, tolerance: float, begun: tuple[Attempt, Array]) -> tuple[_Best, int]:
    """The best attempt, and the number of simulations.

    Args:
        wanted: (N,) the reference.
        begun: the first attempt, and its port voltage at the nodes.
    """
    attempt, port = begun
    corrected, count = wanted, 1
    best = _Best(attempt, _size(attempt.output - wanted), count)
    while count < plant.options.iterations and np.abs(best.attempt.output - wanted).max() > tolerance:
        corrected = corrected + _weight(attempt.command.lost) * (wanted - attempt.output)
        asked, before, port = plant.backwards(corrected, port)
        attempt, count = plant.forwards(asked, before), count + 1
        error = _size(attempt.output - wanted)
        if error < (1.0 - _PROGRESS) * best.error:
            best = _Best(attempt, error, count)
        elif not np.isfinite(error) or count - best.count >= _PATIENCE:
            break
    return best, count


def _has_voltage_and_displacement(network: Network) -> bool:
    """Whether a voltage moves something."""
    volts = any(port.unit == "V" for port in network.ports[:1])
    return volts and any(s.name == network.output and s.unit == "m" for s in network.storages)


def _size(error: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(error**2)))


def _weight(lost: NDArray[np.bool_]) -> Array:
    """(N,) by how much of the error a reference is corrected: not where something is out of reach, nor close to it."""
    if not lost.any():
        return np.ones(lost.size)
    near = maximum_filter1d(lost.astype(float), 2 * _FADE + 1)
    return np.asarray(1.0 - uniform_filter1d(near, 2 * _FADE + 1))


def _told(missed: tuple[Stretch, ...], tolerance: float) -> tuple[str, ...]:
    """Sentences on what is missed: the largest errors first."""
    ordered = sorted(missed, key=lambda s: -abs(s.error))
    told = [
        f"From {s.start:.6g} s to {s.end:.6g} s the reference is missed by up to {abs(s.error):.3g} m, at {s.at:.6g} s"
        + (f": it is limited by {' and '.join(s.causes)}." if s.causes else f" (tolerance {tolerance:.3g} m).")
        for s in ordered[:_TOLD]
    ]
    if len(ordered) > _TOLD:
        told.append(f"So it is, by less, in {len(ordered) - _TOLD} more stretches.")
    return tuple(told)
