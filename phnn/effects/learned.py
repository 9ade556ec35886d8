"""Learned elements: generic one-ports and blocks with a few strengths, for physics that the catalogue does not list.

Each is an ordinary `Effect`: a sum of fixed functions, spaced over the recorded range, with fitted strengths. Bounds on
the strengths keep every fit passive (`J = −Jᵀ`, `D ≥ 0`, `H` bounded below) and the characteristic of every block
increasing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from phnn.effects import kinds
from phnn.effects.additions import Chain, Parts, Placed, bent_port, with_following_dead_zones
from phnn.effects.declaration import (
    Declared,
    bounded,
    constant,
    has_motion,
    has_plain_dead_zones,
    has_transducer,
    positive,
    signed,
)
from phnn.effects.effect import Effect, Points, Scales, gathered
from phnn.laws.resistor import SMOOTHED
from phnn.network.elements import Coupling, Modulation, ModulatorState, Resistor, Storage
from phnn.parameters import Parameter
from phnn.setup import Block, Setup

# Start value of strengths that a start does not emphasise, as a share of the others. It is not zero, where a bounded
# optimiser moves slowly.
_FAINT = 0.1
# Lower bound of strengths by which a law divides, as a share of the typical strength: too small to be seen in a
# recording.
NEARLY_ZERO = 1e-9


def strengths(
    names: Iterable[str], unit: str, description: str, most: float = math.inf, typical: float = 1.0
) -> tuple[Declared, ...]:
    """Strengths that cannot be negative, or larger than ``most``; zero switches a function off."""
    return tuple(bounded(n, unit, description, 0.0, most, typical, strength=True) for n in names)


def either(limits: Mapping[str, float], unit: str, description: str, typical: float) -> tuple[Declared, ...]:
    """Strengths of either sign, up to a limit each."""
    return tuple(bounded(n, unit, description, -most, most, typical, strength=True) for n, most in limits.items())


def constants(names: Iterable[str], unit: str, description: str) -> tuple[Declared, ...]:
    """Constant parameters of one sort, which are never estimated."""
    return tuple(constant(n, unit, description) for n in names)


def named(declared: Iterable[Declared]) -> tuple[str, ...]:
    """Names of parameters."""
    return tuple(d.name for d in declared)


def stiffness_of(setup: Setup) -> float:
    """Stiffness of the base model [N/m], 1 if it has none: the scale of learned forces."""
    stiffness = setup.parameters.get("k")
    return stiffness.value if stiffness is not None and stiffness.value > 0.0 else 1.0


def sized(parameters: Placed, typical: float) -> dict[str, Parameter]:
    """Return the parameters; for the estimated ones, ``typical`` is a noticeable change."""
    return {n: p if p.fixed else replace(p, typical=typical) for n, p in parameters.items()}


def starts(
    strengths: Sequence[Declared],
    value: float,
    stressed: Iterable[Iterable[str]],
    constants: Mapping[str, Any],
    *scales: str,
) -> Points:
    """Grid points: all strengths equal, and then each group of them emphasised in turn.

    Args:
        value: size of the strengths, times the scales of these names.
        stressed: groups of their names.
        constants: the element's other parameters.
    """
    names = named(strengths)
    faint, full = dict.fromkeys(names, (_FAINT * value, *scales)), (value, *scales)
    points = [dict.fromkeys(names, full), *(faint | dict.fromkeys(group, full) for group in stressed)]
    return Points(*({**point, **constants} for point in points))


def each(
    strengths: Sequence[Declared], value: Any, constants: Mapping[str, Any], groups: Iterable[Iterable[str]] = ()
) -> Points:
    """Grid points of strengths of either sign: one for each strength, or for each group of their names."""
    names = named(strengths)
    none = dict.fromkeys(names, 0.0)
    alone = tuple(groups) or tuple((n,) for n in names)
    return Points(*({**none, **dict.fromkeys(group, value), **constants} for group in alone))


@dataclass(frozen=True)
class Within:
    """Multiplication of strengths, limited by their bounds.

    If no strength can be negative, a negative factor leaves them unchanged. The data then ask for a smaller sum, which
    does not determine the single strengths, and a bounded optimiser hardly moves from start values near the bounds.

    Attributes:
        strengths: the strengths to multiply.
        may_vanish: whether a negative factor sets a single strength to zero.
    """

    strengths: tuple[Declared, ...]
    may_vanish: bool = False

    def __call__(self, values: Mapping[str, float], factor: float) -> dict[str, float]:
        one_sided = all(d.lower >= 0.0 for d in self.strengths)
        by = 1.0 if one_sided and factor <= 0.0 and not self.may_vanish else factor
        return {**values, **{d.name: min(max(by * values[d.name], d.lower), d.upper) for d in self.strengths}}


# Levels as shares of the largest command.
_BANDS = {"1": 0.02, "2": 0.08, "3": 0.25}
_AMPLIFIER_KNEES = {"4": 0.5, "5": 0.75, "6": 0.92, "7": -0.5, "8": -0.75, "9": -0.92}
_AMPLIFIER_TYPICAL, _AMPLIFIER_SMALL = 0.1, 5e-4

_IN_BANDS, _BEYOND = (tuple(f"a_C{i}" for i in levels) for levels in (_BANDS, _AMPLIFIER_KNEES))
_AMPLIFIER_LEVELS = tuple(f"U_C{i}" for i in (*_BANDS, *_AMPLIFIER_KNEES))
_LOST_GAINS = strengths((*_IN_BANDS, *_BEYOND), "1", "gain lost in the amplifier", 1.0, _AMPLIFIER_TYPICAL)
# The blocks act in series; each takes the share ``a`` of the gain below or beyond its level.
_AMPLIFIER_BLOCKS = tuple(
    Block("dead_band" if i in _BANDS else "knee", (f"a_C{i}", f"U_C{i}")) for i in (*_BANDS, *_AMPLIFIER_KNEES)
)
# All strengths equal; then emphasis on the dead bands, and on the ends.
_AMPLIFIER_GRID = starts(
    _LOST_GAINS,
    _AMPLIFIER_SMALL,
    (_IN_BANDS, _BEYOND),
    {f"U_C{i}": (share, "voltage") for i, share in (_BANDS | _AMPLIFIER_KNEES).items()},
)


LEARNED_AMPLIFIER = Effect(
    name="learned_amplifier",
    kind=kinds.AMPLIFIER_STATIC,
    equation=r"V = f(u), \quad 0 \leq f' \leq 1",
    statement="The amplifier is not linear: it loses {a_C1}, {a_C2} and {a_C3} of its gain below {U_C1}, {U_C2} and "
    "{U_C3}, and {a_C4}, {a_C5}, {a_C6} beyond {U_C4}, {U_C5}, {U_C6}, {a_C7}, {a_C8}, {a_C9} beyond {U_C7}, {U_C8}, "
    "{U_C9}.",
    fingerprint="Plateaus about zero or flat tops, at one voltage whatever the frequency.",
    separation="Sines of rising amplitude about two offsets of the voltage: the amplifier's characteristic stays at "
    "its voltage, a nonlinearity of the actuator at its displacement.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    declares=(*_LOST_GAINS, *constants(_AMPLIFIER_LEVELS, "V", "level below or beyond which the amplifier loses gain")),
    adds=Chain("amplifier", _AMPLIFIER_BLOCKS),
    grid=_AMPLIFIER_GRID,
    neighbours=("amplifier_saturation", "contact_stop", "electrostriction"),
    rescale=Within(_LOST_GAINS),
)


_FADING = strengths(("a_H1", "a_H2"), "1", "share of the slow voltage that fades", 0.999, _AMPLIFIER_TYPICAL)
# Times over that of one radian of the slowest line.
_FADING_TIMES = {"tau_H1": 0.3, "tau_H2": 10.0}


def fading_grid(scales: Scales) -> list[dict[str, float]]:
    """Return both shares equal, and each of them emphasised."""
    turn = 1.0 / (2.0 * math.pi * scales.slowest)
    names = named(_FADING)
    return starts(_FADING, 1e-3, ((n,) for n in names), {n: t * turn for n, t in _FADING_TIMES.items()})(scales)


LEARNED_FADING = Effect(
    name="learned_fading",
    kind=kinds.LAG,
    equation=r"V = u - a_{Hi} z_i, \quad \tau_{Hi} \dot{z}_i = u - z_i",
    statement="The amplifier does not hold its voltage: the share {a_H1} of it fades with the time {tau_H1}, the share "
    "{a_H2} with {tau_H2}.",
    fingerprint="After a step the displacement creeps back towards where it came from; slow sines are smaller, and "
    "ahead of the command.",
    separation="A step held as long as possible with the terminal voltage recorded as well.",
    references=("Fleming & Moheimani 2005, IEEE Transactions on Control Systems Technology 13 (charge drives)",),
    declares=(*_FADING, *(positive(n, "s", "time after which the voltage fades", 1e3) for n in _FADING_TIMES)),
    adds=Chain("amplifier", tuple(Block("fading", (f"a_H{i}", f"tau_H{i}")) for i in "12")),
    grid=fading_grid,
    neighbours=("creep", "charge_leakage"),
    rescale=Within(_FADING),
)


# A noticeable strength, and one at which the response is still proportional to it, as shares of stiffness ×
# displacement.
_DAMPER_NOTICEABLE, _DAMPER_SMALL = 1e-2, 5e-4
# Speeds at which friction reaches half its value, as shares of the largest speed in the slowest and in any recording.
_STICKING, _SLIDING = 0.1, 0.1

# Strengths: friction, viscous damping and drag forwards and backwards; damping and friction that follow the position.
_BY_SPEED = ("F_f1", "F_b1", "F_2", "F_f3", "F_b3", "F_f4", "F_b4")
_BY_POSITION = ("F_q", "F_qR", "F_qL", "F_rR", "F_rL")
_FORCES = strengths((*_BY_SPEED, *_BY_POSITION), "N", "learned damping force")
_DAMPER_CONSTANTS = (
    constant("v_D1", "m/s", "reference speed of the friction of slow motion, 100 × the speed at half the friction"),
    constant("v_D2", "m/s", "reference speed of the friction of fast motion, 100 × the speed at half the friction"),
    constant("v_D3", "m/s", "speed at which the other learned damping forces have their nominal size"),
    constant("v_Dq", "m/s", "reference speed of the damping that follows the position"),
    constant("n_D1", "1", "exponent of the speed: friction"),
    constant("n_D3", "1", "exponent of the speed: viscous damping"),
    constant("n_D4", "1", "exponent of the speed: drag"),
    constant("n_Dq", "1", "exponent of the speed in the damping that follows the position"),
    constant("q_D", "m", "displacement at which the damping that follows the position has its nominal size"),
    constant("c_DR", "1/m", "inverse of that displacement"),
    constant("c_DL", "1/m", "its mirror image"),
    bounded("s_D", "1", "share of that displacement at which the damping on one side sets in", 0.0, 0.9, 0.1),
)
_OF_SPEED = {
    "friction": ("F_f1", "F_b1", "n_D1", "v_D1"),
    "sliding": ("F_2", "F_2", "n_D1", "v_D2"),
    "viscous": ("F_f3", "F_b3", "n_D3", "v_D3"),
    "drag": ("F_f4", "F_b4", "n_D4", "v_D3"),
}
_OF_POSITION = {
    "bowl": ("square_damper", ("F_q", "n_Dq", "v_Dq", "q_D")),
    "right": ("cushion", ("F_qR", "n_Dq", "v_Dq", "c_DR", "s_D")),
    "left": ("cushion", ("F_qL", "n_Dq", "v_Dq", "c_DL", "s_D")),
    "right_friction": ("ramp_damper", ("F_rR", "n_D1", "v_D1", "c_DR")),
    "left_friction": ("ramp_damper", ("F_rL", "n_D1", "v_D1", "c_DL")),
}
_RESISTORS = (
    *(Resistor(f"learned_{n}", "power_damper", {"p": 1.0}, names) for n, names in _OF_SPEED.items()),
    *(Resistor(f"learned_{n}", law, {"p": 1.0}, names, "q") for n, (law, names) in _OF_POSITION.items()),
)


def brake(setup: Setup, parameters: Placed) -> Setup:
    """Return ``F += −σ(v, q) v``, ``σ ≥ 0``: resistors on ``p``, some of which read ``q``."""
    typical = _DAMPER_NOTICEABLE * stiffness_of(setup) * parameters["q_D"].value
    return Parts(resistors=_RESISTORS)(setup, sized(parameters, typical))


def damper_grid(scales: Scales) -> list[dict[str, float]]:
    """Return all strengths equal; emphasis on those of the speed, and on those of the position."""
    slow = 2.0 * np.pi * scales.slowest * scales.displacement
    sticking, sliding = _STICKING * slow / SMOOTHED, _SLIDING * scales.velocity / SMOOTHED
    constants = {
        "v_D1": sticking, "v_D2": sliding, "v_D3": scales.velocity, "v_Dq": scales.velocity,
        "n_D1": 0.0, "n_D3": 1.0, "n_D4": 2.0, "n_Dq": 1.0,
        "q_D": scales.displacement, "c_DR": 1.0 / scales.displacement, "c_DL": -1.0 / scales.displacement, "s_D": 0.0,
    }  # fmt: skip
    force = _DAMPER_SMALL * scales.stiffness * scales.displacement
    return starts(_FORCES, force, (_BY_SPEED, _BY_POSITION), constants)(scales)


LEARNED_DAMPER = Effect(
    name="learned_damper",
    kind=kinds.DISSIPATIVE,
    equation=r"F = \sigma(v, q)\,v, \quad \sigma = \sum_{ij} F_{ij} B_i(v) C_j(q) \geq 0",
    statement="A further damper acts on the moving part. Forwards it brakes with a friction of {F_f1}, a viscous force "
    "of {F_f3} and a drag of {F_f4} at {v_D3}, backwards with {F_b1}, {F_b3} and {F_b4}; with a friction of fast "
    "motion of {F_2}; and at a displacement of {q_D} with a viscous force of {F_q} on both sides, {F_qR} on the right "
    "and {F_qL} on the left, and a friction of {F_rR} and {F_rL}.",
    fingerprint="A loop whose width depends on the velocity, on its direction or on the displacement, and closes at "
    "rest.",
    separation="Sines of several amplitudes and frequencies about several offsets: damping of the speed follows "
    "amplitude times frequency, damping of the position follows the offset.",
    references=("Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30 (friction, direction, position)",),
    declares=(*_FORCES, *_DAMPER_CONSTANTS),
    adds=brake,
    grid=damper_grid,
    applies=has_motion,
    neighbours=("coulomb_friction", "quadratic_drag"),
    rescale=Within(_FORCES),
)


_RATIO_MOST, _RATIO_TYPICAL, _RATIO_SMALL = 3.0, 0.05, 1e-3
_CHANGES_BY_DISPLACEMENT = either(
    dict.fromkeys(("kappa_P1", "kappa_P2", "kappa_P3"), _RATIO_MOST), "1", "learned change of coupling", _RATIO_TYPICAL
)


LEARNED_RATIO_OF_DISPLACEMENT = Effect(
    name="learned_ratio_of_displacement",
    kind=kinds.RATIO_BY_DISPLACEMENT,
    equation=r"\alpha(q) = \alpha (1 + \kappa_{P1} s + \kappa_{P2} s^2 + \kappa_{P3} s^3), \quad s = q/q_P",
    statement="The transducer ratio follows the displacement: at {q_P} it changes by the shares {kappa_P1} "
    "(proportional), {kappa_P2} (square) and {kappa_P3} (cube).",
    fingerprint="Harmonics and a mean shift with the product of voltage and displacement, weaker and turned in phase "
    "above the resonance.",
    separation="A small sine on several offsets of the voltage, below and above the resonance: a coupling that follows "
    "the displacement changes its gain with the offset and leaves the resonance where it is.",
    references=("van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, ch. 2 (modulated transformer)",),
    declares=(*_CHANGES_BY_DISPLACEMENT, constant("q_P", "m", "reference displacement of the learned coupling")),
    adds=Parts(modulations=(Modulation("alpha", "q", "cubic", (*named(_CHANGES_BY_DISPLACEMENT), "q_P")),)),
    grid=each(_CHANGES_BY_DISPLACEMENT, _RATIO_SMALL, {"q_P": "displacement"}),
    applies=has_transducer,
    neighbours=("displacement_coupling", "electrostriction"),
    rescale=Within(_CHANGES_BY_DISPLACEMENT),
)


_CHANGES_BY_VOLTAGE = either(
    dict.fromkeys(("a_P1", "a_P2"), _RATIO_MOST), "1", "learned change of coupling", _RATIO_TYPICAL
)


def has_simple_port(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio by which a voltage port that is linear or electrostrictive acts on ``p``."""
    laws = [p.law for p in setup.network.ports if p.name == "voltage"]
    return has_transducer(setup) and laws[0] in ("linear", "electrostriction")


