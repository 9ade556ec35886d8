"""An amplifier that lags behind its command, as a low-pass of first or of second order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Plausible, Scales
from phnn.parameters import Parameter, time_constant
from phnn.setup import Block, Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``τ V̇ = u − V`` before the port."""
    tau = values["tau_a"]
    parameter = time_constant("tau_a", tau, "time constant of the amplifier")
    return setup.with_block("amplifier", Block("lowpass", ("tau_a",)), (parameter,))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Small against the fastest line, and two finite corners where the response is no longer proportional."""
    unit = 1.0 / (2.0 * 3.141592653589793 * scales.fastest)
    return [{"tau_a": unit * share} for share in (1e-3, 0.1, 1.0, 10.0)]


def build_second_order(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``τ² V̈ + 2ζ τ V̇ + V = u`` before the port."""
    added = (
        time_constant("tau_a", values["tau_a"], "time constant of the amplifier"),
        Parameter("zeta_a", values["zeta_a"], "1", 0.05, 20.0, positive=True, description="damping of the amplifier"),
    )
    return setup.with_block("amplifier", Block("second_order_lowpass", ("tau_a", "zeta_a")), added)


def grid_second_order(scales: Scales) -> list[dict[str, float]]:
    """The same time constants, well damped and less."""
    return [{"tau_a": point["tau_a"], "zeta_a": zeta} for point in grid(scales) for zeta in (0.5, 1.0)]


_FIRST_ORDER = Effect(
    name="amplifier_lowpass",
    location="amplifier",
    kind="lag",
    equation=r"\tau_a \dot{V} = u - V",
    statement="The amplifier does not follow its command at once: it is a low-pass with a time constant of {tau_a}.",
    fingerprint="The output lags by a time that grows into a phase proportional to frequency, and its gain falls with "
    "the square of it.",
    separation="A sine well above the corner of the amplifier: a low-pass loses gain there where a delay keeps it; the "
    "terminal voltage, recorded as well, tells the amplifier from the sensor.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    passive=False,
    strength="tau_a",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("tau_a",),
    plausible={"tau_a": Plausible(1e-7, 1e-2, "amplifiers of capacitive loads have bandwidths of 20 Hz to 1 MHz")},
    needs_command=True,
    neighbours=("delay", "sensor_lag"),
)
EFFECT = replace(
    _FIRST_ORDER,
    forms=(
        replace(
            _FIRST_ORDER,
            equation=r"\tau_a^2 \ddot{V} + 2 \zeta_a \tau_a \dot{V} + V = u",
            statement="The amplifier does not follow its command at once: it is a low-pass of second order with a time "
            "constant of {tau_a} and a damping of {zeta_a}.",
            build=build_second_order,
            grid=grid_second_order,
            strength="tau_a",
            parameters=("tau_a", "zeta_a"),
            plausible={
                "tau_a": Plausible(1e-7, 1e-2, "amplifiers of capacitive loads have bandwidths of 20 Hz to 1 MHz"),
                "zeta_a": Plausible(0.3, 2.0, "power amplifiers are tuned to overshoot by no more than a third"),
            },
        ),
    ),
)
