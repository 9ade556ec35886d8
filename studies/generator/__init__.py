"""Concealed actuators for demonstrations and benchmarks; they share nothing with the models that are to explain them.

Nothing of ``phnn`` is imported here but its errors: other equations code, other solver, other time grid.
"""

from studies.generator.campaign import generate
from studies.generator.case import Case, draw_case
from studies.generator.concealed import EFFECTS, ON_REQUEST
from studies.generator.conditions import Conditions
from studies.generator.make import make_case
from studies.generator.sealed import Sealed, open_seal, write_seal
from studies.generator.strata import STRATA

__all__ = [
    "EFFECTS",
    "ON_REQUEST",
    "STRATA",
    "Case",
    "Conditions",
    "Sealed",
    "draw_case",
    "generate",
    "make_case",
    "open_seal",
    "write_seal",
]
