"""A program as C99: a header and a source file without dependencies, allocation or global state."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable
from typing import ClassVar

from phnn.exporting.program import (
    CONSTANTS_ABOUT,
    Constant,
    Field,
    Function,
    Program,
    called,
    header,
    indented,
    is_taken,
    one_line,
    walk,
)

_FUNCTIONS = {"absolute": "fabs", "isfinite": "isfinite"}
_HELPERS = {
    "maximum": "static double maximum(double a, double b) { return a >= b ? a : b; }",
    "minimum": "static double minimum(double a, double b) { return a <= b ? a : b; }",
    "sign": "static double sign(double a) { return (double)((a > 0.0) - (a < 0.0)); }",
}


class Printer:
    """Prints the statements of one function in C.

    Other languages have the same operators and levels, and other attributes, of which those with braces are filled with
    a test, or with the name, the number and the last value of a loop.
    """

    negation = "!"
    field = "s->"
    first, other, otherwise, end = "if ({}) {{", "}} else if ({}) {{", "} else {", "}"
    loop = "for (int {0} = 0; {0} < {1}; {0}++) {{"
    operators: ClassVar[dict[type, tuple[str, int]]] = {
        ast.Add: ("+", 6), ast.Sub: ("-", 6), ast.Mult: ("*", 7), ast.Div: ("/", 7), ast.Lt: ("<", 5),
        ast.LtE: ("<=", 5), ast.Gt: (">", 5), ast.GtE: (">=", 5), ast.Eq: ("==", 5), ast.NotEq: ("!=", 5),
        ast.And: ("&&", 3), ast.Or: ("||", 2),
    }  # fmt: skip
    conditional, unary, primary = 1, 8, 9

    def __init__(self, program: Program, function: Function) -> None:
        self.program, self.function = program, function
        self.nodes = nodes = list(walk(function.body))
        self.named = {n.id for n in nodes if isinstance(n, ast.Name)} | ({"s"} if function.of_state else set())
        slices = [n for s in nodes if isinstance(s, ast.Subscript) for n in ast.walk(s.slice)]
        self.whole = {n.id for n in slices if isinstance(n, ast.Name)}
        self.loops = {n.target.id for n in nodes if isinstance(n, ast.For) and isinstance(n.target, ast.Name)}

    def name(self, name: str) -> str:
        """Return a local name; words of a language get an underscore."""
        return f"{name}_" if is_taken(name) else name

    def expression(self, node: ast.expr, level: int = 0) -> str:
        """Return an expression in brackets if it binds less than ``level``."""
        text, precedence = self._expression(node)
        return f"({text})" if precedence < level else text

    def _expression(self, node: ast.expr) -> tuple[str, int]:
        if isinstance(node, ast.Constant):
            # As Python writes a number, it reads back as the same one in every language.
            return repr(node.value), self.primary
        if isinstance(node, ast.Name):
            return self.name(node.id), self.primary
        if isinstance(node, ast.Attribute):
            return f"{self.field}{node.attr}", self.primary
        if isinstance(node, ast.Subscript):
            return self._entry(node), self.primary
        if isinstance(node, ast.UnaryOp):
            sign = self.negation if isinstance(node.op, ast.Not) else "-"
            return f"{sign}{self.expression(node.operand, self.unary + 1)}", self.unary
        if isinstance(node, ast.BinOp):
            sign, level = self.operators[type(node.op)]
            return f"{self.expression(node.left, level)} {sign} {self.expression(node.right, level + 1)}", level
        if isinstance(node, ast.Compare):
            sign, level = self.operators[type(node.ops[0])]
            # Brackets around comparisons that are compared, which compilers ask for.
            return f"{self.expression(node.left, 6)} {sign} {self.expression(node.comparators[0], 6)}", level
        if isinstance(node, ast.BoolOp):
            sign, level = self.operators[type(node.op)]
            # Brackets around mixed conditions, which compilers ask for.
            return f" {sign} ".join(self.expression(v, 4) for v in node.values), level
        if isinstance(node, ast.Call):
            return self._call(node)
        raise TypeError(ast.dump(node))

    def _statement(self, node: ast.stmt) -> list[str]:
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = zip(target.elts, value.elts, strict=True)
                return [line for one, part in pairs for line in self._assign(one, part)]
            return self._assign(target, value)
        if isinstance(node, ast.AugAssign):
            loaded = ast.parse(ast.unparse(node.target), mode="eval").body
            return self._assign(node.target, ast.BinOp(loaded, node.op, node.value))
        if isinstance(node, ast.If):
            return [*self._branches(node, self.first), self.end]
        if isinstance(node, ast.For):
            i, n = self.name(node.target.id), node.iter.args[0].value  # type: ignore[attr-defined]
            return [self.loop.format(i, n, n - 1), *indented(self._block(node.body)), self.end]
        if isinstance(node, ast.Break):
            return ["break;"]
        if isinstance(node, ast.Return):
            assert node.value is not None
            return self._return(node.value)
        if isinstance(node, ast.Expr):
            return self._alone(node.value)
        raise TypeError(ast.dump(node))

    def _branches(self, node: ast.If, head: str) -> list[str]:
        lines = [head.format(self.expression(node.test)), *indented(self._block(node.body))]
        if len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
            return [*lines, *self._branches(node.orelse[0], self.other)]
        return [*lines, self.otherwise, *indented(self._block(node.orelse))] if node.orelse else lines

    def _block(self, body: Iterable[ast.stmt]) -> list[str]:
        return [line for statement in body for line in self._statement(statement)]

    def _entry(self, node: ast.Subscript) -> str:
        return f"{self.expression(node.value, self.primary)}[{self.expression(node.slice)}]"

    def _call(self, node: ast.Call, outputs: Iterable[str] = ()) -> tuple[str, int]:
        name = node.func.id  # type: ignore[attr-defined]
        if name == "where":
            condition, yes, no = (self.expression(a, self.conditional + 1) for a in node.args)
            return f"{condition} ? {yes} : {no}", self.conditional
        arguments = [self.expression(a) for a in node.args]
        if name in self.program.functions:
            name = public(self.program, name)
        return f"{_FUNCTIONS.get(name, name)}({', '.join([*arguments, *outputs])})", self.primary

    def lines(self) -> list[str]:
        """Return the function's body; what it assigns to is declared at its beginning."""
        stored = [n.id for n in self.nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        local = [n for n in dict.fromkeys(stored) if n not in {*self.function.arguments, *self.loops}]
        start = [f"(void){self.name(a)};" for a in self.function.arguments if a not in self.named]
        start += [f"int {self.name(n)} = 0;" if n in self.whole else f"double {self.name(n)} = 0.0;" for n in local]
        return [*start, *self._block(self.function.body)]

    def _assign(self, target: ast.expr, value: ast.expr) -> list[str]:
        if not isinstance(target, ast.Tuple):
            return [f"{self.expression(target)} = {self.expression(value)};"]
        outputs = [f"&{self.expression(t)}" for t in target.elts]
        return [f"{self._call(value, outputs)[0]};"]  # type: ignore[arg-type]

    def _return(self, value: ast.expr) -> list[str]:
        if self.function.returns == 1:
            return [f"return {self.expression(value)};"]
        outputs = [f"out_{i}" for i in range(self.function.returns)]
        if isinstance(value, ast.Tuple):
            pairs = zip(outputs, value.elts, strict=True)
            return [*(f"*{out} = {self.expression(v)};" for out, v in pairs), "return;"]
        return [f"{self._call(value, outputs)[0]};", "return;"]  # type: ignore[arg-type]

    def _alone(self, value: ast.expr) -> list[str]:
        return [f"{self.expression(value)};"]


def public(program: Program, name: str) -> str:
    """Return the name of a function in C: those that are called from outside have the program's as prefix."""
    # The public step also gives the output.
    return f"{program.name}_{'advance' if name == 'step' else name}"


def _signature(program: Program, f: Function, api: bool = False) -> str:
    arguments = [f"double {a}_" if is_taken(a) else f"double {a}" for a in f.arguments[1 if f.of_state else 0 :]]
    if f.of_state:
        arguments.insert(0, f"{'' if f.changes else 'const '}{program.name}_state *s")
    if f.returns > 1:
        arguments += [f"double *out_{i}" for i in range(f.returns)]
    kind = "double" if f.returns == 1 else "void"
    return f"{'' if api else 'static '}{kind} {public(program, f.name)}({', '.join(arguments)})"


def _function(program: Program, f: Function, api: bool) -> str:
    lines = [f"/* {one_line(f.about)} */"] if f.about else []
    lines += [f"{_signature(program, f, api)} {{", *indented(Printer(program, f).lines()), "}"]
    text = "\n".join(lines)
    return text.replace("    return;\n}", "}") if f.returns > 1 else text


def _constant(constant: Constant) -> str:
    about = f" /* {one_line(constant.about)} */" if constant.about else ""
    if isinstance(constant.value, float):
        return f"static const double {constant.name} = {constant.value!r};{about}"
    rows = ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in constant.value)
    shape = f"[{len(constant.value)}][{len(constant.value[0])}]"
    return f"static const double {constant.name}{shape} = {{{rows}}};{about}"


