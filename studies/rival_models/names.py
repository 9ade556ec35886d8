"""Rivals by name, in the comparisons of ``phnn compare`` too; they and their packages are loaded when asked for."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phnn.comparison.models import MODELS, register_rival
from phnn.errors import InputRefused
from phnn.recordings import Campaign

if TYPE_CHECKING:
    from studies.rival_models.rival import Rival

_CLASSES = {
    "prandtl_ishlinskii": ("Prandtl–Ishlinskii", "hysteresis.PrandtlIshlinskii"),
    "preisach": ("Preisach", "hysteresis.Preisach"),
    "dahl": ("Dahl", "hysteresis.Dahl"),
    "hammerstein": ("Hammerstein", "hysteresis.Hammerstein"),
    "narx": ("NARX", "narx.Narx"),
    "gru": ("GRU", "networks.Gru"),
    "subnet": ("SUBNET", "networks.Subnet"),
    "bouc_wen_before_1": ("Bouc–Wen before the mass, 1 term", "bouc_wen.before_1"),
    "bouc_wen_before_3": ("Bouc–Wen before the mass, 3 terms", "bouc_wen.before_3"),
    "bouc_wen_loop_1": ("Bouc–Wen in the loop, 1 term", "bouc_wen.loop_1"),
    "bouc_wen_loop_3": ("Bouc–Wen in the loop, 3 terms", "bouc_wen.loop_3"),
    "trained_ode": ("neural ODE", "continuous.NeuralOde"),
    "oe_phnn": ("OE-pHNN", "continuous.OePhnn"),
    "sphnn": ("sPHNN", "continuous.SPhnn"),
}
NAMES = tuple(_CLASSES)
HEADS = {n: kind.title for n, kind in MODELS.items()} | {n: title for n, (title, _) in _CLASSES.items()}


def rival(name: str) -> Rival:
    """Return the rival of a name.

    Raises:
        InputRefused: nothing has this name, or a package that it needs is not installed.
    """
    if name not in _CLASSES:
        raise InputRefused(f"models: nothing is called {name!r}: choose from {', '.join(NAMES)}")
    module, _, kind = _CLASSES[name][1].partition(".")
    chosen: Rival = getattr(importlib.import_module(f"studies.rival_models.{module}"), kind)()
    return chosen


def needed(package: str) -> ModuleType:
    """Import a package that only rival methods need. Raises InputRefused where it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise InputRefused(f"{package} is not installed: pip install 'phnn[rivals]'") from error


def register_rivals() -> None:
    """Let ``models=`` of a comparison name every rival."""
    for name in NAMES:
        register_rival(name, partial(_fit, name), HEADS[name])


def _fit(
    name: str, campaign: Campaign, seed: int, budget: float
) -> tuple[dict[str, NDArray[np.float64]], Mapping[str, Any]]:
    """Fit a rival within its budget; return outputs by recording, and facts."""
    chosen = rival(name)
    fitted = chosen.fit(campaign.recordings, chosen.times * budget, seed)
    outputs = zip((r.name for r in campaign.recordings), fitted.outputs(campaign.recordings), strict=True)
    about = {"kind": f"{chosen.words} ({chosen.source})", "parameters": fitted.parameters, "gradient": chosen.how}
    return dict(outputs), about | dict(fitted.facts)
