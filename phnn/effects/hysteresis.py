"""Effects of hysteresis: other forms of it, and thresholds that are not constant."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import product

import numpy as np

from phnn.effects import kinds
from phnn.effects.additions import Parts, Placed, Slipping, at_amplifier, with_following_dead_zones
from phnn.effects.declaration import (
    between,
    bounded,
    constant,
    has_inertia,
    has_motion,
    has_plain_dead_zones,
    has_transducer,
    inertia,
    positive,
    signed,
)
from phnn.effects.effect import Effect, Points, Scales
from phnn.models.actuator import hysteron
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.setup import Setup

# Displacements after which the spring slips, over the largest one; a stiffness over that of the base model, with which
# the response is still proportional to it.
_SLIP_TRAVELS, _SMALL = (0.05, 0.2, 0.6, 2.0), 1e-3


def _slipping_grid(scales: Scales, backs: tuple[float, ...]) -> list[dict[str, float]]:
    stiffness = _SMALL * scales.stiffness
    return [
        {"k_B": stiffness, "F_B": stiffness * share * scales.displacement, "n_B": 1.3, "c_B": back}
        for share, back in product(_SLIP_TRAVELS, backs)
    ]


def bouc_wen_grid(scales: Scales) -> list[dict[str, float]]:
    """Slip after shares of the displacement and beyond it; half as much on the way back."""
    return [point | {"a_B": 0.0} for point in _slipping_grid(scales, (0.5,))]


def duhem_grid(scales: Scales) -> list[dict[str, float]]:
    """Return the same with a way back that is softer, and much stiffer, the larger the force."""
    return _slipping_grid(scales, (-0.3, 2.0))


def rescale_slipping(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale stiffness and force; the displacement to slip does not change."""
    weight = max(factor, 1e-3)
    return {**values, "k_B": weight * values["k_B"], "F_B": weight * values["F_B"]}


