"""Learned laws as json: kind and weights, from which the same torch module is made again, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import nn

from phnn.errors import PhnnError
from phnn.laws.neural import DampingMLP, EnergyMLP, MonotoneMLP

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
        ValueError: an unknown kind, or weights that do not fit it.
    """
    if isinstance(content, str):
        return content
    if not isinstance(content, Mapping) or content.get("kind") not in _KINDS:
        raise ValueError(f"no learned law of the kind {content!r:.60}")
    law = _KINDS[content["kind"]](int(content["units"]))
    state = {n: torch.tensor(v, dtype=torch.float64) for n, v in content["state"].items()}
    if not all(bool(torch.isfinite(v).all()) for v in state.values()):
        raise ValueError("a weight of a learned law is not finite")
    try:
        law.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(f"weights of a learned law do not fit: {str(error).splitlines()[-1].strip()}") from error
    return law
