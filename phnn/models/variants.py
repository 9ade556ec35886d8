"""The paper's actuator and its variants as bond graphs: Fig. 5, and those of Secs. 2.4.1 and 2.4.2.

The four choices of a hysteron, a resistor beside (parallel) or behind (series) a capacitor or an inductor, have the
same map from voltage to displacement, with parameters that these functions compute from those of `actuator.hrc`:

* duality: behind a gyrator of ratio 1 Ω a series RL is a parallel RC, ``L = C``, the law taking a flow for an effort;
* two forms of the same relaxation (Zener): a capacitor ``C'`` in series with a parallel RC is, with
  ``λ = C'/(C' + C)``, a capacitor ``(1 − λ) C'`` beside a series RC of ``λ C'`` and ``λ h⁻¹(λ ·)``, for *any* law.

`docs/bondgraph.md` says which claims of the paper hold and for what.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from phnn.errors import InputRefused
from phnn.models.actuator import hrc
from phnn.network.bondgraph import GY, TF, Bond, BondGraph, C, I, R, Se
from phnn.network.bondgraph.description import Element, Link
from phnn.parameters import Parameter, as_table, positive

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
