"""Whether values are absolute or known up to one common factor."""

from __future__ import annotations

from collections.abc import Iterable

from phnn.identification.staged import fixes_common_factor
from phnn.network.elements import Network


def forces_known(known: Iterable[str], network: Network) -> bool:
    """Whether forces are known in newtons: a known parameter fixes the common factor, or the force was measured."""
    return bool(network.senses) or fixes_common_factor(known)
