"""Distil a learned element: the shortest formula that explains the recordings as well as its curve does."""

from phnn.diagnosis.distil.distilled import Distilled, distil
from phnn.diagnosis.distil.grammar import has_grammar

__all__ = ["Distilled", "distil", "has_grammar"]
