"""The places of a network at which effects act, found by the roles of its parts and not by their names."""

from __future__ import annotations

from phnn.effects.places.attached import attached, place_of
from phnn.effects.places.names import Roles, roles_of, values_by_role

__all__ = ["Roles", "attached", "place_of", "roles_of", "values_by_role"]
