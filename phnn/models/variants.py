"""The paper's actuator that warms up by what it dissipates (Sec. 2.4.4), and the beam that it drives (Sec. 2.4.3).

The other hysterons of Sec. 2.4.1 and the circuits of Sec. 2.4.2 are bond graphs in files, see `docs/bondgraph.md`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from phnn.configuration import config_folder
from phnn.errors import InputRefused
from phnn.models.network_file import load_graph
from phnn.network.elements import Coupling, Network, Port, Resistor, Storage, interconnect
from phnn.parameters import as_table, constant, positive


def thermal_hrc(hysterons: int = 2, values: dict[str, float] | None = None) -> Network:
    """`phnn.models.actuator.hrc` with the temperature ``T`` of one body, heated by hysterons and damper alike.

        Q̇_i = α(T) p/m − h_i⁻¹(Q_i/C_i, T),   q̇ = p/m,   ṗ = −α(T) Σ Q_i/C_i − k q − b p/m + α(T) V − F
        C_T Ṫ = Σ (Q_i/C_i) h_i⁻¹ + b (p/m)² − (T − T_a)/R_T
        α(T) = α (1 + κ_α ϑ),   ϱ_i⁻¹(T) = ϱ_i⁻¹ max(0, 1 + κ_ϱ ϑ),   d_i(T) = d_i max(0, 1 + κ_d ϑ),   ϑ = T − T_ref

    The last state is ``ϑ``, at rest ``T_a − T_ref``. ``k`` is purely mechanical: with the capacitor ``C`` of Fig. 5 in
    it, it would follow ``α²``. An actuator of constant energies: neither thermal expansion nor pyroelectricity. Values
    that are left out stand in ``configs/network/thermal_hrc.yaml``: Table 1's, and orders of magnitude of the heat,
    none of which has been identified.

    Args:
        hysterons: ``n``, 0 to 2.
        values: parameter values in SI.

    Raises:
        InputRefused: another number, or a value for a parameter that does not exist.
    """
    if not 0 <= hysterons <= 2:
        raise InputRefused(f"hysterons = {hysterons}: give 0, 1 or 2")
    graph = load_graph(config_folder() / "network" / "thermal_hrc.yaml")
    gone = tuple(f"_{i}" for i in range(hysterons + 1, 3))
    shared = () if hysterons else ("kappa_rho", "kappa_d")
    network = replace(
        graph,
        junctions={n: kind for n, kind in graph.junctions.items() if not n.endswith(gone)},
        elements=tuple(e for e in graph.elements if not e.name.endswith(gone)),
        bonds=tuple(b for b in graph.bonds if not b.end.endswith(gone)),
        parameters={n: p for n, p in graph.parameters.items() if not n.endswith((*gone, *shared))},
    ).network()
    return network.with_values(values or {})


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
