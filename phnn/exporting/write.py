"""Write a model as files of a target: names and contents, by target.

A functional mock-up unit (FMI 2.0 co-simulation) holds C sources and, where there is a compiler, compiled code. Its
input is held during a communication step, or follows the derivative that the master sets.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import io
import math
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar
from xml.sax.saxutils import quoteattr

from phnn.errors import InputRefused, OutputFailed
from phnn.exporting.build import HOLDS, Builder, Hold
from phnn.exporting.c import Printer, c_header, c_source
from phnn.exporting.program import CONSTANTS_ABOUT, Constant, Field, Function, Program, header, indented, one_line
from phnn.intake import LIMITS
from phnn.model import Model
from phnn.network.elements import Network
from phnn.predictor import load
from phnn.results import claim
from phnn.setup import Setup

if TYPE_CHECKING:
    from phnn.modal.model import ModalFit

_FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden")
_TIME_LIMIT = 120
# Longest message of a compiler that is repeated.
_MESSAGE = 2000
# A fixed time, so that the same model gives the same file.
_DATE = (1980, 1, 1, 0, 0, 0)


def fmu(program: Program) -> bytes:
    """Return the content of the ``.fmu`` file."""
    name = program.name
    sources = {f"{name}.h": c_header(program), f"{name}.c": c_source(program)}
    guid = str(uuid.UUID(bytes=hashlib.sha256("".join(sources.values()).encode()).digest()[:16]))
    sources["fmi2.c"] = _wrapper(program, guid)
    entries = {"modelDescription.xml": description(program, guid).encode()}
    entries |= {f"sources/{n}": text.encode() for n, text in sources.items()}
    binary = compiled(name, sources)
    if binary is not None:
        entries[f"binaries/linux64/{name}.so"] = binary
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, data in entries.items():
            archive.writestr(zipfile.ZipInfo(entry, _DATE), data, zipfile.ZIP_DEFLATED)
    return content.getvalue()


def _wrapper(program: Program, guid: str) -> str:
    """Return the functions of the standard around the model."""
    count = len(program.inputs)
    points = [f"u[0] + rate[0] * at[{k}]" for k in range(3)]
    means = [f"u[{k}] + rate[{k}] * at[1]" for k in range(1, count)]
    filled = {
        "MODEL_UPPER": program.name.upper(),
        "MODEL": program.name,
        "INPUTS": str(count),
        "GUID": guid,
        "SUBSTEPS": f"{program.substeps}.0",
        "INIT": ", ".join(f"u[{k}]" for k in range(count)),
        "SUBSTEP": ", ".join([*points, *means]),
    }
    text = (files("phnn.exporting") / "fmi2.c").read_text("utf-8")
    for key, value in filled.items():
        text = text.replace(f"@{key}@", value)
    return text


def description(program: Program, guid: str) -> str:
    """Return ``modelDescription.xml``."""
    output, unit = program.output
    variables = [
        f'<ScalarVariable name={quoteattr(name)} valueReference="{k}" causality="input" variability="continuous">'
        f'<Real start="0" unit={quoteattr(of)}/></ScalarVariable>'
        for k, (name, of) in enumerate(program.inputs)
    ]
    number = len(variables)
    taken = {name for name, _ in program.inputs}
    while output in taken:
        output = f"{output}_measured"
    variables.append(
        f"<ScalarVariable name={quoteattr(output)} "
        f'valueReference="{number}" causality="output" variability="continuous" initial="calculated">'
        f"<Real unit={quoteattr(unit)}/></ScalarVariable>"
    )
    units = dict.fromkeys((*(of for _, of in program.inputs), unit))
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(program.title)} guid="{guid}" '
        f'description={quoteattr(" ".join(header(program).split()))} generationTool="phnn" '
        'variableNamingConvention="flat" numberOfEventIndicators="0">',
        f'<CoSimulation modelIdentifier="{program.name}" canHandleVariableCommunicationStepSize="true" '
        'canInterpolateInputs="true" maxOutputDerivativeOrder="0" canGetAndSetFMUstate="true">',
        f'<SourceFiles><File name="{program.name}.c"/><File name="fmi2.c"/></SourceFiles>',
        "</CoSimulation>",
        f"<UnitDefinitions>{''.join(f'<Unit name={quoteattr(u)}/>' for u in units)}</UnitDefinitions>",
        f'<DefaultExperiment startTime="0" stepSize="{program.dt!r}"/>',
        f"<ModelVariables>{''.join(variables)}</ModelVariables>",
        f'<ModelStructure><Outputs><Unknown index="{number + 1}" dependencies=""/></Outputs>'
        f'<InitialUnknowns><Unknown index="{number + 1}"/></InitialUnknowns></ModelStructure>',
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"


def compiled(name: str, sources: Mapping[str, str]) -> bytes | None:
    """Return the shared library for Linux on 64 bits; None on other machines or without a compiler.

    Args:
        name: of the program.
        sources: texts of C by file name; each file that ends in ``.c`` is compiled. Only functions that are marked as
            visible can be called from outside.

    Raises:
        OutputFailed: the compiler refuses the sources, or takes too long; gives its message.
    """
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        return None
    with tempfile.TemporaryDirectory() as folder:
        for entry, text in sources.items():
            (Path(folder) / entry).write_text(text, "utf-8")
        library = Path(folder) / f"{name}.so"
        units = [entry for entry in sources if entry.endswith(".c")]
        command = [compiler, *_FLAGS, *units, "-o", library.name, "-lm"]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, timeout=_TIME_LIMIT, check=False)
        except subprocess.TimeoutExpired as error:
            raise _uncompiled(compiler, f"it took more than {_TIME_LIMIT} s") from error
        if done.returncode != 0 or not library.exists():
            raise _uncompiled(compiler, done.stderr.decode(errors="replace").strip()[:_MESSAGE])
        return library.read_bytes()


def _uncompiled(compiler: str, cause: str) -> OutputFailed:
    return OutputFailed(
        f"{compiler} does not compile the exported model: {cause}: mend the compiler, or take it out of PATH to do "
        "without compiled code"
    )


# Sample time [s] where none is given: 10 kHz, a common rate of controllers of piezo stages.
SAMPLE_TIME = 1e-4


def export(
    model: Model | Setup | Network | str | Path,
    to: str,
    out: str | Path,
    *,
    dt: float = SAMPLE_TIME,
    substeps: int | None = None,
    input: Hold = "linear",
    name: str = "",
    ports: Sequence[str] = (),
    sensor: bool = True,
    initial_input: float = 0.0,
    overwrite: bool = False,
) -> list[Path]:
    """Write a model as a program for a controller or a simulator.

        phnn.export("out/model", to="c", out="out/c", dt=5e-5)    # out/c/piezo.h, out/c/piezo.c

    Its steps are those of `Model.simulate` with the same sample time, sub-steps and input between the samples.

    Args:
        model: what `phnn.load` returned, or its folder, or that of a diagnosis.
        to: ``c`` (C99 without dependencies), ``fmu`` (FMI 2.0 co-simulation), ``python`` (one file) or ``matlab``.
        out: folder of the files.
        dt: sample time [s].
        substeps: integration steps in a sample time; those of the model if None.
        input: between two samples, ``linear`` or ``zero_order``.
        name: prefix of what is made public; that of the model if empty.
        ports: further ports of the network that are inputs; the input of the others is zero.
        sensor: include the sensor, without its drift; without it the output is what the sensor senses.
        initial_input: constant input under whose rest a network begins in which something flows at rest.
        overwrite: replace files of an earlier export even where they were changed since.

    Returns:
        Paths of the files.

    Raises:
        InputRefused: a law or block has no exported form, a setting is out of range, or the folder cannot be used.
    """
    given = [Path(model)] if isinstance(model, str | Path) else []
    loaded = load(given[0]) if given else model
    program = program_of(loaded, to, dt, substeps, input, name, ports, sensor, initial_input)  # type: ignore[arg-type]
    return write(program, to, Path(out), given, overwrite)


def program_of(
    model: Model | Setup | Network | ModalFit,
    to: str,
    dt: float = SAMPLE_TIME,
    substeps: int | None = None,
    hold: Hold = "linear",
    name: str = "",
    ports: Sequence[str] = (),
    sensor: bool = True,
    initial_input: float = 0.0,
) -> Program:
    """Return the program of a model; arguments as of `export`, ``hold`` is its ``input``.

    Raises:
        InputRefused: a setting is out of range, or a law or block cannot be exported; names it.
    """
    setup, known = (model.setup, model.substeps) if isinstance(model, Model) else (model, 1)
    if isinstance(setup, Network):
        setup = Setup(setup)
    if not isinstance(setup, Setup):
        raise InputRefused(
            f"{type(model).__name__} cannot be exported: a model of phnn modes is a network first: "
            "export phnn.load(MODEL).to_network() from Python"
        )
    if to not in TARGETS:
        raise InputRefused(f"to: {to!r} is no target: choose one of {', '.join(TARGETS)}")
    if hold not in HOLDS:
        raise InputRefused(f"input: {hold!r} between samples is not exported: choose {' or '.join(HOLDS)}")
    # Below the least normal number, a share of it or its reciprocal is lost.
    if not sys.float_info.min <= dt < math.inf:
        raise InputRefused(f"dt: {dt:g} s is no sample time: give a positive, finite one")
    if not math.isfinite(initial_input):
        raise InputRefused(f"initial_input: {initial_input:g}: give a finite number")
    if substeps is not None and not 1 <= substeps <= LIMITS.substeps:
        raise InputRefused(f"substeps: {substeps}: give 1 to {LIMITS.substeps}")
    further = [p.name for p in setup.network.ports[1:]]
    if strange := [port for port in ports if port not in further]:
        raise InputRefused(
            f"ports: the network has no further port {strange[0]!r}; it has {', '.join(further) or 'none'}"
        )
    # A drift belongs to the recordings: in a program, it would go on for ever.
    setup = replace(setup, sensor=tuple(b for b in setup.sensor if sensor and b.kind != "drift"))
    # What drives a unit of co-simulation holds its input during a communication step.
    held: Hold = "zero_order" if to == "fmu" else hold
    # A number of numpy has another text than one of Python.
    steps = known if substeps is None else substeps
    return Builder(setup, float(dt), steps, held, name, ports).program(initial_input)


def write(program: Program, to: str, out: Path, given: Sequence[Path] = (), overwrite: bool = False) -> list[Path]:
    """Write the files of a target into a folder and return their paths; ``given``: folders the model was read from."""
    files = TARGETS[to](program)
    with claim(out, "export", given, tuple(files), overwrite=overwrite) as place:
        for name, content in files.items():
            (place / name).write(content.encode() if isinstance(content, str) else content)
    return [out / name for name in files]


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
        about = one_line(function.about).replace("\\", "/").replace('"', "'")
        lines.append(f'    """{about}{"" if about.endswith(".") else "."}"""')
    for statement in body:
        lines += indented(ast.unparse(ast.fix_missing_locations(statement)).splitlines())
    return "\n".join(lines)


def _zero(field: Field) -> str:
    zero = "0" if field.index else "0.0"
    for length in reversed(field.shape):
        zero = f"[{zero} for _ in range({length})]"
    return zero


def python(program: Program) -> str:
    """Return the text of the file."""
    names = [n for n, _ in program.inputs]
    plain = ", ".join(["u", *(f"u_{n}" for n in names[1:])])
    lines = [f'"""{header(program)}\n"""', "", "import math", "", f"DT = {program.dt!r}  # sample time [s]"]
    lines += ["", *(f"# {line}" for line in CONSTANTS_ABOUT)]
    for constant in program.used_constants():
        about = f"  # {one_line(constant.about)}" if constant.about else ""
        lines.append(f"{constant.name} = {constant.value!r}{about}")
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


_WHERE = """function r = where(condition, a, b)
if condition
    r = a;
