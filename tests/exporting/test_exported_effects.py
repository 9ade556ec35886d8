"""Every effect is exported or refused by name; what ``phnn export`` and `phnn.export` read, write and refuse."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_homes import ACTUATOR, BASE, EFFECTS, FORMULAS, LEARNED, TANKS, home, point
from exported import apart, exported, in_c, in_python, needs_compiler, reference
from solve_paths import case_of, networks

import phnn
from phnn import cli
from phnn.effects import Effect, effect, in_all_forms
from phnn.effects.soundness import Home
from phnn.errors import InputRefused
from phnn.exporting.build import Builder
from phnn.exporting.program import Names, Program, identifier
from phnn.exporting.write import python
from phnn.integrate import kernel
from phnn.integrate.program import compile_network
from phnn.integrate.scheme import can_compile
from phnn.models.store import save
from phnn.network.elements import Network
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.trajectory import simulate


@cache
def exportable() -> dict[str, Network]:
    made = {name: make() for name, make in networks().items()}
    return {name: n for name, n in made.items() if can_compile(n) and n.ports and not n.senses}


def difference(network: Network) -> float:
    """Largest difference of the states of an exported program from those of the kernel, from a state at random."""
    case = case_of(network)
    h, program = np.full(case.h.size, case.h[0]), compile_network(network)
    wanted, efforts = np.empty((h.size + 1, case.x0.size)), np.empty((h.size, case.x0.size))
    assert kernel.march(program, program.theta(network), case.x0, case.u, h, wanted, efforts) == h.size
    found = Builder(Setup(network), float(h[0]), 1, "linear", "", [p.name for p in network.ports[1:]]).program(0.0)
    scope: dict = {}
    exec(python(found), scope)
    state = scope["State"]()
    scope["init"](state, *[0.0] * len(network.ports))
    fields = [found.states[name] for name in network.state_names]
    for field, value in zip(fields, case.x0.tolist(), strict=True):
        setattr(state, field, value)
    path = [case.x0]
    for first, *others in case.u.tolist():
        assert scope["substep"](state, first, first, first, *others) == 1.0
        path.append(np.array([getattr(state, field) for field in fields]))
    scale = np.where(case.scale > 0.0, case.scale, 1.0)
    return float((np.abs(np.array(path) - wanted).max(0) / scale).max())


@pytest.mark.slow
def test_every_network_takes_the_steps_of_the_kernel() -> None:
    wrong = {name: d for name, n in exportable().items() if not (d := difference(n)) < PROMISED}
    assert len(exportable()) > 200
    assert wrong == {}


@pytest.mark.parametrize("name", ["leaf monotone", "nonlinear leaf coulomb", "leaf overflow and a leak"])
def test_storages_without_a_closed_step(name: str) -> None:
    assert difference(networks()[name]()) < PROMISED


# What is promised: the largest difference, as a share of the output's range.
PROMISED = 1e-9
# Sensors whose output needs what comes after it: half-way values by cubics, or a spline through all samples.
REFUSED = {"input_backlash", "output_backlash", "sensor_lag", "sensor_clock", "learned_sensor_over_time"}
FORMS = in_all_forms([*EFFECTS, *FORMULAS, *LEARNED])
IDS = [f"{e.name}-{i}" for i, e in enumerate(FORMS)]
SUBSTEPS = 2


def drive(where: Home, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(n,) times and inputs of several frequencies, large enough to be felt by every effect."""
    if where is ACTUATOR:
        t = np.arange(n) * 5e-5
        return t, sum(a * np.sin(2.0 * np.pi * f * t) for a, f in ((30.0, 10.0), (25.0, 37.0), (15.0, 150.0)))
    t = np.arange(n) * 0.25
    swell, ripple = 1.0 - np.cos(2.0 * np.pi * 0.04 * t), np.sin(2.0 * np.pi * 0.013 * t)
    return t, 5e-5 * (swell + 0.2 * ripple)


@cache
def program_of(effect: Effect) -> Program:
    """The program of the effect's base model with it; of a drive it knows the sample time alone."""
    t, _ = drive(home(effect), 2)
    return exported(effect.add_to(home(effect).setup, point(effect)), t, SUBSTEPS)


