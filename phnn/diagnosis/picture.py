"""The picture at the location: the learned local function against its own variable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import FORCE, GROUPS, OUTPUT, PARAMETER, VOLTAGE, Location
from phnn.diagnosis.learn import learned_force
from phnn.diagnosis.vocabulary import Vocabulary, vocabulary_of
from phnn.effects import Scales
from phnn.setup import Setup

Array = NDArray[np.float64]

_POINTS = 241


@dataclass(frozen=True)
class Picture:
    """A learned function (or the missing signal along one cycle) with labels and units.

    Attributes:
        x, y: (M,); std: (M,) one standard error, None for a cycle.
    """

    x: Array
    y: Array
    std: Array | None
    x_label: str
    y_label: str
    title: str


def picture(linearised: LinearisedFit, location: Location) -> Picture | None:
    """The learned function of the best group of a location."""
    group = GROUPS[location.group]
    if not location.weights.size:
        return None
    scales, varied = linearised.scales, group.varied(linearised.fit.setup.network)
    words = vocabulary_of(linearised.fit.setup.network)
    length, small = (1e9, "nm") if words.mechanical else (1.0, words.output_unit)
    unit, label = {
        FORCE: (scales.stiffness * scales.displacement, f"missing {_labelled(words.effort, words.effort_unit)}"),
        VOLTAGE: (scales.voltage, f"missing {_labelled(words.source, words.source_unit)}"),
        OUTPUT: (length * scales.displacement, f"missing {_labelled(words.output, small)}"),
        PARAMETER: (1.0, " ".join(["relative change", *(["of", ", ".join(varied)] if varied else [])])),
    }[group.enters]
    title = f"{location.name}: {location.detail}"
    if group.static is None:
        return _cycle(linearised, location, unit, label, title)
    x = _axis(group.axis, scales)
    functions = group.static(x, scales)
    # A parameter group has one block of weights a parameter; the first one is drawn.
    count = functions.shape[1]
    weights, covariance = location.weights[:count], location.weight_covariance[:count, :count]
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", functions, covariance, functions), 0.0))
    shown, axis = _shown(x, group.axis, words)
    return Picture(shown, unit * (functions @ weights), unit * std, axis, label, title)


def learned_picture(linearised: LinearisedFit, location: Location, learned: Setup) -> Picture:
    """The law of the learned one-port, on the axis of the location's own functions.

    Args:
        learned: the setup with it.
    """
    group, scales = GROUPS[location.group], linearised.scales
    x = _axis(group.axis, scales)
    force = learned_force(linearised.fit.setup, learned, x, scales.displacement)
    words = vocabulary_of(linearised.fit.setup.network)
    shown, axis = _shown(x, group.axis, words)
    label = "force on the mass [N]" if words.mechanical else _labelled(words.effort, words.effort_unit)
    return Picture(shown, force, None, axis, label, f"learned one-port: {location.detail}")


def _labelled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _shown(x: Array, axis: str, words: Vocabulary) -> tuple[Array, str]:
    """An axis in the words and units of the system; displacements in micrometres."""
    name = axis.partition(" [")[0]
    if name == "displacement":
        return (
            (1e6 * x, f"{words.output} [µm]") if words.mechanical else (x, _labelled(words.output, words.output_unit))
        )
    if name == "velocity":
        return x, _labelled(words.rate, words.rate_unit)
    return (x, _labelled(words.source, words.source_unit)) if name == "voltage" else (x, axis)


def _axis(axis: str, scales: Scales) -> Array:
    if axis.startswith("time after"):
        return np.geomspace(0.1 / scales.fastest, scales.duration, _POINTS)
    if axis.startswith("time"):
        return np.linspace(0.0, scales.duration, _POINTS)
    reach = {"displacement": scales.displacement, "velocity": scales.velocity, "voltage": scales.voltage}
    return np.linspace(-1.0, 1.0, _POINTS) * reach[axis.split()[0]]


def _cycle(linearised: LinearisedFit, location: Location, unit: float, label: str, title: str) -> Picture | None:
    """The missing signal against the displacement along the recording with the largest motion."""
    group = GROUPS[location.group]
    if group.enters == OUTPUT:
        return None
    trajectory = max(linearised.trajectories, key=lambda t: float(np.ptp(t.y)))
    functions = group.functions(trajectory, linearised.scales)
    signal = unit * (functions @ location.weights[: functions.shape[1]])
    last = signal.size
    if trajectory.recording.period:
        elapsed = np.cumsum(trajectory.h)
        last = int(np.searchsorted(elapsed, elapsed[-1] - trajectory.recording.period))
        window = slice(last, signal.size)
    else:
        window = slice(0, last)
    step = max(1, (window.stop - window.start) // 600)
    q = trajectory.mid_displacement[window][::step]
    shown, axis = _shown(q, "displacement [m]", vocabulary_of(linearised.fit.setup.network))
    return Picture(shown, signal[window][::step], None, axis, label, title)


def is_effort(location: Location) -> bool:
    """Whether what was fitted at a location acts as a force: without an anchor its size is known up to one factor."""
    return GROUPS[location.group].enters == FORCE


def missing_force(linearised: LinearisedFit, location: Location, index: int) -> Array | None:
    """(n,) effort that a located mismatch asks for along one trajectory; None where it is not a force."""
    group = GROUPS[location.group]
    if group.enters != FORCE:
        return None
    functions = group.functions(linearised.trajectories[index], linearised.scales)
    return np.asarray(linearised.scales.stiffness * linearised.scales.displacement * (functions @ location.weights))
