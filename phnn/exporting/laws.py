"""Laws and blocks as functions and expressions of an exported program, read from their own source texts.

`refuse_beyond` holds the subset of Python that is translated: statements, expressions and operators. All else is
refused by name.
"""

from __future__ import annotations

import ast
import copy
import inspect
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.exporting.program import INTRINSICS, STATE, Function, Names, Program, made, one_line, walk
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS, namespace
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, form_of
from phnn.network.elements import Modulation, ModulatorState, Port, Resistor, Storage
from phnn.parameters import Parameter

_STATEMENTS = (ast.Assign, ast.AugAssign, ast.If, ast.For, ast.Break, ast.Return, ast.Expr)
_EXPRESSIONS = (
    ast.Constant, ast.Name, ast.Attribute, ast.Subscript, ast.UnaryOp, ast.BinOp, ast.Compare, ast.BoolOp, ast.Call,
    ast.Tuple,
)  # fmt: skip
_OPERATORS = (
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.USub, ast.Not, ast.And, ast.Or, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq,
    ast.NotEq,
)  # fmt: skip
_KNOWN = (*_STATEMENTS, *_EXPRESSIONS, *_OPERATORS, ast.Load, ast.Store)
# What is joined by `and` and `or`: of numbers, Python gives one of them where other languages give a truth value.
_TRUTHS = (ast.Compare, ast.BoolOp, ast.UnaryOp, ast.Name, ast.Call)
_ARGUMENTS = dict.fromkeys(INTRINSICS, 1) | {"maximum": 2, "minimum": 2, "where": 3}
# Longest piece of source in a message.
_SHOWN = 60


def refused(
    what: str,
    cause: str,
    remedy: str = "write its law as a plain function of phnn.laws.namespace, or export a model without it",
) -> InputRefused:
    """Return the refusal of what cannot be exported, with cause and remedy; by default of an untranslated law."""
    return InputRefused(f"{what}: cannot be exported: {cause}: {remedy}")


def refuse_beyond(tree: ast.FunctionDef, what: str, functions: Mapping[str, Function]) -> None:
    """Refuse what the printers do not know.

    Args:
        tree: a definition whose names are resolved.
        what: the element whose law it is.
        functions: those of the program, whose numbers of arguments are compared.

    Raises:
        InputRefused: names the element and the construct.
    """
    given = tree.args
    if given.posonlyargs or given.kwonlyargs or given.vararg or given.kwarg:
        raise refused(what, f"{tree.name} has arguments that are not plain ones, {ast.unparse(given)!r}")
    tuples = {id(t) for node in walk(tree.body) for t in _tuples(node)}
    for node in walk(tree.body):
        if not isinstance(node, _KNOWN) or _is_beyond(node, tuples, functions):
            text = ast.unparse(node) if isinstance(node, ast.expr | ast.stmt) else ""
            construct = (text or type(node).__name__)[:_SHOWN]
            raise refused(what, f"its source has what is not translated, {construct!r}")


def _tuples(node: ast.AST) -> list[ast.AST]:
    """Return tuples where a statement may have them: several targets, and the values of these or of a function."""
    if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
        return [node.value]
    if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Tuple):
        return []
    return [node.targets[0], node.value]


