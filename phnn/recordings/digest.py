"""A hash of recordings: the same only where fits and scores see the same."""

from __future__ import annotations

import hashlib

import numpy as np

from phnn.recordings.recording import Campaign


def digest(campaign: Campaign) -> str:
    """SHA-256, in hexadecimal, of all that fits and scores see of the recordings: samples, uses, starts, anchors."""
    found = hashlib.sha256()
    for r in campaign.recordings:
        facts = (r.name, r.start, r.interpolation, r.parts, r.noise, r.period, r.units, r.measures, r.rise)
        known = (r.sensor, r.offset, r.gain, r.instants_declared)
        found.update(repr((*facts, *known, sorted(r.channels), sorted(r.further))).encode())
        others = [values for _, values in (*sorted(r.channels.items()), *sorted(r.further.items()))]
        instants = [] if r.instants is None else [r.instants]
        for values in (r.t, r.u, r.y, r.noise_correlation, *others, *instants):
            found.update(np.ascontiguousarray(values).tobytes())
    found.update(repr((sorted(campaign.setup.items()), sorted(campaign.known.items()))).encode())
    return found.hexdigest()
