"""The catalogue of physics that a model may leave out, one chapter of this folder for each part of an actuator.

It exports everything that an effect needs; docs/write-your-own-effect.md builds one.
"""

from __future__ import annotations

from phnn.effects import kinds
from phnn.effects.additions import (
    Chain,
    OfEveryRecording,
    Parts,
    Placed,
    at_amplifier,
    at_sensor,
    with_network,
    with_resistors,
)
from phnn.effects.declaration import (
    Declared,
    Plausible,
    always,
    between,
    bounded,
    constant,
    has_dead_zones,
    has_inertia,
    has_motion,
    has_plain_dead_zones,
    has_spring,
    has_tanks,
    has_transducer,
    inertia,
    limit,
    nonnegative,
    positive,
    signed,
    time_constant,
)
from phnn.effects.effect import (
    Effect,
    Points,
    Scales,
    catalogue,
    effect,
    in_all_forms,
    register,
    registered,
    unregister,
)
from phnn.effects.kinds import Kind

__all__ = [
    "Chain",
    "Declared",
    "Effect",
    "Kind",
    "OfEveryRecording",
    "Parts",
    "Placed",
    "Plausible",
    "Points",
    "Scales",
    "always",
    "at_amplifier",
    "at_sensor",
    "between",
    "bounded",
    "catalogue",
    "constant",
    "effect",
    "has_dead_zones",
    "has_inertia",
    "has_motion",
    "has_plain_dead_zones",
    "has_spring",
    "has_tanks",
    "has_transducer",
    "in_all_forms",
    "inertia",
    "kinds",
    "limit",
    "nonnegative",
    "positive",
    "register",
    "registered",
    "signed",
    "time_constant",
    "unregister",
    "with_network",
    "with_resistors",
]
