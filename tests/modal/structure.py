"""A structure of a few modes under periodic forces, integrated by Runge–Kutta; it shares no code with the package.

q̈ + 2ζω q̇ + ω² q = ω² b (u − e(x)),     x = bᵀ q
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE, SIZE, FINE, PERIODS, NOISE = 1000.0, 512, 10, 4, 2e-4
OMEGA = 2.0 * np.pi * np.array([61.0, 102.0, 171.0])
ZETA = np.array([0.02, 0.015, 0.025])
B = np.array([[0.9, 0.5], [0.6, -0.8], [-0.5, 0.6]])
C = np.array([[1.0, 0.7, 0.4], [0.6, -0.9, 0.5]])


def multisines(count: int, amplitude: float, seed: int) -> Array:
    """(count, SIZE, 2) random-phase multisines of equal lines up to 300 Hz."""
    rng = np.random.default_rng(seed)
    lines = np.arange(2, int(300.0 * SIZE / RATE))
    spectrum = np.zeros((count, SIZE // 2 + 1, 2), dtype=complex)
    spectrum[:, lines] = np.exp(2j * np.pi * rng.random((count, lines.size, 2)))
    u = np.fft.irfft(spectrum, SIZE, axis=1)
    return np.asarray(amplitude * u / u.std(axis=1, keepdims=True))


def _push(kind: str, x: Array, v: Array, s: Array) -> Array:
    if kind == "extra_hysteron":
        return np.asarray((np.array([0.05, 0.03, 0.02]) * s).sum(axis=-1))
    if kind == "cubic_stiffness":
        return 0.0003 * x**3
    if kind == "quadratic_drag":
        return 1e-8 * np.abs(v) * v
    return np.zeros_like(x)


def outputs(u: Array, kind: str) -> Array:
    """(count, SIZE, 2) outputs in the last of some periods, all experiments at once."""
    count = len(u)
    spectrum = np.fft.rfft(u, axis=1)
    fine = np.zeros((count, SIZE * FINE + 1, 2), dtype=complex)
    fine[:, : spectrum.shape[1]] = spectrum
    # Two values per step: at its beginning and in its middle.
    dense = np.fft.irfft(fine, 2 * SIZE * FINE, axis=1) * 2 * FINE
    h, r = 1.0 / (RATE * FINE), np.array([0.4, 1.0, 2.5])
    q, v, s = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 2, 3))
    out = np.empty((count, SIZE, 2))

    def slipped(s: Array, moved: Array) -> Array:
        return np.minimum(np.maximum(s + moved[..., None], -r), r)

    def slope(q: Array, v: Array, u: Array, begin: Array, s: Array) -> tuple[Array, Array]:
        x = q @ B
        held = slipped(s, x - begin)
        force = u - _push(kind, x, v @ B, held)
        return v, OMEGA**2 * (force @ B.T - q) - 2.0 * ZETA * OMEGA * v

    for k in range(PERIODS * SIZE * FINE):
        n = k % (SIZE * FINE)
        if n % FINE == 0:
            out[:, n // FINE] = q @ C.T
        a, m, b = dense[:, 2 * n], dense[:, 2 * n + 1], dense[:, (2 * n + 2) % (2 * SIZE * FINE)]
        x = q @ B
        q1, v1 = slope(q, v, a, x, s)
        q2, v2 = slope(q + 0.5 * h * q1, v + 0.5 * h * v1, m, x, s)
        q3, v3 = slope(q + 0.5 * h * q2, v + 0.5 * h * v2, m, x, s)
        q4, v4 = slope(q + h * q3, v + h * v3, b, x, s)
        q, v = q + h / 6.0 * (q1 + 2 * q2 + 2 * q3 + q4), v + h / 6.0 * (v1 + 2 * v2 + 2 * v3 + v4)
        s = slipped(s, q @ B - x)
    return out


def linear_outputs(u: Array) -> Array:
    """The same where nothing is concealed, line by line in closed form."""
    s = 2j * np.pi * np.fft.rfftfreq(SIZE, 1.0 / RATE)[:, None]
    modes = OMEGA**2 * (np.fft.rfft(u, axis=1) @ B.T) / (s**2 + 2.0 * ZETA * OMEGA * s + OMEGA**2)
    return np.fft.irfft(modes @ C.T, SIZE, axis=1)


@cache
def _answered(kind: str, seed: int, levels: tuple[float, ...]) -> tuple[Array, Array]:
    """Five inputs at each amplitude [V] and the outputs [m], computed once a run."""
    u = np.concatenate([multisines(5, a, seed + i) for i, a in enumerate(levels)])
    return u, 1e-6 * (linear_outputs(u) if kind == "none" else outputs(u, kind))


def write_folder(
    folder: Path, kind: str, seed: int, levels: tuple[float, ...] = (0.7, 2.1), held: tuple[float, ...] = ()
) -> None:
    """Four experiments of identification and one of confirmation at each amplitude, two periods each, as arrays.

    Args:
        held: amplitudes all of whose experiments are marked with ``use: confirmation``.
    """
    rng = np.random.default_rng(seed)
    entries = []
    u, y = _answered(kind, seed, levels)
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
