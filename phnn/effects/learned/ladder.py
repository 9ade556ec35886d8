"""Springs side by side on the moving part, each with a resistor through which it gives way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from phnn.effects.effect import with_network
from phnn.effects.learned.strengths import NEARLY_ZERO, stiffness_of, strength
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.parameters import Parameter
from phnn.setup import Setup


def with_ladder(
    setup: Setup,
    cells: Mapping[str, Sequence[str]],
    law: str,
    values: Mapping[str, float],
    noticeable: float,
    description: str,
    constants: Sequence[Parameter],
) -> Setup:
    """``F += −Σ kᵢ sᵢ``: a storage ``sᵢ`` with ``J[sᵢ, p] = 1`` and a resistor for every cell.

    Args:
        cells: parameters of each cell's resistor, its stiffness first, by the cell's name.
        law: of the resistors; they divide by the stiffness, which therefore is never quite zero.
        values: of the stiffnesses [N/m].
        noticeable: share of the base model's stiffness that is a noticeable one.
        description: of a stiffness.
        constants: the other parameters.
    """
    typical = noticeable * stiffness_of(setup)
    least = NEARLY_ZERO * typical
    springs = {cell: names[0] for cell, names in cells.items()}
    strengths = [strength(k, max(values[k], least), "N/m", typical, description, least) for k in springs.values()]
    network = setup.network.extend(
        storages=tuple(Storage(cell, "spring", (k,), "m") for cell, k in springs.items()),
        resistors=tuple(Resistor(cell, law, {cell: 1.0}, tuple(names)) for cell, names in cells.items()),
        couplings=tuple(Coupling(cell, "p", 1.0) for cell in cells),
        parameters=(*strengths, *constants),
    )
    return with_network(setup, network)
