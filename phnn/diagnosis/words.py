"""Plain words for an element that was learned at a location."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import FORCE, GROUPS, OUTPUT, PARAMETER, VOLTAGE, Group, Location
from phnn.diagnosis.character import character_of, forgetting, in_words, memory_in_words, without_line
from phnn.diagnosis.picture import Picture, picture
from phnn.diagnosis.vocabulary import vocabulary_of
from phnn.units import quantity

Array = NDArray[np.float64]

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


def fitted_in_words(linearised: LinearisedFit, location: Location) -> str:
    """The fitted combination of the location's own functions; empty where none was fitted."""
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
    variable = _split(drawn.x_label)[0]
    if group.axis.startswith("time"):
        return f"{acts} that depends on time alone, as a drift does."
    # A straight line is a stiffness or a gain, and the base has these; a damper's line is part of its law.
    plain = drawn if group.axis.startswith("velocity") else _bent(drawn)
    return f"{acts} that depends on the {variable}. {_curve_in_words(plain)}"


def _bent(drawn: Picture) -> Picture:
    return Picture(drawn.x, without_line(drawn.x, drawn.y), None, drawn.x_label, drawn.y_label, drawn.title)


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
        times = forgetting(drawn.x, drawn.y)
        tenth, half, most = (quantity(v, "s") for v in times or (0.0, 0.0, 0.0))
        return memory_in_words(times, (tenth, half, most))
    found = character_of(drawn.x, drawn.y)
    reach = float(drawn.x[-1])
    return in_words(
        found, variable, _spoken(reach, unit), _spoken(found.size, y_unit), _spoken(found.shape.at * reach, unit)
    )


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
