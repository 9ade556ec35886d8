"""All that is to be said of a campaign's recordings, in words and as data: what they can and cannot show, and what to
record next. Recordings of one kind of excitation that are noisier than the others of their kind are told first.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phnn.check.quality import (
    WARNING,
    Finding,
    buried,
    comes_back,
    drift,
    lead,
    limits,
    mains,
    odd_units,
    quantisation,
    stated_noise,
)
from phnn.parameters import duration
from phnn.recordings.describe import describe
from phnn.recordings.excitation import Excitation, excitation_of
from phnn.recordings.recording import ACTUATOR, Campaign, Recording, is_actuator
from phnn.signals.noise import LONG_REST, longest_hold
from phnn.signals.noise_statement import NoiseStatement
from phnn.signals.reconstruct import find_jumps

# Recordings are of one kind within these relative differences of period and amplitude; how many make a kind.
_PERIOD, _AMPLITUDE, _FEWEST = 1e-4, 0.25, 3
# Noise of one over the median of its kind, from which it is contaminated.
_NOISIER = 3.0
# Power of a tone over the median of the spectrum; how many are named.
_STANDS_OUT, _NAMED = 30.0, 3


def contaminated(
    recordings: Sequence[Recording], excitations: Mapping[Recording, Excitation]
) -> dict[str, list[Finding]]:
    """By recording: whether its last two periods differ far more than those of the others with such an excitation.

    The spectra of random-phase multisines differ from realisation to realisation, but not the noise between their
    periods (Pintelon & Schoukens 2012, System Identification, ch. 4).
    """
    between = {r.name: d for r in recordings if (d := _between_periods(r, excitations[r])) is not None}
    sizes = {name: float(np.std(d)) for name, d in between.items()}
    found: dict[str, list[Finding]] = {r.name: [] for r in recordings}
    for r in recordings:
        kin = [o.name for o in recordings if o.name in between and _of_one_kind(r, o)]
        if r.name not in between or len(kin) < _FEWEST:
            continue
        usual = float(np.median([sizes[n] for n in kin]))
        times = sizes[r.name] / max(usual, 1e-300)
        if usual > 0.0 and times > _NOISIER:
            tones = _tones(between[r.name], r.dt)
            where = f", most of it in tones at {', '.join(f'{f:.4g}' for f in tones)} Hz" if tones else ""
            text = (
                f"noise between periods {times:.2g} times that of {len(kin) - 1} others with such an excitation"
                f"{where}: leave it out, or record it again"
            )
            values = {"noise_over_others": times, **{f"tone_{i}_Hz": f for i, f in enumerate(tones, start=1)}}
            found[r.name].append(Finding("contaminated", WARNING, text, values))
    return found


def _between_periods(recording: Recording, excitation: Excitation) -> np.ndarray | None:
    """Difference of the last two periods over √2; None where there are no two of a whole number of samples."""
    if recording.period is None:
        return None
    size, y = recording.period / recording.dt, recording.y
    whole, (first, last) = round(size), excitation.span
    if abs(size - whole) > 1e-3 or last - first < 2 * whole or not np.isfinite(y).all():
        return None
    return np.asarray((y[last - whole : last] - y[last - 2 * whole : last - whole]) / np.sqrt(2.0))


def _of_one_kind(a: Recording, b: Recording) -> bool:
    """Whether two recordings share rate, period and size of the input."""
    if a.period is None or b.period is None or a.dt != b.dt:
        return False
    sizes = float(np.std(a.u)), float(np.std(b.u))
    return abs(a.period / b.period - 1.0) < _PERIOD and abs(sizes[0] - sizes[1]) < _AMPLITUDE * max(sizes)


def _tones(x: np.ndarray, dt: float) -> list[float]:
    """Frequencies of the strongest narrow peaks, in ascending order."""
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(x.size))) ** 2
    limit = _STANDS_OUT * float(np.median(power))
    found: list[int] = []
    for i in np.argsort(power)[::-1]:
        if power[i] < limit or len(found) == _NAMED:
            break
        # The window widens a peak over its neighbours.
        if all(abs(int(i) - k) > 3 for k in found):
            found.append(int(i))
    return sorted(k / (x.size * dt) for k in found)


# Amplitudes and frequencies that count as different; a hold that counts as long, in shortest periods.
_AMPLITUDES, _FREQUENCIES, _HOLD = 1.4, 8.0, 3.0
# Content of a periodic input, in multiples of its fundamental, above which it is a multisine.
_LINES = 30.0
# A jump of the input over its range that is a step; samples at rest before a recording that begins with one.
_STEP, _BEFORE = 0.2, 4


@dataclass(frozen=True)
class Ability:
    """Attributes:
    shows: what could be told; able: whether these recordings tell; record: what to record where they do not.
    """

    shows: str
    able: bool
    record: str


def abilities(campaign: Campaign, excitations: Mapping[Recording, Excitation]) -> list[Ability]:
    """Every question that recordings may answer, in the order in which they are worth asking, in the words of the
    system: a network of the user's own is asked for nothing that only an actuator has."""
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    actuator = is_actuator(campaign.setup) and all(r.units == ACTUATOR for r in chosen)
    drives = [excitations[r] for r in chosen]
    moving = [e for e in drives if e.amplitude > 0.0]
    lows = [e.low_Hz for e in drives if e.low_Hz > 0.0]
    longest = max((_hold(r) for r in chosen), default=0.0)
    # Several amplitudes at about one frequency, or noise, which has them all.
    amplitudes = any(e.kind in ("broadband", "periodic") for e in moving) or any(
        a.amplitude > _AMPLITUDES * b.amplitude and _near(a, b) for a, b in itertools.permutations(moving, 2)
    )
    # Frequencies over almost a decade.
    frequencies = bool(lows) and max(e.high_Hz for e in drives) > _FREQUENCIES * min(lows)
    # A hold or rest that is long against the shortest period.
    holds = longest > (_HOLD / max(lows) if lows else 0.0)
    # A rest at the end, at the input of the beginning.
    returns = any(e.span[1] < 0.9 * r.t.size and comes_back(r.drive) for r, e in zip(chosen, drives, strict=True))
    # Content above the sines.
    wide = any(e.kind == "periodic" and e.high_Hz > _LINES * e.low_Hz for e in drives)
    broad = wide or any(e.kind in ("steps", "chirp", "broadband") for e in drives) or any(map(_steps, chosen))
    measured = campaign.voltage == "terminals" or any({"current", "charge"} & set(r.channels) for r in chosen)
    repeats = longest > 0.0 or any(e.period is not None and e.cycles >= 2.0 for e in drives)
    drive = "voltage" if all(r.units.input == "V" for r in chosen) else "input"
    rest = f"{LONG_REST} samples ({duration(LONG_REST * max((r.dt for r in chosen), default=0.0))})"
    # In the words of a piezo actuator, of any other system (empty where it is no question there), and what to record.
    questions = (
        ("what depends on the amplitude: bent springs, stops, saturation, friction against hysteresis",
         "what depends on the amplitude: laws that are not linear, limits, thresholds",
         amplitudes, "the same sine at a third and at two thirds of the amplitude"),
        ("what depends on the rate: lags, delays, drag, thresholds that follow the rate",
         "what depends on the rate: lags, delays, losses that are not linear",
         frequencies, "the same amplitude at a tenth or at ten times the frequency"),
        ("slow memory: creep, leakage, self-heating",
         "slow memory: what leaks, warms up or settles slowly",
         holds, f"a step to a constant {drive}, held ten times as long as the slowest period"),
        ("a drifting sensor against creep",
         "a drifting sensor against slow memory",
         returns, f"a rest at zero {drive} after the excitation, as long as the excitation itself"),
        ("resonances, and a second mode",
         "resonances, and further modes",
         broad, "a sweep or a step, sampled at least ten times as fast as the resonance"),
        ("the amplifier against the actuator", "",
         measured, "the voltage at the actuator's terminals, its current or its charge"),
        ("the noise, from what repeats or rests",
         "the noise, from what repeats or rests",
         repeats, f"three periods or more of every sine, or a rest of {rest} before each recording"),
    )  # fmt: skip
    said = ((own if actuator else other, able, record) for own, other, able, record in questions)
    return [Ability(shows, able, record) for shows, able, record in said if shows]


