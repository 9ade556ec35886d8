"""Laws registered from outside the package: compiled code of one set of laws is never run for another."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phnn.errors import StructureViolated
from phnn.laws import MEMORY_LAWS, RESISTOR_LAWS, MemoryLaw, ResistorLaw, StorageLaw, register
from phnn.laws.identity import UnknownContent, content
from phnn.laws.namespace import sqrt
from phnn.laws.other import advanced
from phnn.laws.sector import check_law

# A damper of conductance {factor} · drag · {inner}: a value of the module, a parameter, and a value in a helper.
_LAW = """
import phnn
from phnn.laws import ResistorLaw, register
from phnn.laws.namespace import shared

FACTOR = {factor}

@shared
def scaled(effort):
    return {inner} * effort

def flow(effort, q, drag):
    return FACTOR * drag * scaled(effort)

register(ResistorLaw("own_damper", flow, (1.0,)))
"""

_OWN_FRICTION = """
import phnn
from phnn.laws import RESISTOR_LAWS, ResistorLaw, register
stock = RESISTOR_LAWS["coulomb"]
register(ResistorLaw("own_friction", stock.flow, stock.example))
"""

_OUTSIDE = "from phnn.laws.identity import registered_outside; print([law.name for law in registered_outside()])"

_FINGERPRINT = "from phnn.integrate.cache import fingerprint; print(fingerprint())"

_DISCHARGE = """
import numpy as np
from phnn.integrate import kernel
from phnn.integrate.program import (compile_network)
from phnn.network import Network, Port, Resistor, Storage
from phnn.parameters import Parameter, as_table

network = Network(
    storages=(Storage("charge", "capacitor", ("C",)),),
    resistors=(Resistor("leak", "own_damper", {"charge": 1.0}, ("drag",)),),
    couplings=(),
    ports=(Port("current", {"charge": 1.0}, unit="A"),),
    parameters=as_table([Parameter("C", 2.0, "F"), Parameter("drag", 0.5, "S")]),
    output="charge",
)
program = compile_network(network)
states, efforts = np.zeros((11, 1)), np.zeros((10, 1))
states[0] = 1.0
kernel.march_any(program, program.theta(network), np.zeros((10, 1)), np.full(10, 0.1), states, efforts)
print(float(states[-1, 0]))
"""


# Runs each program in a fork of its own, behind the imports of what is none of the package's.
_FORKS = """
import os, sys
import numba, numpy
for program in sys.argv[1:]:
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0
        continue
    exec(program)
    sys.stdout.flush()
    os._exit(0)
"""


def _printed(program: str, folder: Path, *others: str) -> list[str]:
    """The line that each program prints."""
    environment = os.environ | {"PHNN_CACHE_DIR": str(folder)}
    run = ["-c", _FORKS, program, *others] if others else ["-c", program]
    done = subprocess.run([sys.executable, *run], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 1 + len(others)
    return lines


def _hash(source: str) -> str:
    names: dict[str, object] = {"np": np, "__name__": "made"}
    exec(source, names)
    return repr(content(names["flow"], "a law", []))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("A, B = 1.0, 25.0", "A, B = 1.02, 5.0"),
        ("A, B = 1.0, 2.0", "A, B = 2.0, 1.0"),
        ("A, B = np.array([1.0]), 1.0", "A, B = np.array([1.0 + 1e-12]), 1.0"),
        ("A, B = (np.array([1.0]),), 1.0", "A, B = (np.array([1.0 + 1e-12]),), 1.0"),
        ("A, B = 1.0, np.minimum", "A, B = 1.0, np.maximum"),
        (
            "from phnn.laws.namespace import maximum as A; B = 1.0",
            "from phnn.laws.namespace import minimum as A; B = 1.0",
        ),
        ("A = lambda x: 2.0 * x; B = 1.0", "A = lambda x: 3.0 * x; B = 1.0"),
        ("A = lambda x, k=2.0: k * x; B = 1.0", "A = lambda x, k=3.0: k * x; B = 1.0"),
        ("A = lambda x, *, k=2.0: k * x; B = 1.0", "A = lambda x, *, k=3.0: k * x; B = 1.0"),
        ("A = lambda x: x; B = lambda x: 2.0 * x", "A = B = lambda x: x"),
    ],
)
def test_laws_that_differ_in_what_they_use_have_other_hashes(one: str, other: str) -> None:
    body = "\ndef flow(e, q, g):\n    return A, B, g * e\n"
    assert _hash(one + body) == _hash(one + body)
    assert _hash(one + body) != _hash(other + body)


@pytest.mark.parametrize("unknown", ["import json as A", "A = {1: 2}", "class A: pass", "A = [1.0]"])
def test_what_cannot_be_hashed_is_named(unknown: str) -> None:
    with pytest.raises(UnknownContent, match=r"made.flow uses (json|dict|A|list)"):
        _hash(unknown + "\ndef flow(e, q, g):\n    return A\n")


def test_machine_code_is_kept_apart_for_other_laws(tmp_path: Path) -> None:
    laws = [_LAW.format(factor=f, inner=i) for f, i in ((1.0, 2.0), (3.0, 2.0), (1.0, 5.0))]
    programs = (x + _FINGERPRINT for x in (*laws, _OWN_FRICTION, ""))
    named, first, *others = _printed(_OWN_FRICTION + _OUTSIDE, tmp_path, *programs)
    # A law made of the functions of another is one of the user's.
    assert named == "['own_friction']"
    # Another process has another seed of hashes.
    assert _printed(laws[0] + _FINGERPRINT, tmp_path) == [first]
    assert len({first, *others}) == 5


@pytest.mark.slow  # it compiles the general kernel twice
def test_each_process_solves_with_the_law_that_it_registered(tmp_path: Path) -> None:
    for factor, inner in ((1.0, 2.0), (3.0, 2.0)):
        (found,) = _printed(_LAW.format(factor=factor, inner=inner) + _DISCHARGE, tmp_path)
        np.testing.assert_allclose(float(found), np.exp(-factor * inner * 0.5 / 2.0), rtol=1e-3)


def test_worker_processes_know_the_law(tmp_path: Path) -> None:
    ask = """
