"""The targets agree with `phnn.trajectory`; laws are translated from their sources, or refused by the construct."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import linecache
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_homes import BASE, point
from exported import COMPILER, FLAGS, apart, exported, in_c, in_python, needs_compiler, reference

import phnn
from phnn.configuration import config_folder
from phnn.effects import effect
from phnn.errors import InputRefused
from phnn.exporting.build import Builder, Hold
from phnn.exporting.c import c_header, c_source
from phnn.exporting.laws import Sources
from phnn.exporting.program import Program
from phnn.exporting.write import matlab, python
from phnn.models.network_file import load_network, ready
from phnn.parameters import positive
from phnn.recordings.excitation import driving_of
from phnn.recordings.recording import unrecorded
from phnn.setup import Block, Setup
from phnn.trajectory import simulate

PROMISED = 1e-9
DT = 5e-5
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
LAG = (positive("tau_a", 1e-4, "s", "time constant of the amplifier"),)
PIEZO = BASE.with_block("amplifier", Block("lowpass", ("tau_a",)), LAG)
MODES = effect("second_mode").add_to(PIEZO, point(effect("second_mode")))


def drive(n: int, dt: float = DT) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(n) * dt
    return t, sum(a * np.sin(2.0 * np.pi * f * t) for a, f in ((30.0, 10.0), (25.0, 37.0), (15.0, 150.0)))


@needs_compiler
@pytest.mark.parametrize("hold", ["linear", "zero_order"])
@pytest.mark.parametrize("substeps", [1, 3])
def test_the_input_between_samples_is_that_of_the_simulation(hold: str, substeps: int, tmp_path: Path) -> None:
    t, u = drive(2001)
    program = exported(PIEZO, t, substeps, hold)  # type: ignore[arg-type]
    wanted = reference(PIEZO, t, u, substeps, hold)  # type: ignore[arg-type]
    assert apart(in_c(program, u, tmp_path), wanted) < PROMISED
    assert apart(in_python(program, u[:301]), wanted[:301]) < PROMISED


@needs_compiler
def test_it_begins_in_equilibrium_under_the_first_input(tmp_path: Path) -> None:
    t, u = drive(401)
    for setup in (PIEZO, MODES, effect("cubic_stiffness").add_to(PIEZO, point(effect("cubic_stiffness")))):
        wanted = reference(setup, t, u + 40.0, 1)
        assert wanted[0] != 0.0
        (tmp_path / setup.name).mkdir()
        assert apart(in_c(exported(setup, t, 1), u + 40.0, tmp_path / setup.name), wanted) < PROMISED


def test_single_steps_take_any_input_within_them() -> None:
    # `Model.simulate` joins samples by cubics, which need later samples; a single step is given what it needs.
    t, u = drive(201)
    recording = unrecorded("drive", t, u, input_before=0.0)
    scope: dict = {}
    program = exported(PIEZO, t, 2)
    exec(python(program), scope)
    state = scope["State"]()
    scope["init"](state, 0.0)
    y = [scope["output"](state)]
    for row in driving_of(recording, 2).fine(recording):
        assert scope["substep"](state, *map(float, row)) == 1.0
        y.append(scope["output"](state))
    assert apart(np.array(y[::2]), phnn.Model(PIEZO, 2).simulate(t, u)) < PROMISED


@needs_compiler
@pytest.mark.parametrize(
    "name", ["mass_damper", "tanks", "two_masses", "hrlc", "thermal_hrc", "mass_spring_damper", "series_rc"]
)
def test_other_networks(name: str, tmp_path: Path) -> None:
    setup = Setup(load_network(config_folder() / "network" / f"{name}.yaml"))
    t = np.arange(301) * (0.25 if name == "tanks" else 1e-3)
    u = 1e-4 * (1.0 - np.cos(2.0 * np.pi * 0.04 * t)) if name == "tanks" else np.sin(40.0 * t) + 0.5 * np.sin(97.0 * t)
    program, wanted = exported(setup, t, 1), reference(setup, t, u, 1)
    assert apart(in_python(program, u), wanted) < PROMISED
    found = in_c(program, u, tmp_path)
    assert apart(found, wanted) < PROMISED
    # `init` fills all that is read, whatever lies in the memory of a state.
    assert in_c(program, u, tmp_path, 0x7E).tolist() == found.tolist()


# A trolley that is moved and carries a mass on a spring: the force on the trolley is measured.
TROLLEY = """
junctions: {trolley: 1, load: 1, between: 0, joint: 1}
elements:
  p_0: {type: I, junction: trolley, law: capacitor, parameters: [M], unit: kg m/s}
  p_1: {type: I, junction: load, law: capacitor, parameters: [m], unit: kg m/s}
  x: {type: C, junction: joint, law: spring, parameters: [k], unit: m}
  damper: {type: R, junction: joint, law: linear, parameters: [b], direction: resistance}
  motion: {type: Sf, junction: trolley, unit: m/s}
