"""Values of a manifest, checked one by one."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any

from phnn.errors import InputRefused


def mapping(value: Any, where: str) -> Mapping[str, Any]:
    """``value`` as a mapping. Raises InputRefused otherwise."""
    if not isinstance(value, Mapping):
        raise InputRefused(f"{where}: expected keys and values, found {value!r}: write `key: value` entries")
    return value


def keys_of(content: Mapping[str, Any], accepted: Iterable[str], where: str) -> None:
    """Refuse the first key that is not accepted, naming the accepted ones."""
    names = list(accepted)
    for key in content:
        if key not in names:
            near = difflib.get_close_matches(str(key), names, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise InputRefused(f"{where}: unknown key {key!r}{hint}: accepted are {', '.join(names)}")


def choice(value: Any, accepted: tuple[str, ...], where: str, otherwise: str = "") -> str:
    """``value`` if it is one of the accepted words. Raises InputRefused otherwise."""
    if value not in accepted:
        more = f" {otherwise}" if otherwise else ""
        raise InputRefused(f"{where}: {value!r} is not known: accepted are {', '.join(accepted)}{more}")
    return str(value)


def number(value: Any, where: str, above: float | None = None) -> float:
    """``value`` as a finite float, greater than ``above`` where that is given. Raises InputRefused otherwise."""
    good = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if not good or (above is not None and value <= above):
        wanted = "a finite number" if above is None else f"a number greater than {above:g}"
        raise InputRefused(f"{where}: {value!r} is not {wanted}: give one")
    return float(value)


def flag(value: Any, where: str) -> bool:
    """``value`` as a truth value. Raises InputRefused otherwise."""
    if not isinstance(value, bool):
        raise InputRefused(f"{where}: {value!r} is neither true nor false: write one of them")
    return value


def text(value: Any, where: str) -> str:
    """``value`` as a non-empty text; a plain number is taken as its digits. Raises InputRefused otherwise."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)) or str(value).strip() == "":
        raise InputRefused(f"{where}: {value!r} is no name: write a text")
    return str(value).strip()
