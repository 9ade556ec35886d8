"""The requirements on every effect: texts, declared parameters, structure, strength and derivatives.

The checks apply to the effects of the catalogue and to those given to `phnn.effects.register`.
"""

from __future__ import annotations

from phnn.effects.soundness.checks import CHECKS, check_effect
from phnn.effects.soundness.homes import Home, home_of

__all__ = ["CHECKS", "Home", "check_effect", "home_of"]
