"""Words and pictures of the function that was fitted at the location of a mismatch, in the system's own units.

The words and units of a system's domain come from the units of its output and its input. What it is like, its picture
shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.formula import force_of
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import FORCE, GROUPS, OUTPUT, PARAMETER, VOLTAGE, Location
from phnn.effects import Scales
from phnn.network.elements import Network
from phnn.network.roles import measured_displacement
from phnn.setup import Setup

Array = NDArray[np.float64]

# By the SI unit of the output: what it is called, its rate, what acts on it, and the unit of that.
_OUTPUTS: Mapping[str, tuple[str, str, str, str]] = {
    "m": ("displacement", "velocity", "force", "N"),
    "rad": ("angle", "angular velocity", "torque", "N m"),
    "C": ("charge", "current", "voltage", "V"),
    "m³": ("volume", "flow", "pressure", "Pa"),
}
_UNKNOWN = ("output", "rate of the output", "effort", "")
_SOURCES: Mapping[str, str] = {
    "V": "voltage", "A": "current", "N": "force", "N m": "torque", "Pa": "pressure", "m³/s": "flow",
    "m/s": "velocity", "rad/s": "angular velocity",
}  # fmt: skip
_ACTS = {
    FORCE: "a missing {effort}",
    VOLTAGE: "a missing {source}",
    OUTPUT: "a missing {output} at the sensor",
    PARAMETER: "a change of parameters",
}
# Share of the work done either way that must be left over for a force to be called dissipative, or active.
_LOSSY = 0.2
# Points of a curve.
_POINTS = 241


@dataclass(frozen=True)
class Vocabulary:
    """What the variables of a network are called.

    Attributes:
        output: what is measured; rate: its rate of change; effort: what acts on it; source: what drives the network.
        output_unit, source_unit: SI; effort_unit: SI, empty where it is not known.
    """

    output: str
    rate: str
    effort: str
    source: str
    output_unit: str
    effort_unit: str
    source_unit: str

    @property
    def mechanical(self) -> bool:
        """Return whether the output is a displacement [m]."""
        return self.output_unit == "m"

    @property
    def rate_unit(self) -> str:
        """Return the SI unit of the rate."""
        return "1/s" if self.output_unit == "1" else f"{self.output_unit}/s"

    def label(self, variable: str) -> str:
        """Return what ``output``, ``rate``, ``effort`` or ``source`` is called, with its SI unit."""
        name, unit = getattr(self, variable), getattr(self, f"{variable}_unit")
        return f"{name} [{unit}]" if unit else name


def vocabulary_of(network: Network) -> Vocabulary:
    """Return the words of a network; those of no domain where its units belong to none.

    A network without a port is said to be driven by its input. Where a motion is imposed and its force is measured, the
    words are those of the motion.
    """
    moving = measured_displacement(network)
    unit = next((s.unit for s in network.storages if s.name == moving), "1").replace("m3", "m³")
    output, rate, effort, effort_unit = _OUTPUTS.get(unit, _UNKNOWN)
    source_unit = network.ports[0].unit.replace("m3", "m³") if network.ports else "1"
    return Vocabulary(output, rate, effort, _SOURCES.get(source_unit, "input"), unit, effort_unit, source_unit)


@dataclass(frozen=True)
class Picture:
    """A learned function with labels and units.

    Attributes:
        x, y: (M,); std: (M,) one standard error, None for the law of a learned element.
    """

    x: Array
    y: Array
    std: Array | None
    x_label: str
    y_label: str
    title: str


def picture(linearised: LinearisedFit, location: Location) -> Picture | None:
    """Return the learned function of the best group of a location; None where it is no function of one variable."""
    group, scales, network = GROUPS[location.group], linearised.scales, linearised.fit.setup.network
    if not location.weights.size or group.static is None:
        return None
    words = vocabulary_of(network)
    length, small = (1e9, "nm") if words.mechanical else (1.0, words.output_unit)
    unit, label = {
        FORCE: (scales.stiffness * scales.displacement, f"missing {words.label('effort')}"),
        VOLTAGE: (scales.voltage, f"missing {words.label('source')}"),
        OUTPUT: (length * scales.displacement, f"missing {words.output} [{small}]"),
        PARAMETER: (1.0, " of ".join(filter(None, ["relative change", ", ".join(group.varied(network))]))),
    }[group.enters]
    title = f"{location.name}: {location.detail}"
    x = _axis(group.axis, scales)
    functions = group.static(x, scales)
    # A parameter group has one block of weights a parameter; the first one is drawn.
    count = functions.shape[1]
    weights, covariance = location.weights[:count], location.weight_covariance[:count, :count]
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", functions, covariance, functions), 0.0))
    shown, axis = _shown(x, group.axis, words)
    return Picture(shown, unit * (functions @ weights), unit * std, axis, label, title)


def learned_picture(linearised: LinearisedFit, location: Location, learned: Setup, strengths: Sequence[str]) -> Picture:
    """Return the law of a learned spring or damper, on the axis of the location's own functions.

    Args:
        learned: the setup with it; strengths: its parameters.
    """
    axis, words = GROUPS[location.group].axis, vocabulary_of(linearised.fit.setup.network)
    # (M,) displacement [m] of a spring, velocity [m/s] of a damper.
    x = _axis(axis, linearised.scales)
    state = (x, 0.0 * x) if axis.startswith("displacement") else (0.0 * x, x)
    force = -force_of(learned, strengths)(*state)[:, 0]
    shown, name = _shown(x, axis, words)
    label = "force on the mass [N]" if words.mechanical else words.label("effort")
    return Picture(shown, force, None, name, label, f"learned one-port: {location.detail}")


def is_effort(location: Location) -> bool:
    """Return whether a location's fit acts as a force: without an anchor its size is known up to a factor."""
    return GROUPS[location.group].enters == FORCE


