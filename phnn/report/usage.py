"""Lines of Python that load the model of a run and simulate, to be copied from its page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phnn.report.evidence import Trace
from phnn.report.formatting import finite

# What the example simulates where no recording says anything.
_PERIODS, _SAMPLES = 3.0, 2000


def usage(traces: Sequence[Trace], input_unit: str, output_unit: str) -> str:
    """A short program: a sine as large and as long as the first recording, simulated with the model beside the page."""
    amplitude, seconds = _size(traces)
    lines = (
        ('model = phnn.load("model")', "the folder model/ beside this page"),
        (f"t = np.linspace(0.0, {seconds:.4g}, {_SAMPLES + 1})", "time [s]"),
        (f"u = {amplitude:.4g} * np.sin(2.0 * np.pi * {_PERIODS / seconds:.4g} * t)", f"input [{input_unit}]"),
        ("y = model.simulate(t, u)", f"output [{output_unit}]"),
    )
    width = max(len(code) for code, _ in lines)
    shown = "".join(f"{code:{width}}  # {remark}\n" for code, remark in lines)
    return f"import numpy as np\nimport phnn\n\n{shown}print(y.min(), y.max())\n"


def _size(traces: Sequence[Trace]) -> tuple[float, float]:
    """Largest input and duration of the first recording; 1 and 1 s where there is none."""
    if not traces or len(traces[0].t) < 2:
        return 1.0, 1.0
    first = traces[0]
    amplitude = finite(np.nanmax(np.abs(first.u))) if np.isfinite(first.u).any() else None
    seconds = finite(first.t[-1] - first.t[0])
    return amplitude or 1.0, seconds or 1.0
