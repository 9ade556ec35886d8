"""Effects of the amplifier: lag, delay, offset, and limits of the voltage and of its rate."""

from __future__ import annotations

import math

from phnn.effects import kinds
from phnn.effects.additions import at_amplifier
from phnn.effects.declaration import between, limit, signed, time_constant
from phnn.effects.effect import Effect, Points

_BOOK = "Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14"
_TAU = time_constant("tau_a", "time constant of the amplifier", strength=True).plausibly(
    1e-7, 1e-2, "amplifiers of capacitive loads have bandwidths of 20 Hz to 1 MHz"
)
_ZETA = between("zeta_a", "1", "damping of the amplifier", 0.05, 20.0).plausibly(
    0.3, 2.0, "power amplifiers are tuned to overshoot by no more than a third"
)


# Time constants: small against the fastest line, and finite corners, where the response is not proportional.
_CORNERS = (1e-3, 0.1, 1.0, 10.0)


AMPLIFIER_LOWPASS = Effect(
    name="amplifier_lowpass",
    kind=kinds.LAG,
    equation=r"\tau_a \dot{V} = u - V",
    statement="The amplifier does not follow its command at once: it is a low-pass with a time constant of {tau_a}.",
    fingerprint="The phase of the output falls in proportion to frequency, and above the corner the gain falls with "
    "the square of the frequency.",
    separation="A sine well above the corner of the amplifier: a low-pass loses gain there, a delay does not; the "
    "terminal voltage, recorded as well, tells the amplifier from the sensor.",
    references=(_BOOK,),
    declares=(_TAU,),
    adds=at_amplifier("lowpass"),
    grid=Points(*({"tau_a": (share, "shortest")} for share in _CORNERS)),
    neighbours=("delay", "sensor_lag"),
).or_as(
    equation=r"\tau_a^2 \ddot{V} + 2 \zeta_a \tau_a \dot{V} + V = u",
    statement="The amplifier does not follow its command at once: it is a low-pass of second order with a time "
    "constant of {tau_a} and a damping of {zeta_a}.",
    declares=(_TAU, _ZETA),
    adds=at_amplifier("second_order_lowpass"),
    grid=Points(*({"tau_a": (share, "shortest"), "zeta_a": zeta} for share in _CORNERS for zeta in (0.5, 1.0))),
)


AMPLIFIER_OFFSET = Effect(
    name="amplifier_offset",
    kind=kinds.OFFSET,
    equation=r"V = u + V_0",
    statement="The amplifier adds {V_0} to its command. If the actuator is linear in the voltage and a spring "
    "holds it, only the zero of the displacement shows the offset.",
    fingerprint="No trace if the actuator is linear in its voltage, as the zero of the displacement absorbs the "
    "offset; otherwise, even harmonics of a voltage that is not centred.",
    separation="The amplifier switched on during a recording, or the terminal voltage recorded as well.",
    references=(_BOOK,),
    declares=(
        signed("V_0", "V", "offset of the amplifier", 1e3, 0.1, strength=True).plausibly(
            -5.0, 5.0, "high-voltage amplifiers are off by a few volts at most"
        ),
    ),
    adds=at_amplifier("offset"),
    grid=Points({"V_0": (1e-3, "voltage")}),
    neighbours=("constant_load", "electrostriction"),
)


_V_MAX = limit("V_max", "V", "amplifier limit", 1e3).plausibly(5.0, 2e3, "piezo amplifiers end between 5 V and 2 kV")
# Soft limits over the largest command.
_LIMITS = (0.5, 0.7, 0.85, 1.0, 1.2, 1.6, 2.5, 5.0)
_N_V = between("n_V", "1", "sharpness of the limit", 1.0, 200.0)


AMPLIFIER_SATURATION = Effect(
    name="amplifier_saturation",
    kind=kinds.LIMIT,
    equation=r"V = \mathrm{clip}(u, \pm V_{max})",
    statement="The amplifier saturates: beyond {V_max} the voltage no longer follows the command, at any frequency.",
    fingerprint="Flat tops begin at one amplitude of the command, at every frequency and on both sides.",
    separation="Sines of rising amplitude about two offsets of the voltage: a limit of the amplifier stays at its "
    "voltage, a stop at its displacement.",
    references=(_BOOK,),
    declares=(_V_MAX,),
    adds=at_amplifier("saturation"),
    # No small strength exists to start from.
    grid=Points(*({"V_max": (share, "voltage")} for share in (0.995, 0.98, 0.95, 0.9, 0.8, 0.65, 0.5))),
    neighbours=("contact_stop", "cubic_stiffness"),
).or_as(
    equation=r"V = u\,(1 + |u/V_{max}|^{n})^{-1/n}",
    statement="The amplifier saturates: towards {V_max} the voltage follows the command less and less, at any "
    "frequency, with a knee of sharpness {n_V}.",
    references=("Rapp 1991, Effects of HPA-nonlinearity on a 4-DPSK/OFDM signal, 2nd ECSC", _BOOK),
    declares=(_V_MAX, _N_V),
    adds=at_amplifier("soft_saturation"),
    grid=Points(*({"V_max": (share, "voltage"), "n_V": n} for share in _LIMITS for n in (2.0, 4.0, 12.0))),
)


DELAY = Effect(
    name="delay",
    kind=kinds.LAG,
    equation=r"V(t) = u(t - \tau_d)",
    statement="The voltage follows its command with a delay of {tau_d} at every frequency. The displacement alone "
    "does not tell this delay from one of the sensor.",
    fingerprint="A phase that falls in proportion to the frequency while the gain stays as it is.",
    separation="A step of the command sampled much faster than the delay: a delay shows nothing and then all of it, "
    "a low-pass or a lagging sensor responds at once.",
    references=("Åström & Wittenmark 1997, Computer-Controlled Systems",),
    declares=(
        time_constant("tau_d", "delay of the voltage", strength=True).plausibly(
            0.0, 0.01, "converters and buffers hold a signal for 10 ms at most"
        ),
    ),
    adds=at_amplifier("delay"),
    # Small against the fastest line, and two finite delays, where the response is not proportional.
    grid=Points(*({"tau_d": (share, "shortest")} for share in (1e-3, 0.03, 0.3))),
    neighbours=("amplifier_lowpass", "sensor_lag"),
)


SLEW_LIMIT = Effect(
    name="slew_limit",
    kind=kinds.SLEW,
    equation=r"|\dot{V}| \leq S",
    statement="The voltage cannot change faster than {S}: the current of the amplifier is limited, so that large fast "
    "commands become triangles.",
    fingerprint="Triangles instead of sines as soon as amplitude times frequency crosses a line, and nothing below it.",
    separation="Sines of one amplitude times frequency at frequencies far apart: a slew limit acts on all of them "
    "alike, drag and a limit of the voltage do not.",
    references=(_BOOK,),
    declares=(limit("S", "V/s", "largest slew rate", 1e3).plausibly(1e2, 1e9, "1 mA into 10 µF to 10 A into 10 nF"),),
    adds=at_amplifier("slew_limit"),
    # Limits below the steepest sine of the command, and decades above it, as a step is steeper than any sine. No small
    # strength exists to start from.
    grid=Points(
        *({"S": (2.0 * math.pi * share, "fastest", "voltage")} for share in (0.5, 0.75, 0.9, 0.98, 4.0, 40.0, 400.0))
    ),
    neighbours=("quadratic_drag", "amplifier_saturation"),
)