bonds: [{from: trolley, to: between}, {from: between, to: load}, {from: between, to: joint}]
parameters:
  M: {value: 2.5, unit: kg}
  m: {value: 0.8, unit: kg}
  k: {value: 300.0, unit: N/m}
  b: {value: 1.5, unit: N s/m}
output: motion
"""


@needs_compiler
@pytest.mark.parametrize("hold", ["linear", "zero_order"])
def test_the_voltage_that_an_imposed_current_needs(hold: Hold, tmp_path: Path) -> None:
    cell = Setup(ready("battery", {"C_b": 400.0, "R_0": 0.03, "C_1": 20.0, "R_1": 0.05}))
    t = 0.2 * np.arange(60)
    u = np.full(t.size, 7.0)
    if hold == "linear":
        u = np.minimum(t, 5.0)
    # Charge and current of the pair under a ramp of 1 A/s, or under 7 A from rest.
    ramp, left = np.minimum(t, 5.0), np.maximum(t - 5.0, 0.0)
    charge = 0.5 * ramp**2 + 5.0 * left if hold == "linear" else 7.0 * t
    through = (ramp - 1.0 + np.exp(-ramp)) if hold == "linear" else 7.0 * (1.0 - np.exp(-t))
    through = np.where(left > 0.0, 5.0 + (through - 5.0) * np.exp(-left), through) if hold == "linear" else through
    program = exported(cell, t, 8, hold)
    found = in_c(program, u, tmp_path)
    np.testing.assert_allclose(found[1:], (charge / 400.0 + 0.03 * u + 0.05 * through)[1:], atol=1e-4)
    np.testing.assert_allclose(in_python(program, u), found, atol=1e-12)
    assert program.output == ("current", "V")


@needs_compiler
def test_the_force_on_what_is_moved_with_a_mass_on_it(tmp_path: Path) -> None:
    (tmp_path / "trolley.yaml").write_text(TROLLEY)
    setup = Setup(load_network(tmp_path / "trolley.yaml"), name="trolley")
    t = 2e-3 * np.arange(700)
    u = 0.2 * np.sin(6.0 * t) * (1.0 - np.cos(2.0 * t))
    found = in_c(exported(setup, t, 4), u, tmp_path)
    # At a corner of the velocity the simulation takes the mean of both accelerations, the program the one before.
    assert apart(found[5:-5], reference(setup, t, u, 4)[5:-5]) < 5e-3
    rate = np.gradient(u, t)
    assert apart(found[5:-5], (reference(setup, t, u, 4) - 2.5 * rate)[5:-5]) > 0.1
    with pytest.raises(InputRefused, match=r"an inertia.*linear"):
        exported(setup, t, 4, "zero_order")


def test_a_compiler_that_fails_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = tmp_path / "bin" / "cc"
    compiler.parent.mkdir()
    compiler.write_text("#!/bin/sh\necho 'math.h: no such file' >&2\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(compiler.parent))
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(phnn.PhnnError, match=r"does not compile the exported model: math.h: no such file"):
        phnn.export(PIEZO, "fmu", tmp_path / "fmu", dt=DT, name="stage")
    compiler.unlink()
    (path,) = phnn.export(PIEZO, "fmu", tmp_path / "fmu", dt=DT, name="stage")
    with zipfile.ZipFile(path) as archive:
        assert not [n for n in archive.namelist() if n.startswith("binaries")]


def test_ports_whose_names_are_one_identifier_are_told_apart(tmp_path: Path) -> None:
    network = PIEZO.network
    first, force = network.ports[0], next(p for p in network.ports if p.name == "force")
    ports = (first, replace(force, name="load a"), replace(force, name="load-a"), replace(force, name="Voltage"))
    setup = replace(PIEZO, network=replace(network, ports=ports))
    t, u = drive(101)
    load = 0.3 * np.sin(2.0 * np.pi * 20.0 * t)
    loads = {"load a": load, "load-a": -0.5 * load}
    program = Builder(setup, DT, 2, "linear", "", ("load a", "load-a")).program(0.0)
    scope: dict = {}
    exec(python(program), scope)
    model = scope["Model"](0.0, 0.0, 0.0)
    given = zip(u.tolist(), load.tolist(), (-0.5 * load).tolist(), strict=True)
    y = np.array([model.output, *(model.step(*row) for row in list(given)[1:])])
    recording = unrecorded("drive", t, u, "linear", 0.0, loads)
    assert apart(y, simulate(setup, recording, 2).y) < PROMISED
    assert len({name for name, _ in program.inputs}) == 3


@needs_compiler
def test_c_is_one_header_and_one_source_without_allocation(tmp_path: Path) -> None:
    paths = phnn.export(MODES, "c", tmp_path / "c", dt=DT, name="stage")
    assert [p.name for p in paths] == ["stage.h", "stage.c"]
    source = (tmp_path / "c" / "stage.c").read_text("utf-8")
    assert source.count("#include") == 2
    assert "alloc" not in source
    assert "static double" in source
    objects = tmp_path / "stage.o"
    command = [str(COMPILER), *FLAGS, "-Wextra", "-pedantic", "-c", str(tmp_path / "c" / "stage.c"), "-o", str(objects)]
    subprocess.run(command, check=True)
    if shutil.which("nm"):
        symbols = subprocess.run(["nm", str(objects)], capture_output=True, text=True, check=True).stdout.split("\n")
        kinds = {line.split()[-1]: line.split()[-2] for line in symbols if line}
        # Nothing that can be written to stays between calls: no data and no bss.
        assert not {kind for kind in kinds.values() if kind in "dDbBC"}
        assert {n for n, kind in kinds.items() if kind == "T"} == {
            "stage_init", "stage_step", "stage_substep", "stage_output"
        }  # fmt: skip


def test_python_runs_where_phnn_and_numpy_are_not_installed(tmp_path: Path) -> None:
    t, u = drive(101)
    (path,) = phnn.export(PIEZO, "python", tmp_path / "py", dt=np.float64(DT), name="stage")
    program = (
        f"import json, sys; sys.path.insert(0, {str(path.parent)!r}); import stage; m = stage.Model(0.0); "
        f"print(json.dumps([m.step(u) for u in json.loads(sys.stdin.read())]))"
    )
    command = [sys.executable, "-I", "-S", "-c", program]
    done = subprocess.run(command, input=json.dumps(u[1:].tolist()), capture_output=True, text=True, check=True)
    assert apart(np.array(json.loads(done.stdout)), reference(PIEZO, t, u, 1)[1:]) < PROMISED


@pytest.mark.skipif(OCTAVE is None, reason="octave is not installed")
@pytest.mark.parametrize("setup", [PIEZO, MODES], ids=["piezo", "modes"])
def test_matlab(setup: Setup, tmp_path: Path) -> None:
    t, u = drive(201)
    phnn.export(setup, "matlab", tmp_path / "m", dt=DT, name="stage")
    np.savetxt(tmp_path / "u.txt", u)
    script = tmp_path / "run.m"
    script.write_text(
        f"addpath('{tmp_path / 'm'}'); u = load('{tmp_path / 'u.txt'}'); s = stage_init(u(1)); y = zeros(size(u));\n"
        f"b = y; for k = 2:numel(u), [s, y(k)] = stage_step(s, u(k)); end\n"
        f"stage_simulink(0); clear stage_simulink; for k = 2:numel(u), b(k) = stage_simulink(u(k)); end\n"
        f"dlmwrite('{tmp_path / 'y.txt'}', y, 'precision', '%.17g');"
    )
    subprocess.run([str(OCTAVE), "--no-gui", "--norc", "--quiet", str(script)], check=True, capture_output=True)
    assert apart(np.loadtxt(tmp_path / "y.txt"), reference(setup, t, u, 1)) < PROMISED


def test_an_fmu_holds_its_description_and_its_sources(tmp_path: Path) -> None:
    (path,) = phnn.export(PIEZO, "fmu", tmp_path / "fmu", dt=DT, name="stage")
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        description = archive.read("modelDescription.xml").decode()
    assert {"modelDescription.xml", "sources/stage.c", "sources/stage.h", "sources/fmi2.c"} <= names
    assert '<ScalarVariable name="voltage"' in description
    first = path.read_bytes()
    phnn.export(PIEZO, "fmu", tmp_path / "fmu", dt=DT, name="stage")
    assert path.read_bytes() == first


@needs_compiler
@pytest.mark.skipif(
    importlib.util.find_spec("fmpy") is None, reason="fmpy is not installed: pip install 'phnn[export]'"
)
@pytest.mark.parametrize("setup", [PIEZO, MODES], ids=["piezo", "modes"])
def test_an_fmu_in_fmpy(setup: Setup, tmp_path: Path) -> None:
    import fmpy
    import fmpy.validation

    t, u = drive(401)
    (path,) = phnn.export(setup, "fmu", tmp_path / "fmu", dt=DT, substeps=2, name="stage")
    assert fmpy.validation.validate_fmu(str(path)) == []
    signals = np.array(list(zip(t, u, strict=True)), dtype=[("time", float), ("voltage", float)])
    found = fmpy.simulate_fmu(
        str(path), start_time=0.0, stop_time=float(t[-1]), step_size=DT, output_interval=DT, input=signals,
        output=["q"], fmi_type="CoSimulation",
    )  # fmt: skip
    wanted = reference(setup, t, u, 2, "zero_order")
    assert apart(found["q"][: t.size], wanted) < PROMISED


HEAD = """
import numpy as np
from phnn.laws.namespace import where
NEGATIVE, TRUTH, TABLE = -2.0, True, (1.0, 2.0)
def helper(x, k=2.0):
    return k * x
