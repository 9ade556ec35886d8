"""Criteria for the location of a mismatch."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.criteria.criterion import STUDIED, criterion


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
        "Weight of the share that a slow drift of each recording explains, when locations are compared.",
        "Argument: no other recording can test such a drift; its coefficients are free, others must predict.",
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
        "An effect is a candidate only if its location explains more than this share of the best location's.",
        "Argument: wrong locations explain some of a mismatch too, because all locations act through one velocity.",
    )


LOCATING = Locating()
