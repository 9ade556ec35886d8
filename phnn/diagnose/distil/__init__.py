"""Distil a learned element: the shortest formula that explains the recordings as well as its curve does."""

from phnn.diagnose.distil.distilled import Distilled, distil

__all__ = ["Distilled", "distil"]
