"""A document in the words of the system that was recorded: `mechanical` is a word for what moves. Values are
absolute or known up to one common factor.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from phnn.report.document import Document
from phnn.units import FORCE_UNITS

if TYPE_CHECKING:
    from phnn.diagnose.diagnosis import Diagnosis


def forces_known(diagnosis: Diagnosis) -> bool:
    """Whether forces are known in newtons: one was measured or imposed, or a stated parameter fixes the factor."""
    setup, recording = diagnosis.base.setup, diagnosis.campaign.recordings[0]
    # An input of unknown gain is a force in no known unit.
    measured = (recording.units.output, *([recording.units.input] if recording.gain == "known" else []))
    stated = [p.unit for n, p in setup.parameters.items() if n in diagnosis.campaign.known or (p.fixed and p.value)]
    return bool(setup.network.senses) or any(unit in FORCE_UNITS for unit in (*measured, *stated))


# Units of outputs that move, or of what moves them, and what the location `mechanical` is called where nothing does.
MOVING = ("m", "rad", "N", "N m")
NETWORK = "inside the network"


def in_own_words(document: Document) -> Document:
    """The document with its locations as they are said to a person; names in ``diagnosis.json`` stay as they are."""
    if document.output_unit in MOVING:
        return document

    def said(name: str) -> str:
        return NETWORK if name == "mechanical" else name

    where, left = document.location, document.remainder
    if where is not None:
        scores = tuple((said(name), score) for name, score in where.scores)
        where = replace(where, name=said(where.name), tied=tuple(map(said, where.tied)), scores=scores)
    return replace(
        document,
        location=where,
        remainder=None if left is None else replace(left, location=said(left.location)),
        missing=tuple(replace(m, location=said(m.location)) for m in document.missing),
    )
