"""How long does a gradient by all ten parameters take?

    python -m benchmarks.gradient

The gradient of ``Σ (q − wanted)²`` over the seven sines. It is matched twice: by the error of q, with the very settings
that a forward solve needs for 1e-4, 1e-5 and 1e-6 (what these make of the gradient stands beside), and by the error
of the gradient itself. torchdiffeq takes part on one period of 150 Hz.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from benchmarks import peers, peers_torch
from benchmarks.case import CAMPAIGN, PART, TRUTH, Array, adjoint_gradient, march_alone, swept_gradient
from benchmarks.forward import PERIOD, SUBSTEPS, TARGETS, WHOLE, fastest_peer, in_order
from benchmarks.ladder import Choice, Prepare, Solver, choose, relative_errors
from benchmarks.reference import reference
from benchmarks.table import RESULTS, Contender, goal, machine, picture, rows, show, timed, write_csv
from phnn.recordings.recording import Recording

TARGETS_GRADIENT = (1e-2, 1e-3)
# The data come from another actuator, or the gradient would vanish.
MOVED = TRUTH * np.where(np.arange(TRUTH.size) % 2, 1.05, 0.96)
SWEEP, ADJOINT = "phnn, sweep of ten columns", "phnn, torch adjoint"
OWN = (SWEEP, ADJOINT)
REVERSE = "reverse"
GOAL, GOAL_TORCH, GOAL_AT = 10.0, 1000.0, 1e-5
_BUDGET = 2.0  # s
BY_Q, BY_GRADIENT = "q", "gradient"

# How a solver with its settings becomes gradients: names in the table and what prepares them.
Derived = Sequence[tuple[str, Callable[[Choice], Prepare]]]


def problem(recordings: Sequence[Recording]) -> tuple[Array, Array, Array]:
    """(R, N) displacements, (R, N) data, and (R, 10) the gradient of reference."""
    q, by = reference(recordings)
    wanted = reference(recordings, MOVED)[0]
    return q, wanted, 2.0 * np.einsum("rn,rnk->rk", q - wanted, by)


def own(recordings: Sequence[Recording], wanted: Array) -> Derived:
    """phnn's gradients: exact derivatives of the very steps, forward with ten columns, or backward for all at once."""
    swept: Prepare = partial(swept_gradient, recordings, wanted=wanted)
    adjoint: Prepare = partial(adjoint_gradient, recordings, wanted=wanted)
    return ((SWEEP, lambda _: swept), (ADJOINT, lambda _: adjoint))


class Diffrax:
    """diffrax's gradients; each variant is made once, because to compile it takes many seconds."""

    def __init__(self, recordings: Sequence[Recording], wanted: Array) -> None:
        self.recordings, self.wanted = recordings, wanted
        self._made: dict[tuple[str, bool, int | None, str], Prepare] = {}
        self._steps: dict[tuple[str, str], Prepare] = {}

    def _made_once(self, kind: str, together: bool, planned: int | None, note: str) -> Prepare:
        key = (kind, together, planned, note)
        if key not in self._made:
            self._made[key] = peers.gradient(self.recordings, self.wanted, *key)
        return self._made[key]

    def _reverse(self, kind: str, together: bool, choice: Choice) -> Prepare:
        note = choice.solver.note
        if (kind, note) not in self._steps:
            self._steps[kind, note] = peers.steps(self.recordings, kind, note)
        enough = self._steps[kind, note](choice.settings or ())().max() < peers.FEW_STEPS
        return self._made_once(kind, together, peers.FEW_STEPS if enough else peers.MOST_STEPS, note)

    def _forward(self, kind: str, together: bool, choice: Choice) -> Prepare:
        return self._made_once(kind, together, None, choice.solver.note)

    def derived(self, kind: str, together: bool) -> Derived:
        """Reverse mode through recursive checkpoints; forward mode with ten tangents, where it runs at once."""
        how = "vmap" if together else "one by one"
        reverse = (f"diffrax {kind}, {REVERSE}, {how}", partial(self._reverse, kind, together))
        forward = (f"diffrax {kind}, forward, {how}", partial(self._forward, kind, together))
        return (reverse, forward) if together else (reverse,)


def entered(case: str, choice: Choice, derived: Derived, matched: str) -> list[Contender]:
    """The gradients of a choice as lines of the table."""
    found = []
    for name, prepare in derived:
        solve = None if choice.settings is None else prepare(choice)(choice.settings)
        found.append(
            Contender(f"{case}, by {matched}", choice.target, name, choice.setting(), choice.error, solve)
        )  # fmt: skip
    return found