def test_the_list_of_what_is_refused_is_complete() -> None:
    refused = set()
    for member in FORMS:
        try:
            program_of(member)
        except InputRefused as error:
            assert "cannot be exported" in str(error), error
            assert "--no-sensor" in str(error) or "export a model without it" in str(error), error
            refused.add(member.name)
    assert refused == REFUSED


@pytest.mark.parametrize(("target", "samples"), [pytest.param("c", 2001, marks=needs_compiler), ("python", 151)])
@pytest.mark.parametrize("effect", FORMS, ids=IDS)
def test_a_target_takes_the_steps_of_the_simulation(effect: Effect, target: str, samples: int, tmp_path: Path) -> None:
    if effect.name in REFUSED:
        pytest.skip("refused by name, see the list above")
    where, program = home(effect), program_of(effect)
    t, u = drive(where, samples)
    found = in_c(program, u, tmp_path) if target == "c" else in_python(program, u)
    assert apart(found, reference(effect.add_to(where.setup, point(effect)), t, u, SUBSTEPS)) < PROMISED


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A stored model in the folder of a diagnosis."""
    phnn.Model(BASE, 2).save(tmp_path / "mine" / "model")
    return tmp_path / "mine"


def run(model: Path, out: Path, *options: str, to: str = "python") -> int:
    return cli.main(["export", str(model), "--to", to, "--out", str(out), *options])


def test_the_command_writes_and_names_its_files(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = model.parent / "out"
    assert run(model, out, "--dt", "5e-5", "--name", "My stage!", to="c") == 0
    assert capsys.readouterr().out.split() == [str(out / "My_stage.h"), str(out / "My_stage.c")]
    head, source = ((out / f"My_stage.{end}").read_text("utf-8") for end in "hc")
    assert "#define MY_STAGE_DT 5e-05" in head and "fits into an array of" in head
    assert "2.5e-05; /* step of the integration [s] */" in source and not (out / "INCOMPLETE.txt").exists()


def test_a_model_a_setup_a_network_and_both_folders_give_the_same(model: Path, tmp_path: Path) -> None:
    given = (phnn.load(model / "model"), BASE, BASE.network, model, str(model / "model"))
    texts = set()
    for k, one in enumerate(given):
        (path,) = phnn.export(one, "python", tmp_path / f"out{k}", substeps=2, name="stage")  # type: ignore[arg-type]
        texts.add(path.read_text("utf-8").replace("from_paper", "model"))
    assert len(texts) == 1


def test_a_second_export_replaces_the_first_and_no_file_of_others(model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(model, out, "--name", "stage", to="c") == 0
    assert run(model, out, "--name", "stage") == 0
    assert run(model, out, "--name", "stage", "--dt", "2e-5") == 0
    # Targets stand side by side.
    assert sorted(p.name for p in out.iterdir() if p.is_file()) == ["stage.c", "stage.h", "stage.py"]
    assert "DT = 2e-05" in (out / "stage.py").read_text("utf-8")
    (out / "stage.py").write_text("mine")
    assert run(model, out, "--name", "stage") == 2
    assert (out / "stage.py").read_text() == "mine"


REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"to": "rust"}, "'rust' is no target: choose one of c, fmu, python, matlab"),
    ({"input": "cubic"}, "'cubic' between samples is not exported: choose linear or zero_order"),
    ({"dt": 0.0}, "0 s is no sample time"),
    ({"dt": float("inf")}, "inf s is no sample time"),
    ({"dt": 1e-310}, "1e-310 s is no sample time"),
    ({"name": "math"}, "name: 'math' is a word of C, Python or MATLAB or a file of theirs: choose another"),
    ({"name": "class", "to": "python"}, "such as class_model"),
    ({"name": "Stdio"}, "such as Stdio_model"),
    ({"name": "fmi2", "to": "fmu"}, "such as fmi2_model"),
    ({"name": "json", "to": "python"}, "such as json_model"),
    ({"name": "function", "to": "matlab"}, "such as function_model"),
    ({"substeps": 0}, "substeps: 0: give 1 to"),
    ({"initial_input": float("nan")}, "initial_input: nan"),
    ({"ports": ("torque",)}, "no further port 'torque'; it has force"),
]


# What an effect adds cannot be exported with these.
OF_EFFECTS: list[tuple[str, dict[str, Any], str]] = [
    ("output_backlash", {}, "sensor play: cannot be exported: it needs the output after .*--no-sensor"),
    ("delay", {"input": "zero_order"}, "amplifier delay: cannot be exported.*take --input linear"),
    ("delay", {"to": "fmu"}, "amplifier delay: cannot be exported.*a target other than fmu"),
    ("delay", {"dt": 1e-12}, "at most 10000 are kept.*take larger steps"),
]


@pytest.mark.parametrize(("name", "given", "needle"), [*(("", *row) for row in REFUSALS), *OF_EFFECTS])
def test_what_has_no_program_is_refused_by_name(name: str, given: dict[str, Any], needle: str, tmp_path: Path) -> None:
    setup, options = effect(name).add_to(BASE, point(effect(name))) if name else BASE, {"to": "c", **given}
    with pytest.raises(InputRefused, match=needle):
        phnn.export(setup, out=tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_a_refusal_is_one_line_with_exit_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(effect("sensor_lag").add_to(BASE, point(effect("sensor_lag"))), tmp_path / "model")
    assert run(tmp_path / "model", tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert error.startswith("phnn: sensor lag: cannot be exported: ")
    assert error.count("\n") == 1
    assert run(tmp_path / "model", tmp_path / "out", "--no-sensor") == 0
    assert run(tmp_path / "nothing", tmp_path / "out") == 2


def test_names_of_people_become_identifiers() -> None:
    names = Names()
    assert [names.of(n) for n in ("k", "k/2", "k 2", "1st", "Ω", "k/2")] == ["k", "k_2", "k_2_2", "x_1st", "x", "k_2"]
    assert identifier("a*/ int main() {") == "a_int_main"


def test_texts_of_a_model_end_no_comment(tmp_path: Path) -> None:
    hostile = replace(BASE, name='*/ int x; """ \n" + evil() + "')
    for to in ("c", "python", "matlab"):
        for path in phnn.export(hostile, to, tmp_path / to, name="stage"):
            text = path.read_text("utf-8")
            assert "*/ int x" not in text
            assert '""" \n' not in text
            if to == "python":
                compile(text, "stage", "exec")


