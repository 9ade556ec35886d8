"""Parallel springs on the moving part, each in series with a resistor through which it relaxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects import Parts, Placed
from phnn.effects.learned.strengths import NEARLY_ZERO, sized, stiffness_of
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.setup import Setup


def with_ladder(
    setup: Setup, cells: Mapping[str, tuple[str, ...]], law: str, parameters: Placed, noticeable: float
) -> Setup:
    """``F += −Σ kᵢ sᵢ``: a storage ``sᵢ`` with ``J[sᵢ, p] = 1`` and a resistor for every cell.

    Args:
        cells: parameters of each cell's resistor, its stiffness first, by the cell's name.
        law: of the resistors; they divide by the stiffness, which therefore has a positive lower bound.
        parameters: stiffnesses [N/m] and constants.
        noticeable: a noticeable stiffness as a share of the base model's.
    """
    typical = noticeable * stiffness_of(setup)
    least = NEARLY_ZERO * typical
    own = {
        n: p if p.fixed else replace(p, value=max(p.value, least), lower=least)
        for n, p in sized(parameters, typical).items()
    }
    parts = Parts(
        storages=tuple(Storage(cell, "spring", names[:1], "m") for cell, names in cells.items()),
        resistors=tuple(Resistor(cell, law, {cell: 1.0}, names) for cell, names in cells.items()),
        couplings=tuple(Coupling(cell, "p", 1.0) for cell in cells),
    )
    return parts(setup, own)
