"""Checks of recordings before any model is fitted to them, in words and as data: what they show, and what to record.

Of one recording: steps, limits and drift of its output, tones of the mains, an output that comes before its input,
harmonics that the input does not drive. Of all: a gain that differs from that of others by a factor of a thousand or by
its sign (a wrong unit, a reversed wire), noise that exceeds that of others with such an excitation, and the questions
that the recordings can and cannot answer.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from phnn.parameters import duration, quantity
from phnn.recordings.checks import turned
from phnn.recordings.excitation import Excitation, spectrum, waves
from phnn.recordings.reader import describe
from phnn.recordings.recording import ACTUATOR, Campaign, Recording, dominant_frequency, is_actuator
from phnn.signals.first_order import without_trend
from phnn.signals.least_squares import residual
from phnn.signals.noise import LONG_REST, OWN_FLOOR, longest_hold
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement
from phnn.signals.reconstruct import find_jumps
from phnn.signals.sampling import quantisation_step

NOTE, WARNING = "note", "warning"


@dataclass(frozen=True)
class Finding:
    """What a check noticed in a recording."""

    kind: str  # quantisation, limits, drift, restless, mains, lead, distortion, units, noise or contaminated
    severity: str  # note, or warning where it may mislead a diagnosis
    text: str  # one sentence for a person, with what to do about a warning
    values: Mapping[str, float]  # its numbers, SI


# Units differ by powers of a thousand; a gain is suspicious within this factor of one.
_STEP, _WITHIN = 1000.0, 2.5
# Recordings of one kind that tell what the gain usually is, and within which factor of each other they lie.
_FEWEST, _ALIKE = 3, 30.0
# A recording has a gain if its input moves by this share of the usual range, and its output by so many noise floors.
_MOVES, _SEEN = 0.01, 20.0
# A faster recording has a smaller gain: it may fall with this power of the frequency (a mass and one lag).
_ROLL_OFF = 3.0
# Correlation of input and output from which one follows the other, with it or against it; how much faster than all
# others a recording is that may lie above a resonance, where a displacement moves against the force.
_FOLLOWS, _ABOVE = 0.9, 2.0
# Largest voltage of the piezo actuators that are sold, V, with some reserve.
_HIGHEST = 5e3
# Stroke per volt, from a tube scanner of a tenth of a nanometre to a bender, with a decade beyond both; a command in
# front of an amplifier may be smaller by its gain.
_LEAST, _MOST, _AMPLIFIED = 1e-11, 1e-4, 1e-2
# What a single crystal or a tube has at most; stacks and benders have more.
_CRYSTAL = 5e-9  # m/V


def odd_units(campaign: Campaign) -> dict[str, list[Finding]]:
    """Return, by recording, doubts about the units and signs of its input or output.

    Gains about 10³ or 10⁻³ times that of most others, outputs that move against an input that most others follow, and
    voltages and strokes per volt far beyond those of actuators that are sold; any other system may have any gain.
    """
    findings: dict[str, list[Finding]] = {r.name: [] for r in campaign.recordings}
    actuator, most = is_actuator(campaign.setup), _AMPLIFIED if campaign.voltage == "command" else _MOST
    kinds: dict[tuple[str, ...], list[Recording]] = {}
    for r in campaign.recordings:
        if np.isfinite(r.y).all():
            kinds.setdefault((r.measures, r.units.input, r.units.output), []).append(r)
    for some in kinds.values():
        moves = float(np.median([np.ptp(r.u) for r in some]))
        gains = {r: float(np.ptp(r.y) / np.ptp(r.u)) for r in some if _has_gain(r, moves)}
        usual = float(np.median(list(gains.values()))) if gains else 1.0
        alike = [r for r, g in gains.items() if max(g / usual, usual / g) < _ALIKE]
        usable = len(alike) >= max(_FEWEST, len(gains) // 2 + 1)
        fastest = max((dominant_frequency(r) for r in alike), default=0.0) if usable else 0.0
        against = _against([r for r in gains if not r.further])
        for r, gain in gains.items():
            ratio, faster = gain / usual, max(dominant_frequency(r) / max(fastest, 1e-300), 1.0)
            if usable and _thousands(ratio) and max(ratio, 1.0 / (ratio * faster**_ROLL_OFF)) > _ALIKE:
                fact = f"output over input is {ratio:.3g} times that of the {len(alike)} others"
                cause = "a column has probably another unit than is stated (nm, µm, mm; V, kV)"
                text = f"{fact}: {cause}; correct it in recordings.yaml, columns"
                findings[r.name].append(Finding("units", WARNING, text, {"gain_over_others": ratio}))
            strokes = actuator and (r.units.input, r.units.output) == ("V", "m")
            if actuator and r.units.input == "V" and (size := float(np.max(np.abs(r.u)))) > _HIGHEST:
                fact = f"a voltage of {quantity(size, 'V')}, piezo actuators take up to {quantity(_HIGHEST, 'V')}"
                text = f"{fact}: the column is probably in mV; correct it in recordings.yaml, columns"
                findings[r.name].append(Finding("units", WARNING, text, {"voltage": size}))
            elif strokes and not _LEAST <= gain <= most:
                fact = f"output over input is {gain:.2g} m/V, piezo actuators have {_LEAST:g} to {most:g} m/V"
                text = f"{fact}: compare the units and names of its columns with what was recorded"
                findings[r.name].append(Finding("units", WARNING, text, {"gain": gain}))
            elif strokes and usual < _CRYSTAL:
                fact = f"output over input is {1e9 * gain:.2g} nm/V, as of a single crystal"
                text = f"{fact}: of a stack or a bender the column has a larger unit than is stated"
                findings[r.name].append(Finding("units", NOTE, text, {"gain": gain}))
            if r in against:
                text = f"the output moves the other way than in most others: {turned(r.source)}"
                findings[r.name].append(Finding("units", WARNING, text, {"correlation": against[r]}))
    return findings


def _against(recordings: Sequence[Recording]) -> dict[Recording, float]:
    """Return those whose output follows the input with another sign than that of most others, with the correlation.

    One that is much faster than all of the others may lie above a resonance, where that is physics.
    """
    correlations = {r: float(np.corrcoef(r.u, r.y)[0, 1]) for r in recordings}
    usual = [r for r, c in correlations.items() if c > _FOLLOWS]
    other = [r for r, c in correlations.items() if c < -_FOLLOWS]
    if len(other) > len(usual):
        usual, other = other, usual
    fastest = max((dominant_frequency(r) for r in usual), default=0.0)
    return {r: correlations[r] for r in other if dominant_frequency(r) <= _ABOVE * fastest}


def buried(recording: Recording) -> list[Finding]:
    """Return a noise floor that is as large as the output: a signal is not its own noise floor."""
    share = recording.noise / max(float(np.std(recording.y)), 1e-300)
    if not recording.noise_found or not share >= OWN_FLOOR:
        return []
    fact = f"the noise floor is {share:.2g} times the deviation of the whole output"
    cause = "noise hides what the input moves, or the output does not follow this input and counts as noise"
    text = f"{fact}: {cause}. Compare columns and wiring, drive it more, or record a rest"
    return [Finding("noise", WARNING, text, {"noise_over_output": share})]


def _has_gain(r: Recording, usual: float) -> bool:
    floor = r.noise if r.noise_found and np.isfinite(r.noise) else 0.0
    moves, seen = float(np.ptp(r.u)), float(np.ptp(r.y))
    return moves > _MOVES * usual and moves > 0.0 and seen > _SEEN * floor and seen > 0.0


def _thousands(ratio: float) -> bool:
    """Return whether a ratio is about a power of a thousand, up or down, but not one."""
    size = max(ratio, 1.0 / ratio)
    power = round(float(np.log(size) / np.log(_STEP)))
    return power >= 1 and max(size / _STEP**power, _STEP**power / size) <= _WITHIN


Array = NDArray[np.float64]

_MAINS, _MULTIPLES = (50.0, 60.0), (1, 2, 3)
# Power of a tone over the median around it: of some hundred thousand bins of noise one comes that far.
_STANDS_OUT = 20.0
# Bins of the neighbourhood on either side, of the tone itself, and the least periods that tell it from slow changes.
_AROUND, _ITSELF, _PERIODS = 25, 3, 8.0


def mains(recording: Recording) -> list[Finding]:
    """Return the multiples of a mains frequency that stand out of an output's spectrum, but not out of its input's.

    Hann window; the amplitude of a tone is that of a sine of the same power.
    """
    duration = recording.t.size * recording.dt
    lines = [base * n for base in _MAINS for n in _MULTIPLES]
    # Long enough, and sampled fast enough, to show a tone.
    shown = [f for f in lines if f * duration >= _PERIODS and f <= 0.45 / recording.dt]
    asked = [f for f in shown if not _driven(recording.excitation, f, duration)]
    if not asked:
        return []
    output, drive = spectrum(recording.y) ** 2, spectrum(recording.drive) ** 2
    tones = {f: a for f in asked if (a := _amplitude(output, drive, f * duration, recording.t.size)) > 0.0}
    if not tones:
        return []
    named = ", ".join(f"{f:g} Hz ({quantity(a, recording.units.output)})" for f, a in tones.items())
    text = f"tones of the mains in the output at {named}: look for a ground loop, or shield the sensor"
    return [Finding("mains", WARNING, text, {f"amplitude_{f:g}Hz": a for f, a in tones.items()})]


def _driven(excitation: Excitation, frequency: float, duration: float) -> bool:
    """Return whether a harmonic of what drives the recording lies within its resolution of the frequency."""
    if excitation.kind not in ("sine", "periodic"):
        return False
    return abs(frequency - excitation.low_Hz * round(frequency / excitation.low_Hz)) * duration < _ITSELF


def _amplitude(output: Array, drive: Array, place: float, samples: int) -> float:
    """Return the amplitude of a tone in the output's spectrum; 0 without one, or where the input may cause it."""
    stands_out, power = _over_neighbours(output, round(place))
    if stands_out < _STANDS_OUT or _over_neighbours(drive, round(place))[0] > 0.1 * stands_out:
        return 0.0
    # A sine of amplitude a has the power (a n/4)² in the middle bin of a Hann window, a quarter of it on either side.
    return float(np.sqrt(power / 1.5)) * 4.0 / samples


