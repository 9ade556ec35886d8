"""Pooled noise statistics of recordings by one sensor."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from phnn.signals.first_order import correlation_of, density
from phnn.signals.noise import SILENT, WHITE, NoiseFloor

# Fewest recordings whose spectra are pooled; how far their coefficients may lie from the median.
_FEWEST, _AGREES = 3, 0.12
# Factor within which deviations are of one size: a spectrum that ringing or a tail reaches gives many times the noise.
_ONE_SIZE = 1.5
# Level at which recordings of one kind are proven to differ in their noise.
DIFFERENT = 0.01


def pooled(floors: Sequence[NoiseFloor], kinds: Sequence[Hashable] | None = None) -> list[NoiseFloor]:
    """The floors of recordings, those seen in a part of the spectrum only brought to a common word.

    Args:
        kinds: of each recording; recordings of one kind are taken to share a sensor. All are of one kind if left out.
    """
    common = _of_one_word(floors)
    names = kinds if kinds is not None else [None] * len(common)
    groups: dict[Hashable, list[int]] = {}
    for i, (floor, name) in enumerate(zip(common, names, strict=True)):
        # Others keep what they were given: by repetition, by rest, or by agreement.
        if floor.interval is not None and floor.found and floor.coefficient is None:
            groups.setdefault(name, []).append(i)
    for group in groups.values():
        for i, floor in zip(group, _sharing([common[i] for i in group]), strict=True):
            common[i] = floor
    return common


def _sharing(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """The floors of one kind: one for those that are not proven different.

    One spectrum hardly tells coloured noise from what the signal leaves there. Where others of the kind do not agree on
    it the smaller floor stands, with an interval that holds both.
    """
    shared = alike([f.value for f in floors], [f.interval or (0.0, 0.0) for f in floors])
    if len(floors) == 1:
        return list(floors)
    if shared is None:
        return [f.smaller or f for f in floors]

    def of(k: int, floor: NoiseFloor) -> NoiseFloor:
        if k not in shared.members:
            return floor.smaller or floor
        source = f"{floor.source}, shared by {len(shared.members)} recordings that do not differ in it"
        return replace(floor, value=shared.value, source=source, interval=shared.interval, smaller=None)

    return [of(k, floor) for k, floor in enumerate(floors)]


class Shared(NamedTuple):
    """A deviation that some recordings share, its 95 % interval, and their numbers."""

    value: float
    interval: tuple[float, float]
    members: tuple[int, ...]


def alike(values: Sequence[float], intervals: Sequence[tuple[float, float]]) -> Shared | None:
    """The deviation that estimates share unless they are proven different; None where no two agree.

    Under equal deviations ``Q = Σ (ln σ_i − m)²/s_i²`` is χ² with one degree of freedom less than estimates, where
    ``s_i`` is a quarter of the width of ``ln`` of an interval and ``m`` the weighted mean. Where Q exceeds its quantile
    the estimate that lies farthest off leaves, and the others are asked again at the same level.
    """
    logs = np.log(np.maximum(values, 1e-300))
    bounds = np.log(np.maximum(np.asarray(intervals, dtype=float), 1e-300))
    errors = np.maximum((bounds[:, 1] - bounds[:, 0]) / (2.0 * norm.isf(0.025)), 1e-6)
    members = list(range(len(logs)))
    while len(members) > 1:
        weight = 1.0 / errors[members] ** 2
        mean = float(weight @ logs[members] / weight.sum())
        away = weight * (logs[members] - mean) ** 2
        if away.sum() <= chi2.isf(DIFFERENT, len(members) - 1):
            half = norm.isf(0.025) / np.sqrt(weight.sum())
            interval = float(np.exp(mean - half)), float(np.exp(mean + half))
            return Shared(float(np.exp(mean)), interval, tuple(members))
        del members[int(away.argmax())]
    return None


def _of_one_word(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """Floors seen in a part of the spectrum only, where several agree on white or on first-order noise.

    One spectrum hardly tells coloured noise from what the signal leaves there; several that agree do. Where at least
    half of them show first-order noise of about the same coefficient, all get their median; where few do, those get
    the median of the white ones. Only deviations of one size count. One that is larger, and not trusted (it has no
    interval), is what the signal leaves. A smaller one may come from the highest frequencies alone, taken as white:
    where the first-order noise of the others has about that deviation there, it is this noise. Any other keeps its own
    word.
    """
    every = [f for f in floors if f.coefficient is not None]
    size = float(np.median([f.value for f in every])) if every else 0.0
    partial = [f for f in every if size / _ONE_SIZE <= f.value <= size * _ONE_SIZE]
    coloured = [f for f in partial if f.coefficient]
    if len(partial) < _FEWEST or 2 * len(partial) < len(every):
        return list(floors)
    if 2 * len(coloured) >= len(partial):
        middle = float(np.median([f.coefficient or 0.0 for f in coloured]))
        agreeing = [f for f in coloured if abs((f.coefficient or 0.0) - middle) <= _AGREES]
        if 2 * len(agreeing) < len(partial):
            return list(floors)
        note, correlation = f"first-order noise of coefficient {middle:.2g}", correlation_of(middle)
        highest = float(np.sqrt(density(middle, np.array(-1.0))))
    else:
        agreeing = [f for f in partial if not f.coefficient]
        note, correlation, highest = "white noise", WHITE, 1.0
    value = float(np.median([f.value for f in agreeing]))
    source = f"the spectra of {len(agreeing)} recordings that agree on {note}"
    agreed = (*partial, *(f for f in every if _seen_at_the_highest(f, highest * value)))
    told = [f for f in every if f not in agreed and (f.value < size or f.interval is not None)]
    alone = {id(f) for f in (*told, *(agreeing if correlation is WHITE else ()))}
    common = NoiseFloor(value, source, correlation, 0.0)
    return [f if f.coefficient is None or id(f) in alone else common for f in floors]


def _seen_at_the_highest(floor: NoiseFloor, expected: float) -> bool:
    """Whether a floor from the highest frequencies, taken as white, has about the deviation that a noise has there."""
    as_white = not floor.coefficient and floor.interval is None and SILENT not in floor.source
    return as_white and expected / _ONE_SIZE <= floor.value <= expected * _ONE_SIZE