else
    r = b;
end
end"""


class _Body(Printer):
    """Prints one function in MATLAB."""

    negation = "~"
    field = "s."
    first, other, otherwise, end = "if {}", "elseif {}", "else", "end"
    loop = "for {0} = 0:{2}"
    operators: ClassVar[dict[type, tuple[str, int]]] = Printer.operators | {ast.NotEq: ("~=", 5)}

    def __init__(self, program: Program, function: Function) -> None:
        super().__init__(program, function)
        self.local = {n.id for n in self.nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        self.local |= set(function.arguments)
        self.results = [f"out_{i}" for i in range(function.returns)]

    def name(self, name: str) -> str:
        """Return a local name or a field of the constants; words of the language get an underscore."""
        if name in self.program.constants and name not in self.local:
            return f"c.{name}"
        return f"{name}_" if name in ("i", "c", "where") else super().name(name)

    def _call(self, node: ast.Call, outputs: Iterable[str] = ()) -> tuple[str, int]:
        name = node.func.id  # type: ignore[attr-defined]
        arguments = ", ".join(self.expression(a) for a in node.args)
        return f"{_BUILTIN.get(name, name)}({arguments})", self.primary

    def _entry(self, node: ast.Subscript) -> str:
        """Return an entry of an array, counted from one."""
        indices: list[str] = []
        value: ast.expr = node
        while isinstance(value, ast.Subscript):
            at = value.slice
            plain = isinstance(at, ast.Constant)
            indices.insert(0, str(at.value + 1) if plain else f"{self.expression(at)} + 1")  # type: ignore[attr-defined]
            value = value.value
        return f"{self.expression(value)}({', '.join(indices)})"

    def lines(self) -> list[str]:
        """Return the function, from its head to its end."""
        f = self.function
        results = [*["s"] * f.changes, *self.results]
        outputs = f"[{', '.join(results)}] = " if len(results) > 1 else f"{results[0]} = " if results else ""
        lines = [f"function {outputs}{f.name}({', '.join(map(self.name, f.arguments))})"]
        lines += [f"% {one_line(f.about)}"] if f.about else []
        named = {n.id for n in self.nodes if isinstance(n, ast.Name)}
        lines += ["c = constants();"] if (named - self.local) & set(self.program.constants) else []
        return [*lines, *self._block(f.body), "end"]

    def _assign(self, target: ast.expr, value: ast.expr) -> list[str]:
        targets = target.elts if isinstance(target, ast.Tuple) else [target]
        return self._called([self.expression(t) for t in targets], value)

    def _called(self, targets: list[str], value: ast.expr) -> list[str]:
        """Return an assignment; a function that changes the state gives it back."""
        name = value.func.id if isinstance(value, ast.Call) else ""  # type: ignore[attr-defined]
        known = self.program.functions.get(name)
        targets = ["s", *targets] if known is not None and known.changes else targets
        shown = f"[{', '.join(targets)}]" if len(targets) > 1 else targets[0]
        return [f"{shown} = {self.expression(value)};"]

    def _return(self, value: ast.expr) -> list[str]:
        if isinstance(value, ast.Tuple):
            pairs = zip(self.results, value.elts, strict=True)
            return [*(f"{r} = {self.expression(v)};" for r, v in pairs), "return;"]
        return [*self._called(list(self.results), value), "return;"]

    def _alone(self, value: ast.expr) -> list[str]:
        return self._called([], value)


def _constant(constant: Constant) -> str:
    value = constant.value
    rows = value if isinstance(value, tuple) else ()
    shown = "[" + "; ".join(", ".join(map(repr, row)) for row in rows) + "]" if rows else repr(value)
    return f"c.{constant.name} = {shown}; % {one_line(constant.about)}"


def _field(field: Field) -> str:
    shape = (*field.shape, 1)[:2] if field.shape else ()
    return f"s.{field.name} = {f'zeros({shape[0]}, {shape[1]})' if shape else '0.0'}; % {one_line(field.about)}"


def matlab(program: Program) -> dict[str, str]:
    """Return the texts of the files by name."""
    name, inputs = program.name, ", ".join(program.functions["step"].arguments[1:])
    about = [f"% {one_line(line)}" for line in header(program).splitlines()]
    begin = [f"function s = {name}_init({inputs})", f"% {name.upper()}_INIT The state at the start.", *about]
    begin += ["s = empty_state();", f"s = init(s, {inputs});", "end"]
    step = [f"function [s, y] = {name}_step(s, {inputs})"]
    step += [f"% {name.upper()}_STEP One sample time: the state and the output at its end.", *about]
    step += [f"[s, solved] = step(s, {inputs});", "if solved < 1.0"]
    step += ["    error('a step has no solution: is the input finite?');", "end", "y = output(s);", "end"]
    block = [f"function y = {name}_simulink({inputs})"]
    block += [f"% {name.upper()}_SIMULINK Body of a MATLAB Function block with the sample time {program.dt!r} s."]
    block += ["persistent s", "if isempty(s)", f"    s = {name}_init({inputs});", "end"]
    block += [f"[s, y] = {name}_step(s, {inputs});", "end"]
    # A structure keeps its fields, as code generation asks.
    empty = ["function s = empty_state()", *map(_field, program.used_fields()), "end"]
    return {
        f"{name}_init.m": _file(program, [begin, empty], "init"),
        f"{name}_step.m": _file(program, [step], "step", "output"),
        f"{name}_simulink.m": "\n".join(block) + "\n",
    }


def _file(program: Program, first: list[list[str]], *roots: str) -> str:
    """Return a file: its own functions, and those of the program that it needs."""
    constants = ["function c = constants()", *(f"% {line}" for line in CONSTANTS_ABOUT)]
    constants += [*map(_constant, program.used_constants()), "end"]
    bodies = (_Body(program, f).lines() for f in program.needed(*roots).values())
    parts = [*first, *bodies, constants, _WHERE.splitlines()]
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


# Contents of files by name.
TARGETS: dict[str, Callable[[Program], Mapping[str, str | bytes]]] = {
    "c": lambda program: {f"{program.name}.h": c_header(program), f"{program.name}.c": c_source(program)},
    "fmu": lambda program: {f"{program.name}.fmu": fmu(program)},
    "python": lambda program: {f"{program.name}.py": python(program)},
    "matlab": matlab,
}
