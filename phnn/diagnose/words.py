"""Words and pictures of the function that was fitted at the location of a mismatch, in the system's own units.

The words and units of a system's domain come from the units of its output and its input. A curve is described by its
character: odd or even, threshold, growth; a memory by the times in which it forgets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import FORCE, GROUPS, OUTPUT, PARAMETER, VOLTAGE, Location
from phnn.effects import Scales
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.network.elements import Network
from phnn.network.roles import measured_displacement
from phnn.setup import Setup
from phnn.units import quantity

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
# Units of pictures whose sizes are said in the unit that suits.
_LENGTHS = {"µm": 1e-6, "nm": 1e-9}
# Share of the work done either way that must be left over for a force to be called dissipative, or active.
_LOSSY = 0.2
# Below this part of the range a curve is taken as the straight line that base parameters can absorb.
_INNER = 0.3
# Share of a curve's square that the lesser of its odd and even parts, or of its sides, may have and be left out.
_LITTLE, _OTHER_SIDE = 0.1, 0.05
# How much less an onset or a levelling off must leave than a power, which has no scale of its own.
_CLEARLY = 0.5
# A memory that forgets from a tenth to nine tenths over more than this factor of time has no one time constant.
_DECADES = 100.0
# Points of a curve, and at most of a cycle.
_POINTS, _CYCLE = 241, 600


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
        """Whether the output is a displacement [m]."""
        return self.output_unit == "m"

    @property
    def rate_unit(self) -> str:
        """SI unit of the rate."""
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
    """Return the learned function of the best group of a location; None where there is none to draw."""
    group, scales, network = GROUPS[location.group], linearised.scales, linearised.fit.setup.network
    if not location.weights.size or (group.static is None and group.enters == OUTPUT):
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
    if group.static is None:
        # Along the recording with the largest motion, at most one period.
        trajectory = max(linearised.trajectories, key=lambda t: float(np.ptp(t.y)))
        functions = group.functions(trajectory, scales)
        elapsed, period = np.cumsum(trajectory.h), trajectory.recording.period
        first = int(np.searchsorted(elapsed, elapsed[-1] - period)) if period else 0
        drawn = slice(first, functions.shape[0], max(1, (functions.shape[0] - first) // _CYCLE))
        q, axis = _shown(trajectory.mid_displacement[drawn], "displacement", words)
        return Picture(q, unit * (functions[drawn] @ location.weights[: functions.shape[1]]), None, axis, label, title)
    x = _axis(group.axis, scales)
    functions = group.static(x, scales)
    # A parameter group has one block of weights a parameter; the first one is drawn.
    count = functions.shape[1]
    weights, covariance = location.weights[:count], location.weight_covariance[:count, :count]
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", functions, covariance, functions), 0.0))
    shown, axis = _shown(x, group.axis, words)
    return Picture(shown, unit * (functions @ weights), unit * std, axis, label, title)


def learned_picture(linearised: LinearisedFit, location: Location, learned: Setup) -> Picture:
    """Return the law of a learned spring or damper, on the axis of the location's own functions.

    Args:
        learned: the setup with it.
    """
    group, base, values = GROUPS[location.group], linearised.fit.setup.network, learned.values()
    # (M,) displacement [m] of a spring, velocity [m/s] of a damper.
    x = _axis(group.axis, linearised.scales)
    force = np.zeros_like(x)
    for s in (s for s in learned.network.storages if s not in base.storages):
        force -= np.asarray(STORAGE_LAWS[s.law].mean_effort(x, x, *(values[n] for n in s.parameters)))
    for r in (r for r in learned.network.resistors if r not in base.resistors):
        force -= np.asarray(RESISTOR_LAWS[r.law].flow(x, 0.0 * x, *(values[n] for n in r.parameters)))
    words = vocabulary_of(base)
    shown, axis = _shown(x, group.axis, words)
    label = "force on the mass [N]" if words.mechanical else words.label("effort")
    return Picture(shown, force, None, axis, label, f"learned one-port: {location.detail}")


def is_effort(location: Location) -> bool:
    """Return whether what was fitted at a location acts as a force: without an anchor its size is known up to one
    factor."""
    return GROUPS[location.group].enters == FORCE


def missing_force(linearised: LinearisedFit, location: Location, index: int) -> Array | None:
    """Return the effort (n,) that a located mismatch asks for along one trajectory; None where it is not a force."""
    if not is_effort(location):
        return None
    functions = GROUPS[location.group].functions(linearised.trajectories[index], linearised.scales)
    return np.asarray(linearised.scales.stiffness * linearised.scales.displacement * (functions @ location.weights))


def _shown(x: Array, axis: str, words: Vocabulary) -> tuple[Array, str]:
    """An axis in the words and units of the system; displacements in micrometres."""
    name = axis.partition(" [")[0]
    if name == "displacement" and words.mechanical:
        return 1e6 * x, f"{words.output} [µm]"
    own = {"displacement": "output", "velocity": "rate", "voltage": "source"}
    return x, words.label(own[name]) if name in own else axis


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
    own = asdict(vocabulary_of(network))
    acts = f"What the functions fitted there make is {_ACTS[group.enters].format(**own)}"
    if varied := group.varied(network):
        acts += f" {', '.join(varied)}"
    drawn = picture(linearised, location)
    if group.static is None or drawn is None:
        past = (group.kind.history or "on the past").format(**own)
        return f"{acts} that depends {past}.{_work(linearised, location)}"
    if group.axis.startswith("time after"):
        return f"{acts} that depends on the past. {memory_in_words(drawn.x, drawn.y)}"
    if group.axis.startswith("time"):
        return f"{acts} that depends on time alone, as a drift does."
    y, variable = drawn.y, drawn.x_label.partition(" [")[0]
    if not group.axis.startswith("velocity"):
        # A straight line is a stiffness or a gain, and the base has these; a damper's line is part of its law.
        inner = np.abs(drawn.x) <= _INNER * np.abs(drawn.x).max()
        y = np.asarray(y - np.polyval(np.polyfit(drawn.x[inner], y[inner], 1), drawn.x))
    return f"{acts} that depends on the {variable}. {curve_in_words(drawn.x, y, drawn.x_label, drawn.y_label)}"


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


def curve_in_words(x: Array, y: Array, x_label: str, y_label: str) -> str:
    """Return the character of a curve as a sentence: on which side it acts, odd or even, and how it grows.

    Args:
        x: (M,) symmetric about zero, increasing; y: (M,).
        x_label, y_label: their names, each with its unit in brackets.
    """
    if not np.any(y):
        return "Its strengths are all zero."
    right, variable = x >= 0.0, x_label.partition(" [")[0]
    odd, even = 0.5 * (y - y[::-1]), 0.5 * (y + y[::-1])
    share = float(even @ even / (y @ y))
    up, down = y[right], y[::-1][right]
    above, below = float(up @ up), float(down @ down)
    if min(above, below) < _OTHER_SIDE * (above + below):
        parity = f"acts for {'positive' if above > below else 'negative'} {variable} only"
        half = up if above > below else down
    elif share > 1.0 - _LITTLE:
        parity, half = f"is even in the {variable}", even[right]
    elif share < _LITTLE:
        parity, half = f"is odd in the {variable}", odd[right]
    else:
        parity = f"is neither odd nor even in the {variable} ({100 * share:.0f} % of its square is even)"
        half = down if below > above else up
    kind, at = shape_of(x[right] / x[-1], half)
    grows = {1.0: "in proportion", 2.0: "with the square", 3.0: "with the cube"}.get(at, f"with the power {at:g}")
    reach, size = float(x[-1]), float(np.abs(y).max())
    growth = {
        "power": f"is there from the start and grows {grows}",
        "onset": f"sets in at {_spoken(at * reach, x_label)} and grows from there",
        "level": f"levels off beyond {_spoken(at * reach, x_label)}",
    }[kind]
    return f"It {parity}, {growth}; at {_spoken(reach, x_label)} it has reached {_spoken(size, y_label)}."


def _spoken(value: float, label: str) -> str:
    """Return a value of a curve with the unit in its label; lengths in the unit that suits."""
    unit = label.partition(" [")[2].rstrip("]")
    if unit in _LENGTHS:
        return quantity(value * _LENGTHS[unit], "m")
    return quantity(value, unit) if unit else f"{value:.3g}"


def shape_of(s: Array, y: Array) -> tuple[str, float]:
    """Return the kind of function ``f`` that a half curve ``y ≈ a f(s)`` follows best, with its parameter ``p``.

    ``"power"``: ``s^p``; ``"onset"``: ``max(s − p, 0)``; ``"level"``: ``tanh(s/p)``.

    Args:
        s: (M,) from 0 to 1; y: (M,).
    """
    shapes = {("power", p): s**p for p in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)}
    shapes |= {("onset", float(p)): np.maximum(s - p, 0.0) for p in np.arange(0.1, 0.96, 0.025)}
    shapes |= {("level", float(p)): np.tanh(s / p) for p in np.geomspace(1e-3, 0.5, 25)}
    left = {key: float(np.sum((y - f * (f @ y) / max(float(f @ f), 1e-300)) ** 2)) for key, f in shapes.items()}
    power, other = (min((k for k in left if (k[0] == "power") is its), key=left.__getitem__) for its in (True, False))
    return other if left[other] < _CLEARLY * left[power] else power


def memory_in_words(t: Array, y: Array) -> str:
    """Return how a response to a step decays, as a sentence: after which times a tenth, half and most of it are gone.

    Args:
        t: (M,) [s], increasing; y: (M,).
    """
    if not np.any(y):
        return "Its strengths are all zero."
    left = np.abs(y) / max(float(np.abs(y[0])), 1e-300)
    if left.max() > 1.5 or left[-1] > 0.5:
        return "Its response to a step does not simply decay within the recordings."
    # What the recordings are too short to see forgotten counts as gone with their end.
    gone = [float(t[np.argmax(left <= level)] if (left <= level).any() else t[-1]) for level in (0.9, 0.5, 0.1)]
    how = "over decades of time" if gone[2] > _DECADES * gone[0] else "as with one time constant"
    tenth, half, most = (quantity(x, "s") for x in gone)
    return f"It forgets a step {how}: a tenth of it in {tenth}, half in {half}, most in {most}."
