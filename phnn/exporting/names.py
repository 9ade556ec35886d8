"""Identifiers that every target language takes, for names of people."""

from __future__ import annotations

import re

# Words that some target language, or its library, keeps for itself.
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
and as assert async await class def del elif except finally from global import in is lambda nonlocal not or pass
raise try with yield None True False end elseif function otherwise parfor persistent spmd
s y u h main self math
"""
RESERVED = frozenset(_WORDS.split())
# Longest identifier: MATLAB takes 63 characters, with what is put before and behind it.
_LONGEST = 40


class Names:
    """Gives every name of a model an identifier of letters, digits and underscores, each once."""

    def __init__(self) -> None:
        self._given: dict[str, str] = {}

    def of(self, name: str) -> str:
        """The identifier of a name; the same every time."""
        if name not in self._given:
            plain = identifier(name)
            taken = set(self._given.values())
            numbered = (f"{plain}_{i}" for i in range(2, len(taken) + 3))
            self._given[name] = next(n for n in (plain, *numbered) if n not in taken)
        return self._given[name]


def identifier(name: str) -> str:
    """A name with what no identifier may hold replaced by underscores."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name)[:_LONGEST].strip("_") or "x"
    return f"x_{plain}" if plain[0].isdigit() else plain


def one_line(text: str) -> str:
    """Text for a comment: one line that ends no comment of any language."""
    return " ".join("".join(c for c in text if c.isprintable()).split()).replace("*/", "* /").replace('"""', "'''")
