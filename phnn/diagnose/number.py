"""The number of a model: how probable it is among all models that a search has fitted.

Over all recordings ``r`` that were fitted, with χ²_r on n_r samples,

    log w(M) = −½ Σ_r w_r χ²_r / n_r − Σ_e (½ k_e log Σ_r w_r + c_e),        w_r = n_r / (1 + n_r ρ_r)

No model is exact. A model that is true up to a relative misfit ρ of the noise power cannot be told from the truth by
more than 1/ρ samples, however many there are: the coarsened likelihood of Miller & Dunson (2019, J. Am. Stat. Assoc.
114), recording by recording. ρ_r is half of what even the best model leaves there beyond the noise, and at least half
the square of what is material. ``k_e`` counts the free parameters of an element, and the terms that each recording has
of its own by it; the price ``½ k log n`` is Schwarz's (1978), ``c_e`` the odds of one element among the catalogue.

A model that is far from all recordings makes nothing certain, because ρ is large then. The probability of an effect is
the share of all models that hold it, in any form and at any place.

Held-out recordings are no part of the number. They help to choose the model that is written (`best_to_write`), which
never predicts them worse than the base model, and an element with which their error does not fall has no name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import Criteria
from phnn.effects import Effect
from phnn.identification.fit import Fit

Array = NDArray[np.float64]

Key = frozenset[str]


class Misfit(NamedTuple):
    """What a model leaves of one recording: the weighted sum of squares, and its number of samples."""

    chi2: float
    samples: int


@dataclass(frozen=True, eq=False)
class Visited:
    """A model that a search has fitted.

    Attributes:
        elements: what it has beyond the base model, in the order in which it was added.
        fit: to the identification recordings.
        fitted, held_out: its misfit, by recording.
        nuisances: number of terms that its elements give each fitted recording of its own, over all of them.
        converged: the fit was carried to its end, with the sub-steps of the search.
    """

    elements: tuple[Effect, ...]
    fit: Fit
    fitted: Mapping[str, Misfit]
    held_out: Mapping[str, Misfit]
    nuisances: int = 0
    converged: bool = False

    @property
    def key(self) -> Key:
        """Its elements, in any order."""
        return key_of(self.elements)

    @property
    def families(self) -> tuple[str, ...]:
        """Return what its elements are called, each once, in order of the alphabet."""
        return tuple(sorted({family(e) for e in self.elements}))

    @property
    def words(self) -> str:
        """Its elements for a line of progress."""
        return " + ".join(e.name.replace("_", " ") for e in self.elements) or "base model"

    @property
    def left(self) -> float:
        """Return the mean square of the residual over that of the noise, on the fitted recordings."""
        return mean_square(self.fitted.values())

    @property
    def left_held_out(self) -> float:
        """Return the same on held-out recordings; NaN where there are none."""
        return mean_square(self.held_out.values())

    @property
    def left_most(self) -> float:
        """Return the larger one of both."""
        return max(self.left, self.left_held_out if self.held_out else 0.0)

    def parameters_of(self, element: Effect) -> int:
        """Return how many free parameters an element has in this model."""
        parameters = self.fit.setup.parameters
        return sum(n in parameters and not parameters[n].fixed for n in element.parameters)


def mean_square(misfits: Iterable[Misfit]) -> float:
    """Return the weighted sum of squares over the number of samples; NaN without samples."""
    each = list(misfits)
    samples = sum(m.samples for m in each)
    return sum(m.chi2 for m in each) / samples if samples else float("nan")


def over(misfits: Mapping[str, Misfit], noise: Mapping[str, float]) -> dict[str, Misfit]:
    """Return misfits in units of another power of the noise, by recording, 1 where one has none."""
    return {n: Misfit(m.chi2 / noise.get(n, 1.0), m.samples) for n, m in misfits.items()}


def best_of_each(ranked: Sequence[Visited]) -> list[Visited]:
    """Return the first model of each set of effects, whatever their forms and places, in the order that is given."""
    first = {m.families: m for m in reversed(ranked)}
    return [m for m in ranked if first[m.families] is m]


def key_of(elements: Iterable[Effect]) -> Key:
    """Return a key of some elements; two forms of an effect have different ones."""
    return frozenset(uid(e) for e in elements)


def uid(effect: Effect) -> str:
    """Return a name of an effect that tells its forms apart, by their laws."""
    return f"{effect.name}: {effect.equation}"


def family(effect: Effect) -> str:
    """Return the name under which all forms, places and copies of an effect count together."""
    return effect.several_of or effect.canonical


def is_learned(effect: Effect) -> bool:
    """Return whether an element is learned and stands for no effect of the catalogue."""
    return effect.name.startswith("learned_") and not effect.several_of


def tolerated(models: Sequence[Visited], criteria: Criteria) -> dict[str, float]:
    """Return ρ by recording: half of what the best model leaves beyond the noise, and at least the floor."""
    floor = _floor(criteria)
    best = max(models, key=lambda m: log_weight(m, {}, criteria))
    return {r: max(floor, 0.5 * (m.chi2 / m.samples - criteria.slack)) for r, m in best.fitted.items()}


def log_weight(
    model: Visited, rho: Mapping[str, float], criteria: Criteria, noise: Mapping[str, float] | None = None
) -> float:
    """Return log w of a model, up to a constant.

    Args:
        rho: by recording; the floor where one has none.
        noise: power of the noise by recording, over that which was stated; 1 where one has none.
    """
    counts = {r: _count(m, rho.get(r, _floor(criteria))) for r, m in model.fitted.items()}
    likelihood = sum(counts[r] * m.chi2 / m.samples / (noise or {}).get(r, 1.0) for r, m in model.fitted.items())
    return -0.5 * likelihood - _price(model, sum(counts.values()), criteria)


def _floor(criteria: Criteria) -> float:
    return 0.5 * criteria.material**2


def _count(misfit: Misfit, rho: float) -> float:
    """Return the samples for which a recording counts."""
    return misfit.samples / (1.0 + misfit.samples * rho)


def _price(model: Visited, count: float, criteria: Criteria) -> float:
    """Of the elements of a model, and of their free parameters, in nats."""
    free = sum(model.parameters_of(e) for e in model.elements) + model.nuisances
    learned = sum(is_learned(e) for e in model.elements)
    priced = learned * criteria.price_learned + (len(model.elements) - learned) * criteria.price_effect
    return 0.5 * float(np.log(max(count, 2.0))) * free + priced


@dataclass(frozen=True)
class Weighed:
    """All visited models with their numbers.

    Attributes:
        models: most probable first; logs: (M,) their log weights.
    """

    models: tuple[Visited, ...]
    logs: Array

    @property
    def best(self) -> Visited:
        """Return the most probable model."""
        return self.models[0]

    @cached_property
    def shares(self) -> Array:
        """Return (M,) probabilities of the models."""
        odds = np.exp(self.logs - self.logs[0])
        return np.asarray(odds / odds.sum())

    @cached_property
    def probability(self) -> dict[str, float]:
        """Return the probability of every family that some model holds, and of ``none``; the largest first."""
        total: dict[str, float] = {"none": 0.0}
        for model, share in zip(self.models, self.shares, strict=True):
            for name in model.families or ("none",):
                total[name] = min(1.0, total.get(name, 0.0) + float(share))
        return dict(sorted(total.items(), key=lambda item: -item[1]))

    @cached_property
    def alternatives(self) -> list[tuple[tuple[str, ...], float]]:
        """Return the sets of families with their probabilities, the largest first."""
        total: dict[tuple[str, ...], float] = {}
        for model, share in zip(self.models, self.shares, strict=True):
            total[model.families] = total.get(model.families, 0.0) + float(share)
        return sorted(total.items(), key=lambda item: -item[1])

    def behind(self, model: Visited) -> float:
        """By how many nats a model is behind the best one."""
        return float(self.logs[0] - self.logs[self.models.index(model)])


def weigh(models: Sequence[Visited], criteria: Criteria, exact: Visited | None = None) -> Weighed:
    """Return the models with their numbers.

    Args:
        exact: a model that leaves nothing but noise, as far as anything can tell. Where that is more than was stated,
            as it may be of a recording that repeats nothing, it is the noise, and no misfit is tolerated beyond it.
    """
    noise = {} if exact is None else {r: max(1.0, m.chi2 / m.samples / criteria.slack) for r, m in exact.fitted.items()}
    rho = {} if noise else tolerated(models, criteria)
    logs = np.array([log_weight(m, rho, criteria, noise) for m in models])
    order = np.argsort(-logs, kind="stable")
    return Weighed(tuple(models[i] for i in order), logs[order])


def best_to_write(models: Sequence[Visited], criteria: Criteria) -> Visited:
    """Return the model that predicts best for its size, among those whose held-out error is no larger than the base
    model's.

    Args:
        models: the base model among them.
    """
    base = next(m for m in models if not m.elements)
    most = base.left_held_out * (1.0 + criteria.material_share) ** 2
    able = [m for m in models if not m.left_held_out > most]
    return max(able, key=lambda m: forecast(m, criteria))


def forecast(model: Visited, criteria: Criteria) -> float:
    """Return how well a model predicts for its size: ``−½ Σ_r w_r log(χ²_r / n_r)`` less the price of its elements.

    The sum is over fitted and held-out recordings alike, with the floor of ρ. Near the noise that is log w, so that
    small real gains count; far from it a gain counts by its share of what is left, as with a variance that is not
    known.
    """
    each = [(_count(m, _floor(criteria)), m) for m in (*model.fitted.values(), *model.held_out.values())]
    likelihood = sum(n * np.log(max(m.chi2 / m.samples, 1e-300)) for n, m in each)
    return -0.5 * float(likelihood) - _price(model, sum(n for n, _ in each), criteria)
