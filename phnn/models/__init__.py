"""Models: the HRC actuator, ready models by name, Bouc–Wen, and their form on disk."""

from phnn.models.actuator import from_paper, hrc, modal
from phnn.models.network_file import ready

__all__ = ["from_paper", "hrc", "modal", "ready"]
