"""Gains that tell of a wrong unit: a factor of a thousand to the other recordings, or a stroke that no actuator has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from phnn.check.finding import WARNING, Finding
from phnn.recordings.recording import Campaign, Recording, dominant_frequency

# Units differ by powers of a thousand; a gain is suspicious within this factor of one.
_STEP, _WITHIN = 1000.0, 2.5
# Recordings of one kind that tell what the gain usually is, and within which factor of each other they lie.
_FEWEST, _ALIKE = 3, 30.0
# A recording has a gain if its input moves by this share of the largest one, and its output by so many noise floors.
_MOVES, _SEEN = 0.01, 20.0
# A fast recording may have a small gain: up to this factor of the fastest usual one, it may not.
_FAST = 2.0
# Stroke per volt, from a tube scanner of a tenth of a nanometre to a bender, with a decade beyond both; a command in
# front of an amplifier may be smaller by its gain.
_LEAST, _MOST, _AMPLIFIED = 1e-11, 1e-4, 1e-2


def odd_units(campaign: Campaign) -> dict[str, list[Finding]]:
    """By recording: doubts about the units of its input or output."""
    found: dict[str, list[Finding]] = {r.name: [] for r in campaign.recordings}
    kinds: dict[tuple[str, ...], list[Recording]] = {}
    for r in campaign.recordings:
        if np.isfinite(r.y).all():
            kinds.setdefault((r.measures, r.units.input, r.units.output), []).append(r)
    for some in kinds.values():
        largest = max(float(np.ptp(r.u)) for r in some)
        moving = {r.name: r for r in some if _has_gain(r, largest)}
        for name, finding in (*_against_others(moving), *_absolute(moving, campaign.voltage)):
            found[name].append(finding)
    return found


def doubts_of_units(campaign: Campaign) -> tuple[str, ...]:
    """What `phnn check` warns of in the units of a campaign, a sentence each."""
    return tuple(f"{name}: {f.text}." for name, findings in odd_units(campaign).items() for f in findings)


def _has_gain(r: Recording, largest: float) -> bool:
    floor = r.noise if r.noise_found and np.isfinite(r.noise) else 0.0
    moves, seen = float(np.ptp(r.u)), float(np.ptp(r.y))
    return moves > _MOVES * largest and moves > 0.0 and seen > _SEEN * floor and seen > 0.0


def _gain(r: Recording) -> float:
    return float(np.ptp(r.y) / np.ptp(r.u))


def _against_others(moving: Mapping[str, Recording]) -> list[tuple[str, Finding]]:
    """Gains about 10³ or 10⁻³ times that of most others."""
    gains = {name: _gain(r) for name, r in moving.items()}
    usual = float(np.median(list(gains.values()))) if gains else 1.0
    alike = [name for name, g in gains.items() if max(g / usual, usual / g) < _ALIKE]
    if len(alike) < max(_FEWEST, len(moving) // 2 + 1):
        return []
    fastest = max(dominant_frequency(moving[name]) for name in alike)
    found = []
    for name, gain in gains.items():
        ratio = gain / usual
        slow = ratio > 1.0 or dominant_frequency(moving[name]) <= _FAST * fastest
        if slow and (finding := _finding(ratio, alike)):
            found.append((name, finding))
    return found


def _finding(ratio: float, alike: Sequence[str]) -> Finding | None:
    size = max(ratio, 1.0 / ratio)
    power = round(float(np.log(size) / np.log(_STEP)))
    if power < 1 or max(size / _STEP**power, _STEP**power / size) > _WITHIN:
        return None
    text = (
        f"output over input is {ratio:.3g} times that of the {len(alike)} others: a column has probably another unit "
        f"than is stated (nm, µm, mm; V, kV); correct it in recordings.yaml, columns"
    )
    return Finding("units", WARNING, text, {"gain_over_others": ratio})


def _absolute(moving: Mapping[str, Recording], voltage: str) -> list[tuple[str, Finding]]:
    """Strokes per volt far beyond those of actuators that are sold."""
    most = _AMPLIFIED if voltage == "command" else _MOST
    found = []
    for name, r in moving.items():
        gain = _gain(r)
        if (r.units.input, r.units.output) == ("V", "m") and not _LEAST <= gain <= most:
            text = (
                f"output over input is {gain:.2g} m/V, piezo actuators have {_LEAST:g} to {most:g} m/V: compare the "
                f"units and names of its columns with what was recorded"
            )
            found.append((name, Finding("units", WARNING, text, {"gain": gain})))
    return found
