"""Recordings that are objects in memory: one adapter for each library, and tables of columns as a file would give.

No library is loaded: an object can only be given where its library is loaded already.
"""

from phnn.recordings.adapters.collected import given
from phnn.recordings.adapters.entries import described
from phnn.recordings.adapters.given import Given

__all__ = ["Given", "described", "given"]
