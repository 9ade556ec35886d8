"""Whether values are absolute or known up to one common factor."""

from __future__ import annotations

from phnn.diagnosis.diagnosis import Diagnosis

# Units of what a common factor of all forces and charges changes, where voltages and displacements stay as they are.
FORCE_UNITS = ("kg", "N", "N/m", "N s/m", "N s²/m²", "N/V", "C", "C/m", "F", "S", "Ω")


def forces_known(diagnosis: Diagnosis) -> bool:
    """Whether forces are known in newtons: one was measured or imposed, or a stated parameter fixes the factor."""
    setup, units = diagnosis.base.setup, diagnosis.campaign.recordings[0].units
    measured = (units.input, units.output)
    stated = [p.unit for n, p in setup.parameters.items() if n in diagnosis.campaign.known or (p.fixed and p.value)]
    return bool(setup.network.senses) or any(unit in FORCE_UNITS for unit in (*measured, *stated))
