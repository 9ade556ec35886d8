"""Words and pictures of the function that was fitted at the location of a mismatch, in the system's own units.

The words and units of a system's domain come from the units of its output and its input. A curve is described by its
character: odd or even, threshold, growth; a memory by the times in which it forgets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import FORCE, GROUPS, OUTPUT, PARAMETER, VOLTAGE, Group, Location
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
        mechanical: the output is a displacement [m].
    """

    output: str
    rate: str
    effort: str
    source: str
    output_unit: str
    effort_unit: str
    source_unit: str
    mechanical: bool

    @property
    def rate_unit(self) -> str:
        """SI unit of the rate."""
        return "1/s" if self.output_unit == "1" else f"{self.output_unit}/s"


def vocabulary_of(network: Network) -> Vocabulary:
    """Return the words of a network; those of no domain where its units belong to none.

    A network without a port is said to be driven by its input. Where a motion is imposed and its force is measured, the
    words are those of the motion.
    """
    moving = measured_displacement(network)
    unit = next((s.unit for s in network.storages if s.name == moving), "1").replace("m3", "m³")
    output, rate, effort, effort_unit = _OUTPUTS.get(unit, _UNKNOWN)
    source_unit = network.ports[0].unit.replace("m3", "m³") if network.ports else "1"
    source = _SOURCES.get(source_unit, "input")
    return Vocabulary(output, rate, effort, source, unit, effort_unit, source_unit, unit == "m")


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
    group = GROUPS[location.group]
    if not location.weights.size:
        return None
    scales, network = linearised.scales, linearised.fit.setup.network
    varied, words = group.varied(network), vocabulary_of(network)
    length, small = (1e9, "nm") if words.mechanical else (1.0, words.output_unit)
    unit, label = {
        FORCE: (scales.stiffness * scales.displacement, f"missing {_labelled(words.effort, words.effort_unit)}"),
        VOLTAGE: (scales.voltage, f"missing {_labelled(words.source, words.source_unit)}"),
        OUTPUT: (length * scales.displacement, f"missing {_labelled(words.output, small)}"),
        PARAMETER: (1.0, " ".join(["relative change", *(["of", ", ".join(varied)] if varied else [])])),
    }[group.enters]
    title = f"{location.name}: {location.detail}"
    if group.static is None:
        return None if group.enters == OUTPUT else _cycle(linearised, location, unit, label, title)
    x = _axis(group.axis, scales)
    functions = group.static(x, scales)
    # A parameter group has one block of weights a parameter; the first one is drawn.
    count = functions.shape[1]
    weights, covariance = location.weights[:count], location.weight_covariance[:count, :count]
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", functions, covariance, functions), 0.0))
    shown, axis = _shown(x, group.axis, words)
    return Picture(shown, unit * (functions @ weights), unit * std, axis, label, title)


def learned_picture(linearised: LinearisedFit, location: Location, learned: Setup) -> Picture:
    """Return the law of a learned one-port, on the axis of the location's own functions.

    Args:
        learned: the setup with it.
    """
    group, scales, base = GROUPS[location.group], linearised.scales, linearised.fit.setup.network
    # (M,) displacement [m] of a spring, velocity [m/s] of a damper, time [s] after a step of a memory.
    x, values = _axis(group.axis, scales), learned.values()
    force = np.zeros_like(x)
    relaxing = {name for r in learned.network.resistors if r.law == "maxwell" for name in r.on}
    for s in (s for s in learned.network.storages if s not in base.storages and s.name not in relaxing):
        force -= np.asarray(STORAGE_LAWS[s.law].mean_effort(x, x, *(values[n] for n in s.parameters)))
    for r in (r for r in learned.network.resistors if r not in base.resistors):
        own = [values[n] for n in r.parameters]
        if r.law == "maxwell":
            stiffness, tau = own
            force -= stiffness * scales.displacement * np.exp(-x / tau)
        else:
            force -= np.asarray(RESISTOR_LAWS[r.law].flow(x, 0.0 * x, *own))
    words = vocabulary_of(base)
    shown, axis = _shown(x, group.axis, words)
    label = "force on the mass [N]" if words.mechanical else _labelled(words.effort, words.effort_unit)
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


def _labelled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _shown(x: Array, axis: str, words: Vocabulary) -> tuple[Array, str]:
    """An axis in the words and units of the system; displacements in micrometres."""
    name = axis.partition(" [")[0]
    if name == "displacement" and words.mechanical:
        return 1e6 * x, f"{words.output} [µm]"
    labels = {
        "displacement": _labelled(words.output, words.output_unit),
        "velocity": _labelled(words.rate, words.rate_unit),
        "voltage": _labelled(words.source, words.source_unit),
    }
    return x, labels.get(name, axis)