def _near(a: Excitation, b: Excitation) -> bool:
    """Whether two excitations share a frequency; steps share all."""
    if "steps" in (a.kind, b.kind):
        return a.kind == b.kind
    return min(a.high_Hz, b.high_Hz) >= 0.7 * max(a.low_Hz, b.low_Hz)


def _steps(recording: Recording) -> bool:
    """Whether an input jumps somewhere, at the first sample perhaps, by a good part of its range."""
    u = recording.drive
    if recording.start.state == "rest" and not recording.further:
        u = np.append([recording.start.input_before] * _BEFORE, u)
    jumps = find_jumps(u)
    return bool(np.any(np.abs(u[jumps] - u[jumps - 1]) > _STEP * np.ptp(u)))


def _hold(recording: Recording) -> float:
    """Duration [s] of the longest stretch of constant input."""
    first, last = longest_hold(recording.drive)
    return (last - first) * recording.dt if last - first > 0.02 * recording.u.size else 0.0


_NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?: [nµmkM]?(?:m|V|s|N|A|Hz|rad)\b)?")
# Names in a line before only their number is said; check.json has all.
_LISTED = 3
_CHECKS = (buried, quantisation, limits, drift, mains, lead)


@dataclass(frozen=True)
class Checked:
    """Attributes:
    campaign: what was read.
    findings: by recording, in the order of the campaign; abilities: of all together.
    noise: what the noise of each recording is that has an output.
    """

    campaign: Campaign
    findings: dict[str, list[Finding]]
    abilities: list[Ability]
    noise: dict[str, NoiseStatement]

    def text(self) -> str:
        """What `phnn check` prints."""
        lines = [describe(self.campaign), ""]
        if found := [(name, f) for name, some in self.findings.items() for f in some]:
            lines += ["Noticed:", *_noticed(found), ""]
        lines += ["Noise:", *_colours(self.noise), ""]
        for head, able in (("These recordings can show:", True), ("They cannot show, for which to record:", False)):
            some = [a for a in self.abilities if a.able is able]
            if some:
                lines += [head, *(f"  {a.shows}" + ("" if able else f"\n      {a.record}") for a in some), ""]
        return "\n".join(lines).rstrip()

    def document(self) -> dict[str, Any]:
        """The same as plain data, SI."""
        return {
            "schema": "phnn.check/1",
            "recordings": {
                r.name: {
                    "source": r.source, "sample_rate_hz": 1.0 / r.dt, "samples": int(r.t.size),
                    "noise_floor": r.noise if np.isfinite(r.noise) and r.noise_found else None,
                    "noise_interval_95": list(r.noise_interval) if r.noise_interval else None,
                    "noise": self.noise[r.name].document() if r.name in self.noise else None,
                    "start": r.start.state, "period_s": r.period,
                    "findings": [asdict(f) for f in self.findings[r.name]],
                }
                for r in self.campaign.recordings
            },
            "abilities": [asdict(a) for a in self.abilities],
            "notes": list(self.campaign.notes),
        }  # fmt: skip