def _over_neighbours(power: Array, middle: int) -> tuple[float, float]:
    """Return the power at a bin over the median around it, and the power in its three bins together."""
    bins = power[max(middle - 1, 0) : middle + 2]
    below = power[max(middle - _AROUND, 1) : max(middle - _ITSELF, 1)]
    around = np.concatenate([below, power[middle + _ITSELF + 1 : middle + _AROUND + 1]])
    usual = float(np.median(around)) if around.size else 0.0
    return float(bins.max(initial=0.0)) / max(usual, 1e-300), float(bins.sum())


# Samples by which an output must lead before a channel is called shifted, and times the uncertainty of the phase.
_SAMPLES, _SURE_OF_SHIFT = 0.5, 4.0


def lead(recording: Recording) -> list[Finding]:
    """Return whether the output leads the input at the fundamental: no causal actuator of positive static gain does.

    With the complex amplitudes ``U`` and ``Y`` at ``f`` the lead is ``arg(Y/U) / 2πf``. Hysteresis, damping and every
    lag of amplifier or sensor make it negative; above a resonance it is negative still. Nothing is said where further
    inputs have their part in the output.
    """
    excitation = recording.excitation
    if excitation.kind not in ("sine", "periodic") or excitation.cycles < 1.0 or recording.further:
        return []
    first, last = excitation.span
    # Whole periods only, without the first one where there are more: it carries what the start left.
    period = 1.0 / (excitation.low_Hz * recording.dt)
    count = int(excitation.cycles) - (1 if excitation.cycles >= 2.0 else 0)
    chosen = slice(max(last - round(count * period), first), last)
    phase = 2.0 * np.pi * excitation.low_Hz * recording.t[chosen]
    basis = np.column_stack([np.cos(phase), -np.sin(phase), np.ones(phase.size)])
    weights, *_ = np.linalg.lstsq(basis, np.column_stack([recording.u[chosen], recording.y[chosen]]), rcond=None)
    u, y = (complex(w[0], w[1]) for w in weights.T)
    angle = float(np.angle(y / u))
    uncertain = recording.noise * float(np.sqrt(2.0 / phase.size)) / max(abs(y), 1e-300)
    seconds = angle / (2.0 * np.pi * excitation.low_Hz)
    if not (0.0 < angle < 0.5 * np.pi and angle > _SURE_OF_SHIFT * uncertain and seconds > _SAMPLES * recording.dt):
        return []
    shift = f"{seconds:.3g} s ({seconds / recording.dt:.2g} samples) at {excitation.low_Hz:.4g} Hz"
    cause = "the columns are swapped, or the channels shifted; compare names and columns, and sample both together"
    text = f"the output leads the input by {shift}, as no actuator does: {cause}"
    return [Finding("lead", WARNING, text, {"lead_s": seconds})]