def _is_range(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "range"


# How nodes of these kinds have to be used to be translated.
_USED: dict[type[ast.AST], Callable[[Any], bool]] = {
    ast.Constant: lambda node: type(node.value) in (int, float) and math.isfinite(node.value),
    ast.Attribute: lambda node: isinstance(node.value, ast.Name) and node.value.id == STATE,
    ast.BoolOp: lambda node: all(isinstance(v, _TRUTHS) for v in node.values),
    ast.Subscript: lambda node: isinstance(node.slice, ast.Constant | ast.Name | ast.BinOp),
    ast.For: lambda node: not node.orelse and isinstance(node.target, ast.Name) and _is_range(node.iter),
    ast.Return: lambda node: node.value is not None,
    ast.Expr: lambda node: isinstance(node.value, ast.Call),
}


def _is_beyond(node: ast.AST, tuples: set[int], functions: Mapping[str, Function]) -> bool:
    """Return whether a node of a known kind is used in a way that is not translated."""
    if isinstance(node, ast.Tuple):
        return id(node) not in tuples
    if isinstance(node, ast.Call):
        # The names of calls are resolved, and named arguments are refused already.
        name, count = node.func.id, len(node.args)  # type: ignore[attr-defined]
        wanted = len(functions[name].arguments) if name in functions else _ARGUMENTS.get(name, count)
        return bool(count != wanted)
    if isinstance(node, ast.Assign):
        target, value = node.targets[0], node.value
        if len(node.targets) > 1 or not isinstance(target, ast.Tuple):
            return len(node.targets) > 1
        if isinstance(value, ast.Tuple):
            return len(value.elts) != len(target.elts)
        called = value.func.id if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) else ""
        return called not in functions or functions[called].returns != len(target.elts)
    return type(node) in _USED and not _USED[type(node)](node)


# Functions that are known to every target, by the objects that the package's sources name.
_FUNCTIONS_OF_NUMBERS: dict[Any, str] = {
    getattr(module, n): n for module in (namespace, np, math) for n in INTRINSICS if hasattr(module, n)
} | {abs: "absolute", max: "maximum", min: "minimum"}
# Functions that only concern arrays, derivatives or compilation: their argument stands for them.
_TRANSPARENT = {namespace.real, namespace.certain, np.asarray, np.real, float}


class Sources:
    """Functions of the package that a program calls, with those that these call."""

    def __init__(self, functions: dict[str, Function]) -> None:
        self.functions = functions
        self._names: dict[Any, str] = {}

    def name_of(
        self,
        source: Callable[..., Any],
        what: str,
        renamed: Mapping[str, str] | None = None,
        suffix: str = "",
        called: str = "",
    ) -> str:
        """Return the name of a function of the package in the program; translate it the first time.

        Args:
            what: the element whose law it is, for messages.
            renamed: what stands for names in its source, and in functions of its module that it calls.
            called: its name in the program; its own where it is left out, followed by the suffix.

        Raises:
            InputRefused: its source cannot be read, or uses more than the exported subset of Python.
        """
        key = (source, tuple(sorted((renamed or {}).items())))
        if key not in self._names:
            name = _free(called or source.__name__.lstrip("_") + suffix, source, self.functions)
            tree = _definition(source, what)
            inner = _Simplified(self, source, what, renamed or {}, suffix)
            tree = ast.fix_missing_locations(inner.visit(tree))
            refuse_beyond(tree, what, self.functions)
            self._names[key] = name
            self.functions[name] = made(name, tree, self.functions)
        return self._names[key]


def _free(name: str, source: Callable[..., Any], taken: Mapping[str, Any]) -> str:
    """Return a name that is not taken: the function's own, or one with that of its module."""
    if name not in taken and name not in INTRINSICS:
        return name
    longer = f"{name}_{source.__module__.rpartition('.')[2]}"
    return next(n for n in (longer, *(f"{longer}_{i}" for i in range(2, 1000))) if n not in taken)


def _definition(source: Callable[..., Any], what: str) -> ast.FunctionDef:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(source))).body[0]
    except (OSError, TypeError, SyntaxError) as error:
        raise refused(what, f"the source of {source.__name__} cannot be read ({error})") from error
    if not isinstance(tree, ast.FunctionDef):
        raise refused(what, f"{source.__name__} is no plain function")
    return tree


