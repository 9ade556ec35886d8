"""A concealed actuator for demonstrations; it shares nothing with the models that are to explain it.

Nothing of ``phnn`` is imported here but its errors: other equations code, other solver, other time grid.
"""

from phnn.demo.campaign import generate
from phnn.demo.concealed import EFFECTS, ON_REQUEST
from phnn.demo.sealed import Sealed, open_seal, write_seal

__all__ = ["EFFECTS", "ON_REQUEST", "Sealed", "generate", "open_seal", "write_seal"]
