"""A transducer ratio that falls after high voltage and recovers slowly."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, has_transducer, kinds, positive
from phnn.network.elements import Modulation, ModulatorState


def grid(scales: Scales) -> list[dict[str, float]]:
    """Coercive voltages below the largest voltage; times from a tenth of the longest recording to three times its
    length."""
    return [
        {"delta_z": 1e-3, "tau_z": span * scales.duration, "V_c": share * scales.voltage}
        for share in (0.3, 0.6, 0.85)
        for span in (0.1, 0.3, 1.0, 3.0)
    ]


EFFECT = Effect(
    name="depolarisation",
    kind=kinds.RATIO_BY_PAST_VOLTAGE,
    equation=r"\alpha(z) = \alpha (1 - \delta_z z), \quad \tau_z \dot{z} = \max(|V|/V_c - 1, 0) - z",
    statement="High voltage takes polarisation away: beyond {V_c} the transducer ratio falls by the share {delta_z} "
    "for every further such voltage, with a time constant of {tau_z}.",
    fingerprint="The gain is smaller after a stretch of high voltage than it was before, whatever the frequency.",
    separation="A small sine before and after a hold at high constant voltage: nothing is dissipated there, so a loss "
    "of gain is no heating.",
    references=("Damjanovic 1998, Reports on Progress in Physics 61",),
    declares=(
        positive("delta_z", "1", "loss of coupling per excess of voltage", strength=True),
        positive("tau_z", "s", "time constant of depolarisation", 1e3),
        positive("V_c", "V", "voltage beyond which polarisation is lost", 30.0),
    ),
    adds=Parts(
        modulations=(Modulation("alpha", "depolarised", "declining", ("delta_z",)),),
        memories=(ModulatorState("depolarised", "exceeding", ("tau_z", "V_c"), ("voltage",)),),
    ),
    grid=grid,
    applies=has_transducer,
    neighbours=("self_heating", "sensor_drift"),
)
