"""Symptoms of the residual as sentences."""

from __future__ import annotations

from phnn.diagnose.symptoms import Symptoms, Trend, significant
from phnn.report.formatting import p_value
from phnn.units import quantity

# Level of all sentences together.
SIGNIFICANT = 0.01
# An exponent above this is an onset rather than a power; a growth below this is none; exponents within this are alike.
_ONSET, _FLAT, _ALIKE = 6.0, 0.5, 0.1
# Share of the phases that a delay must explain to be called one; share of harmonics that is nearly all.
_LIKE_A_DELAY, _PURE = 0.8, 0.9


def symptom_sentences(every: Symptoms, unit: str = "m") -> tuple[str, ...]:
    """Return what the residual of the base model looks like; nothing is said of what the recordings cannot show, nor of
    what is not significant after correction for the number of symptoms.

    Args:
        unit: of the output.
    """
    shown = significant(every, SIGNIFICANT)
    sentences = [_growth(shown)]
    if "even" in shown and "odd" in shown:
        sentences.append(_harmonics(shown["even"], shown["odd"]))
    if "delay" in shown:
        sentences.append(_phase(shown["delay"]))
    return tuple(s for s in sentences if s)


def _growth(shown: Symptoms) -> str:
    a, f = shown.get("by_amplitude"), shown.get("by_frequency")
    by = [
        f"with the {name} to the power {trend.value:.2g} ± {trend.std:.1g} ({p_value(trend.p_value)})"
        + ", steeply enough for an onset" * (trend is a and trend.value > _ONSET)
        for name, trend in (("amplitude", a), ("frequency", f))
        if trend is not None
    ]
    speed = a and f and f.value > _FLAT and abs(a.value - f.value) < max(2.0 * (a.std + f.std), _ALIKE)
    together = ": it follows amplitude × frequency, that is the speed" if speed else ""
    return f"Over the sines the residual grows {' and '.join(by)}{together}." if by else ""


def _harmonics(even: Trend, odd: Trend) -> str:
    odds = f"even {p_value(even.p_value)}, odd {p_value(odd.p_value)}"
    if odd.value > _PURE:
        return f"Of the harmonics above the first nearly all are odd ({odds}): the cause is symmetric in direction."
    if even.value > _PURE:
        return f"Of the harmonics above the first nearly all are even ({odds}): the cause depends on the direction."
    return f"Even harmonics have {100.0 * even.value:.0f} % of the power above the first, odd ones the rest ({odds})."


def _phase(tau: Trend) -> str:
    side = "lags behind" if tau.value > 0.0 else "runs ahead of"
    size = f"{quantity(abs(tau.value), 's')} ± {quantity(tau.std, 's')}, {p_value(tau.p_value)}"
    if tau.share > _LIKE_A_DELAY:
        return f"The output {side} the model by a phase in proportion to frequency, like a delay ({size})."
    return f"The output {side} the model by a phase that is not in proportion to frequency (mean slope {size})."
