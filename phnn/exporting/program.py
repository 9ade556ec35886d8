"""The program of an exported model: functions in a small part of Python, constants and a state.

Printers turn it into C, Python and MATLAB. A function is a syntax tree of Python's own `ast` module that uses only

    assignments, ``if``, ``for i in range(n)``, ``break``, ``return`` of one value or of several,
    numbers, names, entries of arrays, fields ``s.x`` of the state, calls of other functions of the program and of
    those in `INTRINSICS`

so that laws and blocks of the package, which are written in it, are translated and never written a second time.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from phnn.errors import InputRefused

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
        """Set a table of numbers; returns its name.

        Raises:
            InputRefused: a number is not finite.
        """
        self.constants[name] = Constant(name, tuple(tuple(_finite(name, about, v) for v in row) for row in rows), about)
        return name

    def state(self, name: str, about: str = "", shape: tuple[int, ...] = (), index: bool = False) -> str:
        """Add a field of the state, once; returns how functions refer to it."""
        self.fields.setdefault(name, Field(name, shape, about, index))
        return f"{STATE}.{name}"

    def used_constants(self) -> list[Constant]:
        """Constants that a function names, in the order in which they were added."""
        names = {n.id for f in self.functions.values() for n in walk(f) if isinstance(n, ast.Name)}
        return [c for c in self.constants.values() if c.name in names]

    def used_fields(self) -> list[Field]:
        """Fields that a function names, in the order in which they were added."""
        names = {n.attr for f in self.functions.values() for n in walk(f) if isinstance(n, ast.Attribute)}
        return [f for f in self.fields.values() if f.name in names]

    def prune(self, roots: tuple[str, ...]) -> None:
        """Drop functions that the roots, and what these call, do not call."""
        kept: set[str] = set()
        for name in reversed(self.functions):
            if name in roots or name in kept:
                kept.add(name)
                kept |= {c for c in called(self.functions[name]) if c in self.functions}
        self.functions = {n: f for n, f in self.functions.items() if n in kept}


def _finite(name: str, about: str, value: float) -> float:
    if not math.isfinite(value):
        raise InputRefused(
            f"{name} ({about}): {value:g} is not finite and cannot be exported: choose a longer sample time, or "
            "parameters of usual size"
        )
    return value


def walk(function: Function) -> Iterator[ast.AST]:
    """All nodes of a function."""
    for statement in function.body:
        yield from ast.walk(statement)


def called(function: Function) -> list[str]:
    """Names of the functions that a function calls."""
    return [n.func.id for n in walk(function) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]


def returned(body: tuple[ast.stmt, ...], known: dict[str, Function]) -> int:
    """Number of values that statements return."""
    for statement in body:
        for node in ast.walk(statement):
            if isinstance(node, ast.Return) and node.value is not None:
                if isinstance(node.value, ast.Tuple):
                    return len(node.value.elts)
                name = node.value.func.id if isinstance(node.value, ast.Call) else ""  # type: ignore[attr-defined]
                return known[name].returns if name in known else 1
    return 0


def function(
    name: str,
    arguments: tuple[str, ...],
    lines: list[str],
    known: dict[str, Function],
    about: str = "",
    of_state: bool = True,
) -> Function:
    """A function from the lines of its body; its calls refer to known functions."""
    text = "\n".join(f"    {line}" for line in lines)
    tree = ast.parse(f"def f({', '.join((*[STATE] * of_state, *arguments))}):\n{text}").body[0]
    assert isinstance(tree, ast.FunctionDef)
    return made(name, tree, known, about)


def made(name: str, tree: ast.FunctionDef, known: dict[str, Function], about: str = "") -> Function:
    """The function of a definition that is in the subset already."""
    body = tuple(s for s in tree.body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant)))
    arguments = tuple(a.arg for a in tree.args.args)
    text = about or ast.get_docstring(tree) or ""
    found = Function(name, arguments, body, returned(body, known), " ".join(text.partition("\n\n")[0].split()))
    nodes, own = list(walk(found)), set(called(found))
    fields = any(isinstance(n, ast.Attribute) for n in nodes)
    of_state = fields or any(known[c].of_state for c in own if c in known)
    stored = any(isinstance(n, ast.Attribute | ast.Subscript) and isinstance(n.ctx, ast.Store) for n in nodes)
    changes = of_state and (stored or any(known[c].changes for c in own if c in known))
    return replace(found, of_state=of_state, changes=changes)
