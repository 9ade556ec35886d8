"""Score a model of the Silverbox by the protocol of nonlinearbenchmark.org.

A model is simulated on the input of a test. It may use the first 50 samples of the test's output for its initial state,
and these are not scored. The score is the root mean square error of the other samples, mean included: the zero of the
output comes from the training samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.recordings.recording import Campaign, Recording
from phnn.setup import Setup
from phnn.simulate import simulate

Array = NDArray[np.float64]

# Samples of a test that give the initial state and are not scored: stated by the benchmark.
UNSCORED = 50
# A band-limited input is simulated a little beyond the samples that give the initial state.
_BEYOND = 50
# Gauss–Newton steps for the initial state: the output is nearly linear in it.
_STEPS = 4


def official_errors(setup: Setup, substeps: int, campaign: Campaign) -> dict[str, float]:
    """Root mean square errors [V] of a model on the tests of the benchmark, by name.

    Args:
        setup: the model; substeps: its sub-steps a sample interval.
        campaign: the training samples, for identification, and the tests, for confirmation.
    """
    training = next(r for r in campaign.recordings if r.mask("identification").any())
    # How it begins is forgotten after a thousandth of the training samples.
    zero = float(np.mean((training.y - simulate(setup, training, substeps).y)[UNSCORED:]))
    return {r.name: _error(setup, substeps, r, zero) for r in campaign.recordings if r is not training}


def _error(setup: Setup, substeps: int, test: Recording, zero: float) -> float:
    begun = initial_state(setup, substeps, test, zero)
    left = test.y - zero - simulate(setup, test, substeps, initial=begun).y
    return float(np.sqrt(np.mean(left[UNSCORED:] ** 2)))


def initial_state(setup: Setup, substeps: int, test: Recording, zero: float) -> Array:
    """The initial state (N,) that fits the unscored samples of a test best, the model and its zero [V] held."""
    head = test.only(slice(UNSCORED + _BEYOND))
    state = simulate(setup, head, substeps).states[0].copy()
    for _ in range(_STEPS):
        found = simulate(setup, head, substeps, initial=state)
        columns = output_derivatives(found, (), tuple(range(state.size)))[:UNSCORED]
        size = np.linalg.norm(columns, axis=0)
        # A state that the output does not depend on stays where it is.
        scale = np.where(size > 0.0, 1.0 / np.maximum(size, np.finfo(float).tiny), 0.0)
        left = (head.y - zero - found.y)[:UNSCORED]
        state = state + scale * np.linalg.lstsq(columns * scale, left, rcond=None)[0]
    return np.asarray(state)
