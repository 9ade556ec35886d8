"""Plain values from json: within the limits, every key once, every number finite."""

from __future__ import annotations

import json
import math
from typing import Any

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS

_TOO_DEEP = f"lists and objects more than {LIMITS.depth} levels deep"


def load_json(source: Source, most: int, what: str, remedy: str) -> Any:
    """The content of a json file.

    Args:
        most: bytes; what: of a kind of file, and remedy: for the messages.

    Raises:
        InputRefused: too large, no json, or something that is no plain value within the limits.
    """
    raw = source.read(most, what)
    try:
        content = json.loads(
            raw.decode("utf-8-sig"), parse_int=_whole, parse_float=_real, parse_constant=_constant,
            object_pairs_hook=_once,
        )  # fmt: skip
        _check_depth(content)
    except RecursionError as error:
        raise InputRefused(f"{source.name}: {_TOO_DEEP}: {remedy}") from error
    except ValueError as error:
        raise InputRefused(f"{source.name}: is not json ({error}): {remedy}") from error
    return content


def _whole(text: str) -> int:
    if len(text.lstrip("-")) > LIMITS.digits:
        raise ValueError(f"a whole number of {len(text)} digits, at most {LIMITS.digits} are accepted")
    return int(text)


def _real(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is too large a number")
    return value


def _constant(text: str) -> float:
    raise ValueError(f"{text} is no number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for key, value in pairs:
        if key in content:
            raise ValueError(f"the key {key[:40]!r} is given twice")
        content[key] = value
    return content


def _check_depth(content: Any) -> None:
    level = [content]
    for _ in range(LIMITS.depth + 1):
        level = [
            inner
            for value in level
            if isinstance(value, dict | list)
            for inner in (value.values() if isinstance(value, dict) else value)
        ]
        if not level:
            return
    raise ValueError(_TOO_DEEP)
