"""Channels that are shifted against each other: an output that comes before its input."""

from __future__ import annotations

import numpy as np

from phnn.check.finding import WARNING, Finding
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Recording

# Samples by which an output must lead before a channel is called shifted, and times the uncertainty of the phase.
_SAMPLES, _SURE = 0.5, 4.0


def lead(recording: Recording, excitation: Excitation) -> list[Finding]:
    """Whether the output leads the input at the fundamental: no causal actuator of positive static gain does.

    With the complex amplitudes ``U`` and ``Y`` at ``f`` the lead is ``arg(Y/U) / 2πf``. Hysteresis, damping and every
    lag of amplifier or sensor make it negative; above a resonance it is negative still. Nothing is said where further
    inputs have their part in the output.
    """
    if excitation.kind not in ("sine", "periodic") or excitation.cycles < 1.0 or recording.further:
        return []
    first, last = excitation.span
    # Whole periods only, without the first one where there are more: it carries what the start left.
    period = 1.0 / (excitation.low_Hz * recording.dt)
    count = int(excitation.cycles) - (1 if excitation.cycles >= 2.0 else 0)
    chosen = slice(max(last - round(count * period), first), last)
    phase = 2.0 * np.pi * excitation.low_Hz * recording.t[chosen]
    basis = np.column_stack([np.cos(phase), -np.sin(phase), np.ones(phase.size)])
    weights, *_ = np.linalg.lstsq(basis, np.column_stack([recording.u[chosen], recording.y[chosen]]), rcond=None)
    u, y = (complex(w[0], w[1]) for w in weights.T)
    angle = float(np.angle(y / u))
    uncertain = recording.noise * float(np.sqrt(2.0 / phase.size)) / max(abs(y), 1e-300)
    seconds = angle / (2.0 * np.pi * excitation.low_Hz)
    if not (0.0 < angle < 0.5 * np.pi and angle > _SURE * uncertain and seconds > _SAMPLES * recording.dt):
        return []
    text = (
        f"the output leads the input by {seconds:.3g} s ({seconds / recording.dt:.2g} samples) at "
        f"{excitation.low_Hz:.4g} Hz, as no actuator does: the channels are shifted; sample them "
        f"together, or correct the shift"
    )
    return [Finding("lead", WARNING, text, {"lead_s": seconds})]
