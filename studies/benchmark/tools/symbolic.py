"""Symbolic regression of the residual force as a tool.

gplearn evolves formulas of the base model's signals (Koza 1992, Genetic Programming; Schmidt & Lipson 2009, Science
324). PySR (Cranmer 2023) would be the stronger engine, but it needs the Julia runtime, which is no Python package: it
is not compared here. Formulas are of displacement, velocity, voltage, its rate, the hysterons' voltages, time, and the
displacement relaxed over three time constants, all over their deviations: a formula can make a memory of those only.

The fitness of a formula is the share of the residual, over its noise, that the response of the plant to it explains
beside the base's own parameters, less a price for its length. The plant is the time-invariant one nearest to the
linearised base (`studies.benchmark.residual_force.plant`), for thousands of formulas have to pass it. To compare
responses is to compare forces weighted by ``|G|²`` over the power of the noise, without an inverse filter.

A formula that has evolved is named by its response, not its letters, which are rarely the simplest ones: it is compared
with the table of terms. Three populations of different seeds give frequencies. The signals are those of every recording
for identification, thinned where they are sampled far above all that is excited.

Settings were tuned on twelve cases of the benchmark with seed 902 under a budget of 30 s: 250 formulas for 12
generations; the price of a node is a thousandth of the residual.
"""

from __future__ import annotations

import contextlib
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.benchmark.answer import Answer
from studies.benchmark.residual_force.compressed import compressed
from studies.benchmark.residual_force.evidence import Evidence, evidence_of
from studies.benchmark.residual_force.matching import named, shares
from studies.benchmark.residual_force.naming import EXPLAINED, Weighed, answer_of
from studies.benchmark.residual_force.plant import plant_of
from studies.benchmark.residual_force.prediction import alone, forced
from studies.benchmark.residual_force.signals import relaxed
from studies.benchmark.residual_force.states import States
from studies.benchmark.residual_force.terms import Action
from studies.benchmark.tools.common import base_of
from studies.rivals import needed

Array = NDArray[np.float64]

# Populations, formulas in each, generations, price of a node as a share of the residual.
_POPULATIONS, _FORMULAS, _GENERATIONS, _PRICE = 3, 250, 12, 1e-3
# Samples of all recordings together, at most, that formulas see; slope of the function that stands for a sign.
_SAMPLES, _STEEP = 6000, 50.0
# Time constants of relaxed displacements [s]; gain in χ² on left-out blocks that chance may bring; share of the best
# gain that other formulas need to count; residual over noise, squared, that is no noise whatever explains it.
_TAUS, _CHANCE, _NEARLY, _NO_NOISE = (0.003, 0.03, 0.3), 30.0, 0.8, 1.5
_NAMES = ("q", "v", "u", "du", "e", "t", *(f"q_{tau:g}" for tau in _TAUS))


def answer(folder: Path, seed: int) -> Answer:
    """Evolve formulas, name the force of the best by the table, and predict with it."""
    needed("gplearn")
    base = base_of(folder, seed)
    evidence = evidence_of(base.fit)
    formulas = evolved(evidence, seed)
    responses = [evidence.seen([[Action(force=f(s)[0])] for s in evidence.states])[:, 0] for f in formulas]
    gains = [_gain(evidence, response) for response in responses]
    best = int(np.argmax(gains))
    significant = gains[best] > _CHANCE
    near = [r for r, gain in zip(responses, gains, strict=True) if gain >= _NEARLY * gains[best]]
    found = weighed(evidence, responses[best] if significant else None, near)
    model = alone(base.fit)
    # A formula that leaves most of the residual is no law to predict by.
    if significant and gains[best] >= EXPLAINED * _excess(evidence):
        size = _coefficient(evidence, responses[best])
        model = forced(base.fit, lambda s: (size * formulas[best](s)[0], np.zeros(s.q.size)))
    return answer_of(found, model, folder)


