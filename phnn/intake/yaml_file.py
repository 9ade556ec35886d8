"""Plain values from yaml: mappings, lists, texts, numbers, truth values, nothing. No tags, interpolation or code.

The words are those of YAML 1.1, but dates and times, numbers of base 8, 16, 2 and 60 stay texts, and ``1e-5`` is a
number. Every alias counts as what it stands for, so that aliases of aliases cannot multiply.
"""

from __future__ import annotations

import re
from typing import Any

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS

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
_TOO_DEEP = f"lists and mappings more than {LIMITS.depth} levels deep: write less"


class _Refused(ValueError):
    """What is wrong at a node, and the remedy; the line comes before it."""

    def __init__(self, node: Any, said: str) -> None:
        super().__init__(said)
        self.line = node.start_mark.line + 1


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

    # Without a meaning of their own, values have the tags that somebody wrote, or say whether they stood in quotes.
    loader = type("AsWritten", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {"resolve": _as_written})
    try:
        depth = 0
        # The composer takes long for what is deep, the parser does not.
        for event in yaml.parse(text, Loader=loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > LIMITS.depth + 1:
                raise _Refused(event, _TOO_DEEP)
        documents = list(yaml.compose_all(text, Loader=loader))
        if len(documents) > 1:
            raise _Refused(documents[1], "a second document begins: one file holds one")
        return _Values().of(documents[0], 0) if documents else None
    except _Refused as error:
        raise InputRefused(f"{name}: line {error.line}: {error}") from error
    except (yaml.YAMLError, RecursionError) as error:
        cause = " ".join(str(error).split())
        raise InputRefused(f"{name}: not readable as yaml ({cause}): correct it at the line named") from error


_PLAIN, _QUOTED = "", "quoted"


def _as_written(loader: Any, kind: Any, value: Any, implicit: Any) -> str:
    return _QUOTED if isinstance(implicit, tuple) and not implicit[0] else _PLAIN


class _Values:
    """Plain values from the nodes of a document, counted; an alias is the node that it stands for, again."""

    def __init__(self) -> None:
        self.count = 0

    def of(self, node: Any, depth: int) -> Any:
        """Return the value of a node that lies so deep in others."""
        self.count += 1
        if self.count > LIMITS.yaml_values:
            raise _Refused(node, f"more than {LIMITS.yaml_values} values, aliases written out: write less")
        if depth > LIMITS.depth:
            raise _Refused(node, _TOO_DEEP)
        if node.tag not in (_PLAIN, _QUOTED):
            raise _Refused(node, f"the tag {node.tag!r} is not accepted: write plain values without tags")
        if node.id == "scalar":
            return _scalar(node)
        if node.id == "sequence":
            return [self.of(inner, depth + 1) for inner in node.value]
        return self._mapping(node, depth + 1)

    def _mapping(self, node: Any, depth: int) -> dict[Any, Any]:
        own: dict[Any, Any] = {}
        merged: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key, value = self.of(key_node, depth), self.of(value_node, depth)
            if isinstance(key, list | dict):
                raise _Refused(key_node, "a list or mapping as a key: write a name")
            if key in own:
                raise _Refused(key_node, f"the key {key!r} is given twice: remove one")
            if key != _MERGE:
                own[key] = value
                continue
            for mapping in value if isinstance(value, list) else [value]:
                if not isinstance(mapping, dict):
                    raise _Refused(key_node, "<< stands before something that is no mapping: name a mapping")
                # The first mapping that has a key wins.
                merged = mapping | merged
        return merged | own


def _scalar(node: Any) -> Any:
    text = node.value
    if _INTERPOLATION in text:
        raise _Refused(node, f"{text[:60]!r}: nothing is put in for ${{…}} here: write the value itself")
    if node.tag == _QUOTED:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if _WHOLE.fullmatch(text):
        digits = sum(c.isdigit() for c in text)
        if digits > LIMITS.digits:
            raise _Refused(
                node, f"a whole number of {digits} digits, at most {LIMITS.digits} are accepted: write 1e{digits}"
            )
        return int(text.replace("_", ""))
    if _REAL.fullmatch(text):
        return float(text.replace("_", "").lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text