LEARNED_RATIO_OF_VOLTAGE = Effect(
    name="learned_ratio_of_voltage",
    kind=kinds.FORCE_BY_VOLTAGE,
    equation=r"F = \alpha V (1 + \frac{1}{2} a_{P1} s + \frac{1}{3} a_{P2} s^2), \quad s = V/V_P",
    statement="The transducer ratio follows the voltage: at {V_P} it changes by the shares {a_P1} (with the sign of "
    "the voltage) and {a_P2} (on both sides).",
    fingerprint="Harmonics that depend on the voltage alone, the same at every frequency and without a loop.",
    separation="Small sines about several offsets of the voltage, far below and near the resonance.",
    references=("Uchino 1997, Piezoelectric Actuators and Ultrasonic Motors",),
    declares=(*_CHANGES_BY_VOLTAGE, constant("V_P", "V", "reference voltage of the learned coupling")),
    # The port acts through ψ(V) = V (1 + a₁ s/2 + a₂ s²/3), s = V/V_P: α ψ'(V) = α (1 + a₁ s + a₂ s²).
    adds=partial(bent_port, law="polynomial"),
    grid=each(_CHANGES_BY_VOLTAGE, _RATIO_SMALL, {"V_P": "voltage"}),
    applies=has_simple_port,
    neighbours=("electrostriction", "displacement_coupling"),
    rescale=Within(_CHANGES_BY_VOLTAGE),
)


