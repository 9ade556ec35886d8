"""The symptoms that are significant after correction for their number."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from phnn.diagnosis.symptoms import Symptoms, Trend

# The symptoms that are tested.
_TRENDS = ("by_amplitude", "by_frequency", "even", "odd", "delay", "repetition", "drift")


def told(found: Symptoms, level: float) -> Symptoms:
    """What is significant after correction for the number of symptoms; the rest becomes None.

    Holm's (1979) step-down: the k-th smallest of n p-values has to lie below ``level/(n − k + 1)``. One false sentence
    misleads as much as five do, and the symptoms depend on each other: it bounds the chance of any, whatever their
    dependence. The harmonics come in pairs, of which one alone may be nothing: both stay if either is significant.
    """
    trends = {n: t for n in _TRENDS if isinstance(t := getattr(found, n), Trend)}
    kept: set[str] = set()
    for rank, name in enumerate(sorted(trends, key=lambda n: trends[n].p_value)):
        if trends[name].p_value * (len(trends) - rank) >= level:
            break
        kept.add(name)
    if kept & {"even", "odd"}:
        kept |= {"even", "odd"}
    dropped: dict[str, Any] = {n: None for n in trends if n not in kept}
    return replace(found, **dropped)
