"""The split into identification and confirmation samples: confirmation interpolates and is used once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Part, Recording

_HELD_OUT_SHARE = 0.28  # of the recordings
_NUISANCE_SHARE, _NUISANCE_LEAST = 0.02, 50
# Share of its range that an input has to cover in the head of a recording whose initial state follows from that head.
_COVERED = 0.9
# Of a recording that starts nobody knows how, where its input has no swing after which a hysteresis has forgotten.
_UNKNOWN_SHARE = 0.2
_SAME = 0.05  # amplitudes and frequencies nearer than this are no new ones


@dataclass(frozen=True)
class Candidate:
    """What the choice needs to know of a recording.

    Attributes:
        use: what the manifest demands, ``None`` if nothing.
        begun: nobody knows in which state it starts.
        untold: its input covers too little of its range in its head to tell the initial state and the zero: thresholds
            that only the rest of the range crosses have not been met.
    """

    name: str
    size: int
    dt: float
    excitation: Excitation
    use: str | None
    begun: bool = False
    untold: bool = False

    @property
    def head(self) -> int:
        """Samples that are spent on zero and initial state where the recording is held out: at most half of them.

        From an unknown start it is a whole swing of the input, for by then a hysteresis has forgotten what was before.
        """
        least = max(_NUISANCE_LEAST, int(np.ceil(_NUISANCE_SHARE * self.size)))
        if self.begun:
            slowest = self.excitation.low_Hz
            swing = 1.0 / (slowest * self.dt) if slowest > 0.0 else _UNKNOWN_SHARE * self.size
            least = max(least, int(np.ceil(swing)))
        return min(least, self.size // 2)


def candidate_of(recording: Recording, excitation: Excitation, use: str | None = None) -> Candidate:
    """What the choice needs to know of a recording."""
    begun, u = recording.start.state == "unknown", recording.drive
    one = Candidate(recording.name, recording.t.size, recording.dt, excitation, use, begun)
    covered = np.ptp(u) > 0.0 and np.ptp(u[: one.head]) >= _COVERED * np.ptp(u)
    return replace(one, untold=bool(begun and not covered))


def divide(candidates: Sequence[Candidate]) -> tuple[Mapping[str, tuple[Part, ...]], bool, tuple[str, ...]]:
    """The parts of every recording by name, whether the held-out ones are new, and notes."""
    if all(c.use == "confirmation" for c in candidates):
        raise InputRefused(
            "recordings.yaml: every recording has use: confirmation, nothing is left to identify from: "
            "give at least one use: identification, or leave `use` out"
        )
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
        note = f"Held out for confirmation, chosen here within the span of the others: {', '.join(sorted(held))}."
    if not held:
        note += " No result can be confirmed on recordings that were not used."
    parts_by_name = {c.name: whole_parts(c, c.name in held) for c in candidates}
    kept = [c for c in candidates if c.name not in held]
    # Whether some held-out recording differs from every other one in amplitude, frequency or kind.
    new = any(not any(_alike(c, k) for k in kept) for c in candidates if c.name in held)
    if held:
        note += f" They bring {'an' if new else 'no'} amplitude or frequency that identification lacks."
    return parts_by_name, new, (note,)


def whole_parts(one: Candidate, held_out: bool) -> tuple[Part, ...]:
    """The parts of a recording that serves one use; a held-out one spends its head on zero and initial state."""
    if not held_out:
        return (Part(one.name, 0, one.size, "identification"),)
    return (Part(f"{one.name}[start]", 0, one.head, "nuisance"), Part(one.name, one.head, one.size, "confirmation"))


def split_one(one: Candidate) -> tuple[tuple[Part, ...], str]:
    """A single recording in two parts with a gap: whole periods where it has at least four, else stretches of time."""
    first, last = one.excitation.span
    cycles = int((last - first) * 1.0001 / (one.excitation.period / one.dt)) if one.excitation.period else 0
    if cycles >= 4 and one.excitation.period:
        period = one.excitation.period / one.dt
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
    """Names of the recordings to hold out: about a quarter, inside the span of the rest, spread over it.

    Kept for identification where possible: the extremes of frequency and of amplitude, and whatever is unique in
    kind (steps, chirps, broadband signals). Where some starts are unknown, the largest recording of known start stays
    in any case: parameters are identified from it first. The choice depends on nothing but the recordings.
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
    """0: interpolated by the rest, 1: repeats another, 2: smallest amplitude, 3: an extreme, 4: unique in kind, or of
    no use to confirm, as its first samples tell nothing of its start."""
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
    if max(frequencies) > (1 + _SAME) * min(frequencies) and not (
        min(frequencies) * (1 + _SAME) < mine.frequency < max(frequencies) * (1 - _SAME)
    ):
        # several may share the lowest frequency: the one of largest amplitude stands for it
        rivals = [c for c in tones if _near(c.excitation.frequency, mine.frequency)]
        if mine.amplitude >= max(c.excitation.amplitude for c in rivals) * (1 - 1e-9):
            return 3
    largest = [c for c in everyone if c.excitation.amplitude > (1 - _SAME) * max(amplitudes)]
    if largest == [one]:
        return 3
    if mine.amplitude < (1 + _SAME) * min(amplitudes) and max(amplitudes) > (1 + _SAME) * min(amplitudes):
        return 2
    return 0


def _alike(a: Candidate, b: Candidate) -> bool:
    """Same kind of input at the same frequency and amplitude."""
    return (
        a.excitation.kind == b.excitation.kind
        and _near(a.excitation.amplitude, b.excitation.amplitude)
        and _near(a.excitation.low_Hz, b.excitation.low_Hz)
        and _near(a.excitation.high_Hz, b.excitation.high_Hz)
    )


def _near(a: float, b: float) -> bool:
    return abs(a - b) <= _SAME * max(abs(a), abs(b))
