"""The HRC actuator with learned resistors on its hysterons, and a learned spring where one is asked for.

A hysteron's voltage is all that recordings show of its resistor, and the flow through it drives it: so a learned
resistor is compared over the flows that were visited, as effort over flow, which a steep slope does not blow up.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, PhnnError
from phnn.models.actuator import hrc
from phnn.network.elements import Network
from phnn.nn import ConvexEnergyMLP, MonotoneMLP, SectorMLP

STARTS = ("parametric", "none")
LAWS = ("damping", "monotone")

# A slope that moves the effort by less than this share of d/2 at the fastest motion is as good as a vertical one.
_FINEST = 0.01
# Hysterons of which nothing is known slip at this share of their effort scale, the second at half of it, and so on; the
# slope there carries these shares of the fastest current at the scale, one that mostly slips and one that does not.
_STAGGERED = 2.0 / 3.0
_CARRIED = (1.0, 0.02)
_POINTS = 200
_ITERATIONS = 200
# Efforts at which a law is looked at for its inverse.
_GRID = 20001

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LearnedLaws:
    """The learned laws of an actuator.

    Attributes:
        width: units of every learned resistor.
        law: ``damping`` (`SectorMLP`, sign-constrained) or ``monotone`` (`MonotoneMLP`).
        symmetric: odd resistors; of ``damping`` only.
        spring_width: units of a learned spring (`ConvexEnergyMLP`), fitted to ``k q²/2`` first; 0 for a linear one.

    Raises:
        InputRefused: an unknown law.
    """

    width: int = 16
    law: str = "damping"
    symmetric: bool = True
    spring_width: int = 0

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise InputRefused(f"law = {self.law!r}: choose {' or '.join(LAWS)}")

    def resistor(self, effort: float, conductance: float, seed: int) -> SectorMLP | MonotoneMLP:
        """Return an untrained resistor of a typical conductance [S] at an effort scale [V]."""
        if self.law == "monotone":
            return MonotoneMLP(effort, conductance * effort, self.width)
        return SectorMLP(effort, conductance * effort, self.width, self.symmetric, seed)


@dataclass(frozen=True)
class Motion:
    """The largest displacement ``reach`` [m] and velocity ``speed`` [m/s] of recordings."""

    reach: float = 1.2e-4
    speed: float = 0.12


def neural_hrc(
    hysterons: int = 2,
    laws: LearnedLaws | None = None,
    start: str = "parametric",
    values: Mapping[str, float] | None = None,
    motion: Motion | None = None,
    hold: Collection[str] = (),
    seed: int = 0,
) -> Network:
    """Eqs. (3)–(6) with a network of units in place of every dead zone ``h_i⁻¹`` of eq. (2).

        Q̇_i = α p/m − φ_i(Q_i/C_i),   ε φ_i(ε) ≥ 0 for all weights

    The effort scale of a hysteron is half of what it would reach if nothing leaked, ``α reach/C_i``; conductances are
    scaled for a threshold as steep as recordings of the ``speed`` of ``motion`` can tell. A symmetric law is the
    default because displacement says nothing of a common shift of both thresholds of a hysteron: it is the same as
    another zero.

    Args:
        hysterons: ``n ≥ 1``.
        laws: form and size of the learned laws; those of `LearnedLaws` by default.
        start: ``parametric``: each learned resistor is first fitted to the dead zone of ``values``, with a slope no
            steeper than recordings of this ``speed`` resolve; ``none``: to thresholds that the drive alone gives, at
            staggered shares of the effort scale, as play operators are usually laid out; docs/learning.md says what
            other starts lead to.
        values: starting values of the parameters of `hrc`; those left out are Table 1's.
        motion: how far and how fast the recordings go.
        hold: parameters that stay at their values (a mass, where no anchor fixes the common factor).
        seed: of the initial weights.

    Raises:
        InputRefused: no hysteron, an unknown start, or a name that the model does not have.
    """
    if hysterons < 1:
        raise InputRefused(f"hysterons = {hysterons}: a neural actuator has at least one")
    if start not in STARTS:
        raise InputRefused(f"start = {start!r}: choose {' or '.join(STARTS)}")
    laws, motion = laws or LearnedLaws(), motion or Motion()
    network = hrc(hysterons, dict(values or {}))
    v = {n: p.value for n, p in network.parameters.items()}
    for i in range(1, hysterons + 1):
        network = network.replace(f"hysteron_{i}", _learned(i, laws, start, v, motion, seed + i))
    if laws.spring_width:
        spring = ConvexEnergyMLP(motion.reach, v["k"] * motion.reach, laws.spring_width)
        q = torch.linspace(-2.0 * motion.reach, 2.0 * motion.reach, _POINTS, dtype=torch.float64)
        _fit(spring, q, v["k"] * q)
        network = network.replace(network.output, spring)
    strangers = sorted(set(hold) - set(network.parameters))
    if strangers:
        raise InputRefused(f"hold: no parameter {strangers[0]}; this model has {', '.join(sorted(network.parameters))}")
    return held(network, hold)


def held(network: Network, hold: Collection[str]) -> Network:
    """Return the network with some parameters fixed at their values."""
    table = {n: replace(p, fixed=p.fixed or n in hold) for n, p in network.parameters.items()}
    return replace(network, parameters=table)


def _learned(
    number: int, laws: LearnedLaws, start: str, values: Mapping[str, float], motion: Motion, seed: int
) -> SectorMLP | MonotoneMLP:
    """Return the resistor of one hysteron, fitted to the dead zone of eq. (2), most closely around its edges."""
    effort, flow = effort_and_flow(number, values, motion)
    if start == "parametric":
        zone, rho = values[f"d_{number}"], resolved_slope(number, values, motion)
        conductance = rho
    else:
        zone, rho, conductance = staggered(number, effort, flow)
    resistor, half, reach = laws.resistor(effort, conductance, seed), 0.5 * zone, 2.5 * effort
    even = torch.linspace(-reach, reach, _POINTS, dtype=torch.float64)
    near = half * torch.linspace(0.8, 1.2, _POINTS // 2, dtype=torch.float64)
    efforts = torch.cat([even, near, -near])
    _fit(resistor, efforts, rho * (torch.relu(efforts - half) - torch.relu(-efforts - half)))
    return resistor


def effort_and_flow(number: int, values: Mapping[str, float], motion: Motion) -> tuple[float, float]:
    """Return the effort scale [V] of a hysteron, numbered from 1, and the fastest current [A]."""
    return 0.5 * values["alpha"] * motion.reach / values[f"C_{number}"], values["alpha"] * motion.speed


def resolved_slope(number: int, values: Mapping[str, float], motion: Motion) -> float:
    """Return the slope [S] of a dead zone, numbered from 1, or the steepest that the recordings' speed can tell."""
    flow = effort_and_flow(number, values, motion)[1]
    return min(values[f"rho_{number}"], flow / (_FINEST * 0.5 * values[f"d_{number}"]))


