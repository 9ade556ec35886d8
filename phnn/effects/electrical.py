"""Effects of the ceramic: leaking charge, and a transducer ratio that is not constant."""

from __future__ import annotations

import math
from functools import partial

from phnn.effects import kinds
from phnn.effects.additions import Parts, Placed, bent_port
from phnn.effects.declaration import bounded, constant, has_dead_zones, has_transducer, positive, signed
from phnn.effects.effect import Effect, Points, Scales
from phnn.network.elements import Modulation, ModulatorState, Resistor
from phnn.network.roles import charges
from phnn.setup import Setup


def leak(setup: Setup, parameters: Placed) -> Setup:
    """Return ``Q̇_i = α v − h_i⁻¹(e_i) − G e_i``: a linear resistor beside every dead zone."""
    leaks = tuple(Resistor(f"leakage_{n}", "linear", {n: 1.0}, ("G",)) for n in charges(setup.network))
    return Parts(resistors=leaks)(setup, parameters)


def leakage_grid(scales: Scales) -> list[dict[str, float]]:
    """A weak leak over the whole recording, and faster relaxations, with which the charge no longer falls linearly."""
    c = scales.transducer * scales.displacement / scales.voltage
    slow, longest = 2.0 * math.pi * scales.slowest, scales.duration
    return [{"G": rate * c} for rate in (0.01 / longest, 0.3 / longest, 0.1 * slow, slow)]


CHARGE_LEAKAGE = Effect(
    name="charge_leakage",
    kind=kinds.LEAKAGE,
    equation=r"\dot{Q}_i = \alpha v - h_i^{-1}(e_i) - G e_i, \quad e_i = Q_i/C_i",
    statement="The capacitors of the hysterons leak with a conductance of {G} each, so that the charge which "
    "hysteresis holds is slowly lost.",
    fingerprint="On a hold the displacement drifts by at most what the dead zones hold, and slow loops are narrower "
    "than fast ones.",
    separation="Holds of equal length after loops of small and of large amplitude: leakage releases no more than the "
    "dead zones hold and then stops; creep goes on in proportion to the displacement.",
    references=("Goldfarb & Celanovic 1997, IEEE Control Systems 17 (electrical side of a stack)",),
    declares=(
        positive("G", "S", "leakage of the hysterons' capacitors", 1e8, strength=True).plausibly(
            0.0, 0.05, "ceramics of 10⁹ Ω m and 2·10⁻⁸ F/m discharge in 20 s, better ones more slowly", over="C_1"
        ),
    ),
    adds=leak,
    grid=leakage_grid,
    applies=has_dead_zones,
    neighbours=("creep", "extra_hysteron"),
)


DEPOLARISATION = Effect(
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
    # Coercive voltages below the largest voltage; times up to three times the longest recording.
    grid=Points(
        *(
            {"delta_z": 1e-3, "tau_z": (span, "duration"), "V_c": (share, "voltage")}
            for share in (0.3, 0.6, 0.85)
            for span in (0.1, 0.3, 1.0, 3.0)
        )
    ),
    applies=has_transducer,
    neighbours=("self_heating", "sensor_drift"),
)


DISPLACEMENT_COUPLING = Effect(
    name="displacement_coupling",
    kind=kinds.RATIO_BY_DISPLACEMENT,
    equation=r"\alpha(q) = \alpha (1 + \kappa_a\, q/q_a)",
    statement="The transducer ratio follows the displacement: it changes by the share {kappa_a} per {q_a}.",
    fingerprint="Even harmonics and a mean shift with the product of voltage and displacement, weaker and turned in "
    "phase above the resonance.",
    separation="A small sine on several offsets of the voltage, below and above the resonance: a coupling that follows "
    "the displacement changes its gain with the offset and leaves the resonance where it is.",
    references=("van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, ch. 2 (modulated transformer)",),
    declares=(
        bounded("kappa_a", "1", "change of coupling", -3.0, 3.0, 0.05, strength=True),
        constant("q_a", "m", "reference displacement of the coupling"),
    ),
    adds=Parts(modulations=(Modulation("alpha", "q", "affine", ("kappa_a", "q_a")),)),
    grid=Points({"kappa_a": 1e-3, "q_a": "displacement"}),
    applies=has_transducer,
    neighbours=("electrostriction", "quadratic_stiffness", "sensor_nonlinearity"),
)


ELECTROSTRICTION = Effect(
    name="electrostriction",
    kind=kinds.FORCE_BY_VOLTAGE,
    equation=r"F = \alpha (V + \frac{1}{2} \varepsilon V^2)",
    statement="The force is not proportional to the voltage: electrostriction adds the share {epsilon} times half "
    "the voltage, the same at every frequency.",
    fingerprint="Even harmonics and a mean shift with the square of the voltage, the same at every frequency and "
    "without a loop.",
    separation="Small sines about several offsets of the voltage, far below and near the resonance: electrostriction "
    "follows the voltage, the others follow the displacement.",
    references=("Uchino 1997, Piezoelectric Actuators and Ultrasonic Motors",),
    declares=(
        signed("epsilon", "1/V", "electrostriction", 1.0, 1e-3, strength=True).plausibly(
            -0.02, 0.02, "the charge constant of soft ceramics at most doubles up to the coercive voltage, 50 V or more"
        ),
    ),
    # The voltage port acts through ψ(V) = V + ε V²/2; its conjugate current gains the factor 1 + ε V.
    adds=partial(bent_port, law="electrostriction"),
    grid=Points({"epsilon": (1e-3, "1/voltage")}),
    applies=has_transducer,
    neighbours=("displacement_coupling", "quadratic_stiffness", "sensor_nonlinearity"),
)


# Heat capacity of a gram of ceramic. Recordings without a temperature determine κ_T/C_T and R_T C_T only: the capacity
# is a convention.
_CAPACITY = 0.4
_AMBIENT = 293.15
_CHANGE = 1e-3
# Share of the reactive power k q v that is assumed to be dissipated, on average.
_LOSS = 0.1


def heating_grid(scales: Scales) -> list[dict[str, float]]:
    """Heating times as shares of the longest recording; a change of the ratio by about one per mille."""
    power = _LOSS * scales.stiffness * scales.displacement * scales.velocity
    points = []
    for share in (0.05, 0.3, 2.0):
        tau = share * scales.duration
        # Temperature rise at the end of the recording.
        warmth = power * min(tau, scales.duration) / _CAPACITY
        others = {"R_T": tau / _CAPACITY, "C_T": _CAPACITY, "T_a": _AMBIENT, "T_s": 1.0}
        points.append({"kappa_T": _CHANGE / warmth} | others)
    return points


def heats_nothing_yet(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio of the voltage port, and dissipated power heats nothing in the model yet."""
    network = setup.network
    return has_transducer(setup) and bool(network.resistors) and all(m.law != "thermal" for m in network.memories)


SELF_HEATING = Effect(
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
    grid=heating_grid,
    applies=heats_nothing_yet,
    neighbours=("depolarisation", "sensor_drift"),
)