def on_campaign(q: Array, wanted: Array, truth: Array) -> list[Contender]:
    """phnn and diffrax on the seven sines, matched by q and by the gradient."""
    found = []
    ours = own(CAMPAIGN, wanted)
    diffrax = Diffrax(CAMPAIGN, wanted)
    march = Solver("phnn", SUBSTEPS, partial(march_alone, CAMPAIGN))
    for choice in choose([march], q, TARGETS):
        found += entered(WHOLE, choice, ours, BY_Q)
    for kind in peers.KINDS:
        for together in (True, False):
            for choice in choose(peers.forward(CAMPAIGN, kind, together), q, TARGETS):
                found += entered(WHOLE, choice, diffrax.derived(kind, together), BY_Q)
    sweep = Solver("phnn", SUBSTEPS, partial(swept_gradient, CAMPAIGN, wanted=wanted))
    for choice in choose([sweep], truth, TARGETS_GRADIENT):
        found += entered(WHOLE, choice, ours, BY_GRADIENT)
    for kind in peers.KINDS:
        # Both modes differentiate the same steps: what one of them needs is what the other needs.
        for choice in choose(peers.gradients(CAMPAIGN, wanted, kind), truth, TARGETS_GRADIENT):
            found += entered(WHOLE, choice, diffrax.derived(kind, together=True), BY_GRADIENT)
    return found


def on_part(q: Array, wanted: Array) -> list[Contender]:
    """phnn and torchdiffeq on one period, matched by q."""
    found = []
    for choice in choose([Solver("phnn", SUBSTEPS, partial(march_alone, PART))], q, TARGETS):
        found += entered(PERIOD, choice, own(PART, wanted), BY_Q)
    by_torch = [
        (s.name, lambda _, s=s: s.prepare) for s in (peers_torch.gradient(PART, wanted, a) for a in (True, False))
    ]
    for choice in choose(peers_torch.forward(PART), q, TARGETS):
        found += [replace(c, warm=True) for c in entered(PERIOD, choice, by_torch, BY_Q)]
    return found


def main() -> int:
    """Climb, time in turns, print, write ``gradient.csv`` and ``gradient.png``."""
    print(machine())
    whole, part = problem(CAMPAIGN), problem(PART)
    found = in_order([*on_campaign(*whole), *on_part(*part[:2])])
    seconds, values = timed(found, _BUDGET)
    table = rows(found, seconds)
    truths = [part[2] if c.case.startswith(PERIOD) else whole[2] for c in found]
    table.insert(5, "gradient_error", [np.nan if v is None else relative_errors(v, t).max()
                                       for v, t in zip(values, truths, strict=True)])  # fmt: skip
    for case, here in table.groupby("case", sort=False):
        show(here.drop(columns="case"), f"gradient by ten parameters, {case} (the error that is matched)")
    write_csv(table, RESULTS / "gradient.csv")
    picture(table, RESULTS / "gradient.png", "Gradient by ten parameters, seven recorded sines, one thread")
    print_goals(table)
    return 0


def print_goals(table: pd.DataFrame) -> None:
    """How many times faster than the fastest peer, and than torchdiffeq's adjoint method."""

    def seconds(case: str, target: float, solver: str) -> float:
        chosen = (table["case"] == case) & (table["target"] == target) & (table["solver"] == solver)
        return float(table.loc[chosen, "seconds"].iloc[0])

    reverse_only = table[~table["solver"].str.contains("forward")]
    for matched, target in ((BY_Q, GOAL_AT), (BY_GRADIENT, TARGETS_GRADIENT[1])):
        case = f"{WHOLE}, by {matched}"
        for peer in (fastest_peer(table, case, target), fastest_peer(reverse_only, case, target)):
            for name in OWN:
                what = f"{name}, {matched} to {target:.0e}, against {peer['solver']}"
                goal(what, peer["seconds"] / seconds(case, target, name), GOAL)
    case = f"{PERIOD}, by {BY_Q}"
    (adjoint,) = (s for s in table["solver"].unique() if s.endswith("odeint_adjoint"))
    for name in OWN:
        ratio = seconds(case, GOAL_AT, adjoint) / seconds(case, GOAL_AT, name)
        goal(f"{name}, q to {GOAL_AT:.0e}, against {adjoint} (one period)", ratio, GOAL_TORCH)


if __name__ == "__main__":
    sys.exit(main())
