"""A program as C99: a header and a source file without dependencies, allocation or global state."""

from __future__ import annotations

import ast
from collections.abc import Iterable

from phnn.exporting.program import (
    CONSTANTS_ABOUT,
    Constant,
    Field,
    Function,
    Printer,
    Program,
    called,
    header,
    indented,
    is_taken,
    one_line,
)

_FUNCTIONS = {"absolute": "fabs", "isfinite": "isfinite"}
_HELPERS = {
    "maximum": "static double maximum(double a, double b) { return a >= b ? a : b; }",
    "minimum": "static double minimum(double a, double b) { return a <= b ? a : b; }",
    "sign": "static double sign(double a) { return (double)((a > 0.0) - (a < 0.0)); }",
}


def number(value: float | int) -> str:
    """Return a literal that reads back as the same number."""
    text = f"{value:.17g}"
    shorter = repr(float(value))
    text = shorter if len(shorter) < len(text) else text
    return text if any(c in text for c in ".en") else f"{text}.0"


class _Body(Printer):
    """Prints the statements of one function in C."""

    def __init__(self, program: Program, function: Function) -> None:
        super().__init__(program, function)
        nodes = self.nodes
        self.named = {n.id for n in nodes if isinstance(n, ast.Name)} | ({"s"} if function.of_state else set())
        slices = [n for s in nodes if isinstance(s, ast.Subscript) for n in ast.walk(s.slice)]
        self.whole = {n.id for n in slices if isinstance(n, ast.Name)}
        self.loops = {n.target.id for n in nodes if isinstance(n, ast.For) and isinstance(n.target, ast.Name)}
        self.truths = {
            t.id
            for n in nodes
            if isinstance(n, ast.Assign) and isinstance(n.value, ast.Compare | ast.BoolOp)
            for t in n.targets
            if isinstance(t, ast.Name)
        }

    def _number(self, value: float | int) -> str:
        return str(value) if isinstance(value, int) and not isinstance(value, bool) else number(value)

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
        """Return the function's body."""
        declared = set(self.function.arguments) | self.loops
        top = [self.name(t) for t in self._declared_early(declared)]
        kinds = [(self._type(n.rstrip("_")), n) for n in top]
        self.seen = declared | {n.rstrip("_") for n in top}
        start = [f"(void){self.name(a)};" for a in self.function.arguments if a not in self.named]
        start += [f"{kind} {n} = {'0' if kind == 'int' else '0.0'};" for kind, n in kinds]
        return [*start, *self._block(self.function.body)]

    def _type(self, name: str) -> str:
        return "int" if name in self.whole | self.truths else "double"

    def _declared_early(self, known: set[str]) -> list[str]:
        """Return the names that are not first assigned by a plain statement of the function's own block."""
        plain: set[str] = set()
        early: list[str] = []
        for statement in self.function.body:
            for node in ast.walk(statement):
                if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                    if isinstance(statement, ast.Assign):
                        plain.add(node.id)
                    elif node.id not in plain | known and node.id not in early:
                        early.append(node.id)
        return early

    def _assign(self, target: ast.expr, value: ast.expr) -> list[str]:
        if not isinstance(target, ast.Tuple):
            left = self.expression(target)
            if isinstance(target, ast.Name) and target.id not in self.seen:
                self.seen.add(target.id)
                left = f"{self._type(target.id)} {left}"
            return [f"{left} = {self.expression(value)};"]
        if isinstance(value, ast.Tuple):
            pairs = zip(target.elts, value.elts, strict=True)
            return [line for one, own in pairs for line in self._assign(one, own)]
        outputs = [f"&{self.expression(t)}" for t in target.elts]
        new = [t.id for t in target.elts if isinstance(t, ast.Name) and t.id not in self.seen]
        self.seen |= set(new)
        declared = [f"{self._type(n)} {self.name(n)} = 0.0;" for n in new]
        return [*declared, f"{self._call(value, outputs)[0]};"]  # type: ignore[arg-type]

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
    lines += [f"{_signature(program, f, api)} {{", *indented(_Body(program, f).lines()), "}"]
    text = "\n".join(lines)
    return text.replace("    return;\n}", "}") if f.returns > 1 else text


def _constant(constant: Constant) -> str:
    about = f" /* {one_line(constant.about)} */" if constant.about else ""
    if isinstance(constant.value, float):
        return f"static const double {constant.name} = {number(constant.value)};{about}"
    rows = ", ".join("{" + ", ".join(map(number, row)) + "}" for row in constant.value)
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
    lines += [" */", f"#ifndef {guard}", f"#define {guard}", ""]
    lines += ["#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    lines += [f"#define {program.name.upper()}_DT {number(program.dt)} /* sample time [s] */", ""]
    lines += [f"typedef struct {program.name}_state {{", *map(_field, program.used_fields())]
    lines += [f"}} {program.name}_state;", ""]
    for name in API:
        f = program.functions[name]
        lines += [f"/* {one_line(f.about)} */", f"{_signature(program, f, True)};", ""]
    lines += ["/* One sample time to the given input; y is the output there. Returns 0 where a step was not solved. */"]
    lines += [f"{_step(program)};", ""]
    lines += ["#ifdef __cplusplus", "}", "#endif", "", "#endif"]
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