# Share of the largest line of the input from which a harmonic is driven; the least distortion that is told, as a share
# of the output and in deviations of its noise.
_DRIVEN, _TOLD, _ABOVE_NOISE = 0.01, 1e-3, 4.0


def distortion(recording: Recording) -> list[Finding]:
    """Return what a periodic output holds at harmonics that the input does not drive, where a linear system is silent.

    Of ``K`` whole periods the spectrum has its harmonics at every K-th line. Odd ones come of what is the same in both
    directions (hysteresis, friction, a cubic spring), even ones of what is not (Pintelon & Schoukens 2012, System
    Identification, ch. 4). Shares of the output's deviation; noise is that in as many lines.
    """
    excitation, starting = recording.excitation, 0 if recording.start.state == "periodic" else 1
    periods = int(excitation.cycles + _WHOLE) - starting
    if excitation.period is None or periods < 2 or recording.further or not np.isfinite(recording.noise):
        return []
    size = excitation.period / recording.dt
    rows = slice(excitation.span[1] - round(periods * size), excitation.span[1])
    u, y = recording.u[rows], recording.y[rows]
    # The line through the means of the first and the last period: what drifts is in all harmonics.
    drift = (y[-round(size) :].mean() - y[: round(size)].mean()) / (y.size - size)
    lines = np.fft.rfft(np.column_stack([u, y - drift * np.arange(y.size)]), axis=0)[periods : y.size // 2 : periods].T
    if not lines.any():
        return []
    driven, power = np.abs(lines[0]) > _DRIVEN * np.abs(lines[0]).max(), np.abs(lines[1]) ** 2
    order = np.arange(1, power.size + 1)
    odd, even = (np.sqrt(power[~driven & (order % 2 == k)].sum() / power.sum()) for k in (1, 0))
    noise = recording.noise * float(np.sqrt(y.size * (~driven).sum() / power.sum()))
    if not max(odd, even) > max(_TOLD, _ABOVE_NOISE * noise):
        return []
    fact = f"odd harmonics of {100.0 * odd:.2g} % and even ones of {100.0 * even:.2g} % (noise {100.0 * noise:.2g} %)"
    cause = "hysteresis, friction and symmetric bends make odd ones, what differs between both directions even ones"
    text = f"beside its linear response the output holds {fact}: {cause}"
    return [Finding("distortion", NOTE, text, {"odd": float(odd), "even": float(even), "noise": noise})]


# Harmonics of the drive in which periods may differ because of the transient.
_SETTLING = 3
# By how much of a period a recording may miss a whole number of them; harmonics that give the speed.
_WHOLE, _HARMONICS = 0.02, 20


def _between_periods(r: Recording) -> Sample | None:
    """Return two periods against each other, without what changes slowly; None without two periodic ones.

    The first period is left out, for it holds a transient.
    """
    if r.period is None or not np.isfinite(r.noise):
        return None
    first, last = r.excitation.span
    size = r.period / r.dt
    skip = 0 if r.start.state == "periodic" else 1
    whole = int((last - first) / size + _WHOLE) - skip
    if whole < 2:
        return None
    start, lag = first + round(skip * size), round(whole // 2 * size)
    late = whole // 2 * size - lag
    y = r.y[start : min(last, r.y.size)]
    harmonics = min(_HARMONICS, int(0.4 * size))
    smooth = y - residual(y, lambda rows: waves(rows, 1.0 / size, harmonics))
    speed = np.gradient(smooth, r.dt)
    count = y.size - lag
    # Offset, trend, amplitude, what settles, and the fraction of a sample by which the periods miss each other.
    shapes = [np.arange(float(count)), smooth[:count]]
    if abs(late) > 1e-9:
        shapes += [speed[:count], np.gradient(speed, r.dt)[:count]]
    slow = [shape / np.sqrt(np.mean(shape**2)) for shape in shapes]
    few = min(_SETTLING, harmonics)
    changed = residual(
        y[lag:] - y[:count],
        lambda rows: np.column_stack([*(shape[rows] for shape in slow), waves(rows, 1.0 / size, few)]),
    )
    above = (_SETTLING + 1.5) / r.period
    return Sample(changed / np.sqrt(2.0), r.dt, speed[:count], r.step, above=above)


# Steps of a share of the noise are not worth a word; steps of several times the noise hide it, whose own deviation
# would be step/√12.
_FINE, _COARSE = 0.1, 2.0
# Samples at an extreme value, as a share of all, that a smooth signal does not have.
_SHARE = 2e-3
# Drift over standard error, and over the noise, from which it is worth a word and a warning.
_SURE, _MUCH = 5.0, 2.0
# Stretches from which on a transient is told from a drift; share of a change that a transient may make in their second
# half, where a steady drift makes half of it.
_TELLING, _LATE = 4, 0.2
# Inputs that differ by less than this share of their range are equal.
_LEVEL = 0.01
# Restless: samples of a rest, size over the noise, changes of its sign, the smallest over the largest of its quarters.
_AT_REST, _RESTLESS, _TURNS, _EVEN = 100, 5.0, 10, 0.5


def quantisation(recording: Recording) -> list[Finding]:
    """Return the step of which the output's values are multiples, beside the noise."""
    if recording.step == 0.0 or not recording.noise > 0.0:
        return []
    step, share = recording.step, recording.step / recording.noise
    text = f"output in steps of {quantity(step, recording.units.output)}"
    if not recording.noise_found:
        # There is no noise to hold the steps against.
        return [Finding("quantisation", NOTE, text, {"step": step})]
    if share < _FINE:
        return []
    text, severity = f"{text}, {share:.2g} times the noise", NOTE
    if share >= _COARSE:
        text, severity = f"{text}: steps hide the noise; use a smaller range of the converter", WARNING
    return [Finding("quantisation", severity, text, {"step": step, "step_over_noise": share})]


def limits(recording: Recording) -> list[Finding]:
    """Return samples that stand at the output's extremes, as where a converter ends; many more of them reading refuses.

    Where the manifest says that the sensor saturates there, they are data.
    """
    y = recording.y
    unexplained = y[recording.sensor.at_limit(y) == 0]
    at = max((int(np.sum(unexplained == x)) for x in (y.max(), y.min())), default=0)
    holds = float(np.mean(np.diff(recording.drive) == 0.0))
    if at <= max(3, _SHARE * y.size) or quantisation_step(y) > 0.0 or holds > 0.5:
        return []
    remedy = "choose a larger one, or say so in recordings.yaml, sensor: {saturates: [LEAST, LARGEST]}"
    text = f"{at} samples stand at the output's extreme value: if the sensor's range ends there, {remedy}"
    return [Finding("limits", WARNING, text, {"samples": float(at)})]


def drift(recording: Recording) -> list[Finding]:
    """Return how the output's mean changes from period to period, or between rests at one input, with standard error.

    The first period is left out, for what the start left dies away in it. Without a noise floor nothing is
    significant.
    """
    if not recording.noise_found:
        return []
    means, spread, rests = _levels(recording)
    if means.size < 2:
        return []
    change, error = float(means[-1] - means[0]), spread * float(np.sqrt(2.0))
    if abs(change) < _SURE * error:
        return []
    seconds = recording.t.size * recording.dt
    size = quantity(change, recording.units.output)
    text = f"the output's mean moves by {size} within {seconds:.3g} s at equal input"
    held = recording.units == ACTUATOR
    causes = "creep, heating or a drifting sensor" if held else "creep, heating, a drifting sensor, or nothing holds it"
    later, doubtful = float(np.ptp(means[means.size // 2 :])), WARNING if held else NOTE
    zero = "zero voltage" if recording.units.input == "V" else "the input zero"
    values = {"change": change, "standard_error": error}
    if abs(change) < _MUCH * recording.noise:
        return [Finding("drift", NOTE, text, values)]
    severity = NOTE
    if rests:
        text += " and then rests there: hysteresis leaves such a change"
    elif means.size >= _TELLING and later < max(_SURE * error, _LATE * abs(change)):
        text += ", nearly all of it in the first half: what the start left dies away so, and so does creep"
    elif means.size < _TELLING and recording.excitation.period is not None and recording.start.state != "periodic":
        text += f": what the start left, or {causes}; more periods would tell"
        # From rest a model follows what the start leaves.
        severity = NOTE if recording.start.state == "rest" else doubtful
    else:
        text, severity = f"{text}: {causes}; a long rest at {zero} would tell", doubtful
    return [Finding("drift", severity, text, values)]


def restless(recording: Recording) -> list[Finding]:
    """Return how the output goes on moving while the input stands still, where that is far more than the noise."""
    first, last = longest_hold(recording.drive)
    rest = recording.y[(first + last) // 2 : last]
    if rest.size < _AT_REST or not recording.noise_found:
        return []
    rest = without_trend(rest, 3)
    parts = [float(np.std(part)) for part in np.array_split(rest, 4)]
    size, turns = float(np.std(rest)), np.count_nonzero(np.diff(np.signbit(rest)))
    # What dies away is a response to the input.
    if size < _RESTLESS * recording.noise or turns < _TURNS or min(parts) < _EVEN * max(parts):
        return []
    values = {"rms": size, "over_noise": size / recording.noise}
    moves = f"while the input stands still, the output moves by {quantity(size, recording.units.output)} rms"
    text = f"{moves}, {values['over_noise']:.2g} times the noise: an oscillation, or an input that is not recorded"
    return [Finding("restless", WARNING, f"{text}; no model of the input comes nearer than that", values)]


def comes_back(u: np.ndarray) -> bool:
    """Return whether an input ends where it began."""
    return bool(abs(u[-1] - u[0]) <= _LEVEL * np.ptp(u))


def _levels(recording: Recording) -> tuple[np.ndarray, float, bool]:
    """Return the means of the output over stretches of equal input, in order, the standard error of each, and whether
    the last of them is a rest within which the output does not move."""
    excitation = recording.excitation
    first, last = excitation.span
    deviation = recording.noise * float(np.sqrt(max(2.0 * recording.noise_correlation.sum() - 1.0, 1.0)))
    if excitation.period is not None and excitation.cycles >= 3.0:
        size = excitation.period / recording.dt
        # Periods need not be whole numbers of samples: their means come from the integral, interpolated.
        integral = np.concatenate([[0.0], np.cumsum(recording.y)])
        edges = first + size * np.arange(1, int((last - first) / size + 1e-6) + 1)
        means = np.diff(np.interp(edges, np.arange(integral.size), integral)) / size
        return means, deviation / float(np.sqrt(size)), False
    before, after = recording.y[:first], recording.y[last:]
    if not comes_back(recording.drive) or min(before.size, after.size) < 10:
        return np.zeros(0), 0.0, False
    # What follows the last change of the input is still on its way: its second half counts.
    after = after[after.size // 2 :]
    half = after.size // 2
    moved = abs(float(after[half:].mean() - after[:half].mean())) + _SURE * deviation * float(np.sqrt(2.0 / half))
    change = abs(float(after.mean() - before.mean()))
    # At this rate, what goes on would explain a small share of the change within the whole recording.
    rests = moved * recording.t.size / half < _LATE * change
    return np.array([before.mean(), after.mean()]), deviation / np.sqrt(min(before.size, after.size)), rests


# Recordings are of one kind within these relative differences of period and amplitude; how many make a kind.
_PERIOD, _AMPLITUDE, _KIN = 1e-4, 0.25, 3
# Noise of one over the median of its kind, from which it is contaminated.
_NOISIER = 3.0
# Power of a tone over the median of the spectrum; how many are named.
_TALL, _NAMED = 30.0, 3


def contaminated(recordings: Sequence[Recording]) -> dict[str, list[Finding]]:
    """Return, by recording, last two periods that differ far more than those of others with such an excitation.

    The spectra of random-phase multisines differ from realisation to realisation, but not the noise between their
    periods (Pintelon & Schoukens 2012, System Identification, ch. 4).
    """
    between = {r.name: d for r in recordings if (d := _last_difference(r)) is not None}
    sizes = {name: float(np.std(d)) for name, d in between.items()}
    findings: dict[str, list[Finding]] = {r.name: [] for r in recordings}
    for r in recordings:
        kin = [o.name for o in recordings if o.name in between and _of_one_kind(r, o)]
        if r.name not in between or len(kin) < _KIN:
            continue
        usual = float(np.median([sizes[n] for n in kin]))
        times = sizes[r.name] / max(usual, 1e-300)
        if usual > 0.0 and times > _NOISIER:
            tones = _tones(between[r.name], r.dt)
            where = f", most of it in tones at {', '.join(f'{f:.4g}' for f in tones)} Hz" if tones else ""
            fact = f"noise between periods {times:.2g} times that of {len(kin) - 1} others with such an excitation"
            text = f"{fact}{where}: leave it out, or record it again"
            values = {"noise_over_others": times, **{f"tone_{i}_Hz": f for i, f in enumerate(tones, start=1)}}
            findings[r.name].append(Finding("contaminated", WARNING, text, values))
    return findings


def _last_difference(recording: Recording) -> np.ndarray | None:
    """Return the difference of the last two periods over √2; None without two of a whole number of samples."""
    if recording.period is None:
        return None
    size, y = recording.period / recording.dt, recording.y
    whole, (first, last) = round(size), recording.excitation.span
    if abs(size - whole) > 1e-3 or last - first < 2 * whole or not np.isfinite(y).all():
        return None
    return np.asarray((y[last - whole : last] - y[last - 2 * whole : last - whole]) / np.sqrt(2.0))


def _of_one_kind(a: Recording, b: Recording) -> bool:
    """Return whether two recordings share rate, period and size of the input."""
    if a.period is None or b.period is None or a.dt != b.dt:
        return False
    sizes = float(np.std(a.u)), float(np.std(b.u))
    return abs(a.period / b.period - 1.0) < _PERIOD and abs(sizes[0] - sizes[1]) < _AMPLITUDE * max(sizes)


def _tones(x: np.ndarray, dt: float) -> list[float]:
    """Return the frequencies of the strongest narrow peaks, in ascending order."""
    power = spectrum(x) ** 2
    # The window widens a peak over its neighbours.
    peaks, _ = find_peaks(power, height=_TALL * float(np.median(power)), distance=4)
    strongest = peaks[np.argsort(power[peaks])[-_NAMED:]]
    return sorted((strongest / (x.size * dt)).tolist())


# Amplitudes and frequencies that count as different; a hold that counts as long, in shortest periods.
_AMPLITUDES, _FREQUENCIES, _HOLD = 1.4, 8.0, 3.0
# Content of a periodic input, in multiples of its fundamental, above which it is a multisine.
_LINES = 30.0
# A jump of the input over its range that is a step; samples at rest before a recording that begins with one.
_JUMP, _BEFORE = 0.2, 4
# What recordings may show, in the words of a piezo actuator and of any other system (empty where it is no question
# there), and what to record for it.
QUESTIONS = (
    ("what depends on the amplitude: bent springs, stops, saturation, friction against hysteresis",
     "what depends on the amplitude: laws that are not linear, limits, thresholds",
     "the same sine at a third and at two thirds of the amplitude"),
    ("what depends on the rate: lags, delays, drag, thresholds that follow the rate",
     "what depends on the rate: lags, delays, losses that are not linear",
     "the same amplitude at a tenth or at ten times the frequency"),
    ("slow memory: creep, leakage, self-heating",
     "slow memory: what leaks, warms up or settles slowly",
     "a step to a constant {input}, held ten times as long as the slowest period"),
    ("a drifting sensor against creep",
     "a drifting sensor against slow memory",
     "a rest at zero {input} after the excitation, as long as the excitation itself"),
    ("resonances, and a second mode",
     "resonances, and further modes",
     "a sweep or a step, sampled at least ten times as fast as the resonance"),
    ("the amplifier against the actuator", "",
     "the voltage at the actuator's terminals, its current or its charge"),
    ("the noise, from what repeats or rests",
     "the noise, from what repeats or rests",
     "three periods or more of every sine, or a rest of {rest} before each recording"),
)  # fmt: skip


@dataclass(frozen=True)
class Ability:
    """A question that recordings may answer."""

    shows: str  # what could be told
    able: bool  # whether these recordings tell
    record: str  # what to record where they do not


def abilities(campaign: Campaign) -> list[Ability]:
    """Return every question that recordings may answer, in the order in which they are worth asking, in the words of
    the system: a network of the user's own is asked for nothing that only an actuator has."""
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    actuator = is_actuator(campaign.setup) and all(r.units == ACTUATOR for r in chosen)
    drives = [r.excitation for r in chosen]
    moving = [e for e in drives if e.amplitude > 0.0]
    lows = [e.low_Hz for e in drives if e.low_Hz > 0.0]
    rests = [(r, longest_hold(r.drive)) for r in chosen]
    longest = max(((last - first) * r.dt for r, (first, last) in rests if last - first > 0.02 * r.u.size), default=0.0)
    # Several amplitudes at about one frequency, or noise, which has them all.
    amplitudes = any(e.kind in ("broadband", "periodic") for e in moving) or any(
        a.amplitude > _AMPLITUDES * b.amplitude and _near(a, b) for a, b in itertools.permutations(moving, 2)
    )
    over_a_decade = bool(lows) and max(e.high_Hz for e in drives) > _FREQUENCIES * min(lows)
    long_hold = longest > (_HOLD / max(lows) if lows else 0.0)
    final_rest = any(e.span[1] < 0.9 * r.t.size and comes_back(r.drive) for r, e in zip(chosen, drives, strict=True))
    multisine = any(e.kind == "periodic" and e.high_Hz > _LINES * e.low_Hz for e in drives)
    broad = multisine or any(e.kind in ("steps", "chirp", "broadband") for e in drives) or any(map(_steps, chosen))
    measured = campaign.voltage == "terminals" or any({"current", "charge"} & set(r.channels) for r in chosen)
    repeats = longest > 0.0 or any(e.period is not None and e.cycles >= 2.0 for e in drives)
    drive = "voltage" if all(r.units.input == "V" for r in chosen) else "input"
    rest = f"{LONG_REST} samples ({duration(LONG_REST * max((r.dt for r in chosen), default=0.0))})"
    answers = (amplitudes, over_a_decade, long_hold, final_rest, broad, measured, repeats)
    asked = zip(((piezo if actuator else usual, record) for piezo, usual, record in QUESTIONS), answers, strict=True)
    return [Ability(shows, able, record.format(input=drive, rest=rest)) for (shows, record), able in asked if shows]


def _near(a: Excitation, b: Excitation) -> bool:
    """Return whether two excitations share a frequency; steps share all."""
    if "steps" in (a.kind, b.kind):
        return a.kind == b.kind
    return min(a.high_Hz, b.high_Hz) >= 0.7 * max(a.low_Hz, b.low_Hz)


def _steps(recording: Recording) -> bool:
    """Return whether an input jumps somewhere, at the first sample perhaps, by a good part of its range."""
    u = recording.drive
    if recording.start.state == "rest" and not recording.further:
        u = np.append([recording.start.input_before] * _BEFORE, u)
    jumps = find_jumps(u)
    return bool(np.any(np.abs(u[jumps] - u[jumps - 1]) > _JUMP * np.ptp(u)))


_NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?: [nµmkM]?(?:m|V|s|N|A|Hz|rad)\b)?")
# Kinds of findings that say that a recording is not what it is taken for.
_WRONG = ("units", "lead")
# Names in a line before only their number is said; check.json has all.
_LISTED = 3
_CHECKS = (buried, quantisation, limits, drift, restless, mains, lead, distortion)


@dataclass(frozen=True)
class Checked:
    """A campaign with all that was noticed in it."""

    campaign: Campaign
    findings: dict[str, list[Finding]]  # by recording, in the order of the campaign
    abilities: list[Ability]  # of all recordings together
    noise: dict[str, NoiseStatement]  # of each recording that has an output

    def __str__(self) -> str:
        """Return what `phnn check` prints."""
        first, understood, rest = describe(self.campaign).split("\n\n", 2)
        lines = [first, ""]
        findings = [(name, f) for name, some in self.findings.items() for f in some]
        if findings := sorted(findings, key=lambda n: (n[1].severity != WARNING, n[1].kind not in _WRONG)):
            # What differs in numbers alone shares the line of the first; other warnings each have their own.
            alone = (f.severity == WARNING and f.kind not in _WRONG for _, f in findings)
            keys = ((n, f.text) if a else _NUMBER.sub("#", f.text) for a, (n, f) in zip(alone, findings, strict=True))
            lines_by_key = zip(keys, ((name, f"{f.severity:8}{name}: {f.text}") for name, f in findings), strict=True)
            lines += ["Noticed:", *_grouped("similar", lines_by_key), ""]
        lines += [understood, ""]
        for head, able in (("These recordings can show:", True), ("They cannot show, for which to record:", False)):
            some = [a for a in self.abilities if a.able is able]
            if some:
                lines += [head, *(f"  {a.shows}" + ("" if able else f"\n      {a.record}") for a in some), ""]
        lines += [rest, ""]
        statements = ((name, "; ".join((s.colour, *s.notes))) for name, s in self.noise.items())
        lines += ["Noise:", *_grouped("the same", ((text, (name, f"{name}: {text}")) for name, text in statements)), ""]
        return "\n".join(lines).rstrip()

    def document(self) -> dict[str, Any]:
        """Return the same as plain data, SI."""
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


def _grouped(how: str, lines: Iterable[tuple[Hashable, tuple[str, str]]]) -> Iterator[str]:
    """Yield one line for each key, the first; ``lines``: key, name of the recording and line."""
    groups: dict[Hashable, tuple[str, list[str]]] = {}
    for key, (name, line) in lines:
        groups.setdefault(key, (line, []))[1].append(name)
    for line, (_, *others) in groups.values():
        named = ", ".join(others) if len(others) <= _LISTED else f"{len(others)} others"
        yield f"  {line} ({how} in {named})" if others else f"  {line}"


def found_by(checks: Sequence[Callable[[Recording], list[Finding]]], campaign: Campaign) -> dict[str, list[Finding]]:
    """Return what odd units and some checks of single recordings find, by recording."""
    # Any other system may give an output that leads its input, such as the force of an imposed motion.
    checks = [one for one in checks if one is not lead or is_actuator(campaign.setup)]
    findings = odd_units(campaign)
    for r in (r for r in campaign.recordings if np.isfinite(r.y).all()):
        findings[r.name] += [f for one in checks for f in one(r)]
    return findings


def doubts(campaign: Campaign) -> tuple[str, ...]:
    """Return what says that recordings are not what they are taken for, a sentence each; similar ones share one."""
    findings = found_by((buried, lead), campaign).items()
    doubtful = [(name, f) for name, some in findings for f in some if f.severity == WARNING]
    lines = ((_NUMBER.sub("#", f.text), (name, f"{name}: {f.text}.")) for name, f in doubtful)
    return tuple(line.strip() for line in _grouped("similar", lines))


def check(campaign: Campaign) -> Checked:
    """Return all checks on all recordings that have an output: ``print(phnn.check(phnn.read("recordings/")))``."""
    recorded = [r for r in campaign.recordings if np.isfinite(r.y).all()]
    findings, among = found_by(_CHECKS, campaign), contaminated(recorded)
    for r in recorded:
        findings[r.name] += among[r.name]
    noise = {r.name: noise_statement(r.noise, r.noise_source, r.units.output, _between_periods(r)) for r in recorded}
    return Checked(campaign, findings, abilities(campaign), noise)
