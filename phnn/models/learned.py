"""Learned laws as json: kind and weights, from which the same torch module is made again, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import nn

from phnn.errors import PhnnError
from phnn.intake.limits import LIMITS
from phnn.laws.diverged import LARGEST_WEIGHT, check_weights
from phnn.laws.neural import DampingMLP, EnergyMLP, MonotoneMLP
from phnn.models.typed import a_count, an_object, brief

# Scales are buffers and come with the weights: the ones given here only make room for them.
_KINDS: dict[str, Callable[[int], nn.Module]] = {
    "damping": lambda width: DampingMLP(1.0, 1.0, width),
    "symmetric_damping": lambda width: DampingMLP(1.0, 1.0, width, symmetric=True),
    "monotone": lambda width: MonotoneMLP(1.0, 1.0, width),
    "convex": lambda width: EnergyMLP(1.0, 1.0, width),
}


def as_json(law: Any) -> Any:
    """The name of a law, or the content of a learned one.

    Raises:
        PhnnError: a torch module of another kind.
    """
    if isinstance(law, str):
        return law
    kind = getattr(law, "law", None)
    if not isinstance(law, DampingMLP | MonotoneMLP | EnergyMLP) or kind not in _KINDS:
        raise PhnnError(f"a {type(law).__name__} as a law has no form on disk: keep its state_dict with torch.save")
    return {"kind": kind, "units": law.units, "state": {n: v.tolist() for n, v in law.state_dict().items()}}


def from_json(content: Any) -> Any:
    """What `as_json` was given.

    Raises:
        ValueError: an unknown kind, weights that do not fit it, or values with which the law would not be passive.
    """
    if isinstance(content, str):
        return content
    if not isinstance(content, Mapping) or content.get("kind") not in [*_KINDS]:
        raise ValueError(f"no learned law of the kind {brief(content)}")
    law = _KINDS[content["kind"]](a_count(content.get("units"), "units of a learned law", 1, LIMITS.units))
    given = an_object(content.get("state"), "state of a learned law")
    state = {n: _tensor(v, f"{brief(n)} of a learned law") for n, v in given.items()}
    try:
        law.load_state_dict(state)
        check_weights(law, "of a learned law ", LARGEST_WEIGHT)
    except RuntimeError as error:
        raise ValueError(f"weights of a learned law do not fit: {str(error).splitlines()[-1].strip()}") from error
    for name, buffer in law.named_buffers():
        # A negative conductance would deliver power.
        if not bool(((buffer > 0.0) & torch.isfinite(buffer)).all()):
            raise ValueError(f"{name} of a learned law must be positive")
    return law


def _tensor(value: Any, where: str) -> torch.Tensor:
    """Numbers in lists of equal lengths. Raises ValueError for other values, or if one is not finite."""
    try:
        tensor = torch.tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise ValueError(f"{where} is {brief(value)}, no array of numbers") from error
    if not bool(torch.isfinite(tensor).all()):
        raise ValueError(f"{where} is not finite")
    return tensor
