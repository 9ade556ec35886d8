"""The standard error of a prediction by what is not known of its recording: where its input jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.identification.evaluate import with_instants
from phnn.identification.start import likely_start
from phnn.recordings.driving import unknown_instants
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import simulate

Array = NDArray[np.float64]


def output_spread(setup: Setup, recording: Recording, substeps: int) -> Array | None:
    """(N,) standard error of a prediction by the unknown instants of the input's jumps; None where it has none.

    Without a recorded output each jump may lie anywhere in its sample interval.
    """
    unknown = unknown_instants(recording)
    if not unknown.size:
        return None
    begun = likely_start(setup, recording, substeps)
    timed, covariance = with_instants(setup, recording, substeps, begun)
    if covariance.size:
        columns = output_derivatives(simulate(setup, timed, substeps, initial=begun), (), instants=True)
        return np.asarray(np.sqrt(np.einsum("ng,gh,nh->n", columns, covariance, columns)))
    total = np.zeros(recording.t.size)
    for g, assumed in enumerate(unknown):
        # Over a whole interval the output is not linear in the instant: its ends are compared.
        first, last = (np.where(np.arange(unknown.size) == g, end, unknown) for end in (0.0, 1.0))
        ends = [simulate(setup, replace(recording, instants=at), substeps, initial=begun).y for at in (first, last)]
        total += (ends[1] - ends[0]) ** 2 * (1.0 / 12.0 + (assumed - 0.5) ** 2)
    return np.sqrt(total)