_SPRING = (
    positive("k_B", "N/m", "stiffness of the spring that slips", 1e8, strength=True),
    positive("F_B", "N", "force at which it slips", 1e8),
)
_N, _C = "exponent of the slip", "change of its stiffness by that force"
# What stiffens shall slip too: with e = |E|/F_B, slip over stiffening is e^(n-1)/c. A spring that stiffens and hardly
# slips, of a larger n and c, is a nonlinear spring and no hysteresis.
_STIFFENS = (between("n_B", "1", _N, 1.0, 1.5), bounded("c_B", "1", _C, -0.95, 3.0, 0.1))
_SLIPS = (
    between("n_B", "1", _N, 1.0, 3.0),
    bounded("c_B", "1", "slip on the way back over that on the way forth", 0.0, 5.0, 0.1),
    bounded("a_B", "1", "share by which it slips later on the way up, and earlier on the way down", -0.9, 0.9, 0.1),
)
_DUHEM = Effect(
    name="bouc_wen_hysteresis",
    kind=kinds.SHAPE,
    equation=r"\dot{E} = k_B v\,(1 + c\,|E|/F_B - |E/F_B|^n [vE > 0])",
    statement="A hysteresis acts beside the spring: a spring of {k_B} slips the more the nearer its force comes to "
    "{F_B}, with an exponent of {n_B}; by that force its stiffness has changed by a share of {c_B}.",
    fingerprint="Loops with rounded corners whose width depends on the amplitude and not on the frequency.",
    separation="Slow triangles of several amplitudes at two rates: this hysteresis depends on the path alone.",
    references=(
        "Wen 1976, J. Eng. Mech. Div. 102",
        "Ikhouane & Rodellar 2005, J. Sound Vib. 282 (passivity)",
        "Visintin 1994, Differential Models of Hysteresis (Duhem)",
    ),
    declares=(*_SPRING, *_STIFFENS),
    adds=Slipping(
        "slip_B", "duhem", Storage("z_B", "exponential_spring", ("k_B", "F_B", "c_B"), "m"), ("F_B", "n_B", "c_B")
    ),
    grid=duhem_grid,
    applies=has_inertia,
    neighbours=("extra_hysteron", "coulomb_friction", "creep"),
    rescale=rescale_slipping,
)
BOUC_WEN_HYSTERESIS = _DUHEM.or_as(
    equation=r"\dot{E} = k_B\,(v - \beta\,|v|\,e\,\mathrm{sgn}\,E - \gamma\,v\,e), \quad e = |E/F_\pm|^n,"
    r" \quad F_\pm = F_B\,(1 \pm a), \quad \beta, \gamma = (1 \pm c)/2",
    statement="A hysteresis acts beside the spring: a spring of {k_B} slips the more the nearer its force comes to "
    "{F_B}, with an exponent of {n_B}, and on the way back {c_B} times as much. Forwards that force is the share "
    "{a_B} larger, backwards smaller.",
    declares=(*_SPRING, *_SLIPS),
    adds=Slipping("slip_B", "bouc_wen", Storage("z_B", "spring", ("k_B",), "m"), ("F_B", "n_B", "c_B", "a_B")),
    grid=bouc_wen_grid,
).or_as(
    equation=r"V = u - w s, \quad \dot{s} = (\dot{u} - \beta\,|\dot{u}|\,e\,\mathrm{sgn}\,s - \gamma\,\dot{u}\,e)/V_B,"
    r" \quad e = |s/(1 \pm a)|^n, \quad \beta, \gamma = (1 \pm c)/2",
    statement="The hysteresis lies before the moving part: up to {w_B} of the voltage are lost to a state that follows "
    "it over {V_B} and then slips, with an exponent of {n_B}, and on the way back {c_B} times as much. On the way "
    "up that range is the share {a_B} larger, on the way down smaller.",
    references=(
        "Wen 1976, J. Eng. Mech. Div. 102",
        "Low & Guo 1995, J. Microelectromech. Syst. 4 (of a piezoelectric bender)",
    ),
    declares=(
        positive("w_B", "V", "voltage that the hysteresis takes at most", 1e8, strength=True),
        positive("V_B", "V", "voltage over which it slips", 1e4),
        *_SLIPS,
    ),
    adds=at_amplifier("slipping"),
    applies=has_transducer,
    # Slip after shares of the voltage and beyond it.
    grid=Points(
        *(
            {"w_B": (_SMALL * share, "voltage"), "V_B": (share, "voltage"), "n_B": 1.3, "c_B": 0.5, "a_B": 0.0}
            for share in _SLIP_TRAVELS
        )
    ),
    rescale=None,
)


CELLS = tuple(f"D{i}" for i in range(1, 9))
# The travels of a grid point lie evenly between zero and these shares of the largest displacement.
_TRAVELS = (0.25, 1.0)
# How far the travels lean at the largest displacement.
_LEANING = (-0.03, 0.03)


def distributed_grid(scales: Scales) -> list[dict[str, float]]:
    """Cells of one stiffness that yield early, and late, farther backwards than forwards, and less far."""
    stiffness = _SMALL * scales.stiffness / len(CELLS)
    return [
        {f"k_{i}": stiffness for i in CELLS}
        | {f"x_{c}": share * i / (len(CELLS) + 1) * scales.displacement for i, c in enumerate(CELLS, 1)}
        | {"g_D": 0.2 * abs(lean) / scales.displacement, "a_D": lean / scales.displacement}
        for share in _TRAVELS
        for lean in _LEANING
    ]