class _Simplified(ast.NodeTransformer):
    """Resolves names, and drops what only arrays, tensors, complex steps and the compiler need."""

    def __init__(
        self, sources: Sources, source: Callable[..., Any], what: str, renamed: Mapping[str, str], suffix: str
    ) -> None:
        self.sources, self.what, self.renamed, self.suffix = sources, what, renamed, suffix
        self.module = source.__module__
        self.scope = source.__globals__
        self.local = set(source.__code__.co_varnames)
        self.temporaries = 0
        self.before: list[ast.stmt] = []

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.decorator_list, node.returns, node.args.defaults = [], None, []
        for argument in node.args.args:
            argument.annotation = None
        node.body = self._all(node.body)
        return node

    def _all(self, body: list[ast.stmt]) -> list[ast.stmt]:
        statements: list[ast.stmt] = []
        for statement in body:
            outer, self.before = self.before, []
            for name in ("body", "orelse"):
                if hasattr(statement, name) and isinstance(statement, ast.If | ast.For):
                    setattr(statement, name, self._all(getattr(statement, name)))
            changed = self._headed(statement)
            statements += [*self.before, *self._one_by_one(changed)]
            self.before = outer
        return statements

    def _one_by_one(self, statement: ast.stmt) -> list[ast.stmt]:
        """Split an assignment to several targets; keep values first where one target is read for a later one."""
        if not isinstance(statement, ast.Assign):
            return [statement]
        target, value = statement.targets[0], statement.value
        if not isinstance(target, ast.Tuple) or not isinstance(value, ast.Tuple):
            return [statement]
        later = [_names(ast.Tuple(value.elts[i + 1 :], ast.Load())) for i in range(len(target.elts))]
        if not any(_names(one) & read for one, read in zip(target.elts, later, strict=True)):
            return [statement]
        names = self._temporary(len(value.elts))
        kept = [ast.Assign([ast.Name(n, ast.Store())], v, lineno=0) for n, v in zip(names, value.elts, strict=True)]
        return [*kept, ast.Assign([target], ast.Tuple([ast.Name(n, ast.Load()) for n in names], ast.Load()), lineno=0)]

    def _temporary(self, count: int) -> list[str]:
        """Return the names that the function does not have."""
        self.temporaries += count
        return [f"value_{i}" for i in range(self.temporaries - count, self.temporaries)]

    def _headed(self, statement: ast.stmt) -> ast.stmt:
        """Return a statement with its own expressions simplified; those of the blocks in it are simplified already."""
        if isinstance(statement, ast.If):
            statement.test = self.visit(statement.test)
            return statement
        if isinstance(statement, ast.For):
            statement.target, statement.iter = self.visit(statement.target), self.visit(statement.iter)
            return statement
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            return statement
        return self.generic_visit(statement)  # type: ignore[return-value]

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id in self.local:
            return ast.Name(node.id.lstrip("_") or "unused", node.ctx)
        if node.id in self.renamed:
            return ast.parse(self.renamed[node.id], mode="eval").body
        value = self.scope.get(node.id)
        if isinstance(value, float | int) and not isinstance(value, bool):
            return _literal(float(value))
        raise refused(self.what, f"its source names {node.id}, which is no number")

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if node.attr == "real":
            return self.visit(node.value)
        base = node.value
        if isinstance(base, ast.Name) and self.scope.get(base.id) is np and isinstance(getattr(np, node.attr), float):
            return ast.Constant(getattr(np, node.attr))
        return node

    def _function(self, node: ast.expr) -> Any:
        if isinstance(node, ast.Name):
            return self.scope.get(node.id, {"abs": abs, "max": max, "min": min, "float": float}.get(node.id))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            return getattr(self.scope.get(node.value.id), node.attr, None)
        return None

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id in self.renamed and not node.keywords:
            return ast.Call(self.visit(node.func), [self.visit(a) for a in node.args], [])
        if _is_range(node):
            return self._range(node)
        if isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            return self.visit(node.func.value)
        function = self._function(node.func)
        if function in _TRANSPARENT and node.args:
            return self.visit(node.args[0])
        if node.keywords:
            raise refused(self.what, f"its source calls with named arguments, {ast.unparse(node)!r}")
        if function is namespace.reciprocal:
            return ast.BinOp(ast.Constant(1.0), ast.Div(), self.visit(node.args[0]))
        if function in _FUNCTIONS_OF_NUMBERS:
            name = _FUNCTIONS_OF_NUMBERS[function]
        elif inspect.isfunction(function):
            same_module = function.__module__ == self.module
            renamed, suffix = (self.renamed, self.suffix) if same_module else ({}, "")
            name = self.sources.name_of(function, self.what, renamed, suffix)
        else:
            raise refused(self.what, f"its source calls {ast.unparse(node.func)}, which has no translation")
        return ast.Call(ast.Name(name, ast.Load()), [self.visit(a) for a in node.args], [])

    def _range(self, node: ast.Call) -> ast.AST:
        count = _whole(self.visit(node.args[0])) if len(node.args) == 1 else None
        if count is None:
            raise refused(self.what, f"its source has {ast.unparse(node)!r}, not a range of one known number")
        return ast.Call(node.func, [ast.Constant(count)], [])

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        operand = self.visit(node.operand)
        if isinstance(node.op, ast.UAdd):
            return operand
        return ast.UnaryOp(ast.Not() if isinstance(node.op, ast.Invert) else node.op, operand)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        """Return a chain ``a < b < c`` as ``a < b and b < c``."""
        values = [self.visit(v) for v in (node.left, *node.comparators)]
        pairs = [
            ast.Compare(copy.deepcopy(a), [op], [copy.deepcopy(b)])
            for a, op, b in zip(values, node.ops, values[1:], strict=False)
        ]
        return pairs[0] if len(pairs) == 1 else ast.BoolOp(ast.And(), list(pairs))

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        return ast.Call(ast.Name("where", ast.Load()), [self.visit(v) for v in (node.test, node.body, node.orelse)], [])

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        value = self.visit(node.value)
        if not isinstance(value, ast.Call):
            at = self.visit(node.slice)
            if isinstance(at, ast.Constant) and isinstance(at.value, float) and at.value.is_integer():
                at = ast.Constant(int(at.value))  # a constant of the module
            return ast.Subscript(value, at, node.ctx)
        # One of the values that a function returns.
        known = self.sources.functions.get(value.func.id)  # type: ignore[attr-defined]
        count = known.returns if known is not None else 0
        at = _whole(node.slice)
        if at is None or not -count <= at < count:
            raise refused(self.what, f"its source has {ast.unparse(node)!r}, which is not one of {count} values")
        names = self._temporary(count)
        targets = ast.Tuple([ast.Name(n, ast.Store()) for n in names], ast.Store())
        self.before.append(ast.Assign([targets], value, lineno=0))
        return ast.Name(names[at], ast.Load())

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        first, second = self.visit(node.left), self.visit(node.right)
        if isinstance(node.op, ast.BitAnd | ast.BitOr):
            return ast.BoolOp(ast.And() if isinstance(node.op, ast.BitAnd) else ast.Or(), [first, second])
        if isinstance(node.op, ast.Mult) and (_is_zero(first) or _is_zero(second)):
            return ast.Constant(0.0)
        if isinstance(node.op, ast.Add | ast.Sub) and _is_zero(second):
            return first
        if isinstance(node.op, ast.Add) and _is_zero(first):
            return second
        if isinstance(node.op, ast.Pow):
            raise refused(self.what, f"its source has the power {ast.unparse(node)}")
        if isinstance(node.op, ast.Div):
            # Whole numbers are divided without a rest elsewhere.
            first, second = _real(first), _real(second)
        return ast.BinOp(first, node.op, second)


