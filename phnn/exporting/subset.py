"""The subset of Python that is translated: statements, expressions and operators; all else is refused by name."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping

from phnn.errors import InputRefused
from phnn.exporting.program import INTRINSICS, STATE, Function

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


def refused(what: str, cause: str) -> InputRefused:
    """What is raised for a law that has no translation."""
    return InputRefused(
        f"{what}: cannot be exported: {cause}: write its law as a plain function of phnn.laws.namespace, or export a "
        "model without it"
    )


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
    tuples = {id(t) for s in tree.body for node in ast.walk(s) for t in _tuples(node)}
    # No printer shows texts that stand alone.
    spoken = [s for s in tree.body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
    for statement in spoken:
        for node in ast.walk(statement):
            if not isinstance(node, _KNOWN) or _is_beyond(node, tuples, functions):
                raise refused(what, f"its source has what is not translated, {_shown(node)!r}")


def _shown(node: ast.AST) -> str:
    text = ast.unparse(node) if isinstance(node, ast.expr | ast.stmt) else type(node).__name__
    return (text or type(node).__name__)[:_SHOWN]


def _tuples(node: ast.AST) -> list[ast.AST]:
    """Tuples where a statement may have them: several targets, and the values of these or of a function."""
    if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
        return [node.value]
    if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Tuple):
        return []
    return [node.targets[0], node.value]


def _is_beyond(node: ast.AST, tuples: set[int], functions: Mapping[str, Function]) -> bool:
    """Whether a node of a known kind is used in a way that is not translated."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, bool) or not (
            isinstance(node.value, int | float) and math.isfinite(float(node.value))
        )
    if isinstance(node, ast.Tuple):
        return id(node) not in tuples
    if isinstance(node, ast.Attribute):
        return not (isinstance(node.value, ast.Name) and node.value.id == STATE)
    if isinstance(node, ast.BoolOp):
        return not all(isinstance(v, _TRUTHS) for v in node.values)
    if isinstance(node, ast.Subscript):
        return not isinstance(node.slice, ast.Constant | ast.Name | ast.BinOp)
    if isinstance(node, ast.Call):
        return _is_unknown_call(node, functions)
    return _is_unknown_statement(node, functions)


def _is_unknown_call(node: ast.Call, functions: Mapping[str, Function]) -> bool:
    if not isinstance(node.func, ast.Name) or node.keywords:
        return True
    name, count = node.func.id, len(node.args)
    if name in functions:
        return count != len(functions[name].arguments)
    return count != _ARGUMENTS.get(name, count)


def _is_unknown_statement(node: ast.AST, functions: Mapping[str, Function]) -> bool:
    if isinstance(node, ast.For):
        ranged = isinstance(node.iter, ast.Call) and isinstance(node.iter.func, ast.Name)
        return bool(node.orelse) or not isinstance(node.target, ast.Name) or not ranged or node.iter.func.id != "range"  # type: ignore[attr-defined]
    if isinstance(node, ast.Return):
        return node.value is None
    if isinstance(node, ast.Expr):
        return not isinstance(node.value, ast.Call)
    if not isinstance(node, ast.Assign):
        return False
    target, value = node.targets[0], node.value
    if len(node.targets) > 1:
        return True
    if not isinstance(target, ast.Tuple):
        return False
    if isinstance(value, ast.Tuple):
        return len(value.elts) != len(target.elts)
    called = value.func.id if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) else ""
    return called not in functions or functions[called].returns != len(target.elts)