DISTRIBUTED_HYSTERESIS = Effect(
    name="distributed_hysteresis",
    kind=kinds.SHAPE,
    equation=r"F_h = \sum_i k_i s_i, \quad \dot{s}_i = v \text{ while } -x_i - (g - a) q^2 < s_i < x_i + (g + a) q^2",
    statement="The hysteresis has another form: springs of {k_D1}, {k_D2}, {k_D3}, {k_D4}, {k_D5}, {k_D6}, {k_D7} and "
    "{k_D8} yield after {x_D1}, {x_D2}, {x_D3}, {x_D4}, {x_D5}, {x_D6}, {x_D7} and {x_D8}, and these travels grow with "
    "the square of the displacement, by {g_D} in both directions and by {a_D} more forwards than backwards.",
    fingerprint="Loops whose width grows with the amplitude in another way than the hysterons of the model allow, the "
    "same at every frequency.",
    separation="Slow triangles of many amplitudes, each with a hold at its end.",
    references=(
        "Iwan 1966, J. Appl. Mech. 33 (distributed elements)",
        "Al Janaideh, Rakheja & Su 2011, IEEE/ASME Trans. Mechatron. 16 (envelopes)",
    ),
    declares=(
        *(positive(f"k_{i}", "N/m", "stiffness of a spring that yields", 1e8, strength=True) for i in CELLS),
        *(positive(f"x_{i}", "m", "displacement after which it yields", 1e3) for i in CELLS),
        signed("g_D", "1/m", "growth of the travels with the square of the displacement", 1e9, 100.0, own_size=True),
        signed("a_D", "1/m", "half of what the travels grow more forwards than back", 1e9, 100.0, own_size=True),
    ),
    adds=Parts(
        tuple(Storage(f"s_{i}", "spring", (f"k_{i}",), "m") for i in CELLS),
        tuple(
            Resistor(f"yield_{i}", "plastic", {f"s_{i}": 1.0}, (f"k_{i}", f"x_{i}", "g_D", "a_D"), "q") for i in CELLS
        ),
        tuple(Coupling(f"s_{i}", "p") for i in CELLS),
    ),
    grid=distributed_grid,
    applies=has_motion,
    neighbours=("extra_hysteron", "coulomb_friction", "bouc_wen_hysteresis"),
)


_STORAGE, _RESISTOR, _COUPLING = hysteron("x")


def hysteron_grid(scales: Scales) -> list[dict[str, float]]:
    """Slip after shares of the displacement; relaxation from slower than the slowest to faster than the fastest
    line."""
    small = 1e-3 * scales.voltage
    c = scales.transducer * scales.displacement / small
    rates = (
        2.0 * np.pi * np.array([0.3 * scales.slowest, 3.0 * scales.slowest, scales.fastest / 3.0, 30 * scales.fastest])
    )
    # A weak hysteron has a large C and a low voltage. Its dead zone must be as small, or it would never slip.
    return [
        {"C_x": c, "rho_x": float(rate) * c, "d_x": 2.0 * share * small}
        for share in (0.02, 0.06, 0.15, 0.3, 0.6, 0.9)
        for rate in rates
    ]


