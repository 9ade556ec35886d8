"""The environment of one thread: variables that numerical libraries read when they are loaded."""

from __future__ import annotations

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR", "NUMBA")
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in _LIBRARIES}
"""Environment under which a process does its linear algebra in one thread."""
