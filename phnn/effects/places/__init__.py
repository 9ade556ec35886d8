"""Where effects act in a network, found by what its parts do and not by their names."""

from __future__ import annotations

from phnn.effects.places.attached import attached, place_of
from phnn.effects.places.names import Roles, roles_of, values_by_role

__all__ = ["Roles", "attached", "place_of", "roles_of", "values_by_role"]