def _field(field: Field) -> str:
    shape = "".join(f"[{n}]" for n in field.shape)
    return f"    {'int' if field.index else 'double'} {field.name}{shape}; /* {one_line(field.about)} */"


API = ("init", "substep", "output")


def _step(program: Program) -> str:
    inputs = ", ".join(f"double {a}" for a in program.functions["step"].arguments[1:])
    return f"int {program.name}_step({program.name}_state *s, {inputs}, double *y)"


def c_header(program: Program) -> str:
    """Return the text of the header file."""
    guard = f"{program.name.upper()}_H"
    about = map(one_line, header(program).splitlines())
    lines = [f"/* {line}" if i == 0 else f" * {line}" for i, line in enumerate(about)]
    lines += [" */", f"#ifndef {guard}", f"#define {guard}", "", "#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    lines += [f"#define {program.name.upper()}_DT {program.dt!r} /* sample time [s] */", ""]
    lines += [f"typedef struct {program.name}_state {{", *map(_field, program.used_fields())]
    size = sum(math.prod(f.shape) for f in program.used_fields())
    lines += [f"}} {program.name}_state; /* fits into an array of {size} doubles */", ""]
    for name in API:
        f = program.functions[name]
        lines += [f"/* {one_line(f.about)} */", f"{_signature(program, f, True)};", ""]
    lines += ["/* One sample time to the given input; y is the output there. Returns 0 where a step was not solved. */"]
    lines += [f"{_step(program)};", "", "#ifdef __cplusplus", "}", "#endif", "", "#endif"]
    return "\n".join(lines) + "\n"


def c_source(program: Program) -> str:
    """Return the text of the source file."""
    wanted = {name for f in program.functions.values() for name in called(f.body)}
    parts = [f'#include "{program.name}.h"\n\n#include <math.h>']
    parts += ["\n".join(text for name, text in _HELPERS.items() if name in wanted)] if wanted & set(_HELPERS) else []
    about = "/* " + " ".join(CONSTANTS_ABOUT) + " */"
    parts.append("\n".join([about, *map(_constant, program.used_constants())]))
    parts += [_function(program, f, f.name in API) for f in program.functions.values()]
    inputs = ", ".join(program.functions["step"].arguments[1:])
    step = [f"const int solved = {public(program, 'advance')}(s, {inputs}) > 0.0;"]
    step += [f"*y = {public(program, 'output')}(s);", "return solved;"]
    parts.append("\n".join([f"{_step(program)} {{", *indented(step), "}"]))
    return "\n\n".join(parts) + "\n"