def _noticed(found: Iterable[tuple[str, Finding]]) -> Iterator[str]:
    """Lines of findings; notes that differ in numbers alone share the line of the first."""
    return _grouped("similar", (
        ((name, f.text) if f.severity == WARNING else _NUMBER.sub("#", f.text), name, f"{f.severity:8}{name}: {f.text}")
        for name, f in found
    ))  # fmt: skip


def _colours(statements: Mapping[str, NoiseStatement]) -> Iterator[str]:
    """Lines of noise statements; recordings of which the same is said share one."""
    said = ((name, "; ".join((s.colour, *s.notes))) for name, s in statements.items())
    return _grouped("the same", ((text, name, f"{name}: {text}") for name, text in said))


def _grouped(how: str, told: Iterable[tuple[Hashable, str, str]]) -> Iterator[str]:
    """One line for each key, the first; ``told``: key, name of the recording and line."""
    groups: dict[Hashable, tuple[str, list[str]]] = {}
    for key, name, line in told:
        groups.setdefault(key, (line, []))[1].append(name)
    for line, (_, *others) in groups.values():
        named = ", ".join(others) if len(others) <= _LISTED else f"{len(others)} others"
        yield f"  {line} ({how} in {named})" if others else f"  {line}"


def check(campaign: Campaign) -> Checked:
    """All checks on all recordings that have an output."""
    recorded = [r for r in campaign.recordings if np.isfinite(r.y).all()]
    excitations = {r: excitation_of(r.drive, r.dt) for r in campaign.recordings}
    among = contaminated(recorded, excitations)
    units = odd_units(campaign)
    # Any other system may give an output that leads its input, such as the force of an imposed motion.
    actuator = is_actuator(campaign.setup)
    findings: dict[str, list[Finding]] = {r.name: [] for r in campaign.recordings}
    for r in recorded:
        findings[r.name] = [
            *(f for one in _CHECKS if one is not lead or actuator for f in one(r, excitations[r])),
            *among[r.name],
            *units[r.name],
        ]
    noise = {r.name: stated_noise(r, excitations[r]) for r in recorded}
    return Checked(campaign, findings, abilities(campaign, excitations), noise)
