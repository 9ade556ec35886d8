"""The rim of a tank: a resistor that opens above a volume."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.additions import Parts, Placed
from phnn.network.elements import Ratio, Resistor
from phnn.setup import Setup


def with_rim(setup: Setup, name: str, tank: str, on: Mapping[str, Ratio], parameters: Placed) -> Setup:
    """The setup in which the volume above the rim of a tank flows off.

    Args:
        name: of the resistor.
        tank: whose volume is compared with that of the rim.
        on: storages on which the resistor acts, with their signs.
        parameters: rate [1/s] and volume up to the rim [m³], in this order.
    """
    (capacity,) = next(s.parameters for s in setup.network.storages if s.name == tank)
    rim = Resistor(name, "overflow", dict(on), (*parameters, capacity))
    return Parts(resistors=(rim,))(setup, parameters)
