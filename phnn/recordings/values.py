"""Values of a manifest, checked one by one."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from typing import Any

from phnn.errors import InputRefused, meant
from phnn.intake.limits import LIMITS
from phnn.results import printable

# Beyond, squares and products of two values are no numbers any more, or nothing.
_LARGEST, _SMALLEST = 1e150, 1e-150
# Of long or nested values a message shows the beginning; with aliases the whole could be of any size.
_BRIEF = reprlib.Repr()
_BRIEF.maxstring = _BRIEF.maxother = 60


def shown(value: Any) -> str:
    """The beginning of a value, for messages."""
    return printable(_BRIEF.repr(value))


def mapping(value: Any, where: str) -> Mapping[str, Any]:
    """``value`` as a mapping. Raises InputRefused otherwise."""
    if not isinstance(value, Mapping):
        raise InputRefused(f"{where}: expected keys and values, found {shown(value)}: write `key: value` entries")
    return value


def keys_of(content: Mapping[str, Any], accepted: Iterable[str], where: str) -> None:
    """Refuse the first key that is not accepted, naming the accepted ones."""
    names = list(accepted)
    for key in content:
        if key not in names:
            hint = meant(str(key), names)
            raise InputRefused(f"{where}: unknown key {shown(key)}{hint}: accepted are {', '.join(names)}")


def choice(value: Any, accepted: tuple[str, ...], where: str, otherwise: str = "") -> str:
    """``value`` if it is one of the accepted words. Raises InputRefused otherwise."""
    if value not in accepted:
        more = f" {otherwise}" if otherwise else ""
        raise InputRefused(f"{where}: {shown(value)} is not known: accepted are {', '.join(accepted)}{more}")
    return str(value)


def number(value: Any, where: str, above: float | None = None) -> float:
    """``value`` as a finite float, greater than ``above`` where that is given. Raises InputRefused otherwise."""
    good = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _LARGEST
    good = good and (value == 0.0 or abs(value) >= _SMALLEST)
    if not good or (above is not None and value <= above):
        wanted = "a finite number" if above is None else f"a number greater than {above:g}"
        raise InputRefused(f"{where}: {shown(value)} is not {wanted}: give one")
    return float(value)


def flag(value: Any, where: str) -> bool:
    """``value`` as a truth value. Raises InputRefused otherwise."""
    if not isinstance(value, bool):
        raise InputRefused(f"{where}: {shown(value)} is neither true nor false: write one of them")
    return value


def text(value: Any, where: str) -> str:
    """``value`` as a non-empty text; a plain number is taken as its digits. Raises InputRefused otherwise."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)) or str(value).strip() == "":
        raise InputRefused(f"{where}: {shown(value)} is no name: write a text")
    return str(value).strip()


def label(value: Any, where: str) -> str:
    """A name as `text`, printable and not too long. Raises InputRefused otherwise."""
    name = printable(text(value, where))
    if len(name) > LIMITS.name_characters:
        raise InputRefused(
            f"{where}: {shown(name)}, a name of {len(name)} characters, at most {LIMITS.name_characters} are accepted: "
            f"write a shorter one"
        )
    return name
