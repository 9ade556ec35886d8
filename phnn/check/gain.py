"""Gains that tell of a wrong unit: a factor of a thousand to the other recordings, or a stroke that no actuator has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phnn.check.finding import WARNING, Finding
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Campaign, Recording

# Units differ by powers of a thousand; a gain is suspicious within this factor of one. A resonance or a low-pass seldom
# changes the gain of a whole recording as much.
_STEP, _WITHIN = 1000.0, 2.5
# Recordings of one kind that tell what the gain usually is, and within which factor of each other they lie.
_FEWEST, _ALIKE = 3, 30.0
# Stroke per volt, from a tube scanner of a tenth of a nanometre to a bender, with a decade beyond both.
_GAINS = (1e-11, 1e-4)


def doubts_of_units(campaign: Campaign) -> tuple[str, ...]:
    """What `phnn check` warns of in the units of a campaign, a sentence each."""
    recorded = [r for r in campaign.recordings if np.isfinite(r.y).all()]
    among = odd_units(recorded)
    return tuple(f"{r.name}: {f.text}." for r in recorded for f in (*odd_gain(r), *among[r.name]))


def odd_units(recordings: Sequence[Recording]) -> dict[str, list[Finding]]:
    """By recording: whether its output over its input is about 10³ or 10⁻³ times that of most others."""
    kinds: dict[tuple[str, ...], list[Recording]] = {}
    for r in recordings:
        if np.ptp(r.u) > 0.0 and np.ptp(r.y) > 0.0:
            kinds.setdefault((r.measures, r.units.input, r.units.output), []).append(r)
    found: dict[str, list[Finding]] = {r.name: [] for r in recordings}
    for some in kinds.values():
        gains = {r.name: float(np.ptp(r.y) / np.ptp(r.u)) for r in some}
        usual = float(np.median(list(gains.values())))
        alike = sum(max(g / usual, usual / g) < _ALIKE for g in gains.values())
        if alike < max(_FEWEST, len(some) // 2 + 1):
            continue
        for name, gain in gains.items():
            if finding := _finding(gain / usual, alike):
                found[name].append(finding)
    return found


def _finding(ratio: float, others: int) -> Finding | None:
    size = max(ratio, 1.0 / ratio)
    power = round(float(np.log(size) / np.log(_STEP)))
    if power < 1 or max(size / _STEP**power, _STEP**power / size) > _WITHIN:
        return None
    text = (
        f"output over input is {ratio:.3g} times that of the {others} others: a column has probably another unit "
        f"than is stated (nm, µm, mm; V, kV); correct it in recordings.yaml, columns"
    )
    return Finding("units", WARNING, text, {"gain_over_others": ratio})


def odd_gain(recording: Recording, excitation: Excitation | None = None) -> list[Finding]:
    """Whether the stroke per volt of an actuator is far beyond those that are sold."""
    if (recording.units.input, recording.units.output) != ("V", "m") or not np.ptp(recording.u) > 0.0:
        return []
    gain = float(np.ptp(recording.y) / np.ptp(recording.u))
    if _GAINS[0] <= gain <= _GAINS[1]:
        return []
    text = (
        f"output over input is {gain:.2g} m/V, piezo actuators have {_GAINS[0]:g} to {_GAINS[1]:g} m/V: compare the "
        f"units and names of its columns with what was recorded"
    )
    return [Finding("units", WARNING, text, {"gain": gain})]
