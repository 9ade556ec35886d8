"""Forward solves: time and measured error of the displacement on the paper's campaign, beside the peers."""

from __future__ import annotations

import sys
import time
from functools import partial
from importlib.util import find_spec

import numpy as np
import pandas as pd

from benchmarks.case import (
    FREQUENCIES,
    NAMES,
    PERIODS,
    SAMPLES,
    TRUTH,
    Array,
    Prepared,
    outputs,
    sensitivities,
    simulate_all,
)
from benchmarks.reference import radau, reference, reference_campaign, reference_sensitivities
from benchmarks.table import RESULTS, Contender, Row, measure, picture, relative_error, show, write_csv

TARGET_Q = 5e-5
TARGET_SENSITIVITY = 0.05
_SUBSTEPS = (1, 2, 4, 8)
_TOLERANCES = (1e-6, 1e-3, 1e-4, 1e-5, 1e-7)


def own_contenders() -> list[Contender]:
    """The compiled solver: the solve alone at several sub-steps, and the whole call."""
    solves = [
        Contender(f"phnn, {s} sub-step{'s' * (s > 1)}", TARGET_Q, Prepared(simulate_all(TRUTH, s)).march)
        for s in _SUBSTEPS
    ]
    calls = [
        Contender(f"phnn whole call, {s} sub-step{'s' * (s > 1)}", TARGET_Q, partial(_whole_call, s))
        for s in _SUBSTEPS[:2]
    ]
    return solves + calls


def _whole_call(substeps: int) -> Array:
    return outputs(simulate_all(TRUTH, substeps))


def peer_contenders() -> list[Contender]:
    """diffrax, warmed up by the first run of `measure`, and scipy."""
    found = []
    if find_spec("diffrax"):
        from benchmarks.peers import diffrax_forward

        for name in ("Kvaerno5", "Kvaerno3"):
            batch, single = diffrax_forward(name, together=True), diffrax_forward(name, together=False)
            found += [Contender(f"diffrax {name} vmap, {t:.0e}", t, partial(batch, t)) for t in _TOLERANCES]
            found.append(Contender(f"diffrax {name} one by one, 1e-06", 1e-6, partial(single, 1e-6)))
    else:
        print("diffrax is not installed: pip install -e '.[bench]'", file=sys.stderr)

    def scipy_radau() -> Array:
        return np.stack([radau(f, TRUTH, 1e-6) for f in FREQUENCIES])

    return [*found, Contender("scipy Radau, 1e-06", 1e-6, scipy_radau, repeats=3)]


def one_period_by_dopri5() -> list[Row]:
    """torchdiffeq's explicit dopri5 on one period of 150 Hz only; the whole campaign has 360 times as much time."""
    if not find_spec("diffrax"):
        return []
    from benchmarks.peers import dopri5_one_period

    samples = SAMPLES // PERIODS
    q, seconds = dopri5_one_period(150.0, 1e-6)
    ours = Prepared(simulate_all(TRUTH, 1)[-1:])
    ours.march()
    own = []
    for _ in range(15):
        begin = time.perf_counter()
        ours.march()
        own.append((time.perf_counter() - begin) / PERIODS)
    error = relative_error(q, reference(150.0)[:samples])
    return [
        Row("torchdiffeq dopri5 on one 150 Hz period, 1e-06", 1e-6, error, seconds, seconds / float(np.median(own)))
    ]


def sensitivity_errors(truth: Array, wanted: Array) -> pd.DataFrame:
    """Relative error of ∂q/∂log θ of every parameter over the stacked campaign.

    Args:
        truth: reference displacements.
        wanted: reference sensitivities.

    Returns:
        Columns ``parameter, size`` (norm relative to the displacement's) and ``error_1, error_2`` by sub-steps.
    """
    table = pd.DataFrame({"parameter": NAMES})
    table["size"] = [float(np.linalg.norm(wanted[..., k]) / np.linalg.norm(truth)) for k in range(len(NAMES))]
    for substeps in (1, 2):
        own = sensitivities(simulate_all(TRUTH, substeps))
        table[f"error_{substeps}"] = [relative_error(own[..., k], wanted[..., k]) for k in range(len(NAMES))]
    return table


def main() -> int:
    """Measure, print, write ``forward.csv``, ``sensitivities.csv`` and ``forward.png``."""
    truth = reference_campaign()
    print("one thread each; peers get the continuous sine, phnn its samples and a cubic spline between them")
    rows = measure([*own_contenders(), *peer_contenders()], truth)
    shown = rows + one_period_by_dopri5()
    show(shown, f"forward: seven sines, {SAMPLES} samples each, error of the displacement against Radau at 1e-10")
    write_csv(shown, RESULTS / "forward.csv")
    picture(rows, RESULTS / "forward.png", "Forward solve of the seven sines, one thread")
    errors = sensitivity_errors(truth, reference_sensitivities())
    print(errors.to_string(index=False, float_format=lambda x: f"{x:.2g}"))
    errors.to_csv(RESULTS / "sensitivities.csv", index=False, float_format="%.4g")
    worst = float(errors["error_1"].max())
    print(
        f"error of q {rows[0].measured_error:.1e} (goal {TARGET_Q:.0e}), worst sensitivity {worst:.1%}"
        f" (goal {TARGET_SENSITIVITY:.0%}), both at one sub-step"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