def test_a_backslash_in_a_name_or_a_unit_begins_no_escape(tmp_path: Path) -> None:
    first, *others = BASE.network.ports
    network = replace(BASE.network, ports=(replace(first, unit="V\\N{x}"), *others))
    (path,) = phnn.export(replace(BASE, name="C:\\users\\x", network=network), "python", tmp_path, name="stage")
    compile(path.read_text("utf-8"), "stage", "exec")
    assert path.read_text("utf-8").startswith('"""C:/users/x: exported by phnn.')


def test_numbers_that_are_not_finite_are_refused() -> None:
    program = Program("m", "m", 1.0, 1, "linear", (), ("y", "1"))
    with pytest.raises(InputRefused, match=r"H \(step\): inf is not finite"):
        program.constant("H", float("inf"), "step")
    with pytest.raises(InputRefused, match="FLOORS"):
        program.table("FLOORS", ((1.0, float("nan")),))


def test_where_something_flows_at_rest_the_state_of_one_input_is_stored(tmp_path: Path) -> None:
    (path,) = phnn.export(TANKS.setup, "python", tmp_path / "out", dt=0.25, initial_input=2e-5, name="tanks")
    scope: dict[str, Any] = {}
    exec(path.read_text("utf-8"), scope)
    wanted = simulate(TANKS.setup, unrecorded("still", np.arange(3) * 0.25, np.full(3, 2e-5), input_before=2e-5)).y
    model = scope["Model"](2e-5)
    np.testing.assert_allclose([model.output, model.step(2e-5), model.step(2e-5)], wanted, rtol=1e-9)
    assert "init begins in the state of rest that was computed at the export" in path.read_text("utf-8")
