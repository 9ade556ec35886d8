"""nonlinear_benchmarks: ``Input_output_data``, which has a sampling time and no units."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.recordings.adapters.given import Given, plain, where_of
from phnn.recordings.table import Table
from phnn.results import printable

_MODULE = "nonlinear_benchmarks.utilities"


def is_benchmark(data: object) -> bool:
    """Whether an object is an ``Input_output_data``."""
    module = sys.modules.get(_MODULE)
    return module is not None and isinstance(data, module.Input_output_data)


def given_benchmark(data: Any, names: tuple[str, str], name: str = "", use: str | None = None) -> Given:
    """Input and output of a benchmark; several of them are called ``u[0]``, ``y[0]``, ….

    Args:
        names: of a single input and a single output, as the setup calls them.

    Raises:
        InputRefused: there is no sampling time, or the arrays are not (samples,) or (samples, channels).
    """
    where = where_of(data, name or str(data.name))
    interval = plain(data.sampling_time)
    if not isinstance(interval, int | float) or not interval > 0.0:
        raise InputRefused(
            f"{where}: sampling_time is {interval!r:.40}: set it to the interval between samples in seconds"
        )
    columns = _channels(data.u, names[0], "u", where) | _channels(data.y, names[1], "y", where)
    table = Table(where, tuple(columns), tuple(columns.values()))
    return Given(name or printable(str(data.name)), table, use=use, sample_rate_hz=1.0 / interval)


def _channels(values: Any, single: str, several: str, where: object) -> dict[str, np.ndarray]:
    array = np.asarray(values)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim == 1:
        return {single: array}
    if array.ndim != 2 or array.shape[1] > LIMITS.columns:
        raise InputRefused(f"{where}: {several} has the shape {array.shape}: give (samples,) or (samples, channels)")
    return {f"{several}[{i}]": column for i, column in enumerate(array.T)}
