"""Recordings of one kind of excitation that are noisier than the others of their kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from phnn.check.quality import WARNING, Finding
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Recording

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
            found[r.name].append(_finding(between[r.name], r.dt, times, len(kin) - 1))
    return found


def _finding(difference: np.ndarray, dt: float, times: float, others: int) -> Finding:
    tones = _tones(difference, dt)
    where = f", most of it in tones at {', '.join(f'{f:.4g}' for f in tones)} Hz" if tones else ""
    text = (
        f"noise between periods {times:.2g} times that of {others} others with such an excitation{where}: leave it "
        f"out, or record it again"
    )
    values = {"noise_over_others": times, **{f"tone_{i}_Hz": f for i, f in enumerate(tones, start=1)}}
    return Finding("contaminated", WARNING, text, values)


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
