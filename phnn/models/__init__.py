"""Models: the HRC actuator, Bouc–Wen, and their form on disk."""

from phnn.models.actuator import from_paper, hrc

__all__ = ["from_paper", "hrc"]
