"""An output that the sensor has clipped, and nobody has said so."""

from __future__ import annotations

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings.sensor import PLAIN, Sensor
from phnn.recordings.table import Where
from phnn.signals.quantisation import quantisation_step

LARGEST_CLIPPED_SHARE = 0.02
SHORTEST_CLIPPED_RUN = 5


def not_clipped(u: np.ndarray, y: np.ndarray, label: str, factor: float, where: Where, sensor: Sensor = PLAIN) -> None:
    """Refuse an output stuck at its exact extreme while the input moves on (a sensor out of range).

    A run counts where it is 5 samples or longer, where the input moves during it, and where a parabola through
    the samples on both sides of it passes well beyond the extreme: a resolved reversal that the sensor merely
    quantises does not. A play, which comes to its plateau gently and leaves it steeply, is no clipping either.
    ``factor`` turns the file's numbers into SI. Samples at a stated limit of the sensor are data.
    """
    step = quantisation_step(y)
    known = sensor.at_limit(y)
    for extreme, name in ((float(y.max()), "largest"), (float(y.min()), "smallest")):
        if known[y == extreme].any():
            continue
        runs = [run for run in _runs(y == extreme) if _is_clipped(u, y, run, step)]
        stuck = sum(last - first for first, last in runs)
        if stuck > LARGEST_CLIPPED_SHARE * y.size:
            raise InputRefused(
                f"{where}: {label}, {where.row(runs[0][0])}: clipped, {stuck} samples ({stuck / y.size:.1%}) sit "
                f"exactly at the {name} value {extreme / factor:.6g} while the input moves on: record again within the "
                f"sensor's range, or say in recordings.yaml where it ends, sensor: {{saturates: [LEAST, LARGEST]}}"
            )


def _runs(stuck: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], stuck.astype(int), [0]))))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(first, last) for first, last in pairs if last - first >= SHORTEST_CLIPPED_RUN]


def _is_clipped(u: np.ndarray, y: np.ndarray, run: tuple[int, int], step: float) -> bool:
    first, last = run
    side = max(4, (last - first) // 2)
    if first < side or last + side > y.size:
        return False  # nothing on one side to judge by
    least = max(3.0 * step, 5e-4 * float(np.ptp(y)))
    inside = u[first:last]
    share = float(np.quantile(inside, 0.9) - np.quantile(inside, 0.1)) / max(float(np.ptp(u)), 1e-300)
    if share * float(np.ptp(y)) < least:
        return False
    near = max(4, side // 4)
    arrival, departure = abs(y[first] - y[first - near]), abs(y[last + near - 1] - y[last - 1])
    if arrival < 0.4 * departure:
        return False
    k = np.r_[first - side : first, last : last + side]
    middle = 0.5 * (first + last - 1)
    parabola = np.polyfit(k - middle, y[k], 2)
    overshoot = np.abs(np.polyval(parabola, np.arange(first, last) - middle) - y[first])
    return float(overshoot.max()) > least
