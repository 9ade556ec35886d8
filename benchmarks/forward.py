"""How long does a solve of given accuracy take?

    python -m benchmarks.forward

Displacements of the seven sines to 1e-4, 1e-5 and 1e-6, phnn beside diffrax and scipy; torchdiffeq on one period of
150 Hz, because the whole campaign would take it hours.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import partial

import pandas as pd

from benchmarks import peers, peers_scipy, peers_torch
from benchmarks.case import CAMPAIGN, PART, Array, whole_call
from benchmarks.ladder import Choice, Solver, choose
from benchmarks.reference import reference
from benchmarks.table import RESULTS, Contender, goal, machine, picture, rows, show, timed, write_csv
from phnn.recordings.recording import Recording

TARGETS = (1e-4, 1e-5, 1e-6)
SUBSTEPS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
WHOLE, PERIOD = "seven sines", "one period of 150 Hz"
CALL = "phnn, whole call"
GOAL, GOAL_AT = 10.0, 1e-5


def solvers(case: str, recordings: Sequence[Recording]) -> list[list[Solver]]:
    """All solvers that a case is for, each with its variants."""
    own = [Solver(CALL, SUBSTEPS, partial(whole_call, recordings))]
    if case == PERIOD:
        return [own, peers_torch.forward(recordings)]
    return [
        own,
        *(peers.forward(recordings, kind, together) for kind in peers.KINDS for together in (True, False)),
        *(peers_scipy.forward(recordings, name) for name in peers_scipy.PATHS),
    ]


def contenders(case: str, recordings: Sequence[Recording], truth: Array) -> Iterator[Contender]:
    """Every solver with the settings that each target needs."""
    for variants in solvers(case, recordings):
        for choice in choose(variants, truth, TARGETS):
            yield entered(case, choice)


def entered(case: str, choice: Choice) -> Contender:
    """A choice as a line of the table."""
    solve = None if choice.settings is None else choice.solver.prepare(choice.settings)
    # The climb has compiled everything.
    return Contender(case, choice.target, choice.solver.name, choice.setting(), choice.error, solve, warm=True)


def in_order(found: Sequence[Contender]) -> list[Contender]:
    """By case, then by target, the loosest first."""
    cases = list(dict.fromkeys(c.case for c in found))
    return sorted(found, key=lambda c: (cases.index(c.case), -c.target))


def fastest_peer(table: pd.DataFrame, case: str, target: float) -> pd.Series:
    """The line of the fastest solver that is not phnn."""
    here = table[(table["case"] == case) & (table["target"] == target) & ~table["solver"].str.startswith("phnn")]
    return here.loc[here["seconds"].idxmin()]


def main() -> int:
    """Climb, time in turns, print, write ``forward.csv`` and ``forward.png``."""
    print(machine())
    found = [
        c
        for case, recordings in ((WHOLE, CAMPAIGN), (PERIOD, PART))
        for c in contenders(case, recordings, reference(recordings)[0])
    ]
    ordered = in_order(found)
    seconds, _ = timed(ordered)
    table = rows(ordered, seconds)
    show(table, "forward: relative error of q in the worst recording, one thread each, ratio to the first of its kind")
    write_csv(table, RESULTS / "forward.csv")
    picture(table, RESULTS / "forward.png", "Displacements of seven recorded sines, one thread")
    peer = fastest_peer(table, WHOLE, GOAL_AT)
    print(f"fastest peer at {GOAL_AT:.0e}: {peer['solver']}")
    line = table[(table["case"] == WHOLE) & (table["target"] == GOAL_AT) & (table["solver"] == CALL)].iloc[0]
    goal(f"{CALL}, forward at {GOAL_AT:.0e}", peer["seconds"] / line["seconds"], GOAL)
    return 0


if __name__ == "__main__":
    sys.exit(main())
