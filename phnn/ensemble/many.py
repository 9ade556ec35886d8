"""Many parameter sets on many recordings, simulated in one call."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phnn.ensemble.executor import executor as executor_of
from phnn.errors import InputRefused, PhnnError
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import simulate

Array = NDArray[np.float64]

# Work of a chunk in steps: some 50 ms, beside which handing it out costs nothing. What a simulation costs whatever its
# length counts as so many steps more.
_CHUNK, _CALL = 200_000, 500


@dataclass(frozen=True, eq=False)
class Member:
    """One parameter set on one recording.

    Attributes:
        output: (N,) sensor output without the displacement zero [m]; None where the simulation failed.
        cause: why it failed; empty where it did not.
    """

    output: Array | None
    cause: str = ""


@dataclass(frozen=True, eq=False)
class _Chunk:
    """Neighbouring parameter sets on one recording, so that its input is reconstructed once."""

    recording: Recording
    substeps: int
    values: tuple[Mapping[str, float], ...]


def simulate_many(
    setup: Setup,
    values: Sequence[Mapping[str, float]],
    recordings: Sequence[Recording],
    substeps: int | Mapping[str, int] = 1,
    executor: str = "threads",
) -> list[list[Member]]:
    """Simulate S parameter sets on R recordings; bit by bit the same wherever it is done.

    Args:
        setup: the model.
        values: S mappings from parameter names to SI values; what a mapping leaves out keeps the setup's value.
        recordings: R recordings.
        substeps: steps per sample interval, for all recordings or by the recording's name (1 where that lacks it).
        executor: where, see `phnn.ensemble.executor.executor`; all cores by default.

    Returns:
        S lists of R members. A member that cannot be simulated carries the cause and does not stop the others.

    Raises:
        InputRefused: a name that the setup does not have, or an executor that is not understood.
    """
    unknown = sorted({name for chosen in values for name in chosen} - set(setup.parameters))
    if unknown:
        raise InputRefused(f"no parameter called {', '.join(unknown)}: {setup.name} has {', '.join(setup.parameters)}")
    places, chunks = [], []
    for column, recording in enumerate(recordings):
        steps = substeps if isinstance(substeps, int) else substeps.get(recording.name, 1)
        for rows in _ranges(len(values), recording.t.size * steps):
            places.append((rows, column))
            chunks.append(_Chunk(recording, steps, tuple(values[s] for s in rows)))
    found = {}
    for i, members in executor_of(executor).each(partial(_simulated, setup), chunks):
        rows, column = places[i]
        found.update({(row, column): member for row, member in zip(rows, members, strict=True)})
    return [[found[s, r] for r in range(len(recordings))] for s in range(len(values))]


def _ranges(count: int, steps: int) -> Iterator[range]:
    """``0…count−1`` in pieces; they depend on the work alone, not on who does it."""
    size = max(1, _CHUNK // (steps + _CALL))
    return (range(first, min(first + size, count)) for first in range(0, count, size))


def _simulated(setup: Setup, chunk: _Chunk) -> list[Member]:
    return [_member(setup, values, chunk) for values in chunk.values]


def _member(setup: Setup, values: Mapping[str, float], chunk: _Chunk) -> Member:
    try:
        output = simulate(setup.with_values(values), chunk.recording, chunk.substeps).y
    except PhnnError as failure:
        return Member(None, str(failure))
    except ArithmeticError as failure:
        return Member(None, f"{chunk.recording.name}: {failure}: a value is far from physical")
    if not np.isfinite(output).all():
        return Member(None, f"{chunk.recording.name}: the output is not finite: a value is far from physical")
    return Member(output)
