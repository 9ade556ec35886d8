"""Symptoms of the residual as sentences."""

from __future__ import annotations

from phnn.diagnose.symptoms import Symptoms, Trend, significant
from phnn.report.formatting import p_value
from phnn.units import quantity

# Level of all sentences together.
SIGNIFICANT = 0.01
# An exponent above this is an onset rather than a power; a growth below this is none; exponents within this are alike.
_ONSET, _FLAT, _ALIKE = 6.0, 0.5, 0.1
# Share of the phases that a delay must explain to be called one.
_LIKE_A_DELAY = 0.8
_PURE = 0.9
# Share that does not repeat below which the rest decides.
_MINOR = 0.1


def symptom_sentences(found: Symptoms, unit: str = "m") -> tuple[str, ...]:
    """What the residual of the base model looks like; nothing is said of what the recordings cannot show, nor of what
    is not significant after correction for the number of symptoms.

    Args:
        unit: of the output.
    """
    found = significant(found, SIGNIFICANT)
    sentences = [_growth(found), _harmonics(found), _phase(found), _repetition(found), _drift(found, unit)]
    return tuple(s for s in sentences if s)


def _odds(trend: Trend) -> str:
    return p_value(trend.p_value)


def _exponent(trend: Trend) -> str:
    return f"{trend.value:.2g} ± {trend.std:.1g} ({_odds(trend)})"


def _growth(found: Symptoms) -> str:
    a, f = found.by_amplitude, found.by_frequency
    said = []
    if a is not None:
        onset = ", steeply enough for an onset" if a.value > _ONSET else ""
        said.append(f"with the amplitude to the power {_exponent(a)}{onset}")
    if f is not None:
        said.append(f"with the frequency to the power {_exponent(f)}")
    if not said:
        return ""
    together = ""
    if a is not None and f is not None:
        close = abs(a.value - f.value) < max(2.0 * (a.std + f.std), _ALIKE) and f.value > _FLAT
        together = ": it follows amplitude × frequency, that is the speed" if close else ""
    return f"Over the sines the residual grows {' and '.join(said)}{together}."


def _harmonics(found: Symptoms) -> str:
    if found.even is None or found.odd is None:
        return ""
    even, odd = found.even, found.odd
    odds = f"even {_odds(even)}, odd {_odds(odd)}"
    if odd.value > _PURE:
        return f"Of the harmonics above the first nearly all are odd ({odds}): the cause is symmetric in direction."
    if even.value > _PURE:
        return f"Of the harmonics above the first nearly all are even ({odds}): the cause depends on the direction."
    return f"Even harmonics have {100.0 * even.value:.0f} % of the power above the first, odd ones the rest ({odds})."


def _phase(found: Symptoms) -> str:
    tau = found.delay
    if tau is None:
        return ""
    side = "lags behind" if tau.value > 0.0 else "runs ahead of"
    size = f"{quantity(abs(tau.value), 's')} ± {quantity(tau.std, 's')}, {_odds(tau)}"
    if found.explained > _LIKE_A_DELAY:
        return f"The output {side} the model by a phase in proportion to frequency, like a delay ({size})."
    return f"The output {side} the model by a phase that is not in proportion to frequency (mean slope {size})."


def _repetition(found: Symptoms) -> str:
    r = found.repetition
    # What is but a small part of the mismatch is no mark of it.
    if r is None or found.unrepeated < _MINOR:
        return ""
    return (
        f"The residual does not repeat from period to period: differences are {r.value:.3g} × those of noise "
        f"({_odds(r)}); {100.0 * found.unrepeated:.0f} % of the unexplained power does not repeat."
    )


def _drift(found: Symptoms, unit: str) -> str:
    d = found.drift
    if d is None:
        return ""
    return (
        f"The residual drifts beneath the drive, by {quantity(d.value, unit)}/s ± {quantity(d.std, unit)}/s on average "
        f"({_odds(d)})."
    )
