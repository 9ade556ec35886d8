"""The quality of a recorded output: its steps, its limits, and whether it returns to its start."""

from __future__ import annotations

import numpy as np

from phnn.check.finding import NOTE, WARNING, Finding
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Recording
from phnn.signals.quantisation import quantisation_step
from phnn.units import quantity

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


def quantisation(recording: Recording, excitation: Excitation) -> list[Finding]:
    """The step of which the output's values are multiples, beside the noise."""
    step = quantisation_step(recording.y)
    if step == 0.0 or not recording.noise > 0.0:
        return []
    share = step / recording.noise
    if not recording.noise_found:
        # There is no noise to hold the steps against.
        return [
            Finding(
                "quantisation", NOTE, f"output in steps of {quantity(step, recording.units.output)}", {"step": step}
            )
        ]
    if share < _FINE:
        return []
    text = f"output in steps of {quantity(step, recording.units.output)}, {share:.2g} times the noise"
    values = {"step": step, "step_over_noise": share}
    if share < _COARSE:
        return [Finding("quantisation", NOTE, text, values)]
    return [
        Finding("quantisation", WARNING, f"{text}: steps hide the noise; use a smaller range of the converter", values)
    ]


def limits(recording: Recording, excitation: Excitation) -> list[Finding]:
    """Samples that stand at the output's extremes, as where a converter ends; many more of them reading refuses.

    Where the manifest says that the sensor saturates there, they are data.
    """
    y = recording.y
    unexplained = y[recording.sensor.at_limit(y) == 0]
    at = max((int(np.sum(unexplained == x)) for x in (y.max(), y.min())), default=0)
    holds = float(np.mean(np.diff(recording.drive) == 0.0))
    if at <= max(3, _SHARE * y.size) or quantisation_step(y) > 0.0 or holds > 0.5:
        return []
    text = (
        f"{at} samples stand at the output's extreme value: if the sensor's range ends there, choose a larger one, or "
        f"say so in recordings.yaml, sensor: {{saturates: [LEAST, LARGEST]}}"
    )
    return [Finding("limits", WARNING, text, {"samples": float(at)})]


def drift(recording: Recording, excitation: Excitation) -> list[Finding]:
    """Change of the output's mean from period to period, or between rests at one input, with its standard error.

    The first period is left out, for what the start left dies away in it. Without a noise floor nothing is
    significant.
    """
    if not recording.noise_found:
        return []
    means, spread, rests = _levels(recording, excitation)
    if means.size < 2:
        return []
    change, error = float(means[-1] - means[0]), spread * float(np.sqrt(2.0))
    if abs(change) < _SURE * error:
        return []
    seconds = recording.t.size * recording.dt
    text = (
        f"the output's mean moves by {quantity(change, recording.units.output)} within {seconds:.3g} s at equal input"
    )
    values = {"change": change, "standard_error": error}
    if abs(change) < _MUCH * recording.noise:
        return [Finding("drift", NOTE, text, values)]
    if rests:
        return [Finding("drift", NOTE, f"{text} and then rests there: hysteresis leaves such a change", values)]
    later = float(np.ptp(means[means.size // 2 :]))
    if means.size >= _TELLING and later < max(_SURE * error, _LATE * abs(change)):
        early = "nearly all of it in the first half: what the start left dies away so, and so does creep"
        return [Finding("drift", NOTE, f"{text}, {early}", values)]
    causes = "creep, heating or a drifting sensor"
    severity = WARNING
    if means.size < _TELLING and excitation.period is not None and recording.start.state != "periodic":
        causes = f"what the start left, or {causes}; more periods would tell"
        # From rest a model follows what the start leaves.
        severity = NOTE if recording.start.state == "rest" else WARNING
    else:
        causes = f"{causes}; a long rest at {_zero(recording)} would tell"
    return [Finding("drift", severity, f"{text}: {causes}", values)]


def _zero(recording: Recording) -> str:
    return "zero voltage" if recording.units.input == "V" else "the input zero"


def comes_back(u: np.ndarray) -> bool:
    """Whether an input ends where it began."""
    return bool(abs(u[-1] - u[0]) <= _LEVEL * np.ptp(u))


def _levels(recording: Recording, excitation: Excitation) -> tuple[np.ndarray, float, bool]:
    """Means of the output over stretches of equal input, in order, the standard error of each, and whether the last of
    them is a rest within which the output does not move."""
    first, last = excitation.span
    correlated = float(np.sqrt(max(2.0 * recording.noise_correlation.sum() - 1.0, 1.0)))
    if excitation.period is not None and excitation.cycles >= 3.0:
        size = excitation.period / recording.dt
        # Periods need not be whole numbers of samples: their means come from the integral, interpolated.
        integral = np.concatenate([[0.0], np.cumsum(recording.y)])
        edges = first + size * np.arange(1, int((last - first) / size + 1e-6) + 1)
        means = np.diff(np.interp(edges, np.arange(integral.size), integral)) / size
        return means, recording.noise * correlated / float(np.sqrt(size)), False
    before, after = recording.y[:first], recording.y[last:]
    if not comes_back(recording.drive) or min(before.size, after.size) < 10:
        return np.zeros(0), 0.0, False
    # What follows the last change of the input is still on its way: its second half counts.
    after = after[after.size // 2 :]
    deviation = recording.noise * correlated
    half = after.size // 2
    moved = abs(float(after[half:].mean() - after[:half].mean())) + _SURE * deviation * float(np.sqrt(2.0 / half))
    change = abs(float(after.mean() - before.mean()))
    # At this rate, what goes on would explain a small share of the change within the whole recording.
    rests = moved * recording.t.size / half < _LATE * change
    return np.array([before.mean(), after.mean()]), deviation / np.sqrt(min(before.size, after.size)), rests
