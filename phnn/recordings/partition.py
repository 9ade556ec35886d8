"""The noise floor that recordings of one sensor share, and the split into identification and confirmation samples.

Confirmation interpolates and is used once.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from phnn.errors import InputRefused
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Part, Recording
from phnn.results import listed
from phnn.signals.first_order import correlation_of, density
from phnn.signals.noise import WHITE, NoiseFloor

_HELD_OUT_SHARE = 0.28  # of the recordings
_NUISANCE_SHARE, _NUISANCE_LEAST = 0.02, 50
# Share of its range that an input has to cover in the head of a recording whose initial state follows from that head.
_COVERED = 0.9
# Of a recording that starts nobody knows how, where its input has no swing after which a hysteresis has forgotten.
_UNKNOWN_SHARE = 0.2
_SAME = 0.05  # amplitudes and frequencies nearer than this are no new ones


@dataclass(frozen=True)
class Candidate:
    """What the choice needs to know of a recording."""

    name: str
    size: int
    dt: float
    excitation: Excitation
    use: str | None  # that the manifest demands
    begun: bool = False  # nobody knows in which state it starts
    # Its input covers too little of its range in its head to tell the initial state and the zero: thresholds that only
    # the rest of the range crosses have not been met.
    untold: bool = False

    @property
    def head(self) -> int:
        """Return the samples spent on zero and initial state where the recording is held out: at most half of them.

        From an unknown start it is a whole swing of the input, for by then a hysteresis has forgotten what was before.
        """
        least = max(_NUISANCE_LEAST, int(np.ceil(_NUISANCE_SHARE * self.size)))
        if self.begun:
            slowest = self.excitation.low_Hz
            swing = 1.0 / (slowest * self.dt) if slowest > 0.0 else _UNKNOWN_SHARE * self.size
            least = max(least, int(np.ceil(swing)))
        return min(least, self.size // 2)


def candidate_of(recording: Recording, excitation: Excitation, use: str | None = None) -> Candidate:
    """Return what the choice needs to know of a recording."""
    begun, u = recording.start.state == "unknown", recording.drive
    one = Candidate(recording.name, recording.t.size, recording.dt, excitation, use, begun)
    covered = np.ptp(u) > 0.0 and np.ptp(u[: one.head]) >= _COVERED * np.ptp(u)
    return replace(one, untold=bool(begun and not covered))


def divide(candidates: Sequence[Candidate]) -> tuple[Mapping[str, tuple[Part, ...]], bool, tuple[str, ...]]:
    """Return the parts of every recording by name, whether the held-out ones are new, and notes."""
    if all(c.use == "confirmation" for c in candidates):
        cause = "every recording has use: confirmation, nothing is left to identify from"
        remedy = "give at least one use: identification, or leave `use` out"
        raise InputRefused(f"recordings.yaml: {cause}: {remedy}")
    if len(candidates) == 1 and candidates[0].use is None:
        one = candidates[0]
        parts, note = split_one(one)
        return {one.name: parts}, False, (note,)
    stated = {c.use for c in candidates}
    if "confirmation" in stated or stated == {"identification"}:
        held = {c.name for c in candidates if c.use == "confirmation"}
        note = f"Held out for confirmation, as recordings.yaml says: {', '.join(sorted(held)) or 'nothing'}."
    else:
        held = choose(candidates)
        note = f"Held out for confirmation, chosen here: {', '.join(sorted(held))}."
        untold = [c.name for c in candidates if c.untold and c.name not in held]
        if untold:
            note += f" Not held out, because nobody knows how they start: {listed(untold)}; in the first samples, which"
            note += f" would tell state and zero, the input covers less than {_COVERED:.0%} of its range."
            note += " Say `start: rest`, or begin the slice earlier."
    parts_by_name = {c.name: whole_parts(c, c.name in held) for c in candidates}
    kept = [c for c in candidates if c.name not in held]
    # Whether some held-out recording differs from every other one in amplitude, frequency or kind.
    new = any(not any(_alike(c, k) for k in kept) for c in candidates if c.name in held)
    if held:
        note += f" They bring {'an' if new else 'no'} amplitude or frequency that identification lacks."
    else:
        note += " No result can be confirmed on recordings that were not used."
    return parts_by_name, new, (note,)


def whole_parts(one: Candidate, held_out: bool) -> tuple[Part, ...]:
    """Return the parts of a recording that serves one use; a held-out one spends its head on zero and initial state."""
    if not held_out:
        return (Part(one.name, 0, one.size, "identification"),)
    return (Part(f"{one.name}[start]", 0, one.head, "nuisance"), Part(one.name, one.head, one.size, "confirmation"))


def split_one(one: Candidate) -> tuple[tuple[Part, ...], str]:
    """Return two parts of a single recording with a gap, whole periods where it has four or more, and a note."""
    first, last = one.excitation.span
    period = (one.excitation.period or 0.0) / one.dt  # samples
    cycles = int((last - first) * 1.0001 / period) if period else 0
    if cycles >= 4:
        confirm, gap = max(1, round(0.35 * cycles)), max(1, round(0.05 * cycles))
        begin = first + round((cycles - confirm) * period)
        until = first + round((cycles - confirm - gap) * period)
        end = min(one.size, first + round(cycles * period))
        gap_words = f"{gap} period{'s' if gap > 1 else ''}"
    else:
        until, begin, end = round(0.60 * one.size), round(0.65 * one.size), one.size
        gap_words = f"{(begin - until) * one.dt:.3g} s"
    parts = (
        Part(f"{one.name}[identification]", 0, until, "identification"),
        Part(f"{one.name}[confirmation]", begin, end, "confirmation"),
    )
    note = (
        f"There is one recording only: its samples up to {until * one.dt:.4g} s identify, those from "
        f"{begin * one.dt:.4g} s to {end * one.dt:.4g} s confirm, {gap_words} between them left out. "
        f"They bring no new amplitude or frequency, which limits what can be concluded."
    )
    return parts, note


def choose(candidates: Sequence[Candidate]) -> set[str]:
    """Return the names of the recordings to hold out: about a quarter, inside the span of the rest, spread over it.

    Kept for identification where possible: the extremes of frequency and of amplitude, the largest one above all, and
    whatever is unique in kind (steps, chirps, broadband signals). Where some starts are unknown, the largest recording
    of known start stays in any case: parameters are identified from it first. The choice depends on nothing but the
    recordings.
    """
    certain = [c for c in candidates if not c.begun and c.use != "confirmation"]
    largest = max(certain, key=lambda c: c.excitation.amplitude) if 0 < len(certain) < len(candidates) else None
    free = [c for c in candidates if c.use is None and c is not largest]
    wanted = min(max(1, round(_HELD_OUT_SHARE * len(candidates))), len(candidates) - 1, len(free))
    rank = {c.name: _worth_keeping(c, candidates) for c in candidates}
    held: list[Candidate] = []
    for level in sorted({rank[c.name] for c in free}):
        if held and level >= 3:
            break  # a smaller set serves better than one that takes the last chirp or extreme away
        group = [c for c in free if rank[c.name] == level]
        group.sort(key=lambda c: (c.excitation.frequency, c.excitation.amplitude, c.name))
        count = min(wanted - len(held), len(group))
        # Evenly over the sorted group.
        held += [group[int((i + 0.5) * len(group) / count)] for i in range(count)]
        if len(held) >= wanted:
            break
    return {c.name for c in held}


def _worth_keeping(one: Candidate, everyone: Sequence[Candidate]) -> int:
    """Return 0: interpolated by the rest, 1: repeats another, 2: smallest amplitude, 3: an extreme, 4: unique in kind,
    the largest of all, or of no use to confirm, as its first samples tell nothing of its start."""
    if one.untold:
        return 4
    tones = [c for c in everyone if c.excitation.kind in ("sine", "periodic")]
    others = [c for c in everyone if c is not one]
    if any(_alike(one, other) for other in others):
        # of several alike the first one stays, the rest repeat it
        first = next(c for c in everyone if c is one or _alike(one, c))
        return 1 if first is not one else 3
    if one not in tones:
        return 4 if one.excitation.kind not in {c.excitation.kind for c in others} else 3
    frequencies = [c.excitation.frequency for c in tones]
    amplitudes = [c.excitation.amplitude for c in everyone]
    mine = one.excitation
    if [c for c in everyone if c.excitation.amplitude > (1 - _SAME) * max(amplitudes)] == [one]:
        return 4
    if max(frequencies) > (1 + _SAME) * min(frequencies) and not (
        min(frequencies) * (1 + _SAME) < mine.frequency < max(frequencies) * (1 - _SAME)
    ):
        # several may share the lowest frequency: the one of largest amplitude stands for it
        rivals = [c for c in tones if math.isclose(c.excitation.frequency, mine.frequency, rel_tol=_SAME)]
        if mine.amplitude >= max(c.excitation.amplitude for c in rivals) * (1 - 1e-9):
            return 3
    if mine.amplitude < (1 + _SAME) * min(amplitudes) and max(amplitudes) > (1 + _SAME) * min(amplitudes):
        return 2
    return 0


def _alike(a: Candidate, b: Candidate) -> bool:
    """Return whether two inputs are of one kind, at the same frequency and amplitude."""
    pairs = ((getattr(a.excitation, n), getattr(b.excitation, n)) for n in ("amplitude", "low_Hz", "high_Hz"))
    return a.excitation.kind == b.excitation.kind and all(math.isclose(*pair, rel_tol=_SAME) for pair in pairs)


# Fewest recordings whose spectra are pooled; how far their coefficients may lie from the median.
_FEWEST, _AGREES = 3, 0.12
# Factor within which deviations are of one size: a spectrum that ringing or a tail reaches gives many times the noise.
_ONE_SIZE = 1.5
# Level at which recordings of one kind are proven to differ in their noise.
DIFFERENT = 0.01


def pooled(floors: Sequence[NoiseFloor], kinds: Sequence[tuple[Hashable, ...]]) -> list[NoiseFloor]:
    """Return the floors of recordings, those seen in a part of the spectrum only brought to a common word. ``kinds``
    are sensor and sampling interval, last, of each recording."""
    common = _of_one_word(floors)
    for sensor in {kind[:-1] for kind in kinds}:
        mine = [i for i, kind in enumerate(kinds) if kind[:-1] == sensor]
        for i, floor in zip(mine, _as_others([common[i] for i in mine]), strict=True):
            common[i] = floor
    groups: dict[Hashable, list[int]] = {}
    for i, (floor, kind) in enumerate(zip(common, kinds, strict=True)):
        # Others keep what they were given: by repetition, by rest, or by agreement.
        if floor.interval is not None and floor.found and floor.coefficient is None:
            groups.setdefault(kind, []).append(i)
    for group in groups.values():
        for i, floor in zip(group, _sharing([common[i] for i in group]), strict=True):
            common[i] = floor
    return common


def _as_others(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """Return the floors of one sensor, those that are the level of a band alone replaced by what others agree on that
    show all of their noise, by repetition or at rest.

    Such a band may lie above most of a coloured noise, or hold what the signal leaves there.
    """
    whole = [f for f in floors if f.found and f.coefficient is None]
    size = float(np.median([f.value for f in whole])) if whole else 0.0
    agreeing = [f for f in whole if size / _ONE_SIZE <= f.value <= size * _ONE_SIZE]
    if len(agreeing) < _FEWEST or 2 * len(agreeing) < len(whole):
        return list(floors)
    typical = min(agreeing, key=lambda f: abs(f.value - size))
    shared = NoiseFloor(size, f"{len(agreeing)} others of this sensor that repeat or rest", typical.correlation)
    # The deviation that first-order noise of this correlation has at the highest frequencies.
    lag = float(typical.correlation[1]) if typical.correlation.size > 1 else 0.0
    there = size * float(np.sqrt(density(lag, np.array(-1.0))))
    return [shared if f.found and f.is_level and f.value >= there / _ONE_SIZE else f for f in floors]


def _sharing(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """Return the floors of one kind: one for those that are not proven different.

    One spectrum hardly tells coloured noise from what the signal leaves there. Where others of the kind do not agree on
    it the smaller floor stands, with an interval that holds both.
    """
    if len(floors) == 1:
        return list(floors)
    shared_floors = [f.smaller or f for f in floors]
    shared = alike([f.value for f in floors], [f.interval or (0.0, 0.0) for f in floors])
    if shared is None:
        return shared_floors
    value, interval, members = shared
    for k in members:
        source = f"{floors[k].source}, shared by {len(members)} recordings that do not differ in it"
        shared_floors[k] = replace(floors[k], value=value, source=source, interval=interval, smaller=None)
    return shared_floors


def alike(
    values: Sequence[float], intervals: Sequence[tuple[float, float]]
) -> tuple[float, tuple[float, float], list[int]] | None:
    """Return the deviation that estimates share unless they are proven different, its 95 % interval, and their numbers;
    None where no two agree.

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
            return float(np.exp(mean)), interval, members
        del members[int(away.argmax())]
    return None


def _of_one_word(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """Return the floors seen in a part of the spectrum only, where several agree on white or on first-order noise.

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
    # Floors from the highest frequencies, taken as white, of about the deviation that the common noise has there.
    as_white = [f for f in every if f.is_level]
    there = highest * value
    agreed = (*partial, *(f for f in as_white if there / _ONE_SIZE <= f.value <= there * _ONE_SIZE))
    distinct = [f for f in every if f not in agreed and (f.value < size or f.interval is not None)]
    alone = {id(f) for f in (*distinct, *(agreeing if correlation is WHITE else ()))}
    common = NoiseFloor(value, source, correlation, 0.0)
    return [f if f.coefficient is None or id(f) in alone else common for f in floors]