_CELLS = tuple(str(i) for i in range(1, 7))
# Shortest time, as a share of the fastest period.
_SHORTEST = 0.3
# A noticeable strength, and one at which the response is still proportional to it, as shares of the stiffness.
_RELAXATION_NOTICEABLE, _RELAXATION_SMALL = 0.01, 1e-3

_RELAXING = strengths((f"k_M{i}" for i in _CELLS), "N/m", "stiffness of a learned relaxing spring")
_RELAXATION_TIMES = constants((f"tau_M{i}" for i in _CELLS), "s", "time in which a learned spring relaxes")
_MAXWELL = {f"learned_cell_{i}": (f"k_M{i}", f"tau_M{i}") for i in _CELLS}
_RELAXATION_PARTS = Parts(
    storages=tuple(Storage(cell, "spring", names[:1], "m") for cell, names in _MAXWELL.items()),
    resistors=tuple(Resistor(cell, "maxwell", {cell: 1.0}, names) for cell, names in _MAXWELL.items()),
    couplings=tuple(Coupling(cell, "p", 1.0) for cell in _MAXWELL),
)


def relax(setup: Setup, parameters: Placed) -> Setup:
    """Return ``F += −Σ kᵢ sᵢ``, ``ṡᵢ = v − sᵢ/τᵢ``: storages with ``J[s, p] = 1`` and a linear resistor each.

    The resistors divide by the stiffness, which therefore has a positive lower bound.
    """
    typical = _RELAXATION_NOTICEABLE * stiffness_of(setup)
    least = NEARLY_ZERO * typical
    bounded_parameters = {
        n: p if p.fixed else replace(p, value=max(p.value, least), lower=least)
        for n, p in sized(parameters, typical).items()
    }
    return _RELAXATION_PARTS(setup, bounded_parameters)


