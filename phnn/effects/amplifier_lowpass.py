"""An amplifier that lags behind its command: a low-pass of first or of second order."""

from __future__ import annotations

from phnn.effects import Effect, Scales, at_amplifier, between, kinds, time_constant

_TAU = time_constant("tau_a", "time constant of the amplifier", strength=True).plausibly(
    1e-7, 1e-2, "amplifiers of capacitive loads have bandwidths of 20 Hz to 1 MHz"
)
_ZETA = between("zeta_a", "1", "damping of the amplifier", 0.05, 20.0).plausibly(
    0.3, 2.0, "power amplifiers are tuned to overshoot by no more than a third"
)


def grid(scales: Scales) -> list[dict[str, float]]:
    """A time constant that is small against the fastest line, and two finite corners, where the response is not
    proportional."""
    unit = 1.0 / (2.0 * 3.141592653589793 * scales.fastest)
    return [{"tau_a": unit * share} for share in (1e-3, 0.1, 1.0, 10.0)]


def grid_second_order(scales: Scales) -> list[dict[str, float]]:
    """The same time constants, with high and low damping."""
    return [{"tau_a": point["tau_a"], "zeta_a": zeta} for point in grid(scales) for zeta in (0.5, 1.0)]


EFFECT = Effect(
    name="amplifier_lowpass",
    kind=kinds.LAG,
    equation=r"\tau_a \dot{V} = u - V",
    statement="The amplifier does not follow its command at once: it is a low-pass with a time constant of {tau_a}.",
    fingerprint="The phase of the output falls in proportion to frequency, and above the corner the gain falls with "
    "the square of the frequency.",
    separation="A sine well above the corner of the amplifier: a low-pass loses gain there, a delay does not; the "
    "terminal voltage, recorded as well, tells the amplifier from the sensor.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    declares=(_TAU,),
    adds=at_amplifier("lowpass"),
    grid=grid,
    neighbours=("delay", "sensor_lag"),
).or_as(
    equation=r"\tau_a^2 \ddot{V} + 2 \zeta_a \tau_a \dot{V} + V = u",
    statement="The amplifier does not follow its command at once: it is a low-pass of second order with a time "
    "constant of {tau_a} and a damping of {zeta_a}.",
    declares=(_TAU, _ZETA),
    adds=at_amplifier("second_order_lowpass"),
    grid=grid_second_order,
)
