"""A program as one file of Python that needs nothing but the standard library."""

from __future__ import annotations

import ast
import copy

from phnn.exporting.names import one_line
from phnn.exporting.program import Field, Function, Program
from phnn.exporting.words import constants_about, header

_MATH = ("exp", "sqrt", "log", "log1p", "tanh", "sin", "cos", "isfinite")
_BUILTIN = {"absolute": "abs", "maximum": "max", "minimum": "min"}

_CLASS = '''
class Model:
    """The model with its state.

    {usage}
    """

    def __init__(self, {arguments}):
        self.state = State()
        init(self.state, {passed})

    def step(self, {plain}):
        """Advance by one sample time DT under the input{s}; returns the output there."""
        if not step(self.state, {plain}):
            raise ArithmeticError("a step has no solution: is the input finite?")
        return output(self.state)

    @property
    def output(self):
        """What is measured now."""
        return output(self.state)
'''


class _Printed(ast.NodeTransformer):
    """Intrinsics as Python has them; only the chosen branch of `where` is evaluated."""

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name == "where":
            condition, yes, no = node.args
            return ast.IfExp(condition, yes, no)
        if name == "sign":
            x = ast.unparse(ast.fix_missing_locations(node.args[0]))
            return _name(f"float((({x}) > 0.0) - (({x}) < 0.0))")
        if name in _MATH:
            node.func = _name(f"math.{name}")
        elif name in _BUILTIN:
            node.func = _name(_BUILTIN[name])
        return node


def _name(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _function(function: Function) -> str:
    body = [_Printed().visit(copy.deepcopy(statement)) for statement in function.body]
    lines = [f"def {function.name}({', '.join(function.arguments)}):"]
    if function.about:
        lines.append(f'    """{_ended(one_line(function.about))}"""')
    for statement in body:
        lines += [f"    {line}" for line in ast.unparse(ast.fix_missing_locations(statement)).splitlines()]
    return "\n".join(lines)


def _ended(text: str) -> str:
    return (text.replace("\\", "/") + ("" if text.endswith(".") else ".")).replace('"', "'")


def _zero(field: Field) -> str:
    zero = "0" if field.index else "0.0"
    for length in reversed(field.shape):
        zero = f"[{zero} for _ in range({length})]"
    return zero


def python(program: Program) -> str:
    """The text of the file."""
    names = [n for n, _ in program.inputs]
    plain = ", ".join(["u", *(f"u_{n}" for n in names[1:])])
    lines = [f'"""{header(program)}\n"""', "", "import math", "", f"DT = {program.dt!r}  # sample time [s]"]
    lines += ["", *(f"# {line}" for line in constants_about(program))]
    for constant in program.used_constants():
        value = constant.value
        shown = repr(value) if isinstance(value, float) else repr([list(row) for row in value])
        lines += [f"{constant.name} = {shown}" + (f"  # {one_line(constant.about)}" if constant.about else "")]
    fields = program.used_fields()
    lines += ["", "", "class State:", '    """The state; init fills it."""', ""]
    lines += ["    __slots__ = (", *(f'        "{f.name}",  # {one_line(f.about)}' for f in fields), "    )", ""]
    lines += ["    def __init__(self):", *(f"        self.{f.name} = {_zero(f)}" for f in fields)]
    text = "\n".join(lines) + "\n\n\n" + "\n\n\n".join(map(_function, program.functions.values())) + "\n\n"
    usage = f"model = Model(0.0); y = model.step({', '.join(['1.0'] * len(names))})"
    arguments = ", ".join(f"{n}=0.0" for n in plain.split(", "))
    return text + _CLASS.format(
        usage=usage, arguments=arguments, passed=plain, plain=plain, s="s" if len(names) > 1 else ""
    )
