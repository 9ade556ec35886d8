"""An actuator with two hysterons whose guide brakes: eqs. (3) to (6) written down anew, solved by scipy."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

RIG = {
    "m": 1.05e-3, "k": 2.3e4, "b": 3.4, "alpha": 0.044,
    "C": np.array([5.6e-7, 5.1e-7]), "rho": np.array([0.58, 1.2e-4]), "d": np.array([14.0, 8.8]),
}  # fmt: skip
# Braking force [N] at a speed [m/s] and a displacement [m].
FORCE, SPEED, REACH = 0.25, 0.1, 1.2e-4
NOISE, STEP = 6e-8, 1e-4


def moved(volts: Callable[[float], float], t: Array, power: float) -> Array:
    """Displacement [m] at the times ``t`` [s] under a voltage; the guide brakes with ``|q|`` to a power."""
    r = RIG

    def rate(time: float, z: Array) -> Array:
        q, v, e = z[2], z[3] / r["m"], z[:2] / r["C"]
        slipping = r["rho"] * (e - np.clip(e, -0.5 * r["d"], 0.5 * r["d"]))
        braking = FORCE * (abs(q) / REACH) ** power * v / SPEED
        force = r["alpha"] * (volts(time) - e.sum()) - r["k"] * q - r["b"] * v - braking
        return np.array([*(r["alpha"] * v - slipping), v, force])

    scale = np.array([1e-6, 1e-6, 1e-4, 1e-4])
    found = solve_ivp(rate, (0.0, t[-1]), np.zeros(4), "LSODA", t, rtol=1e-8, atol=1e-9 * scale, max_step=STEP)
    assert found.success
    return np.asarray(found.y[2])


def sine(frequency: float, amplitude: float, offset: float = 0.0) -> Callable[[float], float]:
    """A sine that grows from rest over two hundredths of a second."""
    return lambda t: min(t / 0.02, 1.0) * (offset + amplitude * np.sin(2.0 * np.pi * frequency * t))


RECORDINGS = {
    "slow": (sine(10.0, 75.0), 0.3),
    "fast": (sine(100.0, 75.0), 0.2),
    "faster": (sine(300.0, 40.0), 0.1),
    "aside": (sine(200.0, 25.0, 45.0), 0.1),
    "small": (sine(50.0, 50.0), 0.2),
    "resonant": (sine(500.0, 30.0), 0.1),
}


def write_rig(folder: Path, power: float) -> None:
    """The recordings with noise, and their manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(20)
    entries = []
    for name, (volts, duration) in RECORDINGS.items():
        t = np.arange(round(duration / STEP)) * STEP
        y = moved(volts, t, power) + NOISE * rng.standard_normal(t.size)
        columns = np.column_stack([t, [volts(x) for x in t], 1e6 * y])
        header = "time_s,voltage_V,displacement_um"
        np.savetxt(folder / f"{name}.csv", columns, "%.9g", ",", header=header, comments="")
        entries.append(f"- file: {name}.csv\n  name: {name}\n  start: {{state: rest, input_before: 0.0}}\n")
    manifest = "setup: {model: piezo_actuator, hysterons: 2}\n" + f"known: {{m: {{value: {RIG['m']}, std: 1.0e-5}}}}\n"
    (folder / "recordings.yaml").write_text(manifest + "voltage: command\nrecordings:\n" + "".join(entries))


if __name__ == "__main__":
    write_rig(Path(sys.argv[1]), power=2.0)
