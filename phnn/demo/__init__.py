"""Concealed actuators for demonstrations and benchmarks; they share nothing with the models that are to explain them.

Nothing of ``phnn`` is imported here but its errors: other equations code, other solver, other time grid.
"""

from phnn.demo.campaign import generate
from phnn.demo.case import Case, draw_case
from phnn.demo.concealed import EFFECTS, ON_REQUEST
from phnn.demo.conditions import Conditions
from phnn.demo.make import make_case
from phnn.demo.sealed import Sealed, open_seal, write_seal
from phnn.demo.strata import STRATA

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