def relaxation_grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal; then emphasis on the fast cells, and on the slow ones; times up to the longest recording."""
    times = np.geomspace(_SHORTEST / scales.fastest, scales.duration, len(_CELLS))
    constants = dict(zip(named(_RELAXATION_TIMES), map(float, times), strict=True))
    names, half = named(_RELAXING), len(_CELLS) // 2
    return starts(_RELAXING, _RELAXATION_SMALL * scales.stiffness, (names[:half], names[half:]), constants)(scales)


LEARNED_RELAXATION = Effect(
    name="learned_relaxation",
    kind=kinds.MEMORY,
    equation=r"F = \sum_i k_{Mi}\,s_i, \quad \dot{s}_i = v - s_i/\tau_{Mi}",
    statement="Part of the stiffness relaxes over decades of time: {k_M1} with {tau_M1}, {k_M2} with {tau_M2}, {k_M3} "
    "with {tau_M3}, {k_M4} with {tau_M4}, {k_M5} with {tau_M5} and {k_M6} with {tau_M6}.",
    fingerprint="The displacement goes on growing long after a step, as the logarithm of time rather than towards an "
    "end.",
    separation="A step held as long as possible and back to zero: the recovery shows the same times again.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials, ch. 5",),
    declares=(*_RELAXING, *_RELAXATION_TIMES),
    adds=relax,
    grid=relaxation_grid,
    applies=has_motion,
    neighbours=("creep", "sensor_drift"),
    rescale=Within(_RELAXING),
    several_of="creep",
)


# The slope of the cubic is at least 1 − 2·0.25 − 3·0.16 = 0.02, that of a knee at least 0.1: the characteristic rises.
_SENSOR_LIMITS = {"a_Y2": 0.25, "a_Y3": 0.16, "h_Y1": 0.9, "h_Y2": 0.9, "h_Y3": 0.9, "h_Y4": 0.9}
# Levels of the knees as shares of the displacement.
_SENSOR_KNEES = {"1": 0.35, "2": 0.7, "3": -0.35, "4": -0.7}
_SENSOR_TYPICAL, _SENSOR_SMALL = 0.01, 1e-3

_ERRORS = either(_SENSOR_LIMITS, "1", "learned error of the sensor", _SENSOR_TYPICAL)
_SENSOR_LEVELS = constants(
    ("y_Y", *(f"y_Y{i}" for i in _SENSOR_KNEES)), "{sensed}", "level of the learned characteristic of the sensor"
)
# A cubic; then, at every knee, the share ``h`` of the gain is lost beyond its level.
_SENSOR_BLOCKS = (
    Block("cubic", ("a_Y2", "a_Y3", "y_Y")),
    *(Block("knee", (f"h_Y{i}", f"y_Y{i}")) for i in _SENSOR_KNEES),
)
# The cubic's coefficients one by one, and both knees on either side.
_SENSOR_GRID = each(
    _ERRORS,
    _SENSOR_SMALL,
    {"y_Y": "sensed"} | {f"y_Y{i}": (share, "sensed") for i, share in _SENSOR_KNEES.items()},
    (("a_Y2",), ("a_Y3",), ("h_Y1", "h_Y2"), ("h_Y3", "h_Y4")),
)


LEARNED_SENSOR = Effect(
    name="learned_sensor",
    kind=kinds.SENSOR_STATIC,
    equation=r"y = f(q), \quad f' > 0",
    statement="The sensor is not linear: at {y_Y} it errs by the shares {a_Y2} (square) and {a_Y3} (cube), and it "
    "loses {h_Y1}, {h_Y2}, {h_Y3} and {h_Y4} of its gain beyond {y_Y1}, {y_Y2}, {y_Y3} and {y_Y4}.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, the same at every frequency and "
    "across the resonance.",
    separation="The same sine once with the sensor moved along its range: the sensor's error moves with it.",
    references=("Fleming 2013, Sensors and Actuators A 190 (position sensors), sec. 2.1",),
    declares=(*_ERRORS, *_SENSOR_LEVELS),
    adds=Chain("sensor", _SENSOR_BLOCKS),
    grid=_SENSOR_GRID,
    neighbours=("sensor_nonlinearity", "electrostriction"),
    rescale=Within(_ERRORS),
)


# Bounds: the gain stays above a tenth, and the clock error is at most one radian of the fastest line.
_TIME_LIMITS = {"g_Z1": 0.3, "g_Z2": 0.3, "g_Z3": 0.3, "c_Z": 1.0}

_CHANGES_BY_TIME = either(_TIME_LIMITS, "1", "change of the sensor with time", _SENSOR_TYPICAL)
_TIME_SIZES = (
    constant("T_Z", "s", "time over which the sensor changes"),
    constant("s_Z", "1", "change of the clock for a strength of one"),
)
_TIME_BLOCKS = (Block("clock", ("c_Z", "s_Z")), Block("drifting_gain", ("g_Z1", "g_Z2", "g_Z3", "T_Z")))


LEARNED_SENSOR_OVER_TIME = Effect(
    name="learned_sensor_over_time",
    kind=kinds.SENSOR_OVER_TIME,
    equation=r"y = g(t)\,q((1 - \kappa)\,t)",
    statement="The sensor changes with the time of the recording: its gain by the shares {g_Z1} "
    "(straight), {g_Z2} (square) and {g_Z3} (logarithm) in {T_Z}, and its clock by {c_Z} times {s_Z}.",
    fingerprint="An amplitude that grows or falls, or a growing phase error, with the time since the start.",
    separation="The same sine twice in one long recording, at its start and at its end.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    declares=(*_CHANGES_BY_TIME, *_TIME_SIZES),
    adds=Chain("sensor", _TIME_BLOCKS),
    # One point for each strength.
    grid=each(_CHANGES_BY_TIME, _SENSOR_SMALL, {"T_Z": "duration", "s_Z": (0.5 / math.pi, "1/fastest", "1/duration")}),
    neighbours=("sensor_drift", "self_heating"),
    rescale=Within(_CHANGES_BY_TIME),
)


# Times of ageing as shares of the longest recording: three decades look like the logarithm of time.
_AGES = {"1": 0.01, "2": 0.1, "3": 1.0}
# The product of the three factors stays above a third.
_AGED = either({f"a_A{i}": 0.3 for i in _AGES}, "1", "loss of coupling with time", _RATIO_TYPICAL)
_AGEING_TIMES = constants((f"tau_A{i}" for i in _AGES), "s", "time in which the coupling changes")


LEARNED_RATIO_OVER_TIME = Effect(
    name="learned_ratio_over_time",
    kind=kinds.RATIO_OVER_TIME,
    equation=r"F = \alpha V \prod_i (1 - a_{Ai} z_i), \quad z_i = 1 - e^{-t/\tau_{Ai}}",
    statement="The transducer ratio falls with the time of the recording, whatever the actuator does: by the shares "
    "{a_A1} within {tau_A1}, {a_A2} within {tau_A2} and {a_A3} within {tau_A3} (it rises where they are negative).",
    fingerprint="A gain that grows or falls with the time since the start, the same at every amplitude and frequency.",
    separation="The same sine twice in one long recording, at its start and at its end; once more after a rest as long "
    "as the recording, which tells whether the change comes back.",
    references=("Jaffe, Cook & Jaffe 1971, Piezoelectric Ceramics, ch. 5 (ageing)",),
    declares=(*_AGED, *_AGEING_TIMES),
    adds=Parts(
        modulations=tuple(Modulation("alpha", f"age_{i}", "declining", (f"a_A{i}",)) for i in _AGES),
        memories=tuple(ModulatorState(f"age_{i}", "ageing", (f"tau_A{i}",), ("voltage",)) for i in _AGES),
    ),
    grid=each(_AGED, _RATIO_SMALL, {f"tau_A{i}": (share, "duration") for i, share in _AGES.items()}),
    applies=has_transducer,
    neighbours=("depolarisation", "self_heating"),
    rescale=Within(_AGED),
)


_THRESHOLD_BY_AGE = bounded("kappa_A", "1", "change of the dead zones", -0.95, 3.0, 0.05, strength=True)


def age_dead_zones(setup: Setup, parameters: Placed) -> Setup:
    """Return the setup whose dead zones are ``d_i max(0, 1 + κ z)``, ``z = 1 − e^{−t/τ}``."""
    followed = {n: p for n, p in parameters.items() if n != "tau_A"}
    memory = ModulatorState("age", "ageing", ("tau_A",), ("voltage",))
    aged = Parts(memories=(memory,))(setup, {"tau_A": parameters["tau_A"]})
    return with_following_dead_zones(aged, followed, "following_dead_zone", memory.name)


LEARNED_THRESHOLD_OVER_TIME = Effect(
    name="learned_threshold_over_time",
    kind=kinds.THRESHOLD_OVER_TIME,
    equation=r"d_i(t) = d_i \max(0, 1 + \kappa_A z), \quad z = 1 - e^{-t/\tau_A}",
    statement="The hysteresis changes with the time of the recording, whatever the actuator does: the dead zones by "
    "the share {kappa_A} within {tau_A}.",
    fingerprint="Loops that grow wider or narrower with the time since the start, while their slope stays.",
    separation="The same slow triangle twice in one long recording, at its start and at its end.",
    references=("Damjanovic 1998, Reports on Progress in Physics 61",),
    declares=(
        _THRESHOLD_BY_AGE,
        constant("z_A", "1", "unit of the change"),
        constant("tau_A", "s", "time in which the dead zones change"),
    ),
    adds=age_dead_zones,
    grid=Points(*({"kappa_A": 1e-3, "z_A": 1.0, "tau_A": (share, "duration")} for share in (0.1, 3.0))),
    applies=has_plain_dead_zones,
    neighbours=("hysteresis_asymmetry", "rate_dependent_threshold"),
    rescale=Within((_THRESHOLD_BY_AGE,)),
)


# Gaps as shares of the displacement; beyond the last one, a fifth of the motion remains to identify it.
_GAPS = {"1": 0.2, "2": 0.4, "3": 0.6, "4": 0.8}
# Displacements beyond which the force of a saturating spring no longer grows.
_REACHES = {"5": 0.2, "6": 0.55}
# A noticeable strength, and one at which the response is still proportional to it, as shares of the stiffness.
_SPRING_NOTICEABLE, _SPRING_SMALL = 0.05, 1e-3

_RIGHT, _LEFT = (tuple(f"k_{side}{i}" for i in _GAPS) for side in ("R", "L"))
_YIELDING = tuple(f"k_S{i}" for i in _REACHES)
_STIFFNESSES = strengths((*_RIGHT, *_LEFT, *_YIELDING), "N/m", "stiffness of the learned spring")
_PLACES = constants(
    (f"g_L{i}" for i in (*_GAPS, *_REACHES)), "m", "displacement at which a learned spring sets in or ends"
)
_SPRING_STORAGES = (
    *(Storage(f"learned_stops_{i}", "stops", (f"k_R{i}", f"k_L{i}", f"g_L{i}"), "m") for i in _GAPS),
    *(Storage(f"learned_spring_{i}", "saturating_spring", (f"k_S{i}", f"g_L{i}"), "m") for i in _REACHES),
)
_SPRING_PARTS = Parts(_SPRING_STORAGES, couplings=tuple(Coupling(s.name, "p", 1.0) for s in _SPRING_STORAGES))


def press(setup: Setup, parameters: Placed) -> Setup:
    """``F += −Σ k₊ max(q − g, 0) + Σ k₋ max(−q − g, 0) − Σ k clip(q, ±g)``, each storage with ``J[x, p] = 1``."""
    return _SPRING_PARTS(setup, sized(parameters, _SPRING_NOTICEABLE * stiffness_of(setup)))


LEARNED_SPRING = Effect(
    name="learned_spring",
    kind=kinds.ELASTIC,
    equation=r"F = \sum_i k_{Ri} \max(q - g_i, 0) - k_{Li} \max(-q - g_i, 0) + \sum_j k_{Sj}\,"
    r"\mathrm{clip}(q, \pm g_j)",
    statement="A further spring acts on the moving part, whose force depends on the displacement alone. Its stiffness "
    "grows by {k_R1}, {k_R2}, {k_R3} and {k_R4} beyond {g_L1}, {g_L2}, {g_L3} and {g_L4}, by {k_L1}, {k_L2}, {k_L3} "
    "and {k_L4} on the other side, and falls by {k_S5} and {k_S6} beyond {g_L5} and {g_L6}.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, at every frequency below the "
    "resonance.",
    separation="Slow sines of several amplitudes about several offsets: the force follows the displacement without a "
    "loop.",
    references=("Hastie, Tibshirani & Friedman 2009, The Elements of Statistical Learning, sec. 9.4 (hinges)",),
    declares=(*_STIFFNESSES, *_PLACES),
    adds=press,
    # All strengths equal; then emphasis on the stops on one side, and on the saturating springs.
    grid=starts(
        _STIFFNESSES,
        _SPRING_SMALL,
        (_RIGHT, _LEFT, _YIELDING),
        {f"g_L{i}": (share, "displacement") for i, share in (_GAPS | _REACHES).items()},
        "stiffness",
    ),
    applies=has_motion,
    neighbours=("contact_stop", "cubic_stiffness", "quadratic_stiffness"),
    rescale=Within(_STIFFNESSES),
)


# Errors and forces that repeat along the way: the period is found in the spectrum of the residual along the position.
# A noticeable share of the scale's slope, and of the stiffness times a period.
_WAVE_NOTICEABLE, _PUSH_NOTICEABLE, _WAVE_SMALL = 1e-2, 0.05, 1e-3
# Of a period, whose start value a spectrum gives to a few hundredths.
_STRETCH = 1.5
# Both phases together leave the reading of a scale rising.
_READINGS = either({"h_V1": 0.65, "h_V2": 0.65}, "1", "error of the scale's slope", _WAVE_NOTICEABLE)


LEARNED_WAVE_OF_THE_SENSOR = Effect(
    name="learned_wave_of_the_sensor",
    kind=kinds.SENSOR_STATIC,
    equation=r"y = q + \frac{\lambda}{2\pi}\,(h_{V1} \sin \kappa q + h_{V2} (1 - \cos \kappa q)), \quad "
    r"\kappa = 2\pi/\lambda",
    statement="The reading of the sensor errs periodically along its scale: every {lambda_V} its slope swings by the "
    "shares {h_V1} and {h_V2}.",
    fingerprint="An error that repeats along the displacement, the same forwards and backwards and at every speed.",
    separation="The same sine once with the sensor moved by half a period: the error moves with it.",
    references=("Heydemann 1981, Applied Optics 20 (periodic errors of interferometers and encoders)",),
    declares=(*_READINGS, positive("lambda_V", "{sensed}", "period of the scale's error", _STRETCH)),
    adds=Chain("sensor", (Block("wave", ("h_V1", "h_V2", "lambda_V")),)),
    grid=each(_READINGS, _WAVE_SMALL, {"lambda_V": (0.3, "sensed")}),
    neighbours=("sensor_nonlinearity",),
    rescale=Within(_READINGS),
    wavelength="lambda_V",
)


_WAVES = tuple(signed(n, "N", "force that repeats along the way", 1e9, 1.0, strength=True) for n in ("F_E1", "F_E2"))
_WAVE_SPRING = Storage("learned_wave", "wave_spring", ("F_E1", "F_E2", "lambda_E"), "m")


def cog(setup: Setup, parameters: Placed) -> Setup:
    """Return ``F += −F_E1 sin κq − F_E2 cos κq``, ``κ = 2π/λ``: a storage with ``J[x, p] = 1``."""
    typical = _PUSH_NOTICEABLE * stiffness_of(setup) * parameters["lambda_E"].value
    forces = {n: replace(p, typical=typical) if n != "lambda_E" else p for n, p in parameters.items()}
    return Parts((_WAVE_SPRING,), couplings=(Coupling(_WAVE_SPRING.name, "p", 1.0),))(setup, forces)


# Its energy is bounded, and may be lower than at rest.
cog.passive = False  # type: ignore[attr-defined]


LEARNED_WAVE_OF_THE_SPRING = Effect(
    name="learned_wave_of_the_spring",
    kind=kinds.ELASTIC,
    equation=r"F = F_{E1} \sin \kappa q + F_{E2} \cos \kappa q, \quad \kappa = 2\pi/\lambda",
    statement="A force that repeats along the displacement acts on the moving part: every {lambda_E} it rises and "
    "falls, by {F_E1} (sine) and {F_E2} (cosine).",
    fingerprint="An error that repeats along the displacement, the same forwards and backwards, larger near the "
    "resonance.",
    separation="A slow ramp through several periods, forwards and backwards: both show the same waves.",
    references=("Tomita et al. 1997, IEEE Transactions on Robotics and Automation 13 (cogging)",),
    declares=(*_WAVES, positive("lambda_E", "m", "period of the force", _STRETCH)),
    adds=cog,
    grid=each(_WAVES, (_WAVE_SMALL, "stiffness", "displacement"), {"lambda_E": (0.3, "displacement")}),
    applies=has_motion,
    neighbours=("cubic_stiffness",),
    wavelength="lambda_E",
)


@cache
def learned_elements() -> dict[str, Effect]:
    """Return all learned elements by name; none of them is in the catalogue."""
    return gathered(__name__)
