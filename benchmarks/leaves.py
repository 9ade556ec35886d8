"""Which rule should advance a leaf?

    python -m benchmarks.leaves

A hysteron under the constant current of a step is advanced by its exact flow, by two-stage Radau IIA, or by the
midpoint discrete gradient. All rules take the same steps on the seven sines, 1 to 16 of them an interval, and all go
through the general kernel, march as well as sweep; the quick march, which serves the exact flow only, is one line more.

**Errors** are those of the worst recording, each relative to the peak of its own reference; efforts and sensitivities
column by column. By its mass an actuator at 1 Hz moves a millionth, and no rule for leaves gets that right where the
steps do not resolve the resonance, so sensitivities stand there once more, as *pooled*: relative to the peak of the
column in all recordings, which is what an identification from all of them sees.

**Reference.** Displacements and sensitivities are held against `benchmarks.reference`, which knows none of the rules.
It has no efforts and no loss: these are held against the exact rule with `FINEST` sub-steps, whose displacements and
sensitivities are compared with the same reference. That it does not favour its own kind, Radau confirms with the same
fine steps on the slowest and the fastest sine; an error far above the difference of the two does not depend on
which of them it is held against.

**Times** are those of one recording, because a step costs much the same in all of them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.case import CAMPAIGN, NAMES, SAMPLES, TRUTH, Array, setup_with
from benchmarks.reference import reference
from benchmarks.table import RESULTS, Contender, machine, save, show, timed, write_csv
from phnn.derivatives import output_derivatives
from phnn.errors import SolverFailed
from phnn.integrate import kernel
from phnn.integrate.program import compile_network
from phnn.integrate.scheme import Scheme
from phnn.recordings.recording import Recording
from phnn.trajectory import Trajectory, simulate

SUBSTEPS = (1, 2, 4, 8, 16)
FINEST = 256
TARGETS = (1e-3, 1e-4, 1e-5)
# The slowest and the fastest sine, for a rule that takes minutes with the finest steps.
ENDS = (0, len(CAMPAIGN) - 1)
TIMED = (CAMPAIGN[len(CAMPAIGN) // 2],)
TITLES = {
    "q": "displacement",
    "efforts": "efforts of the hysterons",
    "loss": "energy lost in the hysterons",
    "sensitivities": "sensitivities, by recording",
    "pooled": "sensitivities, pooled",
}
QUANTITIES = tuple(TITLES)
SWEPT = ("sensitivities", "pooled")
HYSTERONS = ("Q_1", "Q_2")
ALPHA = TRUTH[NAMES.index("alpha")]  # N/V
CAPACITANCES = TRUTH[[NAMES.index(n) for n in ("C_1", "C_2")]]  # F
_BUDGET = 1.0  # s


@dataclass(frozen=True)
class Line:
    """A scheme and the kernel it goes through; only the exact rule has a quick one."""

    name: str
    scheme: Scheme
    quick: bool = False


RULES = (Line("exact", Scheme.DISCRETE_GRADIENT), Line("radau", Scheme.RADAU), Line("midpoint", Scheme.MIDPOINT))
QUICK = Line("exact, single-junction kernel", Scheme.DISCRETE_GRADIENT, quick=True)
LINES = (*RULES, QUICK)


class Run:
    """Recordings with one rule and one number of sub-steps; program, inputs and memory are ready."""

    def __init__(self, line: Line, substeps: int, recordings: Sequence[Recording] = CAMPAIGN) -> None:
        self.line, self.substeps = line, substeps
        setup = setup_with(TRUTH)
        program = compile_network(setup.network, line.scheme)
        steps = (simulate(setup, r, substeps) for r in recordings)
        self.trajectories = [replace(t, program=program) for t in steps]

    def march(self) -> Array:
        """(R, N) displacements [m]; the trajectories have become those of the rule.

        Raises:
            SolverFailed: a step was not solved.
        """
        for t in self.trajectories:
            general, start = not self.line.quick, t.states[0].copy()
            if kernel.march(t.program, t.theta, start, t.u, t.h, t.states, t.efforts, general) < t.h.size:
                where = f"{self.line.name}, {self.substeps} sub-steps"
                raise SolverFailed(f"{where}: {t.recording.name} was not solved")
        return np.stack([t.states[t.nodes, t.program.output] for t in self.trajectories])

    def sensitivities(self) -> Array:
        """(R, N, 10) derivatives of the displacements by the logarithms of the parameters, along the march [m]."""
        return np.stack([output_derivatives(t, NAMES) for t in self.trajectories]) * TRUTH


def node_efforts(trajectory: Trajectory) -> Array:
    """(N, 2) efforts of the hysterons at the samples [V]."""
    at = [trajectory.program.states.index(name) for name in HYSTERONS]
    return trajectory.states[trajectory.nodes][:, at] / CAPACITANCES


def dissipated(trajectory: Trajectory) -> float:
    """Energy that the hysterons take over a recording and do not store, ``Σ h i ē − ΔH`` [J]."""
    at = [trajectory.program.states.index(name) for name in HYSTERONS]
    charges, means, h = trajectory.states[:, at], trajectory.efforts[:, at], trajectory.h[:, None]
    current = ALPHA * trajectory.velocity[:, None]
    stored = 0.5 * np.diff(charges**2, axis=0) / CAPACITANCES
    return float(np.sum(h * current * means - stored))


def marched(run: Run) -> dict[str, Array]:
    """(R, N, K) what a march gives: one displacement, two efforts; for the loss also N = 1."""
    q = run.march()
    return {
        "q": q[..., None],
        "efforts": np.stack([node_efforts(t) for t in run.trajectories]),
        "loss": np.array([dissipated(t) for t in run.trajectories])[:, None, None],
    }


def quantities(run: Run) -> dict[str, Array]:
    """(R, N, K) the same and ten sensitivities, which are judged in two ways."""
    return marched(run) | dict.fromkeys(SWEPT, run.sensitivities())


def worst_error(value: Array, truth: Array, pooled: bool = False) -> float:
    """Largest ``max_n |value − truth| / max_n |truth|`` of all recordings and columns; infinite if one is not finite.

    Args:
        value, truth: (R, N, K).
        pooled: relative to the peak of a column in all recordings.
    """
    peak = np.abs(truth).max(axis=(0, 1) if pooled else 1, keepdims=True)
    error = float(np.max(np.abs(value - truth) / peak))
    return error if np.isfinite(error) else np.inf


def errors(found: dict[str, Array], truth: dict[str, Array]) -> dict[str, float]:
    """Errors of all quantities; NaN for those that one of the two lacks."""
    both = found.keys() & truth.keys()
    return {n: worst_error(found[n], truth[n], n == "pooled") if n in both else float("nan") for n in QUANTITIES}


def truths() -> tuple[dict[str, Array], pd.DataFrame]:
    """What the rules are held against, and how well those who could give it agree."""
    q, by = reference(CAMPAIGN)
    independent = {"q": q[..., None], **dict.fromkeys(SWEPT, by)}
    exact = quantities(Run(QUICK, FINEST))
    ends = [CAMPAIGN[i] for i in ENDS]
    radau = marched(Run(RULES[1], FINEST, ends))
    at_ends = [{name: value[list(ENDS)] for name, value in truth.items()} for truth in (independent, exact)]
    checks = {
        "exact against the reference": errors(exact, independent),
        "radau against the reference": errors(radau, at_ends[0]),
        "radau against exact": errors(radau, at_ends[1]),
    }
    table = pd.DataFrame([{"solver": name, **own} for name, own in checks.items()])
    return exact | independent, table


def nanoseconds() -> Array:
    """(S · L, 2) median times per step of march and sweep [ns], in the order of `measured`."""
    runs = [Run(line, s, TIMED) for s in SUBSTEPS for line in LINES]
    # Measuring the errors has compiled everything.
    work = [
        Contender(what, float(run.substeps), run.line.name, "", 0.0, solve, warm=True)
        for run in runs
        for what, solve in (("march", run.march), ("sweep", run.sensitivities))
    ]
    steps = np.array([sum(t.h.size for t in run.trajectories) for run in runs])
    return 1e9 * np.reshape(timed(work, _BUDGET)[0], (-1, 2)) / steps[:, None]


def measured(truth: dict[str, Array]) -> pd.DataFrame:
    """A line for every rule and number of sub-steps: times per step [ns] and errors."""
    which = [(line, s) for s in SUBSTEPS for line in LINES]
    found = pd.DataFrame([errors(quantities(Run(line, s)), truth) for line, s in which])
    times = nanoseconds().round().astype(int)
    head = {
        "rule": [line.name for line, _ in which],
        "substeps": [s for _, s in which],
        "march_ns": times[:, 0],
        "sweep_ns": times[:, 1],
    }
    table = pd.concat([pd.DataFrame(head), found], axis=1)
    order = [line.name for line in LINES]
    return table.sort_values("rule", key=lambda c: c.map(order.index), kind="stable", ignore_index=True)


def cost(table: pd.DataFrame, quantity: str) -> pd.Series:
    """Time per sample of the recording [ns]: sensitivities need the march and the sweep, all else the march alone."""
    per_step = table["march_ns"] + (table["sweep_ns"] if quantity in SWEPT else 0)
    return per_step * table["substeps"]


def cheapest(table: pd.DataFrame) -> pd.DataFrame:
    """For every quantity and target what each rule needs, and which of those in the general kernel needs least."""
    lines = []
    for quantity in QUANTITIES:
        for target in TARGETS:
            met = table.assign(cost=cost(table, quantity))[table[quantity] <= target].sort_values("cost")
            first = met.drop_duplicates("rule").set_index("rule")
            cells = {rule: _cell(first, rule) for rule in table["rule"].unique()}
            able = [rule for rule in first.index if rule != QUICK.name]
            lines.append({"quantity": quantity, "error": target, **cells, "cheapest": able[0] if able else "none"})
    return pd.DataFrame(lines)


def _cell(first: pd.DataFrame, rule: str) -> str:
    if rule not in first.index:
        return "not reached"
    return f"{first.loc[rule, 'cost']:,.0f} ns ({first.loc[rule, 'substeps']})"


def picture(table: pd.DataFrame, path: Path) -> None:
    """Error against time per sample, a panel for every quantity."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 7.5), layout="constrained")
    *panels, rest = figure.subplots(2, 3).ravel()
    for axes, (quantity, title) in zip(panels, TITLES.items(), strict=True):
        spent = cost(table, quantity)
        for rule, own in table.groupby("rule", sort=False):
            style = "--" if rule == QUICK.name else "-"
            axes.loglog(spent[own.index], own[quantity], style, marker="o", ms=4, label=rule)
        for target in TARGETS:
            axes.axhline(target, color="0.5", lw=0.8, ls=":")
        what = "march and sweep" if quantity in SWEPT else "march"
        axes.set(title=title, xlabel=f"time of {what} per sample [ns]", ylabel="relative error, worst recording")
        axes.grid(True, which="both", alpha=0.25)
    rest.axis("off")
    rest.legend(*panels[0].get_legend_handles_labels(), loc="center", title="rule")
    few, many = SUBSTEPS[0], SUBSTEPS[-1]
    figure.suptitle(f"Rules for a leaf, seven recorded sines: {few} to {many} sub-steps, from left to right")
    save(figure, path)


def main() -> int:
    """Measure, print, write ``leaves.csv`` and ``leaves.png``."""
    print(machine())
    truth, checks = truths()
    show(checks, f"leaves: how well the references agree, {FINEST} sub-steps for each of {SAMPLES} samples")
    table = measured(truth)
    show(table, "leaves: median times per step [ns] and relative errors in the worst recording, one thread")
    show(cheapest(table), "leaves: time per sample (sub-steps) by relative error, and the cheapest in the same kernel")
    write_csv(table, RESULTS / "leaves.csv")
    picture(table, RESULTS / "leaves.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
