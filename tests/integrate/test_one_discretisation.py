"""One scheme is one step: every path that solves a network gives the same states and gradients."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from solve_paths import STEPS, apart, case_of, in_a_hurry, networks, paths
from subjects import body

import phnn
from phnn.integrate import method
from phnn.integrate.equations import reducible_rules
from phnn.integrate.scheme import Scheme
from phnn.models.actuator import hrc
from phnn.network import PortHamiltonianSystem

_PRIVATE = re.compile(r"torchdiffeq\._impl|numba\.(core|_)|_nrt\b|getclosurevars")


def test_private_parts_are_there_and_used_in_two_files() -> None:
    assert method.SOLVERS is not None, "gone from torchdiffeq: adapt phnn.integrate.method, or bound its version"
    root = Path(phnn.__file__).parent
    using = {p.relative_to(root).as_posix() for p in root.rglob("*.py") if _PRIVATE.search(p.read_text())}
    assert using == {"integrate/method.py", "integrate/cache.py"}


NETWORKS = networks()
TOLERANCE = 1e-12
# Parameters that hardly matter are compared on the scale of those that do, see `solve_paths.apart`: of random networks
# with rates up to 1e9 1/s, which amplify the rounding of a state, all parameters are.
WEAKEST, STIFF = 1e-3, ("stiff ", "rich ", "network ")


# Where every path is tried under every scheme even in a hurry: leaves with a closed solution and without, no kernel.
FEW = ("hrc", "leaf coulomb", "leaf of another module")
# From states that no rigid contact has, rounding is all that these two show.
RIGID = ("battery", "friction_rig")


def disagreements(name: str, schemes: Iterable[Scheme], every: bool, steps: int) -> dict[str, tuple[float, float]]:
    """Paths that are farther from the first one than rounding, with the differences of states and of gradients."""
    case, wrong = case_of(NETWORKS[name](), steps), {}
    weakest = 1.0 if name.startswith(STIFF) else WEAKEST
    for scheme in schemes:
        first, *others = paths(case, scheme, every).items()
        assert others, "nothing to compare with"
        assert np.isfinite(first[1].states).all()
        for path, solution in others:
            if max(differences := apart(case, first[1], solution, weakest)) > TOLERANCE:
                wrong[f"{first[0]} and {path}, {scheme}"] = differences
    return wrong


@pytest.mark.parametrize("name", [n for n in in_a_hurry() if n not in RIGID])
def test_torch_and_kernels_take_the_same_steps(name: str) -> None:
    assert not disagreements(name, [Scheme.DISCRETE_GRADIENT], every=False, steps=2)


@pytest.mark.parametrize(
    "name", [n if n in FEW else pytest.param(n, marks=pytest.mark.slow) for n in NETWORKS if n not in RIGID]
)
def test_every_path_takes_the_same_steps_under_every_scheme(name: str) -> None:
    assert not disagreements(name, Scheme, every=True, steps=STEPS)


def test_schemes_differ_in_reducible_storages_alone() -> None:
    case = case_of(hrc(2))
    found = {scheme: paths(case, scheme)["torch"].states for scheme in Scheme}
    assert np.abs(found[Scheme.DISCRETE_GRADIENT] - found[Scheme.MIDPOINT]).max() > 1e-6 * case.scale.max()
    assert reducible_rules(case.system, Scheme.MIDPOINT) == {}
    assert not reducible_rules(PortHamiltonianSystem(body()), Scheme.DISCRETE_GRADIENT)
