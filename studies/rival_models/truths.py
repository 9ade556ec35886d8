"""Actuators of three families, from which recordings are made: none of them favours one model in all tables.

    phs                  the paper's network of two hysterons, Table 1 moved by up to 20 % (`studies.generator`)
    bouc_wen             a Bouc–Wen element in the place of the hysterons (`studies.generator.other_base`)
    prandtl_ishlinskii   q = L [c₀ u + Σ c_i w_i(u)], plays with cubic envelopes and thresholds r_i + λ |u̇|, behind a
                         mass, spring and damper L (Al Janaideh, Krejčí 2011)

The first two are those of `studies.generator`, integrated by LSODA. The third is computed here, sample by sample on a
grid a hundredth as long as the shortest time constant; it shares no code with the rivals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.results import write_atomic
from studies.generator.actuator import simulate_all
from studies.generator.base import draw_base
from studies.generator.excitation import PEAK, Excitation
from studies.generator.folder import MANIFEST, measured, write_manifest, write_recording
from studies.generator.other_base import BOUC_WEN, HYSTERONS, with_hysteresis

Array = NDArray[np.float64]

PHS, PLAYS = "phs", "prandtl_ishlinskii"
TRUTHS = (PHS, PLAYS, BOUC_WEN)
_WEIGHING, _STEP_NM = 1e-4, 1
_FINE = 100.0  # grid steps in the shortest time constant
_COUNT = 5  # plays
_RATED = (2e-5, 6e-5)  # λ times the largest rate of 75 V at 150 Hz is 0.02 to 0.06 of the largest voltage


def write_truth(
    folder: Path, truth: str, seed: int, plan: tuple[Mapping[str, str], Sequence[Excitation]], noise_um: float
) -> None:
    """Draw an actuator, simulate a plan from rest, add what a sensor adds, and write the folder.

    Args:
        truth: one of ``TRUTHS``; seed: of the actuator, the noise and the zeros.
        plan: use by recording name, and what drives the recordings.
        noise_um: standard deviation of the white noise, µm.

    Raises:
        InputRefused: an unknown truth.
        SolverFailed: the simulation failed.
    """
    if truth not in TRUTHS:
        raise InputRefused(f"truths: nothing is called {truth!r}: choose from {', '.join(TRUTHS)}")
    uses, excitations = plan
    choices, sensor = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    base = draw_base(choices)
    if truth == PLAYS:
        law = _drawn(choices)
        outputs = tuple(_plays(law, base, e) for e in excitations)
    else:
        family = BOUC_WEN if truth == BOUC_WEN else HYSTERONS
        outputs = simulate_all(with_hysteresis(base, family, choices), excitations)
    folder.mkdir(parents=True, exist_ok=True)
    for excitation, q in zip(excitations, outputs, strict=True):
        y = measured(q, noise_um * 1e-6, _STEP_NM * 1e-9, sensor)
        write_recording(folder / f"{excitation.name}.csv", excitation, y, write_atomic)
    write_manifest(folder / MANIFEST, base["m"], excitations, uses, _WEIGHING, write=write_atomic)


def base_of(seed: int) -> dict[str, float]:
    """The parameters of Table 1 as `write_truth` moves them for a seed, SI."""
    return draw_base(np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0]))


def _drawn(rng: np.random.Generator) -> dict[str, Array]:
    """Weights, thresholds over the largest voltage, envelope ``(a, b, c)``, and λ [s]."""
    reach = np.sort(rng.uniform(0.08, 0.7, _COUNT))
    shares = 0.45 * rng.dirichlet(np.full(_COUNT, 4.0))
    envelope = np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.08, 0.02), rng.uniform(0.0, 0.03)])
    return {
        "weights": np.array([1.0 - shares.sum(), *shares]), "reach": reach, "envelope": envelope,
        "rated": np.array([rng.uniform(*_RATED)]),
    }  # fmt: skip


def _plays(law: Mapping[str, Array], base: Mapping[str, float], excitation: Excitation) -> Array:
    """(samples,) displacement [m] from rest."""
    omega = math.sqrt(base["k"] / base["m"])
    damping = base["b"] / (2.0 * math.sqrt(base["k"] * base["m"]))
    parts = max(1, math.ceil(excitation.dt * omega * _FINE / (2.0 * math.pi)))
    dt = excitation.dt / parts
    t = np.arange((excitation.samples - 1) * parts + 1, dtype=np.float64) * dt
    u = excitation.voltage(t) / PEAK
    gain = base["alpha"] * PEAK / base["k"]
    path = _path(u, dt, law["reach"], law["weights"], law["envelope"], float(law["rated"][0]), omega, damping)
    return np.asarray(gain * path[::parts])


@njit(cache=True)
def _path(
    u: Array, dt: float, reach: Array, weights: Array, envelope: Array, rated: float, omega: float, damping: float
) -> Array:
    """Output of the plays through ``q̈ + 2ζω q̇ + ω² q = ω² f`` by the trapezoidal rule."""
    w, out = np.zeros(reach.size), np.zeros(u.size)
    q, v, last = 0.0, 0.0, 0.0
    for n in range(u.size):
        x = u[n]
        rate = abs(x - (u[n - 1] if n > 0 else 0.0)) / dt
        middle = x + envelope[0] * x * x + envelope[1] * x**3
        up, down = middle + envelope[2] * x * x, middle - envelope[2] * x * x
        force = weights[0] * x
        for i in range(w.size):
            r = reach[i] + rated * rate
            w[i] = max(up - r, min(down + r, w[i]))
            force += weights[i + 1] * w[i]
        if n > 0:
            # Trapezoidal rule, solved for the new velocity.
            pull = omega**2 * (0.5 * (force + last) - q - 0.25 * dt * v) - damping * omega * v
            new = (v + dt * pull) / (1.0 + dt * damping * omega + (0.5 * dt * omega) ** 2)
            q, v = q + 0.5 * dt * (v + new), new
        out[n], last = q, force
    return out
