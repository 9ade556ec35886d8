"""The view of one recording in pictures and plots: units, labels, names, the stretch that tells most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phnn.report.evidence import Trace
from phnn.report.formatting import Unit, display_unit, quantity
from phnn.report.reduction import telling_stretch

_INPUTS = {"V": "voltage", "N": "force", "A": "current"}


@dataclass(frozen=True)
class View:
    """What all panels and plots of a recording share.

    Attributes:
        error_before, error_after: (N,) measured minus model, SI.
        stretch: samples where the base model is worst; all where the recording is short.
        output, error: display units of the output and of its errors.
        changed: the final model differs from the base model; names: of both models.
    """

    trace: Trace
    error_before: np.ndarray
    error_after: np.ndarray
    stretch: slice
    output: Unit
    error: Unit
    input_label: str
    output_label: str
    output_unit: str
    changed: bool
    names: tuple[str, str]

    @property
    def whole(self) -> bool:
        """The stretch that tells most is the whole recording."""
        return self.stretch == slice(0, len(self.trace.t))


def _largest(*arrays: np.ndarray) -> float:
    values = [float(np.max(np.abs(a[np.isfinite(a)]))) for a in arrays if np.isfinite(a).any()]
    return max(values, default=0.0)


def _spread(trace: Trace) -> float:
    """Size of an error worth an axis: its 99th percentile on scored samples, or the noise."""
    error = (trace.measured - trace.before)[trace.scored]
    error = np.abs(error[np.isfinite(error)])
    return max(float(np.percentile(error, 99.0)) if error.size else 0.0, trace.noise if trace.noise > 0.0 else 0.0)


def view_of(trace: Trace, input_unit: str, output_unit: str) -> View:
    """How a recording is shown; the units are SI units of its channels."""
    output = display_unit(_largest(trace.measured), output_unit, floor=1.0)
    changed = not np.array_equal(trace.before, trace.after, equal_nan=True)
    error_before = trace.measured - trace.before
    return View(
        trace=trace,
        error_before=error_before,
        error_after=trace.measured - trace.after,
        stretch=telling_stretch(trace.u, error_before, trace.scored),
        output=output,
        error=display_unit(_spread(trace), output_unit),
        input_label=f"{_INPUTS.get(input_unit, 'input')} ({input_unit})",
        output_label=f"{'displacement' if output_unit == 'm' else 'output'} ({output.name})",
        output_unit=output_unit,
        changed=changed,
        names=("base model", "final model") if changed else ("base model (nothing added)", ""),
    )


def error_limits(view: View) -> tuple[float, str]:
    """Half the height of the error axis, and a remark where a few lone samples would have flattened all others."""
    usable = view.trace.scored
    errors = np.abs(np.concatenate((view.error_before[usable], view.error_after[usable])))
    errors = errors[np.isfinite(errors)]
    largest = _largest(errors)
    common = float(np.percentile(errors, 99.9)) if errors.size else 0.0
    if common > 0.0 and largest > 3.0 * common:
        beyond = np.fmax(np.abs(view.error_before), np.abs(view.error_after)) > 2.0 * common
        count = int(np.count_nonzero(beyond & usable))
        limit, noun = 2.0 * common, "sample" if count == 1 else "samples"
        remark = f"{count} {noun} beyond, up to {quantity(largest, view.output_unit)}"
    else:
        limit, remark = largest, ""
    return 1.12 * max(limit, 3.0 * view.trace.noise if view.trace.noise > 0.0 else 0.0) or 1.0, remark


def unscored(scored: np.ndarray) -> list[slice]:
    """Stretches that were not scored, none where nothing was."""
    if not scored.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([True], scored, [True])).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