def _shown(x: Array, axis: str, words: Vocabulary) -> tuple[Array, str]:
    """Return an axis in the words and units of the system; displacements in micrometres."""
    name = axis.partition(" [")[0]
    if name == "displacement" and words.mechanical:
        return 1e6 * x, f"{words.output} [µm]"
    role = {"displacement": "output", "velocity": "rate", "voltage": "source"}
    return x, words.label(role[name]) if name in role else axis


def _axis(axis: str, scales: Scales) -> Array:
    if axis.startswith("time after"):
        return np.geomspace(0.1 / scales.fastest, scales.duration, _POINTS)
    if axis.startswith("time"):
        return np.linspace(0.0, scales.duration, _POINTS)
    reach = {"displacement": scales.displacement, "velocity": scales.velocity, "voltage": scales.voltage}
    return np.linspace(-1.0, 1.0, _POINTS) * reach[axis.split()[0]]


def fitted_in_words(linearised: LinearisedFit, location: Location) -> str:
    """Return the fitted combination of the location's own functions in words; empty where none was fitted."""
    group, network = GROUPS[location.group], linearised.fit.setup.network
    if not np.any(location.weights):
        return ""
    words = vocabulary_of(network)
    vocabulary = asdict(words)
    acts = f"What the functions fitted there make is {_ACTS[group.enters].format(**vocabulary)}"
    if varied := group.varied(network):
        acts += f" {', '.join(varied)}"
    if group.static is None:
        past = (group.kind.history or "on the past").format(**vocabulary)
        return f"{acts} that depends {past}.{_work(linearised, location)}"
    if group.axis.startswith("time after"):
        return f"{acts} that depends on the past."
    if group.axis.startswith("time"):
        return f"{acts} that depends on time alone, as a drift does."
    variable = _shown(_axis(group.axis, linearised.scales), group.axis, words)[1].partition(" [")[0]
    return f"{acts} that depends on the {variable}."


def _work(linearised: LinearisedFit, location: Location) -> str:
    """Return whether the fitted force takes energy from the motion, over all recordings; empty for no force."""
    group = GROUPS[location.group]
    if group.enters != FORCE:
        return ""
    forces = [(t, group.functions(t, linearised.scales) @ location.weights) for t in linearised.trajectories]
    powers = np.concatenate([t.h * force * t.velocity for t, force in forces])
    share = float(powers.sum()) / max(float(np.abs(powers).sum()), 1e-300)
    if share < -_LOSSY:
        return " Over the recordings it takes energy away: it is dissipative."
    if share > _LOSSY:
        return " Over the recordings it feeds energy in: no passive element does that by itself."
    return " Over the recordings it gives back about what it takes: it is nearly conservative."
