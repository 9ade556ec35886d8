"""Criteria for where a mismatch is."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.diagnosis.criteria.criterion import STUDIED, criterion


@dataclass(frozen=True)
class Locating:
    """When a location explains the residual, and when two explain it equally well."""

    tied: float = criterion(
        0.03,
        "share of the excess",
        "Locations whose shares differ by less are equally good.",
        STUDIED,
    )
    drift_weight: float = criterion(
        0.7,
        "1",
        "The share that a slow course of each recording explains counts this much where locations are compared.",
        "Argument: no other recording can test such a course, so that it explains by freedom what others predict.",
    )
    located: float = criterion(
        0.3,
        "share of the excess",
        "A location is believed only if it explains more.",
        STUDIED,
    )
    possible: float = criterion(
        0.05,
        "share of the best location's",
        "An effect is a candidate only where its location explains more than this share of what the best one does.",
        "Argument: what lies elsewhere still explains some of a mismatch, for all locations act through one velocity.",
    )


LOCATING = Locating()
