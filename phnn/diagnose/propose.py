"""The next recording: the one of a menu on which the members of a class differ most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.refit import Trial
from phnn.effects import Scales
from phnn.errors import SolverFailed
from phnn.recordings.recording import Part, Recording, Start
from phnn.simulate import simulate

Array = NDArray[np.float64]

_SAMPLES = 4000


@dataclass(frozen=True)
class NextExperiment:
    """A recording to make, what it separates, and why."""

    recording: str
    separates: tuple[str, ...]
    why: str


def menu(scales: Scales) -> dict[str, Recording]:
    """Recordings a laboratory can easily make, at the voltage already in use."""
    v = scales.voltage
    hold = np.linspace(0.0, max(10.0 * scales.duration, 10.0), _SAMPLES)
    slow = np.linspace(0.0, 4.0 / (0.2 * scales.slowest), _SAMPLES)
    fast = np.linspace(0.0, 20.0 / (2.0 * scales.fastest), _SAMPLES)
    middle = np.sqrt(scales.slowest * scales.fastest)
    sweep = np.linspace(0.0, 10.0 / middle, _SAMPLES)
    sine = np.sin
    return {
        f"hold: a step to {v:.3g} V held for {hold[-1]:.0f} s": _recording(hold, np.where(hold >= 0.0, v, 0.0)),
        f"slow sine: {0.2 * scales.slowest:.3g} Hz at {v:.3g} V": _recording(
            slow, v * sine(2 * np.pi * 0.2 * scales.slowest * slow)
        ),
        f"fast sine: {2.0 * scales.fastest:.3g} Hz at {0.5 * v:.3g} V": _recording(
            fast, 0.5 * v * sine(2 * np.pi * 2.0 * scales.fastest * fast)
        ),
        f"amplitude sweep: {middle:.3g} Hz growing from 0 to {v:.3g} V": _recording(
            sweep, v * sweep / sweep[-1] * sine(2 * np.pi * middle * sweep)
        ),
        f"offset sine: {middle:.3g} Hz at {0.4 * v:.3g} V around {0.5 * v:.3g} V": _recording(
            sweep, 0.5 * v * np.minimum(1.0, 2 * middle * sweep) + 0.4 * v * sine(2 * np.pi * middle * sweep)
        ),
    }


def _recording(t: Array, u: Array) -> Recording:
    part = Part("menu", 0, t.size, "identification")
    return Recording(
        "menu", t, u, np.zeros_like(t), Start("rest", 0.0), "cubic", (part,), 1.0, "none", np.array([1.0]), None, {}, ""
    )


def propose(members: Sequence[Trial], scales: Scales) -> NextExperiment | None:
    """The menu entry with the largest smallest separation between refitted members, in noise standard deviations."""
    fitted = [t for t in members if t.fit is not None]
    if len(fitted) < 2:
        return None
    best_name, best = "", 0.0
    for name, recording in menu(scales).items():
        try:
            outputs = [simulate(t.fit.setup, recording, 2).y for t in fitted if t.fit is not None]
        except SolverFailed:
            continue
        distances = [
            float(np.std(a - b)) / scales.noise for i, a in enumerate(outputs) for b in outputs[i + 1 :]
        ]  # fmt: skip
        if min(distances) > best:
            best_name, best = name, min(distances)
    names = tuple(t.candidate.effect.name for t in fitted)
    if not best_name:
        return None
    why = f"the refitted models of {', '.join(names)} differ there by at least {best:.2g} × noise (root mean square)"
    return NextExperiment(best_name, names, why)