@dataclass(frozen=True)
class Formula:
    """A formula that has evolved.

    Attributes:
        text: in gplearn's notation; program: a function of (N, D) signals; deviations: (D,) by which they are divided.
    """

    text: str
    program: Callable[[Array], Array]
    deviations: Array

    def __call__(self, s: States) -> tuple[Array, Array]:
        """(N,) force up to a factor, and no change of the output."""
        with np.errstate(all="ignore"):
            values = np.asarray(self.program(_signals(s) / self.deviations), dtype=np.float64)
        return np.nan_to_num(values, posinf=0.0, neginf=0.0) * np.ones(s.q.size), np.zeros(s.q.size)


def _signals(s: States) -> Array:
    """(N, D) signals of which formulas are made."""
    slow = [relaxed(s.q, s.dt, tau) for tau in _TAUS]
    return np.column_stack([s.q, s.v, s.u, s.du, s.e.sum(axis=1), s.t, *slow])


def evolved(evidence: Evidence, seed: int) -> list[Formula]:
    """The fittest formula of every population."""
    genetic, fitness = needed("gplearn.genetic"), needed("gplearn.fitness")
    signals = [_signals(s) for s in evidence.states]
    deviations = np.concatenate(signals).std(axis=0)
    deviations = np.where(deviations > 0.0, deviations, 1.0)
    filtered = _Filtered.of(evidence)
    rows = np.concatenate([x[s.lead :][:: filtered.step] for x, s in zip(signals, evidence.states, strict=True)])
    metric = fitness.make_fitness(
        function=lambda y, force, weight: filtered.left(force),
        greater_is_better=False,
        wrap=False,
    )
    found = []
    for population in range(_POPULATIONS):
        regressor = genetic.SymbolicRegressor(
            population_size=_FORMULAS, generations=_GENERATIONS, tournament_size=10, metric=metric,
            function_set=("add", "sub", "mul", "abs", "max", "min", _sign()), const_range=(-2.0, 2.0),
            init_depth=(1, 4), parsimony_coefficient=_PRICE, p_crossover=0.65, p_subtree_mutation=0.1,
            p_hoist_mutation=0.1, p_point_mutation=0.1, feature_names=_NAMES, random_state=seed + population,
        )  # fmt: skip
        with warnings.catch_warnings(), np.errstate(all="ignore"), contextlib.suppress(ZeroDivisionError):
            warnings.simplefilter("ignore")
            regressor.fit(rows / deviations, np.zeros(rows.shape[0]))
        program: Any = regressor._program
        found.append(Formula(str(program), program.execute, deviations))
    return found


def _steep(x: Array) -> Array:
    """A sign without a jump."""
    return np.tanh(_STEEP * x)


def _sign() -> Any:
    """The function of gplearn that makes dry friction."""
    return needed("gplearn.functions").make_function(function=_steep, name="sign", arity=1, wrap=False)


