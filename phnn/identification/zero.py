"""Unknown quantities that recordings share, as parameters of the model: zero of the output, gain of the input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phnn.errors import InputRefused
from phnn.identification.fit import Fit
from phnn.identification.plan import Plan
from phnn.identification.staged import fit_identified, stated_only
from phnn.parameters import positive, signed
from phnn.recordings.recording import Recording
from phnn.setup import Block, Setup
from phnn.trajectory import simulate

ZERO, GAIN = "y_0", "gamma_u"


def with_own_zeros(plan: Plan) -> Plan:
    """The plan in which every recording has a zero of its own, for the search of starting values."""
    return replace(plan, recordings=own_zeros(plan.recordings))


def own_zeros(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Recordings, each with a zero of its own."""
    return tuple(replace(r, offset="own") for r in recordings)


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
    plan, held = replace(plan, substeps=first.plan.substeps), stated_only(first.held)
    return fit_identified(setup, plan, held, origin=first, keep=(ZERO,))


def with_unknown_gain(setup: Setup, recordings: Sequence[Recording]) -> Setup:
    """The setup behind a drive of unknown gain, where the recordings say so.

    Raises:
        InputRefused: some have a known gain and some do not.
    """
    unknown = [r for r in recordings if r.gain == "unknown"]
    if not unknown:
        return setup
    if len(unknown) < len(recordings):
        other = next(r for r in recordings if r.gain == "known")
        raise InputRefused(
            f"{other.source}: the gain of {other.name} is known, that of {unknown[0].name} is not: give both the same "
            f"in recordings.yaml"
        )
    return setup.with_block("amplifier", Block("gain", (GAIN,)), (positive(GAIN, 1.0, "1", "gain of the input", 1e9),))