def rescale_hysteron(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale ``1/C``, the strength; the relaxation rate ``ϱ⁻¹/C`` and the displacement ``d C/(2α)`` to slip do not
    change."""
    weight = min(max(factor, 1e-2), 1e3)
    return {"C_x": values["C_x"] / weight, "rho_x": values["rho_x"] / weight, "d_x": values["d_x"] * weight}


def weakened(values: Mapping[str, float]) -> dict[str, float]:
    """Return the hysterons of a model at a hundredth of their strength, so that another form of hysteresis can take
    their place."""
    parameters = {}
    for name in _names(values):
        weak = rescale_hysteron({f"{kind}_x": values[f"{kind}_{name}"] for kind in ("C", "rho", "d")}, 0.0)
        parameters.update({f"{key[:-2]}_{name}": value for key, value in weak.items()})
    return parameters


def equivalents(values: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the extra hysteron exchanged with each of the others, any of which may be the superfluous one."""
    return [_in_the_place_of(name, values) for name in _names(values) if name != "x"]


def _names(values: Mapping[str, float]) -> list[str]:
    """Names of the hysterons with a dead zone."""
    return [n[2:] for n in values if n.startswith("d_") and {f"C_{n[2:]}", f"rho_{n[2:]}"} <= set(values)]


def _in_the_place_of(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Parameter values that exchange one hysteron with the extra one."""
    return {f"{kind}_{name}": values[f"{kind}_x"] for kind in ("C", "rho", "d") if name != "x"}


EXTRA_HYSTERON = Effect(
    name="extra_hysteron",
    kind=kinds.SHAPE,
    equation=r"\dot{Q}_x = \alpha v - h_x^{-1}(Q_x/C_x)",
    statement="The hysteresis needs one more hysteron: capacitance {C_x}, dead zone {d_x}, conductance {rho_x} outside "
    "it.",
    fingerprint="Loops whose width grows with the amplitude in another way than the hysterons of the model allow: "
    "rounder corners.",
    separation="Slow triangles of many amplitudes, each with a hold at its end: a hysteron needs a displacement to "
    "slip, creep and friction do not.",
    references=("Díaz, Ramírez, Le Gorrec & Wu, eqs. (1)–(4)",),
    declares=(
        positive("C_x", "F", "capacitance of hysteron x", strength=True),
        positive("rho_x", "S", "conductance of hysteron x outside its dead zone"),
        positive("d_x", "V", "width of the dead zone of hysteron x"),
    ),
    adds=Parts((_STORAGE,), (_RESISTOR,), (_COUPLING,)),
    grid=hysteron_grid,
    applies=has_transducer,
    neighbours=("creep", "coulomb_friction"),
    rescale=rescale_hysteron,
    equivalents=equivalents,
)


HYSTERESIS_ASYMMETRY = Effect(
    name="hysteresis_asymmetry",
    kind=kinds.THRESHOLD_BY_DISPLACEMENT,
    equation=r"d_i(q) = d_i \max(0, 1 + \kappa_d\, q/q_d)",
    statement="The hysteresis loop is wider on one side: the dead zones grow by the share {kappa_d} per {q_d} of "
    "displacement.",
    fingerprint="The loop is wider on one side of the displacement than on the other: even harmonics that carry "
    "dissipation.",
    separation="Small slow loops about a high and a low offset: thresholds that follow the displacement change their "
    "width, electrostriction only their slope.",
    references=("Díaz, Ramírez, Le Gorrec & Wu, sec. 2.4.3 (asymmetric actuators)",),
    declares=(
        bounded("kappa_d", "1", "asymmetry of hysteresis", -3.0, 3.0, 0.05, strength=True),
        constant("q_d", "m", "reference displacement of the asymmetry"),
    ),
    adds=partial(with_following_dead_zones, law="following_dead_zone", state="q"),
    grid=Points({"kappa_d": 1e-3, "q_d": "displacement"}),
    applies=has_plain_dead_zones,
    neighbours=("electrostriction",),
)


def follow_rate(setup: Setup, parameters: Placed) -> Setup:
    """Return every dead zone becomes ``d_i (1 + κ |v|)``, ``v = p/m``: the law reads the momentum."""
    return with_following_dead_zones(setup, parameters, "rate_dependent_dead_zone", "p", (inertia(setup),))


def moves_plain_dead_zones(setup: Setup) -> bool:
    """At least one resistor has a dead zone that follows no state yet, and a mass of constant inertia moves."""
    return has_inertia(setup) and has_plain_dead_zones(setup)


RATE_DEPENDENT_THRESHOLD = Effect(
    name="rate_dependent_threshold",
    kind=kinds.THRESHOLD_BY_RATE,
    equation=r"d_i(v) = d_i (1 + \kappa_v |v|)",
    statement="The hysteresis loop widens with the speed: the dead zones grow in proportion to it, by {kappa_v}.",
    fingerprint="The loop grows wider with frequency, while its corners stay at the reversals of the motion.",
    separation="Triangles of one amplitude at rates over two decades: thresholds that follow the speed widen the loop "
    "in proportion to the rate, another hysteron narrows or widens it around one rate.",
    references=("Al Janaideh, Rakheja & Su 2009, Mechatronics 19 (rate-dependent play)",),
    declares=(positive("kappa_v", "s/m", "growth of the dead zones with the speed", 1e8, strength=True),),
    adds=follow_rate,
    grid=Points({"kappa_v": (1e-3, "1/velocity")}),
    applies=moves_plain_dead_zones,
    neighbours=("extra_hysteron", "quadratic_drag"),
)