def staggered(number: int, effort: float, flow: float) -> tuple[float, float, float]:
    """Dead zone ``d`` [V], its slope ``ϱ⁻¹`` [S], and a conductance [S], of a hysteron of which nothing is known.

    Args:
        number: of the hysteron, from 1.
        effort: scale of its effort [V]; flow: fastest current [A].
    """
    carried = _CARRIED[(number - 1) % len(_CARRIED)] * flow
    rho = carried * number / ((1.0 - _STAGGERED) * effort)
    return 2.0 * _STAGGERED * effort / number, rho, 2.0 * carried / effort


def _fit(law: nn.Module, x: Tensor, target: Tensor) -> None:
    """Fit a law to values by least squares, by a quasi-Newton method."""
    unit = target.square().mean().sqrt()
    optimiser = torch.optim.LBFGS(
        law.parameters(), max_iter=_ITERATIONS, history_size=30, line_search_fn="strong_wolfe"
    )

    def misfit() -> Tensor:
        optimiser.zero_grad()
        loss = ((law(x) - target) / unit).square().mean()
        loss.backward()
        return loss

    optimiser.step(misfit)


def inverse(law: Callable[[Tensor], Tensor], flows: Array, reach: float) -> Array:
    """Return the (K,) smallest effort [V] within ``reach``, on the side of the flow's sign, at which the law carries
    each flow [A].

    Raises:
        PhnnError: a flow that the law does not reach.
    """
    effort, efforts = np.linspace(0.0, reach, _GRID), np.empty_like(flows)
    for side, mine in ((-1.0, flows < 0.0), (1.0, flows >= 0.0)):
        with torch.no_grad():
            carried = np.maximum.accumulate(side * law(torch.from_numpy(side * effort)).numpy())
        wanted = np.abs(flows[mine])
        if strange := wanted[(wanted <= carried[0]) | (wanted > carried[-1])].tolist():
            raise PhnnError(
                f"the law carries no {strange[0]:g} A within {reach:g} V: give a larger reach, or a flow above 0"
            )
        efforts[mine] = side * np.interp(wanted, carried, effort)
    return efforts


def thresholds(law: Callable[[Tensor], Tensor], largest: float, reach: float, points: int = 50) -> tuple[float, float]:
    """Return where the straight line through the inverse characteristic of each side meets zero flow [V].

    For the dead zone of eq. (2) these are ``−d/2`` and ``d/2`` exactly.

    Args:
        largest: largest flow that was visited [A]; the line is fitted from a twentieth of it on.
        reach: efforts looked at [V].
    """
    flows = np.linspace(0.05 * largest, largest, points)
    low, high = (np.polyfit(s * flows, inverse(law, s * flows, reach), 1)[1] for s in (-1.0, 1.0))
    return float(low), float(high)
