"""A transducer ratio that depends on the temperature, which the dissipated power raises."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, bounded, constant, has_transducer, kinds, positive
from phnn.network.elements import Modulation, ModulatorState
from phnn.setup import Setup

# Heat capacity of a gram of ceramic. Recordings without a temperature determine κ_T/C_T and R_T C_T only: the capacity
# is a convention.
_CAPACITY = 0.4
_AMBIENT = 293.15
_CHANGE = 1e-3
# Share of the reactive power k q v that is assumed to be dissipated, on average.
_LOSS = 0.1


def grid(scales: Scales) -> list[dict[str, float]]:
    """Heating times as shares of the longest recording; a change of the ratio by about one per mille."""
    power = _LOSS * scales.stiffness * scales.displacement * scales.velocity
    found = []
    for share in (0.05, 0.3, 2.0):
        tau = share * scales.duration
        # Temperature rise at the end of the recording.
        warmth = power * min(tau, scales.duration) / _CAPACITY
        others = {"R_T": tau / _CAPACITY, "C_T": _CAPACITY, "T_a": _AMBIENT, "T_s": 1.0}
        found.append({"kappa_T": _CHANGE / warmth} | others)
    return found


def applies(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio of the voltage port, and dissipated power heats nothing in the model yet."""
    network = setup.network
    return has_transducer(setup) and bool(network.resistors) and all(m.law != "thermal" for m in network.memories)


EFFECT = Effect(
    name="self_heating",
    kind=kinds.RATIO_BY_WARMTH,
    equation=r"\alpha(T) = \alpha (1 + \kappa_T (T - T_a)/T_s), \quad C_T \dot{T} = P - (T - T_a)/R_T",
    statement="The actuator heats itself: the transducer ratio changes by the share {kappa_T} per kelvin. The heat "
    "flows to the ambient over {R_T}; a heat capacity of {C_T} is assumed.",
    fingerprint="The gain drifts with the square of the amplitude and with frequency, and recovers at rest.",
    separation="A small sine of low frequency before, after and well after a burst near the resonance: heating needs "
    "dissipation and recovers at rest, polarisation is lost by voltage alone, and a sensor drifts in any case.",
    references=("Ramírez, Maschke & Sbarbaro 2013, Chemical Engineering Science 89 (irreversible systems)",),
    declares=(
        bounded("kappa_T", "1", "change of coupling per kelvin", typical=0.1, strength=True).plausibly(
            -0.01, 0.01, "the constants of piezoceramics change by less than 1 % per kelvin (Jaffe, Cook & Jaffe 1971)"
        ),
        positive("R_T", "K/W", "thermal resistance to the ambient"),
        constant("C_T", "J/K", "heat capacity, a convention"),
        constant("T_a", "K", "temperature of the ambient, where the other parameters hold"),
        constant("T_s", "K", "unit of the temperature coefficient"),
    ),
    adds=Parts(
        modulations=(Modulation("alpha", "theta", "affine", ("kappa_T", "T_s")),),
        memories=(ModulatorState("theta", "thermal", ("C_T", "R_T", "T_a", "T_a"), unit="K"),),
    ),
    grid=grid,
    applies=applies,
    neighbours=("depolarisation", "sensor_drift"),
)
