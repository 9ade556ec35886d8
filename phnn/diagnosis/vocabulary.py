"""The words and units of a system's own domain, from the units of its output and its input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from phnn.network.elements import Network
from phnn.network.roles import measured_displacement


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


# By the SI unit of the output: what it is called, its rate, what acts on it, and the unit of that.
_OUTPUTS: Mapping[str, tuple[str, str, str, str]] = {
    "m": ("displacement", "velocity", "force", "N"),
    "rad": ("angle", "angular velocity", "torque", "N m"),
    "C": ("charge", "current", "voltage", "V"),
    "m³": ("volume", "flow", "pressure", "Pa"),
}
_SOURCES: Mapping[str, str] = {
    "V": "voltage", "A": "current", "N": "force", "N m": "torque", "Pa": "pressure", "m³/s": "flow",
    "m/s": "velocity", "rad/s": "angular velocity",
}  # fmt: skip
_UNKNOWN = ("output", "rate of the output", "effort", "")


def vocabulary_of(network: Network) -> Vocabulary:
    """The words of a network; those of no domain where its units belong to none.

    A network without a port is said to be driven by its input. Where a motion is imposed and its force is measured, the
    words are those of the motion.
    """
    moving = measured_displacement(network)
    unit = next((s.unit for s in network.storages if s.name == moving), "1").replace("m3", "m³")
    output, rate, effort, effort_unit = _OUTPUTS.get(unit, _UNKNOWN)
    source_unit = network.ports[0].unit.replace("m3", "m³") if network.ports else "1"
    source = _SOURCES.get(source_unit, "input")
    return Vocabulary(output, rate, effort, source, unit, effort_unit, source_unit, unit == "m")
