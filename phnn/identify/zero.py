"""One zero of the output for all recordings that share it: a parameter of the model, not of each recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phnn.errors import InputRefused
from phnn.identify.fit import Fit
from phnn.identify.problem import Plan
from phnn.identify.staged import fit_identified, stated_only
from phnn.parameters import signed
from phnn.recordings.recording import Recording
from phnn.setup import Block
from phnn.simulate import simulate

ZERO = "y_0"


def with_own_zeros(plan: Plan) -> Plan:
    """The plan in which every recording has a zero of its own, for the search of starting values."""
    return replace(plan, recordings=tuple(replace(r, offset="own") for r in plan.recordings))


def is_shared(recordings: Sequence[Recording]) -> bool:
    """Whether recordings share the zero of their output.

    Raises:
        InputRefused: some do and some do not.
    """
    shared = [r for r in recordings if r.offset == "shared"]
    if shared and len(shared) < len(recordings):
        other = next(r for r in recordings if r.offset != "shared")
        raise InputRefused(
            f"{other.source}: {other.name} has a zero of its own, {shared[0].name} shares one: say `offset: shared` "
            f"for all recordings in recordings.yaml, or for none"
        )
    return bool(shared)


def with_shared_zero(first: Fit, plan: Plan) -> Fit:
    """A fit with own zeros continued with one zero for all recordings of a plan.

    Args:
        first: with own zeros; plan: the same recordings, which share theirs.
    """

    def error(recording: Recording) -> float:
        y = simulate(first.setup, recording, first.plan.steps_of(recording), initial=first.initial(recording.name)).y
        counted = recording.mask("identification") & (recording.sensor.at_limit(recording.y) == 0)
        return float(np.mean((recording.y - y)[counted])) if counted.any() else 0.0

    start, reach = float(np.mean(plan.each(error))), max(float(np.abs(r.y).max()) for r in plan.recordings)
    unit = plan.recordings[0].units.output
    parameter = signed(ZERO, start, unit, 10.0 * reach, reach, "zero of the output, common to all recordings")
    setup = first.setup.with_block("sensor", Block("zero", (ZERO,)), (parameter,))
    plan = replace(plan, substeps=first.plan.substeps)
    return fit_identified(setup, plan, stated_only(first.held), origin=first, keep=(ZERO,))