def _axis(axis: str, scales: Scales) -> Array:
    if axis.startswith("time after"):
        return np.geomspace(0.1 / scales.fastest, scales.duration, _POINTS)
    if axis.startswith("time"):
        return np.linspace(0.0, scales.duration, _POINTS)
    reach = {"displacement": scales.displacement, "velocity": scales.velocity, "voltage": scales.voltage}
    return np.linspace(-1.0, 1.0, _POINTS) * reach[axis.split()[0]]


def _cycle(linearised: LinearisedFit, location: Location, unit: float, label: str, title: str) -> Picture:
    """The missing signal against the displacement along the recording with the largest motion."""
    trajectory = max(linearised.trajectories, key=lambda t: float(np.ptp(t.y)))
    functions = GROUPS[location.group].functions(trajectory, linearised.scales)
    signal = unit * (functions @ location.weights[: functions.shape[1]])
    first = 0
    if trajectory.recording.period:
        elapsed = np.cumsum(trajectory.h)
        first = int(np.searchsorted(elapsed, elapsed[-1] - trajectory.recording.period))
    drawn = slice(first, signal.size, max(1, (signal.size - first) // _CYCLE))
    q, axis = _shown(
        trajectory.mid_displacement[drawn], "displacement [m]", vocabulary_of(linearised.fit.setup.network)
    )
    return Picture(q, signal[drawn], None, axis, label, title)


def fitted_in_words(linearised: LinearisedFit, location: Location) -> str:
    """Return the fitted combination of the location's own functions in words; empty where none was fitted."""
    drawn, group = picture(linearised, location), GROUPS[location.group]
    if not location.weights.size or not np.any(location.weights):
        return ""
    network = linearised.fit.setup.network
    own = asdict(vocabulary_of(network))
    acts = f"What the functions fitted there make is {_ACTS[group.enters].format(**own)}"
    if varied := group.varied(network):
        acts += f" {', '.join(varied)}"
    if group.static is None or drawn is None:
        past = (group.kind.history or "on the past").format(**own)
        return f"{acts} that depends {past}.{_work(linearised, location, group)}"
    if group.axis.startswith("time after"):
        return f"{acts} that depends on the past. {_curve_in_words(drawn)}"
    if group.axis.startswith("time"):
        return f"{acts} that depends on time alone, as a drift does."
    variable = _split(drawn.x_label)[0]
    if not group.axis.startswith("velocity"):
        # A straight line is a stiffness or a gain, and the base has these; a damper's line is part of its law.
        inner = np.abs(drawn.x) <= _INNER * np.abs(drawn.x).max()
        line = np.polyval(np.polyfit(drawn.x[inner], drawn.y[inner], 1), drawn.x)
        drawn = replace(drawn, y=np.asarray(drawn.y - line))
    return f"{acts} that depends on the {variable}. {_curve_in_words(drawn)}"


def _split(label: str) -> tuple[str, str]:
    """Name and unit of ``name [unit]``."""
    name, _, unit = label.partition(" [")
    return name, unit.rstrip("]")


def _spoken(value: float, unit: str) -> str:
    if unit in _LENGTHS:
        return quantity(value * _LENGTHS[unit], "m")
    return quantity(value, unit) if unit else f"{value:.3g}"


def _curve_in_words(drawn: Picture) -> str:
    """Character of a curve, or how a memory decays."""
    if not np.any(drawn.y):
        return "Its strengths are all zero."
    (variable, unit), (_, y_unit) = _split(drawn.x_label), _split(drawn.y_label)
    if variable.startswith("time"):
        return memory_in_words(forgetting(drawn.x, drawn.y))
    character, reach = character_of(drawn.x, drawn.y), float(drawn.x[-1])
    spoken = _spoken(reach, unit), _spoken(character.size, y_unit), _spoken(character.shape.at * reach, unit)
    return character_in_words(character, variable, *spoken)


def _work(linearised: LinearisedFit, location: Location, group: Group) -> str:
    """Whether the fitted force takes energy from the motion, over all recordings."""
    if group.enters != FORCE:
        return ""
    done, moved = 0.0, 0.0
    for trajectory in linearised.trajectories:
        force = group.functions(trajectory, linearised.scales) @ location.weights
        power = trajectory.h * force * trajectory.velocity
        done, moved = done + float(power.sum()), moved + float(np.abs(power).sum())
    share = done / max(moved, 1e-300)
    if share < -_LOSSY:
        return " Over the recordings it takes energy away: it is dissipative."
    if share > _LOSSY:
        return " Over the recordings it feeds energy in: no passive element does that by itself."
    return " Over the recordings it gives back about what it takes: it is nearly conservative."


@dataclass(frozen=True)
class Shape:
    """``y ≈ a f(s)`` on ``0 ≤ s ≤ 1`` with the kind of ``f`` that leaves least.

    Attributes:
        kind: ``"power"``: ``s^p``; ``"onset"``: ``max(s − p, 0)``; ``"level"``: ``tanh(s/p)``.
        at: the parameter ``p``.
    """

    kind: str
    at: float


@dataclass(frozen=True)
class Character:
    """What a function of one variable is like.

    Attributes:
        even: share of its square that is even.
        side: 1 or −1 where it acts for one sign of the variable only, else 0.
        shape: on the side, or of the odd or even part, over the range of the variable.
        size: largest value.
    """

    even: float
    side: int
    shape: Shape
    size: float


def character_of(x: Array, y: Array) -> Character:
    """Return the character of a curve.

    Args:
        x: (M,) symmetric about zero, increasing; y: (M,), not zero everywhere.
    """
    odd, even = 0.5 * (y - y[::-1]), 0.5 * (y + y[::-1])
    share = float(even @ even / (y @ y))
    up, down = y[x >= 0.0], y[::-1][x >= 0.0]
    above, below = float(up @ up), float(down @ down)
    least = _OTHER_SIDE * (above + below)
    side = 1 if below < least else -1 if above < least else 0
    half = down if side < 0 or (side == 0 and below > above) else up
    if side == 0 and min(share, 1.0 - share) < _LITTLE:
        half = (even if share > 0.5 else odd)[x >= 0.0]
    return Character(share, side, shape_of(x[x >= 0.0] / x[-1], half), float(np.abs(y).max()))


def shape_of(s: Array, y: Array) -> Shape:
    """Return the kind of function that a half curve follows best.

    Args:
        s: (M,) from 0 to 1; y: (M,).
    """

    def best(kind: str, functions: Mapping[float, Array]) -> tuple[float, Shape]:
        rests = {p: y - f * (f @ y) / max(float(f @ f), 1e-300) for p, f in functions.items()}
        return min(((float(r @ r), Shape(kind, p)) for p, r in rests.items()), key=lambda item: item[0])

    power = best("power", {p: s**p for p in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)})
    onset = best("onset", {float(p): np.maximum(s - p, 0.0) for p in np.arange(0.1, 0.96, 0.025)})
    level = best("level", {float(p): np.tanh(s / p) for p in np.geomspace(1e-3, 0.5, 25)})
    other = min((onset, level), key=lambda item: item[0])
    return other[1] if other[0] < _CLEARLY * power[0] else power[1]


def character_in_words(character: Character, variable: str, reach: str, size: str, at: str) -> str:
    """Return the character as a sentence.

    Args:
        variable: what it is a function of; reach: the largest value of that, with unit; size: of the curve, with unit.
        at: the value of the variable at the shape's parameter, with unit.
    """
    if character.side:
        parity = f"acts for {'positive' if character.side > 0 else 'negative'} {variable} only"
    elif character.even > 1.0 - _LITTLE:
        parity = f"is even in the {variable}"
    elif character.even < _LITTLE:
        parity = f"is odd in the {variable}"
    else:
        parity = f"is neither odd nor even in the {variable} ({100 * character.even:.0f} % of its square is even)"
    power = character.shape.at
    grows = {1.0: "in proportion", 2.0: "with the square", 3.0: "with the cube"}.get(power, f"with the power {power:g}")
    growth = {
        "power": f"is there from the start and grows {grows}",
        "onset": f"sets in at {at} and grows from there",
        "level": f"levels off beyond {at}",
    }[character.shape.kind]
    return f"It {parity}, {growth}; at {reach} it has reached {size}."


def forgetting(t: Array, y: Array) -> tuple[float, float, float] | None:
    """Return the times [s] after which a tenth, a half and nine tenths of a response to a step are gone; None where it
    does not decay.

    Args:
        t: (M,) increasing; y: (M,).
    """
    left = np.abs(y) / max(float(np.abs(y[0])), 1e-300)
    if left.max() > 1.5 or left[-1] > 0.5:
        return None
    # What the recordings are too short to see forgotten counts as gone with their end.
    gone = [int(np.argmax(left <= level)) if (left <= level).any() else t.size - 1 for level in (0.9, 0.5, 0.1)]
    return float(t[gone[0]]), float(t[gone[1]]), float(t[gone[2]])


def memory_in_words(times: tuple[float, float, float] | None) -> str:
    """Return how a response to a step decays, as a sentence, from the times of `forgetting`."""
    if times is None:
        return "Its response to a step does not simply decay within the recordings."
    tenth, half, most = (quantity(t, "s") for t in times)
    how = "over decades of time" if times[2] > _DECADES * times[0] else "as with one time constant"
    return f"It forgets a step {how}: a tenth of it in {tenth}, half in {half}, most in {most}."
