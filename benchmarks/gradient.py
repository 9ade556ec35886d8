"""Gradients: d/dlog θ of ``Σ (q − q_ref)²`` by all ten parameters on the paper's campaign, beside diffrax."""

from __future__ import annotations

import sys
from functools import partial
from importlib.util import find_spec

import numpy as np

from benchmarks.case import TRUTH, Array, Prepared, cost_gradient, simulate_all
from benchmarks.reference import reference_campaign, reference_sensitivities
from benchmarks.table import RESULTS, Contender, measure, picture, show, write_csv

TARGET = 0.05
# The data come from another actuator, or the gradient would vanish.
MOVED = TRUTH * np.where(np.arange(TRUTH.size) % 2, 1.05, 0.96)


def own_contenders(wanted: Array) -> list[Contender]:
    """March and forward sweep of the linearised recursion, in the compiled solver."""
    found = []
    for substeps in (1, 2):
        prepared = Prepared(simulate_all(TRUTH, substeps))
        name = f"phnn, {substeps} sub-step{'s' * (substeps > 1)}"
        found.append(Contender(name, TARGET, partial(cost_gradient, prepared, wanted)))
    return found


def peer_contenders(wanted: Array) -> list[Contender]:
    """diffrax in reverse mode through recursive checkpoints, and in forward mode with ten tangents."""
    if not find_spec("diffrax"):
        print("diffrax is not installed: pip install -e '.[bench]'", file=sys.stderr)
        return []
    from benchmarks.peers import diffrax_gradient

    found = []
    for solver in ("Kvaerno5", "Kvaerno3"):
        for mode in ("reverse", "forward"):
            for together in (True, False):
                solve = diffrax_gradient(solver, mode, together, wanted)
                name = f"diffrax {solver} {mode} {'vmap' if together else 'one by one'}, 1e-06"
                found.append(Contender(name, 1e-6, partial(solve, 1e-6), repeats=9))
    return found


def main() -> int:
    """Measure, print, write ``gradient.csv`` and ``gradient.png``."""
    wanted = reference_campaign(MOVED)
    truth = 2.0 * np.einsum("rn,rnk->k", reference_campaign() - wanted, reference_sensitivities())
    print("one thread each; the gradient's reference is central differences of Radau at 1e-10")
    rows = measure([*own_contenders(wanted), *peer_contenders(wanted)], truth)
    show(rows, "gradient of the sum of squares by ten parameters, seven sines of 2000 samples")
    write_csv(rows, RESULTS / "gradient.csv")
    picture(rows, RESULTS / "gradient.png", "Gradient by ten parameters, one thread")
    return 0


if __name__ == "__main__":
    sys.exit(main())
