"""How everything that a user names comes in: files that may be read, limits, plain yaml and json, names that print."""

from phnn.intake.files import Source, named_file
from phnn.intake.limits import LIMITS, Limits
from phnn.intake.names import printable

__all__ = ["LIMITS", "Limits", "Source", "named_file", "printable"]
