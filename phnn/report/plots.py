"""The traces that the zoomable plots of a page draw: reduced to bins that lose no extreme, packed into json."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.report.document import FitRow
from phnn.report.formatting import finite, ratio
from phnn.report.view import View, error_limits, unscored

Array = NDArray[np.float64]

# Points of a trace on the page: two for each bin. Thirteen recordings of six traces take 1.3 MB.
POINTS = 6000
# Values are stored as whole numbers from 0 to here, over the range of their trace; one more says that there is none.
_TOP = 65534
_ABSENT = _TOP + 1


def samples_per_bin(count: int, points: int = POINTS) -> int:
    """How many samples of a trace of ``count`` share two points; 1 where every sample is a point."""
    return 1 if count <= points else -(-2 * count // points)


def binned(y: Array, width: int) -> Array:
    """The smallest and the largest sample of every ``width``, in the order in which they were recorded.

    Args:
        y: (N,) samples; those that are not finite are passed over.
        width: samples in a bin; 1 leaves the trace as it is.

    Returns:
        (2 ⌈N / width⌉,) values, NaN where a bin holds none.
    """
    if width == 1:
        return np.asarray(y, dtype=float)
    rows = -(-len(y) // width)
    padded = np.full(rows * width, np.nan)
    padded[: len(y)] = y
    blocks = padded.reshape(rows, width)
    bad = ~np.isfinite(blocks)
    ends = np.stack((np.where(bad, np.inf, blocks).argmin(axis=1), np.where(bad, -np.inf, blocks).argmax(axis=1)), 1)
    found = np.take_along_axis(blocks, np.sort(ends, axis=1), axis=1).ravel()
    return np.where(np.isfinite(found), found, np.nan)


def packed(y: Array) -> dict[str, Any]:
    """A trace as whole numbers of 16 bits in base64: ``low + step · number``, and 65535 where there is no value."""
    known = np.isfinite(y)
    low, high = (float(y[known].min()), float(y[known].max())) if known.any() else (0.0, 0.0)
    step = (high - low) / _TOP
    numbers = np.full(len(y), _ABSENT, dtype="<u2")
    numbers[known] = np.rint((y[known] - low) / step) if step > 0.0 else 0
    return {"low": low, "step": step, "data": base64.b64encode(numbers.tobytes()).decode("ascii")}


def plots(view: View, fit: FitRow | None) -> str:
    """What the script of the page needs to draw a recording: output, error and input over one axis of time, as json.

    The text is safe inside a ``script`` element: it holds no ``<``.
    """
    trace = view.trace
    count = len(trace.t)
    width = samples_per_bin(count)
    dt = float(trace.t[-1] - trace.t[0]) / max(count - 1, 1)
    limit, _ = error_limits(view)
    names, levels = view.names, (fit.before, fit.after) if fit else (None, None)
    said = [n if s is None or s.residual_over_noise is None else f"{n} ({ratio(s.residual_over_noise)} × noise)"
            for n, s in zip(names, levels, strict=True)]  # fmt: skip
    outputs = [("measured", "measured", trace.measured), ("before", names[0], trace.before)]
    errors = [("before", said[0], view.error_before)]
    if view.changed:
        outputs.append(("after", names[1], trace.after))
        errors.append(("after", said[1], view.error_after))
    panels = [
        _panel("Output", view.output_label, outputs, view.output.scale, width),
        _panel("Error (measured − model)", f"error ({view.error.name})", errors, view.error.scale, width)
        | {"limit": limit / view.error.scale, "band": 2.0 * (finite(trace.noise) or 0.0) / view.error.scale},
        _panel("Input", view.input_label, [("input", "input", trace.u)], 1.0, width),
    ]
    content = {
        "name": trace.name,
        "start": float(trace.t[0]),
        "step": dt if width == 1 else 0.5 * width * dt,
        "samples": count,
        "width": width,
        "panels": panels,
        "unscored": [[float(trace.t[s.start]), float(trace.t[s.stop - 1])] for s in unscored(trace.scored)],
        "worst": None if view.whole else [float(x) for x in trace.t[view.stretch][[0, -1]]],
    }
    return json.dumps(content, ensure_ascii=True, allow_nan=False).replace("<", "\\u003c")


def _panel(
    title: str, label: str, series: Sequence[tuple[str, str, Array]], scale: float, width: int
) -> dict[str, Any]:
    traces = [{"role": role, "label": name, **packed(binned(y / scale, width))} for role, name, y in series]
    return {"title": title, "label": label, "series": traces}
