"""Identifiers that every target language takes, for names of people."""

from __future__ import annotations

import keyword
import re
import sys

from phnn.errors import InputRefused

# Words that some target language, or its library, keeps for itself.
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
and as assert async await class def del elif except finally from global import in is lambda nonlocal not or pass
raise try with yield None True False end elseif function otherwise parfor persistent spmd
s y u h main self math
"""
RESERVED = frozenset(_WORDS.split())
# Names of files that a compiler or an interpreter would find in place of its own, or that a target writes besides.
_HEADERS = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic stdbool
stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype fmi2
"""
_FILES = frozenset(_HEADERS.split()) | sys.stdlib_module_names | frozenset(w.lower() for w in keyword.kwlist)
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


def prefix(name: str, title: str) -> str:
    """The name of files and the prefix of what is public: the given one, or that of the model.

    Raises:
        InputRefused: the given name is a word of a target language or the name of one of its own files.
    """
    plain = identifier(name or title)
    # Letters of both cases name the same file on some machines.
    if plain not in RESERVED and plain.lower() not in _FILES:
        return plain
    if name:
        raise InputRefused(
            f"name: {name!r} is a word of C, Python or MATLAB or a file of theirs: choose another, such as "
            f"{plain}_model"
        )
    return f"{plain}_model"


def one_line(text: str) -> str:
    """Text for a comment: one line that ends no comment of any language."""
    plain = " ".join("".join(c for c in text if c.isprintable()).split())
    return plain.replace("/*", "/ *").replace("*/", "* /").replace('"""', "'''")