def _is_zero(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value == 0.0


def _real(node: ast.expr) -> ast.expr:
    return _literal(float(node.value)) if isinstance(node, ast.Constant) and isinstance(node.value, int) else node


def _literal(value: float) -> ast.expr:
    """Return a number; the sign of a negative one is an operator, for which printers set the brackets."""
    return ast.UnaryOp(ast.USub(), ast.Constant(-value)) if math.copysign(1.0, value) < 0.0 else ast.Constant(value)


def _whole(node: ast.AST) -> int | None:
    """Return the whole number that an expression writes out."""
    try:
        return int(ast.literal_eval(node))
    except (ValueError, TypeError):
        return None


def _names(node: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


# What messages call the elements that have laws, and these laws by name.
_LAWS: dict[type, tuple[str, Mapping[str, Any]]] = {
    Storage: ("storage", STORAGE_LAWS),
    Resistor: ("resistor", RESISTOR_LAWS),
    Port: ("port", PORT_LAWS),
    Modulation: ("modulation of", FACTOR_LAWS),
    ModulatorState: ("memory", MEMORY_LAWS),
}


class Elements:
    """Expressions of laws and parameters; what they name is added to the program.

    Args:
        program: to be filled.
        parameters: of the setup, by name.
    """

    def __init__(self, program: Program, parameters: Mapping[str, Parameter]) -> None:
        self.program, self.parameters = program, parameters
        self.sources = Sources(program.functions)
        self.names, self.states, self.tables = Names(), Names(), Names()

    def parameter(self, name: str) -> str:
        """Return the constant of a parameter."""
        p = self.parameters[name]
        about = one_line(f"{name}: {p.description or 'parameter'} [{p.unit}]")
        return self.program.constant(f"P_{self.names.of(name)}", p.value, about)

    def derived(self, name: str, value: float, about: str) -> str:
        """Return a constant that follows from parameters and the step."""
        return self.program.constant(f"D_{name}", value, about)

    def values(self, names: Sequence[str]) -> list[float]:
        """Return the values of parameters."""
        return [self.parameters[n].value for n in names]

    def call(self, source: Callable[..., Any], what: str, *arguments: str) -> str:
        """Return a call of one of the package's functions."""
        return f"{self.sources.name_of(source, what)}({', '.join(arguments)})"

    def law(self, element: Any, part: str, *arguments: str) -> str:
        """Return a call of a part of an element's law, such as ``mean_effort``, with its parameters."""
        if isinstance(element, Port) and element.law == "linear":
            return arguments[0]
        kind, known = _LAWS[type(element)]
        what = f"{kind} {element.ratio if isinstance(element, Modulation) else element.name}"
        if isinstance(element.law, str):
            values = (self.parameter(n) for n in element.parameters)
            return self.call(getattr(known[element.law], part), what, *arguments, *values)
        known, names = (WIDE_STORAGES, ("a", "b")) if isinstance(element, Storage) else (WIDE_RESISTORS, ("effort",))
        return f"{self._sum_over_units(known, element, what, names)}({', '.join(arguments[: len(names)])})"

    def _sum_over_units(self, known: Mapping[str, Any], element: Any, what: str, arguments: tuple[str, ...]) -> str:
        """Write a function of a law that is a sum over units, with its weights in a table, and return its name."""
        law = known[form_of(element.law)]
        name = f"law_{self.tables.of(what)}"
        if name in self.program.functions:
            return name
        weights = [float(w) for w in element.law.weights().detach().tolist()]
        head, units = weights[: law.head], weights[law.head :]
        rows = tuple(tuple(units[i : i + law.per_unit]) for i in range(0, len(units), law.per_unit))
        table = f"W_{self.tables.of(what)}"
        self.program.table(table, rows, one_line(f"weights of {what}, a row for each unit"))
        given = [self.derived(f"{name}_{i}", w, one_line(f"weight of {what}")) for i, w in enumerate(head)]
        entries = [f"{table}[i][{j}]" for j in range(law.per_unit)]
        lines = [
            "total = 0.0",
            f"for i in range({len(rows)}):",
            f"    total = total + {self.call(law.unit, what, *arguments, *entries)}",
            f"return {self.call(law.combine, what, *arguments, 'total', *given)}",
        ]
        return self.program.add(name, arguments, lines, one_line(f"law of {what}"), of_state=False)
