"""A program as a functional mock-up unit: FMI 2.0 co-simulation, in C sources and, where there is a compiler, compiled.

The unit's input is held during a communication step, or follows the derivative that the master sets.
"""

from __future__ import annotations

import hashlib
import io
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from xml.sax.saxutils import quoteattr

from phnn.errors import OutputFailed
from phnn.exporting.c import c_header, c_source
from phnn.exporting.program import Program, header

_FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden")
_TIME_LIMIT = 120
# Longest message of a compiler that is repeated.
_MESSAGE = 2000
# A fixed time, so that the same model gives the same file.
_DATE = (1980, 1, 1, 0, 0, 0)


def fmu(program: Program) -> bytes:
    """The content of the ``.fmu`` file."""
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
    """The functions of the standard around the model."""
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
    """``modelDescription.xml``."""
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
    """The shared library for Linux on 64 bits; None on other machines or without a compiler.

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
