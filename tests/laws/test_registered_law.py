"""Laws registered from outside the package: compiled code of one set of laws is never run for another."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phnn.errors import StructureViolated
from phnn.laws import RESISTOR_LAWS, ResistorLaw, StorageLaw, register

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

_FINGERPRINT = "from phnn.integrate.cache import fingerprint; print(fingerprint())"

_DISCHARGE = """
import numpy as np
from phnn.integrate import general
from phnn.integrate.program import compile_network
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
general.march(program, program.theta(network), np.zeros((10, 1)), np.full(10, 0.1), states, efforts)
print(float(states[-1, 0]))
"""


def _printed(program: str, folder: Path) -> str:
    environment = os.environ | {"PHNN_CACHE_DIR": str(folder)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_machine_code_is_kept_apart_for_other_laws(tmp_path: Path) -> None:
    laws = [_LAW.format(factor=f, inner=i) for f, i in ((1.0, 2.0), (1.0, 2.0), (3.0, 2.0), (1.0, 5.0))]
    first, again, other_value, other_helper = (_printed(law + _FINGERPRINT, tmp_path) for law in laws)
    assert first == again
    assert len({first, other_value, other_helper, _printed(_FINGERPRINT, tmp_path)}) == 4


@pytest.mark.slow  # it compiles the general kernel twice
def test_each_process_solves_with_the_law_that_it_registered(tmp_path: Path) -> None:
    for factor, inner in ((1.0, 2.0), (3.0, 2.0)):
        found = float(_printed(_LAW.format(factor=factor, inner=inner) + _DISCHARGE, tmp_path))
        np.testing.assert_allclose(found, np.exp(-factor * inner * 0.5 / 2.0), rtol=1e-3)


def test_worker_processes_know_the_law(tmp_path: Path) -> None:
    ask = """
from phnn.ensemble.processes import Processes

def newest(_):
    from phnn.laws import RESISTOR_LAWS
    import phnn.integrate.dispatch
    name, law = list(RESISTOR_LAWS.items())[-1]
    return name, float(law.flow(1.0, 0.0, 2.0))

print(*(result for _, result in Processes(1).each(newest, [0])))
"""
    assert _printed(_LAW.format(factor=3.0, inner=2.0) + ask, tmp_path) == "('own_damper', 12.0)"


def test_a_law_that_comes_after_the_solver_is_refused() -> None:
    import phnn.integrate.dispatch  # noqa: F401

    with pytest.raises(StructureViolated, match=r"'late_damper' comes too late: .* directly after `import phnn`"):
        register(ResistorLaw("late_damper", lambda e, q, drag: drag * e, (1.0,)))
    assert "late_damper" not in RESISTOR_LAWS


def test_functions_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(StructureViolated, match=r"mean effort changes the energy by .* but H changes by"):
        register(StorageLaw("odd", lambda x, k: k * x * x / 2, lambda a, b, k: k * a, (1.0,)))
    with pytest.raises(StructureViolated, match="its thresholds say"):
        register(ResistorLaw("odd", lambda e, q, g: g * e, (1.0,), thresholds=lambda q, g: (g, -1.0, 1.0)))


def test_functions_with_another_number_of_parameters_are_refused() -> None:
    with pytest.raises(StructureViolated, match="one number for each of the 2 parameters of its example"):
        register(ResistorLaw("odd", lambda e, q, drag: drag * e, (1.0, 2.0)))
