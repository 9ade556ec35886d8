"""The paper's actuator that warms up by what it dissipates (Sec. 2.4.4).

The other hysterons of Sec. 2.4.1, the circuits of Sec. 2.4.2 and the driven beam of Sec. 2.4.3 are bond graphs in
files, see `docs/bondgraph.md`.
"""

from __future__ import annotations

from dataclasses import replace

from phnn.configuration import config_folder
from phnn.errors import InputRefused
from phnn.models.network_file import load_graph
from phnn.network.elements import Network


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
