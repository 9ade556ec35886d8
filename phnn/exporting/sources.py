"""Laws and blocks of the package as functions of an exported program, read from their own source texts."""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.exporting.program import INTRINSICS, Function, made
from phnn.laws import namespace

# Functions that are known to every target, by the objects that the package's sources name.
_KNOWN: dict[Any, str] = {getattr(namespace, n): n for n in INTRINSICS if hasattr(namespace, n)}
_KNOWN |= {
    np.exp: "exp", np.sqrt: "sqrt", np.log: "log", np.log1p: "log1p", np.tanh: "tanh", np.sin: "sin", np.cos: "cos",
    np.sign: "sign", np.minimum: "minimum", np.maximum: "maximum", np.isfinite: "isfinite", np.where: "where",
    math.exp: "exp", math.sqrt: "sqrt", math.log: "log", abs: "absolute", max: "maximum", min: "minimum",
}  # fmt: skip
# Functions that only concern arrays, derivatives or compilation: their argument stands for them.
_TRANSPARENT = {namespace.real, namespace.certain, np.asarray, np.real, float}
_PARTS = (ast.Assign, ast.AugAssign, ast.If, ast.For, ast.Break, ast.Return)


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
        called: str = "",
        suffix: str = "",
    ) -> str:
        """The name under which a function of the package is called in the program; it is translated the first time.

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
            _refuse_beyond(tree, what)
            self._names[key] = name
            self.functions[name] = made(name, tree, self.functions)
        return self._names[key]


def _free(name: str, source: Callable[..., Any], taken: Mapping[str, Any]) -> str:
    """A name that is not taken: the function's own, or one with that of its module."""
    if name not in taken and name not in INTRINSICS:
        return name
    longer = f"{name}_{source.__module__.rpartition('.')[2]}"
    return next(n for n in (longer, *(f"{longer}_{i}" for i in range(2, 1000))) if n not in taken)


def _definition(source: Callable[..., Any], what: str) -> ast.FunctionDef:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(source))).body[0]
    except (OSError, TypeError, SyntaxError) as error:
        raise _refused(what, f"the source of {source.__name__} cannot be read ({error})") from error
    if not isinstance(tree, ast.FunctionDef):
        raise _refused(what, f"{source.__name__} is no plain function")
    return tree


def _refused(what: str, cause: str) -> InputRefused:
    return InputRefused(
        f"{what}: cannot be exported: {cause}: write its law as a plain function of phnn.laws.namespace, or export a "
        "model without it"
    )


def _refuse_beyond(tree: ast.FunctionDef, what: str) -> None:
    """Refuse statements that the printers do not know."""
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and node is not tree and not isinstance(node, _PARTS):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant | ast.Call):
                continue
            raise _refused(what, f"its source has a statement that is not translated, {ast.unparse(node)[:60]!r}")


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
        node.decorator_list, node.returns = [], None
        for argument in node.args.args:
            argument.annotation = None
        node.body = self._all(node.body)
        return node

    def _all(self, body: list[ast.stmt]) -> list[ast.stmt]:
        found: list[ast.stmt] = []
        for statement in body:
            outer, self.before = self.before, []
            for name in ("body", "orelse"):
                if hasattr(statement, name) and isinstance(statement, ast.If | ast.For):
                    setattr(statement, name, self._all(getattr(statement, name)))
            changed = self._headed(statement)
            found += [*self.before, changed]
            self.before = outer
        return found

    def _headed(self, statement: ast.stmt) -> ast.stmt:
        """A statement with its own expressions simplified; those of the blocks in it are simplified already."""
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
            return ast.Constant(float(value))
        return node

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
        if isinstance(node.func, ast.Name) and node.func.id in self.renamed:
            return ast.Call(self.visit(node.func), [self.visit(a) for a in node.args], [])
        if isinstance(node.func, ast.Name) and node.func.id == "range":
            return ast.Call(node.func, [ast.Constant(int(ast.literal_eval(self.visit(node.args[0]))))], [])
        if isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            return self.visit(node.func.value)
        function = self._function(node.func)
        if function in _TRANSPARENT:
            return self.visit(node.args[0])
        if function is namespace.reciprocal:
            return ast.BinOp(ast.Constant(1.0), ast.Div(), self.visit(node.args[0]))
        if function in _KNOWN:
            name = _KNOWN[function]
        elif inspect.isfunction(function):
            own = function.__module__ == self.module
            renamed, suffix = (self.renamed, self.suffix) if own else ({}, "")
            name = self.sources.name_of(function, self.what, renamed, suffix=suffix)
        else:
            raise _refused(self.what, f"its source calls {ast.unparse(node.func)}, which has no translation")
        return ast.Call(ast.Name(name, ast.Load()), [self.visit(a) for a in node.args], [])

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        value = self.visit(node.value)
        if not isinstance(value, ast.Call):
            return ast.Subscript(value, self.visit(node.slice), node.ctx)
        # One of the values that a function returns.
        count = self.sources.functions[value.func.id].returns  # type: ignore[attr-defined]
        names = [f"value_{self.temporaries + i}" for i in range(count)]
        self.temporaries += count
        targets = ast.Tuple([ast.Name(n, ast.Store()) for n in names], ast.Store())
        self.before.append(ast.Assign([targets], value, lineno=0))
        return ast.Name(names[ast.literal_eval(node.slice)], ast.Load())

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        left, right = self.visit(node.left), self.visit(node.right)
        if isinstance(node.op, ast.BitAnd | ast.BitOr):
            return ast.BoolOp(ast.And() if isinstance(node.op, ast.BitAnd) else ast.Or(), [left, right])
        if isinstance(node.op, ast.Mult) and (_is_zero(left) or _is_zero(right)):
            return ast.Constant(0.0)
        if isinstance(node.op, ast.Add | ast.Sub) and _is_zero(right):
            return left
        if isinstance(node.op, ast.Add) and _is_zero(left):
            return right
        if isinstance(node.op, ast.Pow):
            raise _refused(self.what, f"its source has the power {ast.unparse(node)}")
        return ast.BinOp(left, node.op, right)


def _is_zero(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value == 0.0
