"""An array in a file, known by name, shape and type before its numbers are read."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phnn.recordings.recording import Campaign

# Kinds of numpy's types that are numbers; complex ones are refused where somebody asks for them.
NUMBERS = "iufbc"


@dataclass(frozen=True)
class Stored:
    """Attributes:
    name: of the array, groups before it.
    shape, dtype: as the file states them.
    load: reads the numbers; raises InputRefused where they are damaged or too large.
    unit: that the file states beside the name; empty where it states none.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype
    load: Callable[[], np.ndarray]
    unit: str = ""


def lazily(stored: Stored) -> Callable[[], np.ndarray]:
    """The numbers of an array, read at the first call and kept for further ones."""
    kept: list[np.ndarray] = []

    def get() -> np.ndarray:
        if not kept:
            kept.append(stored.load())
        return kept[0]

    return get


def digest(campaign: Campaign) -> str:
    """SHA-256, in hexadecimal, of all that fits and scores see of the recordings: samples, uses, starts, anchors."""
    found = hashlib.sha256()
    for r in campaign.recordings:
        facts = (r.name, r.start, r.interpolation, r.parts, r.noise, r.period, r.units, r.measures, r.rise)
        known = (r.sensor, r.offset, r.gain, r.instants_declared)
        found.update(repr((*facts, *known, sorted(r.channels), sorted(r.further))).encode())
        others = [values for _, values in (*sorted(r.channels.items()), *sorted(r.further.items()))]
        instants = [] if r.instants is None else [r.instants]
        seen = [] if r.seen is None else [r.seen]
        for values in (r.t, r.u, r.y, r.noise_correlation, *others, *instants, *seen):
            found.update(np.ascontiguousarray(values).tobytes())
    found.update(repr((sorted(campaign.setup.items()), sorted(campaign.known.items()))).encode())
    return found.hexdigest()
