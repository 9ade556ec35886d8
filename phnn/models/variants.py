"""The paper's actuator and its variants as bond graphs: Fig. 5, and those of Secs. 2.4.1 and 2.4.2.

The four choices of a hysteron, a resistor beside (parallel) or behind (series) a capacitor or an inductor, have the
same map from voltage to displacement, with parameters that these functions compute from those of `actuator.hrc`:

* duality: behind a gyrator of ratio 1 Ω a series RL is a parallel RC, ``L = C``, the law taking a flow for an effort;
* two forms of the same relaxation (Zener): a capacitor ``C'`` in series with a parallel RC is, with
  ``λ = C'/(C' + C)``, a capacitor ``(1 − λ) C'`` beside a series RC of ``λ C'`` and ``λ h⁻¹(λ ·)``, for *any* law.

`docs/bondgraph.md` says which claims of the paper hold and for what. Here are also the actuator that warms up by what
it dissipates (Sec. 2.4.4), and a cantilever in its first modes with the actuator that drives it (Sec. 2.4.3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from phnn.errors import InputRefused
from phnn.models.actuator import hrc
from phnn.network.bondgraph import GY, TF, Bond, BondGraph, C, I, R, Se
from phnn.network.bondgraph.description import Element, Link
from phnn.network.elements import Coupling, Modulation, ModulatorState, Network, Port, Resistor, Storage, interconnect
from phnn.parameters import Parameter, as_table, constant, positive

CHOICES = ("parallel_rc", "series_rl", "series_rc", "parallel_rl")
# Share of the stiffness that the electrical capacitor is taken to contribute, α²/C of k; recordings cannot tell.
SHARE = 0.5
SMALL, LARGE = 1e-3, 0.1
# Current [A] below which the regularised dry friction of a series RL hysteron sticks: creep stays below 1e-4 at 1 Hz.
STICKING = 1e-9


@dataclass
class _Draft:
    """A bond graph as it grows; the mechanical side is there from the start."""

    values: dict[str, float]
    junctions: dict[str, int] = field(default_factory=lambda: {"electrical": 1})
    elements: list[Element] = field(default_factory=list)
    bonds: list[Link] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)

    def add(self, name: str, value: float, unit: str, description: str = "") -> str:
        self.parameters.append(positive(name, value, unit, description))
        return name

    def junction(self, name: str, kind: int, of: Link | None = None) -> str:
        self.junctions[name] = kind
        self.bonds += [of] if of is not None else []
        return name

    def capacitor(self, name: str, junction: str, value: float, key: str) -> None:
        self.elements.append(C(name, junction, "capacitor", (self.add(key, value, "F"),), "C"))

    def coil(self, name: str, junction: str, value: float, key: str) -> None:
        self.elements.append(I(name, junction, "capacitor", (self.add(key, value, "H"),), "V s"))

    def dead_zone(self, i: int, junction: str, slope: float, width: float, direction: str = "conductance") -> None:
        units = ("S", "V") if direction == "conductance" else ("Ohm", "A")
        names = self.add(f"rho_{i}", slope, units[0]), self.add(f"d_{i}", width, units[1])
        self.elements.append(R(f"hysteron_{i}", junction, "dead_zone", names, direction))

    def graph(self, stiffness: float, transducer: str = "electrical") -> BondGraph:
        """The whole actuator; ``transducer`` is the junction whose voltage the transducer takes."""
        v = self.values
        self.junction("mechanical", 1, TF(transducer, "mechanical", "1/alpha"))
        table = [
            positive("m", v["m"], "kg", "moving mass"),
            positive("k", stiffness, "N/m", "stiffness"),
            positive("b", v["b"], "N s/m", "viscous damping"),
            positive("alpha", v["alpha"], "N/V", "transducer ratio"),
            *self.parameters,
        ]
        elements = (
            *self.elements,
            C("q", "mechanical", "spring", ("k",), "m"),
            I("p", "mechanical", "capacitor", ("m",), "kg m/s"),
            R("damper", "mechanical", "linear", ("b",), "resistance"),
            Se("voltage", "electrical", "V"),
            Se("force", "mechanical", "N", -1),
        )
        return BondGraph(self.junctions, elements, tuple(self.bonds), as_table(table))


def hysteron_choice(
    choice: str = "parallel_rc", hysterons: int = 2, values: Mapping[str, float] | None = None, share: float = SHARE
) -> BondGraph:
    """The actuator of Fig. 5 with one of the four hysterons of Sec. 2.4.1, all with the voltage response of `hrc`.

    Args:
        choice: ``parallel_rc`` (the paper's), ``series_rl``, ``series_rc`` or ``parallel_rl``.
        hysterons: ``n ≥ 0``.
        values: of `phnn.models.actuator.hrc`, whose ``k`` is the total stiffness.
        share: part of ``k`` that the electrical capacitor contributes, ``α²/C``, between 0 and 1.

    Raises:
        InputRefused: an unknown choice, a share outside (0, 1), or what `hrc` refuses.
    """
    if choice not in CHOICES:
        raise InputRefused(f"hysteron choice {choice!r}: choose one of {', '.join(CHOICES)}")
    draft = _draft(hysterons, values)
    total, squared = draft.values["k"], draft.values["alpha"] ** 2
    if not 0.0 < share < 1.0:
        raise InputRefused(f"share = {share:g} of the stiffness: give a number between 0 and 1")
    simple = choice in CHOICES[:2]
    # The capacitor is one, or is shared out in series among the hysterons.
    capacitance = squared / (share * total) * (1 if simple else max(hysterons, 1))
    for i in range(1, hysterons + 1):
        _HYSTERONS[choice](draft, i, capacitance)
    if simple or hysterons == 0:
        draft.capacitor("Q_C", "electrical", capacitance, "C")
    return draft.graph((1.0 - share) * total)


def _parallel_rc(draft: _Draft, i: int, outer: float) -> None:
    v = draft.values
    node = draft.junction(f"hysteron_{i}", 0, Bond("electrical", f"hysteron_{i}"))
    draft.capacitor(f"Q_{i}", node, v[f"C_{i}"], f"C_{i}")
    draft.dead_zone(i, node, v[f"rho_{i}"], v[f"d_{i}"])


def _series_rl(draft: _Draft, i: int, outer: float) -> None:
    v = draft.values
    loop = draft.junction(f"hysteron_{i}", 1, GY("electrical", f"hysteron_{i}", 1.0))
    draft.coil(f"phi_{i}", loop, v[f"C_{i}"], f"L_{i}")
    draft.dead_zone(i, loop, v[f"rho_{i}"], v[f"d_{i}"], "resistance")


def zener(outer: float, inner: float, slope: float, width: float) -> tuple[float, float, float, float]:
    """From ``C'`` in series with ``C ∥ h⁻¹`` to a capacitor beside a series RC.

    Args:
        outer, inner: ``C'`` and ``C``; slope, width: of the dead zone ``h⁻¹`` of eq. (2).

    Returns:
        The capacitor beside, the capacitor within the series RC, and slope and width of its dead zone.
    """
    part = outer / (outer + inner)
    return (1.0 - part) * outer, part * outer, part**2 * slope, width / part


def _series_rc(draft: _Draft, i: int, outer: float) -> None:
    v = draft.values
    beside, within, slope, width = zener(outer, v[f"C_{i}"], v[f"rho_{i}"], v[f"d_{i}"])
    node = draft.junction(f"node_{i}", 0, Bond("electrical", f"node_{i}"))
    draft.capacitor(f"Q_C{i}", node, beside, f"C_C{i}")
    loop = draft.junction(f"hysteron_{i}", 1, Bond(node, f"hysteron_{i}"))
    draft.capacitor(f"Q_{i}", loop, within, f"C_{i}")
    draft.dead_zone(i, loop, slope, width)


def _parallel_rl(draft: _Draft, i: int, outer: float) -> None:
    v = draft.values
    behind, within, slope, width = zener(outer, v[f"C_{i}"], v[f"rho_{i}"], v[f"d_{i}"])
    loop = draft.junction(f"loop_{i}", 1, GY("electrical", f"loop_{i}", 1.0))
    draft.coil(f"phi_L{i}", loop, behind, f"L_L{i}")
    node = draft.junction(f"hysteron_{i}", 0, Bond(loop, f"hysteron_{i}"))
    draft.coil(f"phi_{i}", node, within, f"L_{i}")
    draft.dead_zone(i, node, slope, width, "resistance")


_HYSTERONS = dict(zip(CHOICES, (_parallel_rc, _series_rl, _series_rc, _parallel_rl), strict=True))


def hrlc(
    hysterons: int = 1,
    values: Mapping[str, float] | None = None,
    across: str = "hysterons",
    inductance: float = SMALL,
    sticking: float = STICKING,
) -> BondGraph:
    """Fig. 6a: series RL hysterons with a capacitor ``C``; one state more than the HRC actuator.

        across = hysterons:   φ̇_i = Q/C − h_i(φ_i/L_i),       Q̇ = α v − Σ φ_i/L_i,   ṗ = α (V − Q/C) − k q − b v − F
        across = transducer:  φ̇_i = V − Q/C − h_i(φ_i/L_i),   Q̇ = Σ φ_i/L_i − α v,   ṗ = α Q/C − k q − b v − F

    The hysterons lie side by side, dually to the parallel RC hysterons in a row. ``h_i`` is the inverse of eq. (2),
    ``f/ρ + (d/2) sign f``, as a linear resistor and a regularised dry friction ``(d/2) tanh(f/f_s)``.

    Args:
        hysterons: ``n ≥ 1``.
        values: of `phnn.models.actuator.hrc`; ``C`` is its ``C_1``.
        across: what lies beside the capacitor. The text fits both; across the ``hysterons`` a single one becomes that
            of `hrc(1)` for ``L → 0``, across the ``transducer`` only if ``C → 0`` as well.
        inductance: ``L_i`` [H].
        sticking: ``f_s`` [A].

    Raises:
        InputRefused: no hysteron, an unknown arrangement, or what `hrc` refuses.
    """
    if across not in ("transducer", "hysterons"):
        raise InputRefused(f"across = {across!r}: write transducer or hysterons")
    draft = _draft(_at_least_one(hysterons), values)
    v = draft.values
    block = draft.junction("block", 0, Bond("electrical", "block"))
    place = block
    if across == "transducer":
        place = draft.junction("node", 0, Bond("electrical", "node"))
    draft.capacitor("Q_C", place, v["C_1"], "C")
    draft.parameters.append(positive("f_s", sticking, "A", "current below which dry friction sticks"))
    for i in range(1, hysterons + 1):
        loop = draft.junction(f"hysteron_{i}", 1, Bond(block, f"hysteron_{i}"))
        draft.coil(f"phi_{i}", loop, inductance, f"L_{i}")
        slope, half = draft.add(f"rho_{i}", v[f"rho_{i}"], "S"), draft.add(f"V_{i}", 0.5 * v[f"d_{i}"], "V")
        draft.elements.append(R(f"viscous_{i}", loop, "linear", (slope,)))
        draft.elements.append(R(f"dry_{i}", loop, "coulomb", (half, "f_s"), "resistance"))
    return draft.graph(v["k"], "node" if across == "transducer" else "electrical")


def hrcl(hysterons: int = 1, values: Mapping[str, float] | None = None, inductance: float = LARGE) -> BondGraph:
    """Fig. 6b: parallel RC hysterons with an inductor across the transducer.

        Q̇_i = φ/L + α v − h_i⁻¹(Q_i/C_i),   φ̇ = V − Σ Q_i/C_i,   ṗ = α φ̇ − k q − b v − F

    At rest ``φ̇ = 0``, hence ``q = −F/k`` whatever the voltage.

    Args:
        hysterons: ``n ≥ 1``.
        values: of `phnn.models.actuator.hrc`.
        inductance: ``L`` [H].

    Raises:
        InputRefused: no hysteron, or what `hrc` refuses.
    """
    draft = _draft(_at_least_one(hysterons), values)
    for i in range(1, hysterons + 1):
        _parallel_rc(draft, i, 0.0)
    node = draft.junction("node", 0, Bond("electrical", "node"))
    draft.coil("phi", node, inductance, "L")
    return draft.graph(draft.values["k"], "node")


def _at_least_one(hysterons: int) -> int:
    if hysterons < 1:
        raise InputRefused(f"hysterons = {hysterons}: give a count of one or more")
    return hysterons


def _draft(hysterons: int, values: Mapping[str, float] | None) -> _Draft:
    return _Draft({n: p.value for n, p in hrc(hysterons, dict(values or {})).parameters.items()})


# The heat capacity is that of the 1.11 g that the paper's bender weighs, at 350 J/(kg K), a usual figure for PZT
# ceramics. Ambient conductance is some 10 W/(m² K), natural convection and radiation, over its two faces of 32 mm by
# 8 mm. The temperature coefficients are placeholders: of soft PZT, coupling and losses grow and coercivity falls by the
# order of a permille to a percent per kelvin. None of these has been identified.
ORDERS = {
    "C_T": 0.39,
    "R_T": 200.0,
    "T_a": 293.15,
    "T_ref": 293.15,
    "kappa_alpha": 1e-3,
    "kappa_rho": 1e-2,
    "kappa_d": -2e-3,
}


def thermal_hrc(hysterons: int = 2, values: dict[str, float] | None = None) -> Network:
    """`phnn.models.actuator.hrc` with the temperature ``T`` of one body, heated by hysterons and damper alike.

        Q̇_i = α(T) p/m − h_i⁻¹(Q_i/C_i, T),   q̇ = p/m,   ṗ = −α(T) Σ Q_i/C_i − k q − b p/m + α(T) V − F
        C_T Ṫ = Σ (Q_i/C_i) h_i⁻¹ + b (p/m)² − (T − T_a)/R_T
        α(T) = α (1 + κ_α ϑ),   ϱ_i⁻¹(T) = ϱ_i⁻¹ max(0, 1 + κ_ϱ ϑ),   d_i(T) = d_i max(0, 1 + κ_d ϑ),   ϑ = T − T_ref

    The last state is ``ϑ``, at rest ``T_a − T_ref``. ``k`` is purely mechanical: with the capacitor ``C`` of Fig. 5 in
    it, it would follow ``α²``. An actuator of constant energies: neither thermal expansion nor pyroelectricity.

    Args:
        hysterons: ``n ≥ 0``.
        values: parameter values in SI; those left out are Table 1's and `ORDERS`.

    Raises:
        InputRefused: a negative count, or a value for a parameter that does not exist.
    """
    base = hrc(hysterons)
    parameters = [*base.parameters.values(), *_thermal_parameters()]
    return replace(
        base,
        resistors=tuple(_tempered(r) if r.law == "dead_zone" else r for r in base.resistors),
        modulations=(Modulation("alpha", "theta", "affine", ("kappa_alpha", "T_s")),),
        memories=(ModulatorState("theta", "thermal", ("C_T", "R_T", "T_a", "T_ref"), unit="K"),),
        parameters=as_table(parameters),
    ).with_values(values or {})


def _tempered(hysteron: Resistor) -> Resistor:
    names = (*hysteron.parameters, "kappa_rho", "kappa_d")
    return replace(hysteron, law="thermal_dead_zone", parameters=names, modulated_by="theta")


def _thermal_parameters() -> tuple[Parameter, ...]:
    about = {
        "kappa_alpha": "temperature coefficient of the transducer ratio",
        "kappa_rho": "temperature coefficient of the hysterons' conductance",
        "kappa_d": "temperature coefficient of the hysterons' dead zones",
    }
    return (
        positive("C_T", ORDERS["C_T"], "J/K", "heat capacity"),
        positive("R_T", ORDERS["R_T"], "K/W", "thermal resistance to the ambient"),
        constant("T_a", ORDERS["T_a"], "K", "temperature of the ambient"),
        constant("T_ref", ORDERS["T_ref"], "K", "temperature at which the other parameters hold"),
        constant("T_s", 1.0, "K", "unit of temperature coefficients"),
        *(Parameter(n, ORDERS[n], "1/K", typical=1e-3, description=text) for n, text in about.items()),
    )


Array = NDArray[np.float64]


def wave_numbers(modes: int) -> Array:
    """(N,) roots ``β_i L`` of ``cos z cosh z = −1``, of a beam that is clamped at one end and free at the other.

    Raises:
        InputRefused: less than one mode.
    """
    if modes < 1:
        raise InputRefused(f"modes = {modes}: give a count of one or more")
    # Divided by cosh the equation stays of order one; between multiples of π it has one root each.
    return np.array([brentq(_characteristic, np.pi * i, np.pi * (i + 1), xtol=1e-14, rtol=1e-15) for i in range(modes)])


def _characteristic(z: float) -> float:
    return float(np.cos(z) + 1.0 / np.cosh(z))


def mode_shapes(
    place: Array | float,  # (...) position x/L along the beam
    modes: int,
) -> Array:
    """(..., N) shapes ``φ_i`` with ``∫₀¹ φ_i φ_j d(x/L) = δ_ij`` and ``φ_i(1) = ±2``.

        φ = cosh βx − cos βx − σ (sinh βx − sin βx),   σ = (cosh βL + cos βL)/(sinh βL + sin βL)

    Raises:
        InputRefused: less than one mode, or a place that is not on the beam.
    """
    x = np.asarray(place, dtype=np.float64)
    if not ((x >= 0.0) & (x <= 1.0)).all():
        raise InputRefused(f"a place {place} is not on the beam: give x/L between 0, the clamp, and 1, the tip")
    z = wave_numbers(modes)
    # cosh βx − σ sinh βx = ((1 − σ) e^{βx} + (1 + σ) e^{−βx})/2 with 1 − σ written so that e^{βL} does not cancel.
    decay = np.exp(-z)
    below = 1.0 + 2.0 * np.sin(z) * decay - decay**2
    less = 2.0 * decay * (np.sin(z) - np.cos(z) - decay) / below
    arc = x[..., None] * z
    growing = (np.sin(z) - np.cos(z) - decay) / below * np.exp(arc - z)
    return np.asarray(growing + 0.5 * (2.0 - less) * np.exp(-arc) - np.cos(arc) + (1.0 - less) * np.sin(arc))


def cantilever(
    modes: int, length: float, rigidity: float, mass: float, place: float = 1.0, damping: float = 0.005
) -> Network:
    """An Euler–Bernoulli cantilever in its first ``N`` modes, with a force on it at one place.

        q̇_i = p_i,   ṗ_i = −ω_i² q_i − 2 ζ ω_i p_i + φ_i(a) F/√M,   ω_i² = (β_i L)⁴ EI/(M L³),   y = ẇ(a)

    in coordinates in which every modal mass is 1, so that the deflection is ``w(x) = Σ φ_i(x) q_i/√M`` (`deflection`).

    Args:
        modes: ``N``.
        length: ``L`` [m]; rigidity: ``EI`` [N m²]; mass: ``M``, of the whole beam [kg].
        place: where the force acts, ``a/L``.
        damping: ``ζ`` of every mode.

    Returns:
        Storages ``beam_q_i``, ``beam_p_i``, resistors ``beam_damper_i``, and the port ``load`` [N].

    Raises:
        InputRefused: a length, rigidity, mass or damping that is not positive, or what `mode_shapes` refuses.
    """
    for name, value in (("length", length), ("rigidity", rigidity), ("mass", mass), ("damping", damping)):
        if not 0.0 < value < np.inf:
            raise InputRefused(f"{name} = {value:g} of the beam: give a positive number in SI units")
    omega = wave_numbers(modes) ** 2 * np.sqrt(rigidity / (mass * length**3))
    shapes = mode_shapes(place, modes) / np.sqrt(mass)
    numbers = range(1, modes + 1)
    parameters = [constant("beam_mass", 1.0, "1", "modal mass in coordinates in which it is one")]
    for i, w in zip(numbers, omega.tolist(), strict=True):
        parameters.append(positive(f"beam_k_{i}", w**2, "1/s2", f"square of the frequency of mode {i}"))
        parameters.append(positive(f"beam_c_{i}", 2.0 * damping * w, "1/s", f"damping of mode {i}"))
    storages = [Storage(f"beam_q_{i}", "spring", (f"beam_k_{i}",), "m kg1/2") for i in numbers]
    storages += [Storage(f"beam_p_{i}", "capacitor", ("beam_mass",), "m kg1/2/s") for i in numbers]
    return Network(
        tuple(storages),
        tuple(Resistor(f"beam_damper_{i}", "linear", {f"beam_p_{i}": 1.0}, (f"beam_c_{i}",)) for i in numbers),
        tuple(Coupling(f"beam_q_{i}", f"beam_p_{i}") for i in numbers),
        (Port("load", {f"beam_p_{i}": float(s) for i, s in zip(numbers, shapes, strict=True)}, unit="N"),),
        as_table(parameters),
        "beam_q_1",
    )


def deflection(
    network: Network,
    states: Array,  # (..., n) states of a network that contains a beam
    mass: float,
    place: Array | float = 1.0,  # (...) x/L
) -> Array:
    """(...) ``w(x) = Σ φ_i(x) q_i/√M`` [m] of the beam within a network, at one place or along several.

    Several places (K,) are the last dimension of the result.
    """
    columns = [k for k, name in enumerate(network.state_names) if name.startswith("beam_q_")]
    shapes = mode_shapes(place, len(columns)) / np.sqrt(mass)
    return np.asarray(states[..., columns] @ shapes.T)


def driven_beam(actuator: Network, beam: Network, stiffness: float) -> Network:
    """An actuator whose mass drives a beam through a joint, an elastic connection between their force ports.

        ṡ = ẇ(a) − v,   the actuator feels k_j s and the beam −k_j s

    Args:
        actuator: with the port ``force`` of `phnn.models.actuator.hrc`, which acts against its velocity.
        beam: of `cantilever`.
        stiffness: ``k_j`` of the joint [N/m]; a rigid joint would make the momenta depend on each other.

    Raises:
        StructureViolated: what `phnn.network.elements.interconnect` refuses.
    """
    joint = positive("joint_k", stiffness, "N/m", "stiffness of the joint between actuator and beam")
    return interconnect(actuator, "force", beam, "load", Storage("joint", "spring", ("joint_k",), "m"), (joint,))
