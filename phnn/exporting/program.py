"""The program of an exported model: functions in a small part of Python, constants and a state.

Printers turn it into C, Python and MATLAB. A function is a syntax tree of Python's own `ast` module that uses only

    assignments, ``if``, ``for i in range(n)``, ``break``, ``return`` of one value or of several,
    numbers, names, entries of arrays, fields ``s.x`` of the state, calls of other functions of the program and of
    those in `INTRINSICS`

so that laws and blocks of the package, which are written in it, are translated and never written a second time. Here
are also the identifiers that every target language takes, and the texts that exported files of every language share.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from phnn.errors import InputRefused

# Words that some target language, or its library, keeps for itself.
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
end elseif function otherwise parfor persistent spmd s y u h main self math
"""
RESERVED = frozenset(_WORDS.split()) | frozenset(keyword.kwlist)
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
        """Return the identifier of a name; the same every time."""
        if name not in self._given:
            plain = identifier(name)
            taken = set(self._given.values())
            numbered = (f"{plain}_{i}" for i in range(2, len(taken) + 3))
            self._given[name] = next(n for n in (plain, *numbered) if n not in taken)
        return self._given[name]


def identifier(name: str) -> str:
    """Return a name with what no identifier may hold replaced by underscores."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name)[:_LONGEST].strip("_") or "x"
    return f"x_{plain}" if plain[0].isdigit() else plain


def prefix(name: str, title: str) -> str:
    """Return the name of files and the prefix of what is public: the given one, or that of the model.

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
    """Return the text for a comment: one line that ends no comment of any language."""
    plain = " ".join("".join(c for c in text if c.isprintable()).split())
    return plain.replace("/*", "/ *").replace("*/", "* /").replace('"""', "'''")


_HOLD = {
    "linear": "the input runs straight from the last value to the given one",
    "zero_order": "the input has the given value since the last call",
}


def header(program: Program) -> str:
    """Return what an exported file is, in a few lines of text."""
    inputs = ", ".join(f"{n} [{unit}]" for n, unit in program.inputs)
    name, unit = program.output
    begin = "init begins in the state of rest that was computed at the export; its input only fills the amplifier."
    if program.from_rest:
        begin = "init begins in the equilibrium under a constant input, in which hysterons are empty."
    text = (
        f"{program.title}: exported by phnn.\n\n"
        f"Input: {inputs}. Output: what is measured of {name} [{unit}], SI.\n"
        f"A call of step advances the model by DT = {program.dt:g} s in {program.substeps} power-preserving step(s);\n"
        f"{_HOLD[program.hold]}. The output is that at the end of DT.\n"
        f"{begin}"
    )
    # In a text of Python it would begin an escape.
    return text.replace("\\", "/")


# What the constants are.
CONSTANTS_ABOUT = (
    "Parameters P_ in SI units, and constants D_ that follow from them and from the step H.",
    "Whoever changes a parameter or the step exports the model again.",
)


# What every target language offers under some name.
INTRINSICS = frozenset(
    {"exp", "sqrt", "log", "log1p", "tanh", "sin", "cos", "absolute", "maximum", "minimum", "where", "isfinite", "sign"}
)
STATE = "s"


@dataclass(frozen=True)
class Function:
    """A function of the program.

    Attributes:
        name: unique in the program.
        arguments: their names, `STATE` first where the function reads or changes the state.
        body: statements.
        returns: number of values that it returns.
        about: a line for the comment above it.
        of_state: whether it is given the state; changes: whether it changes the state.
    """

    name: str
    arguments: tuple[str, ...]
    body: tuple[ast.stmt, ...]
    returns: int
    about: str = ""
    of_state: bool = False
    changes: bool = False


@dataclass(frozen=True)
class Constant:
    """A number, or a table of numbers, that the functions refer to by name."""

    name: str
    value: float | tuple[tuple[float, ...], ...]
    about: str = ""


@dataclass(frozen=True)
class Field:
    """A field of the state.

    Attributes:
        name: of the field.
        shape: empty for a number, else the lengths of the array.
        about: a line for the comment beside it.
        index: whether it is a whole number, the place of an entry of an array.
    """

    name: str
    shape: tuple[int, ...] = ()
    about: str = ""
    index: bool = False