"""
# Bodies of laws of x and y, by the name of the law.
LAWS = {
    "negated": "return where(~(x > y), x, +y)",
    "chained": "return where(-1.0 < x < y <= 1.0, 1.0, 0.0)",
    "swapped": "x, y = y, x; return x - 2.0 * y",
    "conditional": "return x if x > y else 3.0 * y",
    "below": "return y - NEGATIVE - -NEGATIVE * x",
    "divided": "return 1 / 2 * x + y",
    "signs": "return np.sign(x) + 3.0 * np.sign(y - y)",
    "either": "return where((x > 0.0) & ~(y > 0.0) | (x < -0.5), x, y)",
}
POINTS = [(x, y) for x in (-0.75, -0.25, 0.0, 0.5) for y in (-0.5, 0.0, 0.5, 1.5)]
# Bodies beyond the subset, and what the refusal names of them.
REFUSED = {
    "return helper(x, k=y)": "named arguments, 'helper(x, k=y)'", "return helper(x) + y": "'helper(x)'",
    "return x % y": "'Mod'", "return x ^ y": "'BitXor'", "return x * TABLE[1] + y": "TABLE, which is no number",
    "return where(TRUTH, x, y)": "TRUTH, which is no number", "return np.minimum(x, np.inf) + y": "'1e309'",
    "a = b = x; return a + b + y": "'a = b = x'", "return (x + 1.0) or y": "'x + 1.0 or y'",
    "return max(x, y, 0.0)": "'maximum(x, y, 0.0)'", "return x**1.5": "the power x ** 1.5",
    "for _i in range(2, 5): x = x + y\n    return x": "not a range of one known number",
    "while x > 1.0: x = x - 1.0\n    return x": "while x > 1.0", "return print(x)": "calls print",
}  # fmt: skip


def made(bodies: dict[str, str], arguments: str = "x, y") -> list[Callable[..., Any]]:
    """Laws from their bodies; their source can be read, as that of a law in a file."""
    text = HEAD + "".join(f"def {name}({arguments}):\n    {body}\n" for name, body in bodies.items())
    file = f"<laws {hash(text)}>"
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    scope: dict[str, Any] = {"__name__": "laws"}
    exec(compile(text, file, "exec"), scope)
    return [scope[name] for name in bodies]


def program_of(laws: list[Callable[..., Any]]) -> Program:
    """A program that only has an output, the values of laws at its input; begun and advanced by nothing."""
    p = Program("law", "law", 1.0, 1, "linear", (("u", "1"),), ("y", "1"))
    p.state("x", "a state")
    sources = Sources(p.functions)
    names = [sources.name_of(law, "law of a test") for law in laws]
    nothing = ["s.x = 0.0", "return 1.0"]
    for name, arguments in (("init", ("u",)), ("substep", ("a", "b", "c")), ("step", ("u",))):
        p.add(name, arguments, nothing if name != "init" else nothing[:1])
    calls = " + ".join(f"{name}(s.x, s.x)" for name in names)
    p.add("output", (), [f"return {calls}"])
    return p


def test_laws_have_their_values_in_python() -> None:
    scope: dict = {}
    exec(python(program_of(made(LAWS))), scope)
    for law in made(LAWS):
        for x, y in POINTS:
            assert scope[law.__name__](x, y) == float(law(np.float64(x), np.float64(y))), (law.__name__, x, y)


@needs_compiler
def test_laws_have_their_values_in_c(tmp_path: Path) -> None:
    laws = made(LAWS)
    program = program_of(laws)
    (tmp_path / "law.h").write_text(c_header(program), "utf-8")
    wrapped = [f"double at_{f.__name__}(double, double);" for f in laws]
    wrapped += [f"double at_{f.__name__}(double x, double y) {{ return law_{f.__name__}(x, y); }}" for f in laws]
    (tmp_path / "law.c").write_text(c_source(program) + "\n".join(wrapped), "utf-8")
    assert COMPILER is not None
    library = tmp_path / "law.so"
    command = [COMPILER, *FLAGS, "-shared", "-fPIC", str(tmp_path / "law.c"), "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    loaded = ctypes.CDLL(str(library))
    for law in laws:
        found = getattr(loaded, f"at_{law.__name__}")
        found.argtypes, found.restype = [ctypes.c_double] * 2, ctypes.c_double
        for x, y in POINTS:
            assert found(x, y) == float(law(np.float64(x), np.float64(y))), (law.__name__, x, y)


def test_matlab_has_no_operator_of_python() -> None:
    text = matlab(program_of(made(LAWS)))["law_step.m"]
    assert "--" not in text
    assert "where(~(x > y), x, y)" in text
    assert "-1.0 < x && x < y && y <= 1.0" in text


@pytest.mark.parametrize("body", [*REFUSED, "return x"])
def test_what_has_no_translation_is_refused_by_name(body: str) -> None:
    # The last one could be translated, but for its arguments.
    laws = made({"law": body}, "x, y" if body in REFUSED else "*x")
    with pytest.raises(InputRefused, match="law of a test: cannot be exported") as caught:
        program_of(laws)
    assert REFUSED.get(body, "'*x'") in str(caught.value).replace("\n", " ")
