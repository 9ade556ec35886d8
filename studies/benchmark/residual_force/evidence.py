"""The regression behind a residual force: what the base leaves, against the response to every candidate.

A force ``F`` changes the output of the linearised base by ``g ∗ F``. To compare ``g ∗ F`` with the residual over its
noise is to compare ``F`` with the residual force ``g⁻¹ ∗ r``, every frequency weighted by ``|G(ω)|²`` over the power of
the noise: the least-squares solution is the same, and no noise is amplified on the way (the integral form of
Schaeffer & McCalla 2017, Phys. Rev. E 96; the weak form of Messenger & Bortz 2021, J. Comput. Phys. 443). What the
base could take up itself, the span of its sensitivities, is estimated along with every regression.

The noise may have a colour that nobody has stated: rows are whitened by an autoregression of what the whole table of
candidates leaves, recording by recording (Cochrane & Orcutt 1949, J. Am. Stat. Assoc. 44).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from phnn.diagnosis.linearised_fit import LinearisedFit, scales_of
from phnn.identification.fit import Fit
from phnn.recordings.recording import Recording, dominant_frequency
from phnn.simulate import simulate
from studies.benchmark.residual_force import signals
from studies.benchmark.residual_force.lines import Lines
from studies.benchmark.residual_force.states import States, responses, states_of
from studies.benchmark.residual_force.terms import Action, Sizes, Term, table_of

Array = NDArray[np.float64]

# Order of the autoregression of the noise, and the least share of its variance that is not predictable; the residual
# over noise up to which what is left may be noise of another colour, and the least variance that noise is believed to
# have, both in units of the stated noise.
_ORDER, _LEAST, _NOISE, _BELIEVED = 4, 1e-3, 1.5, 0.25
# Blocks of time of a recording, at most, and the fewest samples of one.
_BLOCKS, _SAMPLES = 6, 250


@dataclass(frozen=True)
class Evidence:
    """Rows are the identification samples of all recordings, in units of the innovations of their noise.

    Attributes:
        linearised: the fit of the base, its trajectories among it.
        states: of every recording.
        terms: candidates; columns: (n, K) responses to them of unit length; lengths: (K,) of the responses before.
        base: (n, J) responses to the base's own parameters; target: (n,) residual.
        filters: (p+1,) whitening filter of each recording.
        blocks: rows of every block of time; recording_of: number of the recording of each block.
    """

    linearised: LinearisedFit
    states: tuple[States, ...]
    terms: tuple[Term, ...]
    columns: Array
    lengths: Array
    base: Array
    target: Array
    filters: tuple[Array, ...]
    blocks: tuple[slice, ...]
    recording_of: tuple[int, ...]

    def whitened(self, rows: Array) -> Array:
        """(n, …) rows in units of the stated noise, whitened."""
        out = np.empty_like(rows)
        for part, taps in zip(self.linearised.slices, self.filters, strict=True):
            out[part] = lfilter(taps, [1.0], rows[part], axis=0)
        return out

    def seen(self, actions: Sequence[Sequence[Action]]) -> Array:
        """(n, K) whitened responses to actions, by recording and candidate."""
        return self.whitened(responses_of(self.linearised, self.states, actions))


def evidence_of(fit: Fit) -> Evidence:
    """Simulate the base, and let every term of the table act on it.

    Responses are linear in a small quantity: a quarter of the fit's sub-steps serves them.
    """
    coarse = fit.plan.coarse()
    trajectories = tuple(coarse.each(lambda r: simulate(fit.setup, r, coarse.steps_of(r), initial=fit.initial(r.name))))
    linearised = LinearisedFit(fit, trajectories, scales_of(fit, trajectories))
    states = tuple(states_of(t) for t in trajectories)
    lines = Lines.found(linearised)
    terms = (*table_of(sizes_of(fit.plan.recordings, states)), *lines.terms)
    acted = [[term.action(s) for term in terms[: len(terms) - len(lines.terms)]] for s in states]
    columns = np.column_stack([responses_of(linearised, states, acted), lines.columns(linearised)])
    lengths = np.linalg.norm(linearised.project(columns), axis=0)
    # A term that nothing excites, or that the base can take up, is none.
    kept = np.flatnonzero(lengths > 1e-6 * np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    columns, terms = columns[:, kept], tuple(terms[k] for k in kept)
    raw = Evidence(
        linearised, states, terms, columns, np.ones(kept.size), -fit.jacobian, fit.residual, (),
        *_blocks(linearised),
    )  # fmt: skip
    filters = _filters(raw)
    white = replace(raw, filters=filters)
    columns = white.whitened(columns)
    lengths = np.linalg.norm(columns, axis=0)
    base, target = white.whitened(-fit.jacobian), white.whitened(fit.residual)
    return replace(white, columns=columns / lengths, lengths=lengths, base=base, target=target)


def responses_of(
    linearised: LinearisedFit, states: Sequence[States], actions: Sequence[Sequence[Action]]
) -> Array:  # fmt: skip
    """(n, K) responses in units of the stated noise, without the means of the recordings."""
    found = []
    for trajectory, s, each in zip(linearised.trajectories, states, actions, strict=True):
        forces = np.column_stack([force_of(s, action) for action in each])
        outputs = np.column_stack([_output(s, action) for action in each])
        found.append(responses(trajectory, forces) + outputs[s.lead :])
    return linearised.stack(found)


def force_of(s: States, action: Action) -> Array:
    """(N,) force on the mass [N]: its own, and that of hysterons through which a current flows."""
    total = np.zeros(s.q.size) if action.force is None else action.force
    if action.current is None:
        return total
    held = [
        signals.held_charge(action.current[:, i], np.abs(s.slips[:, i]), s.dt, s.capacitance[i], s.slope[i])
        for i in range(s.capacitance.size)
    ]
    return np.asarray(total - s.alpha * np.sum(held, axis=0)) if held else total


def _output(s: States, action: Action) -> Array:
    return np.zeros(s.q.size) if action.output is None else action.output


def sizes_of(recordings: Sequence[Recording], states: Sequence[States]) -> Sizes:
    """Sizes by which the table is graded."""
    frequencies = [f for r in recordings if (f := dominant_frequency(r)) > 0.0]
    largest = {n: max(float(np.abs(getattr(s, n)).max()) for s in states) for n in ("q", "v", "u", "du")}
    return Sizes(
        **largest, slowest=min(frequencies), fastest=max(frequencies),
        duration=max(float(r.t[-1]) for r in recordings), dt=min(r.dt for r in recordings),
        noise=float(np.median([r.noise for r in recordings])),
    )  # fmt: skip


def _blocks(linearised: LinearisedFit) -> tuple[tuple[slice, ...], tuple[int, ...]]:
    blocks, owners = [], []
    for number, rows in enumerate(linearised.slices):
        count = min(_BLOCKS, max(1, (rows.stop - rows.start) // _SAMPLES))
        edges = np.linspace(rows.start, rows.stop, count + 1).astype(int).tolist()
        blocks += [slice(a, b) for a, b in itertools.pairwise(edges)]
        owners += [number] * count
    return tuple(blocks), tuple(owners)


def _filters(raw: Evidence) -> tuple[Array, ...]:
    """Whitening filters of the noise, to innovations of unit size: of its stated colour; where base and all terms
    leave no more than noise together, of the colour that they leave."""
    everything = np.column_stack([raw.base, raw.columns / np.linalg.norm(raw.columns, axis=0)])
    left = raw.target - everything @ np.linalg.lstsq(everything, raw.target, rcond=1e-6)[0]
    found = []
    for rows, recording in zip(raw.linearised.slices, raw.linearised.plan.recordings, strict=True):
        stated = np.append(recording.noise_correlation, np.zeros(_ORDER + 1))[: _ORDER + 1]
        seen = correlation_of(left[rows])
        found.append(whitening_filter(seen if seen[0] < _NOISE**2 else stated))
    return tuple(found)


def correlation_of(x: Array) -> Array:
    """(p+1,) autocovariance of a signal of mean zero."""
    return np.array([float(x[: x.size - k] @ x[k:]) / x.size for k in range(_ORDER + 1)])


def whitening_filter(lags: Array) -> Array:
    """(p+1,) ``a/σ`` with ``Σ a_k x_{n−k}`` white of deviation ``σ``, by the Yule–Walker equations.

    Args:
        lags: (p+1,) autocovariance of ``x`` in units of the stated variance.
    """
    ahead = solve_toeplitz(lags[:-1], lags[1:])
    variance = max(lags[0] - float(ahead @ lags[1:]), _LEAST * lags[0])
    taps = np.append(1.0, -ahead)
    # Where the table explains noise as well, no less than a part of the stated noise is believed.
    return np.asarray(taps / np.sqrt(variance * max(1.0, _BELIEVED / lags[0])))
