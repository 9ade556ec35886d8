"""The test whether values are absolute or known up to one common factor."""

from __future__ import annotations

from phnn.diagnosis.diagnosis import Diagnosis
from phnn.units import FORCE_UNITS


def forces_known(diagnosis: Diagnosis) -> bool:
    """Whether forces are known in newtons: one was measured or imposed, or a stated parameter fixes the factor."""
    setup, recording = diagnosis.base.setup, diagnosis.campaign.recordings[0]
    # An input of unknown gain is a force in no known unit.
    measured = (recording.units.output, *([recording.units.input] if recording.gain == "known" else []))
    stated = [p.unit for n, p in setup.parameters.items() if n in diagnosis.campaign.known or (p.fixed and p.value)]
    return bool(setup.network.senses) or any(unit in FORCE_UNITS for unit in (*measured, *stated))
