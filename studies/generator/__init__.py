"""Concealed actuators for demonstrations and benchmarks; they share nothing with the models that are to explain them.

    plans → world → effects, noise → cases → seal → make

Nothing of ``phnn`` is imported here but its errors: other equations code, other solver, other time grid.
"""

from studies.generator.cases import Case, Conditions, draw_case
from studies.generator.effects import EFFECTS, ON_REQUEST
from studies.generator.make import generate, make_case
from studies.generator.seal import Sealed, open_seal, write_seal

__all__ = [
    "EFFECTS", "ON_REQUEST", "Case", "Conditions", "Sealed", "draw_case", "generate", "make_case", "open_seal",
    "write_seal",
]  # fmt: skip