from phnn.parallel import executor

def newest(_):
    from phnn.laws import RESISTOR_LAWS
    import phnn.integrate.step
    name, law = list(RESISTOR_LAWS.items())[-1]
    return name, float(law.flow(1.0, 0.0, 2.0))

print(*(result for _, result in executor("processes:1").each(newest, [0])))
"""
    assert _printed(_LAW.format(factor=3.0, inner=2.0) + ask, tmp_path) == ["('own_damper', 12.0)"]


def test_a_law_that_comes_after_the_solver_is_refused() -> None:
    import phnn.integrate.step  # noqa: F401

    with pytest.raises(StructureViolated, match=r"'late_damper' comes too late: .* directly after `import phnn`"):
        register(ResistorLaw("late_damper", lambda e, q, drag: drag * e, (1.0,)))
    assert "late_damper" not in RESISTOR_LAWS


def test_functions_that_contradict_each_other_or_the_example_are_refused() -> None:
    with pytest.raises(StructureViolated, match=r"mean effort changes the energy by .* but H changes by"):
        register(StorageLaw("odd", lambda a, b, k: k * a, (1.0,)))
    with pytest.raises(StructureViolated, match="its thresholds say"):
        register(ResistorLaw("odd", lambda e, q, g: g * e, (1.0,), thresholds=lambda q, g: (g, -1.0, 1.0)))
    with pytest.raises(StructureViolated, match="one number for each of the 2 parameters of its example"):
        register(ResistorLaw("odd", lambda e, q, drag: drag * e, (1.0, 2.0)))


def test_a_mean_effort_that_is_no_number_or_wrong_where_nothing_moves_is_refused() -> None:
    def quotient(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
        return k * (b * b - a * a) / (2.0 * (b - a))

    def jumping(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
        return np.where(a == b, -7.0 * k * a, 0.5 * k * (a + b))

    with pytest.raises(StructureViolated, match="mean effort"):
        register(StorageLaw("odd", quotient, (1.0,)))
    with pytest.raises(StructureViolated, match="mean effort"):
        register(StorageLaw("odd", jumping, (1.0,)))


def test_mean_efforts_that_round_near_rest_are_accepted() -> None:
    def mean_effort(a: np.ndarray, b: np.ndarray, k: float, s: float) -> np.ndarray:
        return k * (a + b) / (sqrt(1.0 + (a / s) ** 2) + sqrt(1.0 + (b / s) ** 2))

    check_law(StorageLaw("odd", mean_effort, (1.0, 1.0)))


POINTS = np.array([-2.3, -0.71, -0.0021, 0.0017, 0.83, 1.9])
every = pytest.mark.parametrize("law", MEMORY_LAWS.values(), ids=MEMORY_LAWS.keys())


@every
def test_rate_is_affine_with_the_slope_of_the_decay(law: MemoryLaw) -> None:
    z, drive = POINTS, np.roll(POINTS, 1)
    decay = law.decay(*law.example)
    assert decay > 0.0
    expected = law.rate(0.0 * z, drive, *law.example) - decay * z
    np.testing.assert_allclose(law.rate(z, drive, *law.example), expected, rtol=1e-12, atol=1e-13)


@every
@pytest.mark.parametrize("h", [1e-6, 0.3, 40.0])
def test_step_is_the_flow(law: MemoryLaw, h: float) -> None:
    z, drive = 1.7, -0.9
    rate, decay = law.rate(z, drive, *law.example), law.decay(*law.example)

    def flow(t: float, y: np.ndarray) -> list[float]:
        return [law.rate(y[0], drive, *law.example)]

    exact = solve_ivp(flow, (0.0, h), [z], "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    assert advanced(z, h, rate, decay) == pytest.approx(exact[0], rel=1e-10, abs=1e-10)


def test_only_what_lies_beyond_the_threshold_is_remembered() -> None:
    law = MEMORY_LAWS["exceeding"]
    assert law.rate(0.0, 0.49, 0.8, 0.5) == law.rate(0.0, -0.49, 0.8, 0.5) == 0.0
    assert law.rate(0.0, -1.0, 0.8, 0.5) == law.rate(0.0, 1.0, 0.8, 0.5) == pytest.approx(1.0 / 0.8)