@dataclass(frozen=True)
class _Filtered:
    """What a metric needs to see a force through the plant.

    Attributes:
        step: every so many samples are taken; slices: rows of the recordings among them; kept: (n,) one in the rows for
            identification, zero elsewhere; gains: response of the plant over the noise at the frequencies of each;
            basis: (n, J) orthonormal, of what the base takes up; target: (n,) residual without that.
    """

    step: int
    slices: tuple[slice, ...]
    kept: Array
    gains: tuple[NDArray[np.complex128], ...]
    basis: Array
    target: Array

    @classmethod
    def of(cls, evidence: Evidence) -> _Filtered:
        """Thin the samples of all recordings by one whole number."""
        linearised = evidence.linearised
        step = max(1, -(-linearised.fit.residual.size // _SAMPLES))
        slices, gains, rows, begun = [], [], [], 0
        for recording, own, trajectory in zip(
            linearised.plan.recordings, linearised.slices, linearised.trajectories, strict=True
        ):
            inside = np.flatnonzero(recording.mask("identification")[::step])
            size = recording.t[::step].size
            frequency = np.asarray(np.fft.rfftfreq(2 * size, step * recording.dt), dtype=np.float64)
            gains.append(plant_of(trajectory).response(frequency) / recording.noise)
            slices.append(slice(begun, begun + size))
            begun += size
            position = np.cumsum(recording.mask("identification")) - 1 + own.start
            rows.append((inside, position[::step][inside], size))
        base, target = np.zeros((begun, evidence.base.shape[1])), np.zeros(begun)
        for part, (inside, taken, _) in zip(slices, rows, strict=True):
            base[part.start + inside] = -linearised.fit.jacobian[taken]
            target[part.start + inside] = linearised.fit.residual[taken]
        kept = np.concatenate([np.isin(np.arange(size), inside) for inside, _, size in rows])
        number = np.repeat(np.arange(len(slices)), [p.stop - p.start for p in slices])
        zeros = kept[:, None] * (number[:, None] == np.arange(len(slices)))
        basis = np.linalg.qr(np.column_stack([base, zeros]))[0]
        return cls(
            step, tuple(slices), kept.astype(float), tuple(gains), basis, target - basis @ (basis.T @ target)
        )  # fmt: skip

    def left(self, force: Array) -> float:
        """Share of the residual that the plant's response to a force (n,) does not explain; 1 for no force."""
        # gplearn tries a metric on two samples.
        if force.size != self.target.size or not np.isfinite(force).all():
            return 1.0
        response = np.empty(force.size)
        for part, gain in zip(self.slices, self.gains, strict=True):
            own = force[part]
            # Before its first sample a force is what it is there.
            longer = np.concatenate([np.full(own.size, own[0]), own])
            response[part] = np.fft.irfft(gain * np.fft.rfft(longer), longer.size)[own.size :]
        response *= self.kept
        before = float(response @ response)
        response = response - self.basis @ (self.basis.T @ response)
        size = float(response @ response)
        if not size > 1e-10 * before:
            return 1.0
        return 1.0 - float(response @ self.target) ** 2 / (size * float(self.target @ self.target))


def _coefficient(evidence: Evidence, response: Array) -> float:
    """The factor of a formula that fits the recordings best beside the base's parameters."""
    columns = np.column_stack([evidence.base, response])
    return float(np.linalg.lstsq(columns, evidence.target, rcond=1e-12)[0][-1])


def _excess(evidence: Evidence) -> float:
    """Sum of squares that the base leaves beyond the noise."""
    basis = np.linalg.qr(evidence.base)[0]
    left = evidence.target - basis @ (basis.T @ evidence.target)
    return float(left @ left) - left.size


def _gain(evidence: Evidence, response: Array) -> float:
    """Gain in χ² on left-out blocks."""
    if not np.any(response):
        return 0.0
    small = compressed(evidence, (response / np.linalg.norm(response))[:, None])
    return float(np.sum(small.validated(np.zeros(0, dtype=int)) - small.validated(np.array([0]))))


def weighed(evidence: Evidence, best: Array | None, near: list[Array]) -> Weighed:
    """Effects whose terms respond as formulas do; the best one counts a half, those nearly as good the other half.

    Args:
        best: (n,) response to the best formula, None where it gains no more than chance; near: to those nearly as good.
    """
    basis = np.linalg.qr(evidence.base)[0]

    def project(x: Array) -> Array:
        return np.asarray(x - basis @ (basis.T @ x))

    target, excess = project(evidence.target), _excess(evidence)
    if best is None:
        strange = float(target @ target) > _NO_NOISE * target.size
        return Weighed(strange, {}, 0.0)
    columns, effects = project(evidence.columns), tuple(t.effect for t in evidence.terms)

    def resembled(response: Array) -> tuple[frozenset[str], float]:
        inner = project(response)
        return named(shares(columns, inner, effects, float(inner @ inner)))

    chosen, share = resembled(best)
    found = Counter(name for response in near for name in resembled(response)[0])
    frequencies = {n: 0.5 * (n in chosen) + 0.5 * found[n] / len(near) for n in found}
    response = project(best)
    gained = float(response @ target) ** 2 / float(response @ response) / max(excess, 1e-9)
    # Either the formula leaves most of the residual, or no one or two terms resemble it.
    return Weighed(True, frequencies, min(1.0, gained, EXPLAINED * share))
