"""A structure of a few modes under periodic forces, line by line in closed form; it shares no code with the package.

q̈ + 2ζω q̇ + ω² q = ω² b (u − k x/(1 + ⟨x²⟩/r²)),     x = bᵀ q,     ⟨x²⟩ of the period before
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE, SIZE, NOISE = 1000.0, 512, 2e-4
OMEGA = 2.0 * np.pi * np.array([61.0, 102.0, 171.0])
ZETA = np.array([0.02, 0.015, 0.025])
B = np.array([[0.9, 0.5], [0.6, -0.8], [-0.5, 0.6]])
C = np.array([[1.0, 0.7, 0.4], [0.6, -0.9, 0.5]])
STIFFNESS, REACH = np.array([0.15, 0.1]), np.array([15.0, 10.0])


def multisines(count: int, amplitude: float, seed: int) -> Array:
    """(count, SIZE, 2) random-phase multisines of equal lines up to 300 Hz."""
    rng = np.random.default_rng(seed)
    lines = np.arange(2, int(300.0 * SIZE / RATE))
    spectrum = np.zeros((count, SIZE // 2 + 1, 2), dtype=complex)
    spectrum[:, lines] = np.exp(2j * np.pi * rng.random((count, lines.size, 2)))
    u = np.fft.irfft(spectrum, SIZE, axis=1)
    return np.asarray(amplitude * u / u.std(axis=1, keepdims=True))


def outputs(u: Array, kind: str) -> Array:
    """(SIZE, 2) outputs of one experiment in the steady state, period after period where springs are ``slow``."""
    s = 2j * np.pi * np.fft.rfftfreq(SIZE, 1.0 / RATE)[:, None]
    h = OMEGA**2 / (s**2 + 2.0 * ZETA * OMEGA * s + OMEGA**2)
    drive, square = np.fft.rfft(u, axis=0), np.zeros(2)
    for _ in range(1 if kind == "none" else 30):
        k = 0.0 * STIFFNESS if kind == "none" else STIFFNESS / (1.0 + square / REACH**2)
        z = np.array([B.T @ (row[:, None] * B) for row in h])
        x = np.linalg.solve(np.eye(2) + z * k, z @ drive[:, :, None])[:, :, 0]
        square = np.fft.irfft(x, SIZE, axis=0).var(axis=0)
    q = h * ((drive - k * x) @ B.T)
    return np.fft.irfft(q @ C.T, SIZE, axis=0)


def write_folder(
    folder: Path, kind: str, seed: int, levels: tuple[float, ...] = (0.7, 2.1), held: tuple[float, ...] = ()
) -> None:
    """Four experiments of identification and one of confirmation at each amplitude, two periods each, as arrays.

    Args:
        kind: ``none``, or ``slow`` for springs that soften with the mean square of their extension.
        held: amplitudes all of whose experiments are marked with ``use: confirmation``.
    """
    rng = np.random.default_rng(seed)
    entries = []
    u = np.concatenate([multisines(5, a, seed + i) for i, a in enumerate(levels)])
    y = 1e-6 * np.array([outputs(one, kind) for one in u])
    for i, level in enumerate(levels):
        some = slice(5 * i, 5 * i + 5)
        for name, part, use in (
            (f"train_{i}", slice(0, 4), "confirmation" if level in held else "identification"),
            (f"test_{i}", slice(4, 5), "confirmation"),
        ):
            inputs = np.repeat(u[some][part].transpose(1, 2, 0)[..., None], 2, axis=3)
            measured = np.repeat(y[some][part].transpose(1, 2, 0)[..., None], 2, axis=3)
            measured = measured + NOISE * y.std() * rng.standard_normal(measured.shape)
            np.save(folder / f"u_{name}.npy", inputs)
            np.save(folder / f"y_{name}.npy", measured)
            entries.append(f"  - {{file: [u_{name}.npy, y_{name}.npy], name: {name}, use: {use}}}\n")
    (folder / "recordings.yaml").write_text(
        f"sample_rate_hz: {RATE:g}\nstart: periodic\ninput: band_limited\n"
        "axes: [time, channel, realisation, period]\n"
        "columns: {voltage: {column: 0, unit: V}}\nports: {voltage_2: {column: 1, unit: V}}\n"
        "outputs: {y_1: {column: 2, unit: m}, y_2: {column: 3, unit: m}}\nrecordings:\n" + "".join(entries),
        encoding="utf-8",
    )
