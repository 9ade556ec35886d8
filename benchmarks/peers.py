"""diffrax on the case: the same scaled states, the same straight lines between the samples.

The input is looked up by index arithmetic, which is no slower than `jnp.interp` or `diffrax.LinearInterpolation`. Each
solver comes in two variants, free to stride over the kinks of the input or made to step on every sample: the first is
faster at loose targets, the second at tight ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import TRUTH, Array, Solve
from benchmarks.ladder import Prepare, Solver
from benchmarks.reference import SCALE
from phnn.recordings.recording import Recording

jax.config.update("jax_enable_x64", True)

KINDS = {"Kvaerno3": diffrax.Kvaerno3(), "Kvaerno5": diffrax.Kvaerno5()}
TOLERANCES = tuple(float(10.0 ** (-0.5 * k)) for k in range(4, 19))
VARIANTS = {"": False, "stepping on samples": True}
MOST_STEPS = 20_000
# Reverse mode plans its checkpoints for so many steps; a larger plan costs it time.
FEW_STEPS = 4096


def rates(z: Any, voltage: Any, theta: Any) -> Any:
    """(4,) eqs. (3)–(6) in scaled states, as in `benchmarks.reference`."""
    m, k, b, alpha = theta[0], theta[1], theta[2], theta[3]
    x = z * SCALE
    v = x[3] / m
    effort = x[:2] / theta[4:6]
    half = 0.5 * theta[8:10]
    leak = theta[6:8] * (jnp.maximum(effort - half, 0.0) + jnp.minimum(effort + half, 0.0))
    force = -alpha * jnp.sum(effort) - k * x[2] - b * v + alpha * voltage
    return jnp.concatenate([alpha * v - leak, jnp.stack([v, force])]) / SCALE


def solution(kind: str, knots: bool, planned: int | None, theta: Any, u: Any, dt: Any, tolerance: Any) -> Any:
    """One recorded input.

    Args:
        kind: key of `KINDS`.
        knots: step on every sample.
        planned: steps that reverse mode plans for; None for no derivative or forward mode.
        u: (N,) samples; dt: their interval [s].

    Returns:
        (N,) displacement [m], infinite from where the solver gave up, and the number of steps.
    """
    slopes = jnp.diff(u) / dt
    times = jnp.arange(u.size) * dt

    def field(t: Any, z: Any, arguments: Any) -> Any:
        n = jnp.clip((t / dt).astype(int), 0, u.size - 2)
        return rates(z, u[n] + slopes[n] * (t - n * dt), theta)

    controller: Any = diffrax.PIDController(rtol=tolerance, atol=tolerance)
    if knots:
        controller = diffrax.ClipStepSizeController(controller, step_ts=times[1:-1])
    found = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        KINDS[kind],
        t0=0.0,
        t1=times[-1],
        dt0=dt,
        y0=jnp.zeros(4),
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=controller,
        adjoint=diffrax.RecursiveCheckpointAdjoint() if planned else diffrax.ForwardMode(),
        max_steps=planned or MOST_STEPS,
        throw=False,
    )
    return found.ys[:, 2] * SCALE[2], found.stats["num_steps"]


def arrays(recordings: Sequence[Recording]) -> tuple[Any, Any]:
    """(R, N) inputs and (R,) sampling intervals on the side of jax."""
    return jnp.array(np.stack([r.u for r in recordings])), jnp.array([r.dt for r in recordings])


def _mapped(function: Callable[..., Any], together: bool, *stacked: Any) -> Prepare:
    """A function of one recording's arrays and a tolerance, on all recordings: at once by vmap, or one by one."""
    if together:
        batch = jax.jit(jax.vmap(function))
        return lambda settings: lambda: np.asarray(batch(*stacked, jnp.array(settings)))
    single = jax.jit(function)
    rows = [[a[r] for a in stacked] for r in range(len(stacked[0]))]

    def prepare(settings: Sequence[float]) -> Solve:
        return lambda: np.stack([np.asarray(single(*row, s)) for row, s in zip(rows, settings, strict=True)])

    return prepare


def forward(recordings: Sequence[Recording], kind: str, together: bool) -> list[Solver]:
    """Both variants of a solver for the displacements."""
    return [
        Solver(_name(kind, together), TOLERANCES, _solved(recordings, kind, note, together, 0), note)
        for note in VARIANTS
    ]  # fmt: skip


def steps(recordings: Sequence[Recording], kind: str, note: str) -> Prepare:
    """(R,) steps that the recordings take."""
    return _solved(recordings, kind, note, True, 1)


def _solved(recordings: Sequence[Recording], kind: str, note: str, together: bool, which: int) -> Prepare:
    """One of the results of `solution` under the true parameters."""

    def one(u: Any, dt: Any, tolerance: Any) -> Any:
        return solution(kind, VARIANTS[note], None, jnp.array(TRUTH), u, dt, tolerance)[which]

    return _mapped(one, together, *arrays(recordings))


def gradient(
    recordings: Sequence[Recording], wanted: Array, kind: str, together: bool, planned: int | None, note: str
) -> Prepare:
    """(R, 10) derivatives of ``Σ (q − wanted)²`` by the logarithms of the parameters [m²].

    Args:
        planned: steps that reverse mode plans its recursive checkpoints for; None for forward mode with ten tangents.
        note: which variant.
    """

    def cost(logarithms: Any, u: Any, dt: Any, target: Any, tolerance: Any) -> Any:
        q, _ = solution(kind, VARIANTS[note], planned, jnp.exp(logarithms), u, dt, tolerance)
        # In multiples of the peak, because the squares of metres are tiny.
        return jnp.sum(((q - target) / SCALE[2]) ** 2)

    derivative = (jax.grad if planned else jax.jacfwd)(cost)
    start = jnp.log(jnp.array(TRUTH))

    def one(u: Any, dt: Any, target: Any, tolerance: Any) -> Any:
        return derivative(start, u, dt, target, tolerance) * SCALE[2] ** 2

    return _mapped(one, together, *arrays(recordings), jnp.array(wanted))


def gradients(recordings: Sequence[Recording], wanted: Array, kind: str) -> list[Solver]:
    """Both variants of a solver for the gradient, to climb with: forward mode, all recordings at once."""
    return [
        Solver(_name(kind, True), TOLERANCES, gradient(recordings, wanted, kind, True, None, note), note)
        for note in VARIANTS
    ]


def _name(kind: str, together: bool) -> str:
    return f"diffrax {kind}, {'vmap' if together else 'one by one'}"
