"""Augmentation of the base model's linear fractional representation, with a group lasso over places, as a tool.

After Györök, Drenth, Verhoek, Péni, Schoukens & Tóth (2026, arXiv 2604.11421) and Hoekstra et al. (2024, arXiv
2404.01901): a first-principles model and learned blocks are joined in one linear fractional representation, and a
group lasso (as Bemporad 2025, IEEE Trans. Autom. Control) removes the blocks that the data do not need. Here a block
stands at each place of the actuator (`blocks`); base parameters move freely beside them and are not penalised.

The authors train all by simulation. This tool selects places to first order about the identified base model, in which
the problem is convex: the blocks are linear in their coefficients, and the output responds to each by the base model's
sensitivities. Where something strong is missing that first order is rough; so phnn's learned elements at the best three
places are trained by simulation beside, and one that predicts more takes the place and the predictions. There is no
algebraic loop, since no block acts on its own input at once.

The paper recovers a structure and no names. Names are read from the channel that alone predicts held-out stretches
best at the first place, by `NAMES`. Settings were chosen on cases of a benchmark of seed 903 that was written for that
purpose.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.diagnosis.linearised_fit import LinearisedFit
from phnn.errors import PhnnError
from phnn.model import Model
from phnn.recordings import read
from phnn.simulate import simulate
from studies.benchmark.answer import Answer
from studies.benchmark.tools.blocks import Blocks, Channel, blocks, raw_responses
from studies.benchmark.tools.common import base_of, predictions
from studies.benchmark.tools.group_lasso import orthonormal, path
from studies.benchmark.tools.regimes import evaluated, whole
from studies.benchmark.tools.trained import trained

Array = NDArray[np.float64]

# What a channel is called in the catalogue.
NAMES: dict[Channel, str] = {
    ("amplifier", "lag"): "amplifier_lowpass",
    ("amplifier", "limit"): "amplifier_saturation",
    ("amplifier", "slew"): "slew_limit",
    ("amplifier", "offset"): "amplifier_offset",
    ("coupling", "square of the voltage"): "electrostriction",
    ("coupling", "voltage times displacement"): "displacement_coupling",
    ("coupling", "past voltage"): "depolarisation",
    ("mechanical", "even spring"): "quadratic_stiffness",
    ("mechanical", "odd spring"): "cubic_stiffness",
    ("mechanical", "stop"): "contact_stop",
    ("mechanical", "drag"): "quadratic_drag",
    ("mechanical", "friction"): "coulomb_friction",
    ("mechanical", "memory"): "creep",
    ("mechanical", "mode"): "second_mode",
    ("mechanical", "load"): "constant_load",
    ("hysteron", "play"): "extra_hysteron",
    ("hysteron", "by displacement"): "hysteresis_asymmetry",
    ("hysteron", "by rate"): "rate_dependent_threshold",
    ("electrical", "leakage"): "charge_leakage",
    ("thermal", "warmth"): "self_heating",
    ("sensor", "curve"): "sensor_nonlinearity",
    ("sensor", "lag"): "sensor_lag",
    ("sensor", "play"): "output_backlash",
    ("sensor", "drift"): "sensor_drift",
}
# Stretches of each recording that take turns to be left out; weight that keeps normal matrices regular.
_STRETCHES, _RIDGE = 10, 1e-6
# Share of what is left out that has to be predicted, or else nothing is missing; share of the best prediction that the
# chosen places have to reach.
_WORTH, _ENOUGH = 0.05, 0.95
# Share of the energy above the noise that the blocks have to predict for a name to be claimed.
_UNDERSTOOD = 0.6
# Probability that nothing is missing, or that it is; that it is not listed where blocks do not understand it, and
# where they do. Gains of channels are compared by their power of this exponent.
_NONE, _FOUND, _UNLISTED, _REST = 0.85, 0.95, 0.6, 0.1
_SHARP = 12.0
_PLACES = 3


@dataclass(frozen=True)
class Evidence:
    """Sums of squares left out, by what may explain them.

    Attributes:
        alone: with the base model; joint: with the blocks of the chosen places; size: samples.
        places: the chosen ones, the best one first; further: those that enter later along the path.
        channels: what each channel of the chosen places leaves alone.
    """

    alone: float
    joint: float
    size: int
    places: tuple[str, ...]
    further: tuple[str, ...]
    channels: dict[Channel, float]

    @property
    def missing(self) -> bool:
        """Whether the blocks predict more than could be chance."""
        return bool(self.places) and self.joint < (1.0 - _WORTH) * self.alone

    @property
    def ranked(self) -> tuple[str, ...]:
        """All places, the best one first."""
        return (*self.places, *self.further)

    def with_first(self, place: str, share: float, found: Blocks, folds: Folds) -> Evidence:
        """The evidence where a block that was trained by simulation leaves less: its place alone is chosen."""
        rest = tuple(name for name in self.ranked if name != place)
        channels = {c: folds.left(found.of_channel(c)) for c in dict.fromkeys(found.channels) if c[0] == place}
        return Evidence(self.alone, share * self.alone, self.size, (place,), rest, channels)


class Folds:
    """Left-out predictions of linear models on stretches that take turns, from products over each half."""

    def __init__(self, linearised: LinearisedFit, found: Blocks) -> None:
        base, r = linearised.fit.jacobian, linearised.fit.residual
        joined = np.hstack([base, found.columns])
        self.sizes = np.maximum(np.linalg.norm(joined, axis=0), 1e-300)
        joined = joined / self.sizes
        halves = _halves(linearised)
        self.base, self.size = base.shape[1], r.size
        self._grams = [joined[h].T @ joined[h] for h in halves]
        self._rights = [joined[h].T @ r[h] for h in halves]
        self._squares = [float(r[h] @ r[h]) for h in halves]

    def left(self, columns: Sequence[int]) -> float:
        """Sum of squares that the base model and some columns, fitted on either half, leave on the other."""
        total = 0.0
        for here, there in ((0, 1), (1, 0)):
            beta, use = self._solved(self._grams[here], self._rights[here], columns)
            gram, right = self._grams[there][np.ix_(use, use)], self._rights[there][use]
            total += self._squares[there] - float(2.0 * beta @ right - beta @ gram @ beta)
        return total

    def fitted(self, columns: Sequence[int]) -> tuple[Array, Array]:
        """Coefficients of base parameters and of some columns, fitted to all samples."""
        beta, use = self._solved(self._grams[0] + self._grams[1], self._rights[0] + self._rights[1], columns)
        found = beta / self.sizes[use]
        return found[: self.base], found[self.base :]

    def _solved(self, gram: Array, right: Array, columns: Sequence[int]) -> tuple[Array, NDArray[np.int64]]:
        use = np.concatenate([np.arange(self.base), self.base + np.asarray(columns, dtype=np.int64)])
        ridge = np.where(np.arange(use.size) < self.base, 1e-9, _RIDGE)
        return np.linalg.solve(gram[np.ix_(use, use)] + np.diag(ridge), right[use]), use


def answer(folder: Path, seed: int) -> Answer:
    """Augment the base model at every place, keep what the group lasso keeps, and read a name from it."""
    base = base_of(folder, seed)
    linearised = evaluated(base.fit, whole(base.fit.plan))
    found = blocks(linearised)
    folds = Folds(linearised, found)
    evidence = weighed(linearised, found, folds)
    predicted = dict(predictions(base.model, folder))
    if not evidence.missing:
        return read_off(evidence, predicted)
    best = trained(base.fit, linearised.plan, evidence.ranked[:_PLACES])[:1]
    predicted = _augmented(linearised, found, folds, evidence.places, folder, predicted)
    if best and best[0].share < evidence.joint / evidence.alone and best[0].effect is not None:
        one = best[0].fit
        predicted = dict(predictions(Model(one.setup, one.plan.finest), folder))
        evidence = evidence.with_first(best[0].effect.location, best[0].share, found, folds)
    return read_off(evidence, predicted)


def weighed(linearised: LinearisedFit, found: Blocks, folds: Folds) -> Evidence:
    """The fewest places along the path of the group lasso whose blocks predict nearly as well as the best do."""
    names = list(dict.fromkeys(place for place, _ in found.channels))
    projected = linearised.project(found.columns)
    bases = [orthonormal(projected[:, found.of([name])]) for name in names]
    steps = path(linearised.residual, bases)
    # A single place is tried in any case: the penalty favours places with few functions.
    tried = {frozenset(names[i] for i in step.active) for step in steps} | {frozenset([name]) for name in names}
    left = {places: folds.left(found.of(places)) for places in tried}
    alone, best = folds.left([]), min(left.values())
    enough = alone - _ENOUGH * max(alone - best, 0.0)
    chosen = min((p for p in tried if left[p] <= enough), key=lambda p: (len(p), left[p]))
    singly = {name: folds.left(found.of([name])) for name in chosen}
    ordered = tuple(sorted(chosen, key=lambda name: singly[name]))
    # What stays only until the penalty falls is named last.
    entered = dict.fromkeys(names[i] for step in steps for i in step.active)
    rest = tuple(name for name in entered if name not in ordered)
    channels = {c: folds.left(found.of_channel(c)) for c in dict.fromkeys(found.channels) if c[0] in chosen}
    return Evidence(alone, left[chosen], folds.size, ordered, rest, channels)


def read_off(evidence: Evidence, predicted: dict[str, Array]) -> Answer:
    """The answer that blocks give: names by `NAMES`."""
    gain, places = evidence.alone - evidence.joint, evidence.ranked[:_PLACES]
    if not evidence.missing:
        return Answer({}, none=_NONE, places=places, predictions=predicted)
    gains = {c: max(evidence.alone - left, 0.0) / gain for c, left in evidence.channels.items()}
    total = sum(g**_SHARP for g in gains.values())
    understood = gain >= _UNDERSTOOD * max(evidence.alone - evidence.size, 1e-300)
    unlisted = _REST if understood else _UNLISTED
    listed = _FOUND - unlisted
    names: dict[str, float] = {}
    for channel, g in gains.items():
        name = NAMES[channel]
        names[name] = names.get(name, 0.0) + (listed * g**_SHARP / total if total > 0.0 else 0.0)
    return Answer(names, 1.0 - _FOUND, unlisted, places, predicted)


def _halves(linearised: LinearisedFit) -> list[NDArray[np.bool_]]:
    """(N,) which rows belong to the even and to the odd stretches of their recordings."""
    odd = np.zeros(linearised.fit.residual.size, dtype=bool)
    for rows in linearised.slices:
        edges = np.linspace(rows.start, rows.stop, _STRETCHES + 1).astype(int)
        for i, (a, b) in enumerate(itertools.pairwise(edges)):
            odd[a:b] = i % 2 == 1
    return [~odd, odd]


def _augmented(
    linearised: LinearisedFit, found: Blocks, folds: Folds, places: Sequence[str], folder: Path, base: dict[str, Array]
) -> dict[str, Array]:  # fmt: skip
    """Predictions with the chosen blocks, to first order; those of the base model where they cannot be had."""
    fitted, plan = linearised.fit, linearised.plan
    chosen = found.of(places)
    step, beta = folds.fitted(chosen)
    names = fitted.variables.names
    slopes = [fitted.setup.parameters[n].slope(fitted.setup.parameters[n].value) for n in names]
    predicted = {}
    for recording in read(folder / "exam", need_output=False).recordings:
        try:
            trajectory = simulate(fitted.setup, recording, plan.finest)
            columns, _ = raw_responses(trajectory, linearised.scales)
            moved = output_derivatives(trajectory, names) * slopes
        except PhnnError:
            return base
        # The Jacobian is that of the residual: its coefficients are steps of the parameters with the other sign.
        predicted[recording.name] = trajectory.y - moved @ step[: len(names)] + columns[:, chosen] @ beta
    return predicted