@dataclass
class Program:
    """A model as a program.

    Attributes:
        name: an identifier, the prefix of all that a target makes public.
        title: one line of text for comments.
        dt: sample time [s]; substeps: steps in it; hold: the input between samples, ``linear`` or ``zero_order``.
        inputs: (name, unit) of the inputs, the recorded one first; output: (name, unit).
        constants, fields, functions: by name, a function after those that it calls.
        states: fields of the network's states, by the names that the network gives them.
        from_rest: the initial state follows the constant input that it is given; else it is that of zero input.
    """

    name: str
    title: str
    dt: float
    substeps: int
    hold: str
    inputs: tuple[tuple[str, str], ...]
    output: tuple[str, str]
    from_rest: bool = True
    constants: dict[str, Constant] = field(default_factory=dict)
    fields: dict[str, Field] = field(default_factory=dict)
    functions: dict[str, Function] = field(default_factory=dict)
    states: dict[str, str] = field(default_factory=dict)

    def constant(self, name: str, value: float, about: str = "") -> str:
        """Add a constant, once; returns its name.

        Raises:
            InputRefused: it is not finite.
        """
        self.constants.setdefault(name, Constant(name, _finite(name, about, float(value)), about))
        return name

    def table(self, name: str, rows: tuple[tuple[float, ...], ...], about: str = "") -> str:
        """Set a table of numbers; return its name.

        Raises:
            InputRefused: a number is not finite.
        """
        self.constants[name] = Constant(name, tuple(tuple(_finite(name, about, v) for v in row) for row in rows), about)
        return name

    def state(self, name: str, about: str = "", shape: tuple[int, ...] = (), index: bool = False) -> str:
        """Add a field of the state, once; returns how functions refer to it."""
        self.fields.setdefault(name, Field(name, shape, about, index))
        return f"{STATE}.{name}"

    def add(
        self, name: str, arguments: tuple[str, ...], lines: list[str], about: str = "", of_state: bool = True
    ) -> str:
        """Add a function from the lines of its body, whose calls refer to known functions; returns its name."""
        text = "\n".join(indented(lines))
        tree = ast.parse(f"def f({', '.join((*[STATE] * of_state, *arguments))}):\n{text}").body[0]
        assert isinstance(tree, ast.FunctionDef)
        self.functions[name] = made(name, tree, self.functions, about)
        return name

    def used_constants(self) -> list[Constant]:
        """Return the constants that a function names, in the order in which they were added."""
        names = {n.id for f in self.functions.values() for n in walk(f.body) if isinstance(n, ast.Name)}
        return [c for c in self.constants.values() if c.name in names]

    def used_fields(self) -> list[Field]:
        """Return the fields that a function names, in the order in which they were added."""
        names = {n.attr for f in self.functions.values() for n in walk(f.body) if isinstance(n, ast.Attribute)}
        return [f for f in self.fields.values() if f.name in names]

    def needed(self, *roots: str) -> dict[str, Function]:
        """Return the functions that are called by the roots, or by what these call, and the roots."""
        kept = set(roots)
        for name in reversed(self.functions):
            if name in kept:
                kept |= set(called(self.functions[name].body))
        return {n: f for n, f in self.functions.items() if n in kept}


def _finite(name: str, about: str, value: float) -> float:
    if not math.isfinite(value):
        raise InputRefused(
            f"{name} ({about}): {value:g} is not finite and cannot be exported: choose a longer sample time, or "
            "parameters of usual size"
        )
    return value


def walk(body: Iterable[ast.stmt]) -> Iterator[ast.AST]:
    """Return all nodes of statements, without those of texts that stand alone, which no printer shows."""
    for statement in body:
        if not _is_text(statement):
            yield from ast.walk(statement)


def _is_text(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def called(body: Iterable[ast.stmt]) -> list[str]:
    """Return the names of the functions that statements call."""
    return [n.func.id for n in walk(body) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]


def returned(body: tuple[ast.stmt, ...], known: dict[str, Function]) -> int:
    """Return the number of values that statements return."""
    for node in walk(body):
        if isinstance(node, ast.Return) and node.value is not None:
            if isinstance(node.value, ast.Tuple):
                return len(node.value.elts)
            name = node.value.func.id if isinstance(node.value, ast.Call) else ""  # type: ignore[attr-defined]
            return known[name].returns if name in known else 1
    return 0


def made(name: str, tree: ast.FunctionDef, known: dict[str, Function], about: str = "") -> Function:
    """Return the function of a definition that is in the subset already."""
    body = tuple(s for s in tree.body if not _is_text(s))
    arguments = tuple(a.arg for a in tree.args.args)
    text = " ".join((about or ast.get_docstring(tree) or "").partition("\n\n")[0].split())
    nodes, callees = list(walk(body)), [known[name] for name in called(body) if name in known]
    of_state = any(isinstance(n, ast.Attribute) for n in nodes) or any(f.of_state for f in callees)
    stored = any(isinstance(n, ast.Attribute | ast.Subscript) and isinstance(n.ctx, ast.Store) for n in nodes)
    changes = of_state and (stored or any(f.changes for f in callees))
    return Function(name, arguments, body, returned(body, known), text, of_state, changes)


def indented(lines: Iterable[str]) -> list[str]:
    """Return the lines of a block."""
    return [f"    {line}" for line in lines]


def is_taken(name: str) -> bool:
    """Return whether a local name is a word of some target language."""
    return name in RESERVED - {"s", "y", "u", "h"}
