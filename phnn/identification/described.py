"""Identify a network that a file describes, from the values in the file and from others around them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from phnn.errors import PhnnError
from phnn.identification.fit import Fit, distinct_optima
from phnn.identification.plan import Plan
from phnn.identification.staged import FURTHER_STARTS, check_known, fit_identified, held_at
from phnn.recordings.recording import Anchor
from phnn.rescue import late
from phnn.setup import Setup

_QUICK, _FULL = 12, 60
_FINALISTS = 3


def identify_network(setup: Setup, plan: Plan, known: Mapping[str, Anchor], starts: int, seed: int) -> Fit:
    """Fit a network to the identification samples of a plan.

    Args:
        setup: the network with starting values; the first start are these.
        plan: recordings and sub-steps.
        known: anchors; a known parameter is held at its value.
        starts: number of starting points; all but the first have every positive parameter multiplied by a factor around
            one, ``exp N(0, 1)``, and every other moved by its typical size.
        seed: of these factors.

    Raises:
        InputRefused: a known parameter does not belong to the network.
        PhnnError: no starting point can be simulated.
    """
    check_known(known, setup.parameters)
    setup = setup.with_values({n: a.value for n, a in known.items()})
    held = held_at(known)
    tried: list[Fit] = []
    for start in _starts(setup, held, starts, seed):
        if tried and late(FURTHER_STARTS):
            break
        try:
            tried.append(fit_identified(start, plan, held, _QUICK))
        except PhnnError as error:
            failure = error
    if not tried:
        raise PhnnError(f"no starting point of {setup.name} can be simulated ({failure}): give other starting values")
    finished: list[Fit] = []
    for first in sorted(tried, key=_cost)[:_FINALISTS]:
        if finished and late(FURTHER_STARTS):
            break
        finished.append(fit_identified(first.setup, plan, held, _FULL, first))
    best, alternatives = distinct_optima(finished)
    return replace(best, alternatives=alternatives)


def _cost(fitted: Fit) -> float:
    return fitted.cost


def _starts(setup: Setup, held: Mapping[str, str], count: int, seed: int) -> list[Setup]:
    rng = np.random.default_rng(seed)
    found = [setup]
    for _ in range(count - 1):
        values = {}
        for name in (n for n in setup.free if n not in held):
            p, z = setup.parameters[name], float(rng.standard_normal())
            moved = p.value * np.exp(z) if p.positive else p.value + z * p.typical
            values[name] = float(np.clip(moved, p.lower, p.upper))
        found.append(setup.with_values(values))
    return found
