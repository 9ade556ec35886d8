"""What a set of recordings can and cannot show, and what to record next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from phnn.check.quality import comes_back
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Campaign, Recording
from phnn.signals.noise import longest_hold

# Amplitudes and frequencies that count as different; a hold that counts as long, in shortest periods.
_AMPLITUDES, _FREQUENCIES, _HOLD = 1.4, 8.0, 3.0
# Content of a periodic input, in multiples of its fundamental, above which it is a multisine.
_LINES = 30.0


@dataclass(frozen=True)
class Ability:
    """Attributes:
    shows: what could be told; able: whether these recordings tell; record: what to record where they do not.
    """

    shows: str
    able: bool
    record: str


@dataclass(frozen=True)
class _Set:
    """What the recordings for identification offer."""

    recordings: Sequence[Recording]
    excitations: Sequence[Excitation]
    voltage: str

    @property
    def lows(self) -> list[float]:
        """Lowest frequency [Hz] of every excitation that has one."""
        return [e.low_Hz for e in self.excitations if e.low_Hz > 0.0]

    def amplitudes(self) -> bool:
        """Several amplitudes at about one frequency, or noise, which has them all."""
        moving = [e for e in self.excitations if e.amplitude > 0.0]
        many = any(e.kind in ("broadband", "periodic") for e in moving)
        return many or any(
            a.amplitude > _AMPLITUDES * b.amplitude and _near(a, b) for a in moving for b in moving if a is not b
        )

    def frequencies(self) -> bool:
        """Frequencies over almost a decade."""
        highs = [e.high_Hz for e in self.excitations if e.high_Hz > 0.0]
        return bool(self.lows) and max(highs) > _FREQUENCIES * min(self.lows)

    def hold(self) -> bool:
        """A hold or rest that is long against the shortest period."""
        longest = max((_hold(r) for r in self.recordings), default=0.0)
        return longest > (_HOLD / max(self.lows) if self.lows else 0.0)

    def returns(self) -> bool:
        """A rest at the end, at the input of the beginning."""
        return any(
            e.span[1] < 0.9 * r.t.size and comes_back(r.drive)
            for r, e in zip(self.recordings, self.excitations, strict=True)
        )

    def broad(self) -> bool:
        """A step, a sweep, noise or a multisine: content above the sines."""
        wide = [e for e in self.excitations if e.kind == "periodic" and e.high_Hz > _LINES * e.low_Hz]
        return bool(wide) or any(e.kind in ("steps", "chirp", "broadband") for e in self.excitations)

    def port(self) -> bool:
        """What goes into the actuator was measured: its voltage at the terminals, its current or its charge."""
        return self.voltage == "terminals" or any({"current", "charge"} & set(r.channels) for r in self.recordings)

    def repeats(self) -> bool:
        """Two periods of something, or a rest: the noise is known from repetition."""
        return any(e.cycles >= 2.0 for e in self.excitations) or any(_hold(r) > 0.0 for r in self.recordings)


_ABILITIES: tuple[tuple[str, Callable[[_Set], bool], str], ...] = (
    (
        "what depends on the amplitude: bent springs, stops, saturation, friction against hysteresis",
        _Set.amplitudes, "the same sine at a third and at two thirds of the amplitude",
    ),
    (
        "what depends on the rate: lags, delays, drag, thresholds that follow the rate",
        _Set.frequencies, "the same amplitude at a tenth or at ten times the frequency",
    ),
    (
        "slow memory: creep, leakage, self-heating",
        _Set.hold, "a step to a constant voltage, held ten times as long as the slowest period",
    ),
    (
        "a drifting sensor against creep",
        _Set.returns, "a rest at zero voltage after the excitation, as long as the excitation itself",
    ),
    (
        "resonances, and a second mode",
        _Set.broad, "a sweep or a step, sampled at least ten times as fast as the resonance",
    ),
    (
        "the amplifier against the actuator",
        _Set.port, "the voltage at the actuator's terminals, its current or its charge",
    ),
    (
        "the noise, from what repeats or rests",
        _Set.repeats, "three periods or more of every sine, or a second of rest before each recording",
    ),
)  # fmt: skip


def abilities(campaign: Campaign, excitations: Mapping[Recording, Excitation]) -> list[Ability]:
    """Every question that recordings may answer, in the order in which they are worth asking."""
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    offered = _Set(chosen, [excitations[r] for r in chosen], campaign.voltage)
    return [Ability(shows, test(offered), record) for shows, test, record in _ABILITIES]


def _near(a: Excitation, b: Excitation) -> bool:
    """Whether two excitations share a frequency; steps share all."""
    if "steps" in (a.kind, b.kind):
        return a.kind == b.kind
    return min(a.high_Hz, b.high_Hz) >= 0.7 * max(a.low_Hz, b.low_Hz)


def _hold(recording: Recording) -> float:
    """Duration [s] of the longest stretch of constant input."""
    first, last = longest_hold(recording.drive)
    return (last - first) * recording.dt if last - first > 0.02 * recording.u.size else 0.0
