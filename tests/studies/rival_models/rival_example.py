"""Recordings of small systems with one input and one output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, dlsim

from phnn.recordings.recording import Part, Recording, Start

Array = NDArray[np.float64]
DT, NOISE = 1e-3, 1e-3


def recording(name: str, u: Array, y: Array, use: str = "identification", dt: float = DT) -> Recording:
    """A recording from rest at zero, whose output has a zero of its own and a little noise."""
    rng = np.random.default_rng(len(name) + u.size)
    return Recording(
        name=name, t=np.arange(u.size) * dt, u=u, y=y + 0.3 + NOISE * rng.standard_normal(u.size), start=Start("rest"),
        interpolation="linear", parts=(Part(name, 0, u.size, use),), noise=NOISE, noise_source="stated",
        noise_correlation=np.ones(1), period=None, channels={}, source=f"{name}.csv",
    )  # fmt: skip


def sweep(amplitude: float, low: float, high: float, samples: int = 600) -> Array:
    """A sine whose frequency rises, from zero."""
    t = np.arange(samples) * DT
    return np.asarray(amplitude * np.sin(2.0 * np.pi * (low * t + 0.5 * (high - low) / t[-1] * t * t)))


def second_order(f: Array, omega: float = 150.0, zeta: float = 0.3) -> Array:
    """``ÿ + 2ζω ẏ + ω² y = ω² f`` from rest, ``f`` linear between samples."""
    a, b, c, d, _ = cont2discrete(
        (
            np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]]), np.array([[0.0], [omega**2]]),
            np.array([[1.0, 0.0]]), np.zeros((1, 1)),
        ),
        DT, method="foh",
    )  # fmt: skip
    return np.asarray(dlsim((a, b, c, d, DT), f)[1][:, 0])


DRIVES = {"slow": (2.0, 2.0, 6.0), "fast": (2.0, 8.0, 20.0), "weak": (0.9, 4.0, 12.0)}


def linear_recordings() -> list[Recording]:
    """Three recordings of a linear system."""
    return [recording(name, u := sweep(*drive), second_order(u)) for name, drive in DRIVES.items()]
