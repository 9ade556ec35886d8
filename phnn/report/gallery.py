"""All figures of one report, numbered as the page shows them."""

from __future__ import annotations

import base64
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.report.document import Document, FitRow
from phnn.report.evidence import Evidence, Shares, Trace
from phnn.report.figures import (
    View,
    draw_fingerprint,
    draw_ledger,
    draw_locations,
    draw_overview,
    draw_picture,
    draw_recording,
    error_limits,
    extremes,
    unscored,
    view_of,
)
from phnn.report.figures.style import RC, Drawing, png, svg
from phnn.report.formatting import finite, listing, ratio, words
from phnn.rescue import needed
from phnn.results import file_name

Array = NDArray[np.float64]

# Points of a trace on the page: two for each bin. Thirteen recordings of six traces take 1.3 MB.
POINTS = 6000
# Values are stored as whole numbers from 0 to here, over the range of their trace; one more says that there is none.
_TOP = 65534
_ABSENT = _TOP + 1


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
    found = np.asarray(y, dtype=float)[np.sort(extremes(y, width), axis=1).ravel()]
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
    # So many samples share two points; 1 where every sample is a point.
    width = 1 if count <= POINTS else -(-2 * count // POINTS)
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


_MOST_DRAWN = 12  # recordings of each kind that get a figure of their own; the table has them all


@dataclass(frozen=True)
class Gallery:
    """The figures in the order of the page; ``None`` where there is nothing to draw."""

    locations: Drawing | None
    picture: Drawing | None
    overview: Drawing | None
    held_out: tuple[Drawing, ...]
    identification: tuple[Drawing, ...]
    ledger: Drawing | None
    omitted: int  # recordings without a figure of their own
    fingerprints: tuple[Drawing | None, ...] = ()  # of the named elements, in their order

    @property
    def drawings(self) -> tuple[Drawing, ...]:
        """All of them."""
        single = [self.locations, self.picture, self.overview]
        rest = [*self.held_out, *self.identification, self.ledger, *self.fingerprints]
        return tuple(drawing for drawing in [*single, *rest] if drawing is not None)


def _drawing(
    numbers: Iterator[int],
    stem: str,
    title: str,
    alt: str,
    draw: Callable[[], Figure],
    shown: Callable[[], str] | None = None,
) -> Drawing | None:
    """Draw and number a figure; one of a whole recording has plots in place of an SVG, which would be ten times as
    large. None where it cannot be drawn."""
    name = file_name(f"{next(numbers):02d}-{stem}", ".png")

    def drawn() -> Drawing:
        figure, traces = draw(), "" if shown is None else shown()
        return Drawing(name, title, alt, png(figure), b"" if traces else svg(figure), traces)

    return needed(f"figure {name}", drawn, None)


def _recordings(
    traces: Sequence[Trace], kind: str, document: Document, numbered: Callable[..., Drawing | None]
) -> tuple[tuple[Drawing, ...], int]:
    pairs = [(trace, document.fit(trace.name)) for trace in traces]
    pairs.sort(key=lambda pair: (pair[1].before.residual_over_noise or 0.0) if pair[1] else 0.0, reverse=True)
    drawings: list[Drawing | None] = []
    units = document.input_unit, document.output_unit
    figures: list[Figure | None] = [None]

    def draw(trace: Trace, fit: FitRow | None) -> Figure:
        # One figure serves all; what failed half way is not used again.
        reused, figures[0] = figures[0], None
        figure = draw_recording(trace, fit, *units, reused=reused)
        figures[0] = figure
        return figure

    def shown(trace: Trace, fit: FitRow | None) -> str:
        return plots(view_of(trace, *units), fit)

    for trace, fit in pairs[:_MOST_DRAWN]:
        alt = f"{trace.name}: measured and modelled output in time and as a loop, error in time, spectrum of the error"
        stem, both = f"{kind}-{trace.name}", (trace, fit)
        drawings.append(numbered(stem, trace.name, alt, partial(draw, *both), partial(shown, *both)))
    able = tuple(d for d in drawings if d is not None)
    return able, len(traces) - len(able)


def draw_gallery(document: Document, evidence: Evidence, shares: Sequence[Shares]) -> Gallery:
    """Draw everything that the document and the evidence hold."""
    numbered = partial(_drawing, itertools.count(1))
    location, curves = document.location, evidence.curves
    with rc_context(RC):
        locations = picture = overview = ledger = None
        if location is not None and any(score is not None for _, score in location.scores):
            alt = f"Scores of the locations; best: {words(location.name)}"
            locations = numbered("locations", "Which location explains it", alt, partial(draw_locations, location))
        if curves:
            alt = f"Learned curves: {listing(curve.title for curve in curves)}"
            picture = numbered("picture", "What happens there", alt, partial(draw_picture, curves))
        ratios = [s.residual_over_noise for row in document.fits for s in (row.before, row.after)]
        if len(document.fits) > 1 and any(ratio is not None for ratio in ratios):
            alt = "Residual over noise of every recording, before and after; held-out recordings on top"
            overview = numbered("overview", "Before and after", alt, partial(draw_overview, document.fits))
        held_out, left = _recordings([t for t in evidence.traces if t.held_out], "held-out", document, numbered)
        others, more = _recordings([t for t in evidence.traces if not t.held_out], "identification", document, numbered)
        if shares:
            alt = "Shares of the supplied energy: dissipated by each element, stored, and the work of the missing force"
            ledger = numbered("ledger", "Energy", alt, partial(draw_ledger, shares))
        fingerprints = tuple(
            numbered(
                f"fingerprint-{s.effect}",
                words(s.effect),
                f"What the base model and the final model leave against the {s.seen.x_label}",
                partial(draw_fingerprint, s.seen),
            )
            if s.seen is not None
            else None
            for s in evidence.supports
        )
    return Gallery(locations, picture, overview, held_out, others, ledger, left + more, fingerprints)
