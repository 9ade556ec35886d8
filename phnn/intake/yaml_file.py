"""Plain values from yaml: mappings, lists, texts, numbers, truth values, nothing. No tags, interpolation or code.

The words are those of YAML 1.1, but dates and times, numbers of base 8, 16, 2 and 60 stay texts, and ``1e-5`` is a
number. Every alias counts as what it stands for, so that aliases of aliases cannot multiply.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS

_TAG = "tag:yaml.org,2002:"
_WORDS: dict[str, Any] = {"": None, "~": None} | {
    form: value
    for word, value in (("null", None), ("yes", True), ("no", False), ("true", True), ("false", False), ("on", True),
                        ("off", False))
    for form in (word, word.capitalize(), word.upper())
}  # fmt: skip
_WHOLE = re.compile(r"[-+]?(?:0|[1-9][0-9_]*)")
_REAL = re.compile(
    r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|[0-9][0-9_]*[eE][-+]?[0-9]+|\.[0-9][0-9_]*(?:[eE][-+]?[0-9]+)?"
    r"|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN)"
)
_MERGE = "<<"
# What other readers of yaml would replace, from the environment for instance.
_INTERPOLATION = "${"


class _Refused(ValueError):
    """What is wrong, and the remedy; the line comes before it."""


def load_yaml(source: Source) -> Any:
    """The one document of a yaml file; ``None`` where it holds none.

    Raises:
        InputRefused: too large, no yaml, or something that is no plain value within the limits; names file and line.
    """
    raw = source.read(LIMITS.yaml_bytes, "a yaml file")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputRefused(
            f"{source.name}: not readable as yaml (byte {error.start} is no UTF-8): save it as UTF-8"
        ) from error
    return plain_values(text, source.name)


def plain_values(text: str, name: str) -> Any:
    """The one document of a yaml text; ``name`` is that of the file. Raises InputRefused as `load_yaml`."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    events = _Events(yaml.parse(text, Loader=loader))
    try:
        return events.document()
    except _Refused as error:
        raise InputRefused(f"{name}: line {events.line}: {error}") from error
    except yaml.YAMLError as error:
        cause = " ".join(str(error).split())
        raise InputRefused(f"{name}: not readable as yaml ({cause}): correct it at the line named") from error


class _Events:
    """Values from the events of a parser, which itself never recurs."""

    def __init__(self, events: Iterator[Any]) -> None:
        self.events = events
        self.line = 1
        # What anchors stand for, and how many values that is.
        self.anchors: dict[str, tuple[Any, int]] = {}
        self.count = 0

    def document(self) -> Any:
        """The one document."""
        found = None
        around = ("StreamStartEvent", "StreamEndEvent", "DocumentStartEvent", "DocumentEndEvent")
        for number, event in enumerate(e for e in self.events if type(e).__name__ not in around):
            if number:
                raise _Refused("a second document begins: one file holds one")
            found = self._value(event, 0)
        return found

    def _value(self, event: Any, depth: int) -> Any:
        self.line = event.start_mark.line + 1
        kind = type(event).__name__
        if kind == "AliasEvent":
            return self._alias(event)
        if depth > LIMITS.depth:
            raise _Refused(f"lists and mappings {depth} levels deep, at most {LIMITS.depth} are accepted")
        before = self.count
        self._add(1)
        if kind == "ScalarEvent":
            value = _scalar(event)
        elif kind == "SequenceStartEvent":
            _check_tag(event, ("seq",))
            value = list(self._items("SequenceEndEvent", depth))
        else:
            _check_tag(event, ("map",))
            value = self._mapping(depth)
        if event.anchor is not None:
            self.anchors[event.anchor] = value, self.count - before
        return value

    def _items(self, end: str, depth: int) -> Iterator[Any]:
        for event in self.events:
            if type(event).__name__ == end:
                return
            yield self._value(event, depth + 1)

    def _mapping(self, depth: int) -> dict[Any, Any]:
        own: dict[Any, Any] = {}
        merged: dict[Any, Any] = {}
        for key in (items := self._items("MappingEndEvent", depth)):
            line = self.line
            if isinstance(key, list | dict):
                raise _Refused("a list or mapping as a key: write a name")
            value = next(items)
            if key == _MERGE:
                _merge(merged, value)
                continue
            if key in own:
                self.line = line
                raise _Refused(f"the key {key!r} is given twice: remove one")
            own[key] = value
        return merged | own

    def _alias(self, event: Any) -> Any:
        if event.anchor not in self.anchors:
            raise _Refused(f"the alias *{event.anchor} stands for nothing that is complete: define it before")
        value, size = self.anchors[event.anchor]
        self._add(size)
        return value

    def _add(self, count: int) -> None:
        self.count += count
        if self.count > LIMITS.yaml_values:
            raise _Refused(f"more than {LIMITS.yaml_values} values, aliases written out: write less")


def _merge(merged: dict[Any, Any], value: Any) -> None:
    """What ``<<`` brings: the first mapping that has a key wins."""
    for mapping in value if isinstance(value, list) else [value]:
        if not isinstance(mapping, dict):
            raise _Refused("<< stands before something that is no mapping: name a mapping")
        for key, said in mapping.items():
            merged.setdefault(key, said)


def _scalar(event: Any) -> Any:
    text, tag = event.value, event.tag
    _check_tag(event, ("str", "int", "float", "bool", "null"))
    if _INTERPOLATION in text:
        raise _Refused(f"{text[:60]!r}: nothing is put in for ${{…}} here: write the value itself")
    if (not event.implicit[0] and tag is None) or tag == f"{_TAG}str" or tag == "!":
        return text
    value = _plain(text)
    wanted = {f"{_TAG}int": int, f"{_TAG}float": int | float, f"{_TAG}bool": bool}.get(tag or "")
    if wanted is not None and (not isinstance(value, wanted) or (wanted is not bool and isinstance(value, bool))):
        raise _Refused(f"{text[:60]!r} is not what its tag says: leave the tag out")
    return float(value) if tag == f"{_TAG}float" else value


def _plain(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    if _WHOLE.fullmatch(text):
        digits = sum(c.isdigit() for c in text)
        if digits > LIMITS.digits:
            raise _Refused(f"a whole number of {digits} digits, at most {LIMITS.digits} are accepted: write 1e{digits}")
        return int(text.replace("_", ""))
    if _REAL.fullmatch(text):
        return float(text.replace("_", "").lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text


def _check_tag(event: Any, accepted: tuple[str, ...]) -> None:
    if event.tag not in (None, "!", *(_TAG + name for name in accepted)):
        raise _Refused(f"the tag {event.tag!r} is not accepted: write plain values without tags")
