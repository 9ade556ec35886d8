"""Made recordings: a smooth hysteretic output of a known input, with a known noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phnn.errors import InputRefused
from phnn.recordings import read

NOISE = 50e-9


def play(u: np.ndarray, radius: float) -> np.ndarray:
    """The play operator: hysteresis with exact corners."""
    y, state = np.empty_like(u), 0.0
    for i, value in enumerate(u):
        state = min(max(state, value - radius), value + radius)
        y[i] = state
    return y


def output(u: np.ndarray, noise: float = NOISE, seed: int = 0, step: float = 0.0) -> np.ndarray:
    """Displacement in m: gain, two plays, offset, white noise, quantisation."""
    q = 0.5e-6 * (u + 0.2 * play(u, 8.0) + 0.1 * play(u, 30.0)) + 1.2345e-6
    q = q + noise * np.random.default_rng(seed).normal(size=u.size)
    return np.round(q / step) * step if step else q


def sine(frequency: float, amplitude: float, cycles: float = 3.0, samples: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Time in s and voltage in V."""
    t = np.arange(int(cycles * samples)) / (samples * frequency)
    return t, amplitude * np.sin(2.0 * np.pi * frequency * t)


def write(
    path: Path, t: np.ndarray, u: np.ndarray, y: np.ndarray, header: str = "time_s,voltage_V,displacement_m"
) -> Path:
    rows = "\n".join(",".join(repr(float(v)) for v in row) for row in zip(t, u, y, strict=True))
    path.write_text(f"{header}\n{rows}\n")
    return path


def write_sine(folder: Path, name: str, frequency: float, amplitude: float, cycles: float = 3.0) -> Path:
    t, u = sine(frequency, amplitude, cycles)
    return write(folder / f"{name}.csv", t, u, output(u, seed=hash((frequency, amplitude)) % 1000))


def refused(folder: Path, *words: str, manifest: Path | None = None) -> str:
    """Reading the folder is refused with one message that holds all the words."""
    with pytest.raises(InputRefused) as caught:
        read(folder, manifest)
    message = str(caught.value)
    missing = [word for word in words if word not in message]
    if missing:
        pytest.fail(f"{missing} not in the message: {message}")
    return message
