"""The state of a run on disk, whole or not at all, so that it goes on as if it had never been stopped."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from phnn.errors import InputRefused
from phnn.output import Place

FILE = "checkpoint.pt"
_SCHEMA = "phnn.checkpoint/1"


def save(place: Place, state: Mapping[str, Any]) -> None:
    """Write a state of tensors, numbers, texts, lists and dictionaries, and that of torch's random generator."""
    place.write(as_bytes({"schema": _SCHEMA, "random": torch.get_rng_state(), **state}))


def as_bytes(content: Mapping[str, Any]) -> bytes:
    """What ``torch.load(..., weights_only=True)`` reads back."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def load(path: Path) -> dict[str, Any] | None:
    """The state that `save` wrote, with torch's random generator set back to it; None where there is none.

    Raises:
        InputRefused: the file is damaged or no checkpoint.
    """
    if not path.exists():
        return None
    try:
        state = torch.load(path, weights_only=True)
    except Exception as error:
        raise InputRefused(f"{path}: cannot be read ({type(error).__name__}): delete it to begin anew") from error
    if not isinstance(state, dict) or state.get("schema") != _SCHEMA:
        raise InputRefused(f"{path}: is no {_SCHEMA} file: delete it to begin anew")
    torch.set_rng_state(state["random"])
    return state
