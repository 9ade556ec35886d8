"""The few exceptions of the package; every message carries the offending value and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

# Letters of an unknown word that are compared.
_COMPARED = 200


class PhnnError(Exception):
    """Base class of what phnn raises: ``except phnn.PhnnError``. The command line prints the message alone."""

    exit_status = 1


class InputRefused(PhnnError):
    """What the user supplied cannot be used as it is: names the file, column, row, value and remedy."""

    exit_status = 2


class SolverFailed(PhnnError):
    """A simulation could not be completed: names the time, the cause and the remedy."""


class StructureViolated(PhnnError):
    """A network is not a port-Hamiltonian system, or not one that the requested operation covers."""


class OutputRefused(InputRefused):
    """Results cannot be written where the user wants them: names the file or folder and the remedy."""


class OutputFailed(PhnnError):
    """Results could not be written while the work was going on, as on a full disk: names what was finished."""


def meant(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean X?)"`` for the known word that an unknown one resembles; empty where there is none."""
    near = difflib.get_close_matches(word[:_COMPARED], list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""
