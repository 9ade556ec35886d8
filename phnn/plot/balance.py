"""The energy balance of a simulation: what is stored, supplied and dissipated, and what the balance misses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from phnn.diagnose.diagnosis import Diagnosis
from phnn.integrate.residual import power_balance
from phnn.model import Model
from phnn.network.system import PortHamiltonianSystem
from phnn.plot.panels import Array, Panels, grid, network_model, scaled
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, FAINT, INK, RC, literal, quiet_grid
from phnn.report.view import envelope
from phnn.trajectory import Trajectory

# Storages that have a colour of their own; the smallest others are joined.
_MOST = 6
# Columns of a legend whose longest name has fewer letters than this, and of one with long names.
_SHORT, _NARROW, _WIDE = 10, 5, 3


@dataclass(frozen=True)
class Balance:
    """The energy balance at the nodes of the steps.

    Attributes:
        t: (n+1,) time [s].
        stored: (n+1, N) energy of every storage [J], by name; supplied: (n+1, P) energy that came in through every port
            [J] since the beginning; dissipated: (n+1, R) energy that every resistor has taken [J].
    """

    t: Array
    stored: dict[str, Array]
    supplied: dict[str, Array]
    dissipated: dict[str, Array]

    @property
    def total_stored(self) -> Array:
        """(n+1,) ``H(x)`` [J]."""
        return _sum(self.stored, self.t)

    @property
    def total_supplied(self) -> Array:
        """(n+1,) energy supplied by all ports [J]."""
        return _sum(self.supplied, self.t)

    @property
    def total_dissipated(self) -> Array:
        """(n+1,) energy that all resistors have taken [J]."""
        return _sum(self.dissipated, self.t)

    @property
    def error(self) -> Array:
        """(n+1,) ``H(t) − H(0) − supplied + dissipated`` [J]; a rounding error."""
        return self.total_stored - self.total_stored[0] - self.total_supplied + self.total_dissipated

    @property
    def turned_over(self) -> float:
        """The largest energy that was supplied, or taken back [J]: the measure of the error."""
        return float(np.abs(self.total_supplied).max())

    def powers(self) -> tuple[Array, Array]:
        """(n+1,) power supplied and dissipated [W], means over the step that ends at a node; zero at the first."""
        h = np.diff(self.t)
        found = [np.append(0.0, np.diff(x) / h) for x in (self.total_supplied, self.total_dissipated)]
        return found[0], found[1]

    def draw(self, axes: Any = None) -> Panels:
        """(4,) axes: stored energy, powers, cumulated balance, its error."""
        with rc_context(RC):
            ratios = [1.2, 1.0, 1.2, 0.7]
            panels = grid(axes, 4, 1, 7.6, 8.8, sharex=True, height_ratios=ratios)[:, 0]
            time = scaled("time", "s", self.t)
            t = time(self.t)
            _draw_stored(panels[0], t, self)
            _draw_powers(panels[1], t, self)
            _draw_cumulated(panels[2], t, self)
            _draw_error(panels[3], t, self)
            for one in panels:
                one.set_xlim(t[0], t[-1])
                quiet_grid(one)
            panels[3].set_xlabel(time.label)
        return panels

    def tables(self) -> dict[str, pd.DataFrame]:
        """Energies at the nodes, and mean powers of the steps that end there."""
        power_in, power_out = self.powers()
        content = {"time_s": self.t}
        content |= {f"stored_{_plain(n)}_J": x for n, x in self.stored.items()}
        content |= {f"supplied_{_plain(n)}_J": x for n, x in self.supplied.items()}
        content |= {f"dissipated_{_plain(n)}_J": x for n, x in self.dissipated.items()}
        content |= {"stored_J": self.total_stored, "supplied_J": self.total_supplied}
        content |= {"dissipated_J": self.total_dissipated, "balance_error_J": self.error}
        return {"": pd.DataFrame(content | {"supplied_W": power_in, "dissipated_W": power_out})}


def energy(
    model: Model | Diagnosis | str | Path, t: ArrayLike, u: ArrayLike, *, axes: Any = None, **options: Any
) -> Panels:
    """Draw the energy balance of a model from rest under an input: passivity as it can be seen.

        axes = phnn.plot.energy(model, t, 75.0 * np.sin(2.0 * np.pi * 10.0 * t))

    What is dissipated never falls, and stored energy grows by no more than what is supplied. Without a mass or force
    that anchors them, joules are known up to one common factor.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        t: (N,) time [s], increasing in equal steps; u: (N,) input, SI.
        axes: four axes to draw into.
        options: ``input_before``, ``further`` and ``substeps`` as of `phnn.Model.simulate`.

    Returns:
        (4,) axes: energy by storage, power supplied and dissipated, cumulated balance, error of the balance.

    Raises:
        InputRefused: there is no such model, an input that cannot be simulated, or another number of axes.
        SolverFailed: a step has no solution.
    """
    return balance(network_model(model).trajectory(t, u, **options)).draw(axes)


def balance(trajectory: Trajectory) -> Balance:
    """What `energy` draws, from the first recorded sample on."""
    network = trajectory.setup.network
    first = int(trajectory.nodes[trajectory.lead])
    found = power_balance(trajectory)
    with torch.no_grad():
        energies = PortHamiltonianSystem(network).energies(torch.from_numpy(trajectory.states)).numpy()[first:]
    t = np.append(0.0, np.cumsum(trajectory.h))[first:]
    flows = [np.pad(np.cumsum(x.numpy()[first:], axis=0), ((1, 0), (0, 0))) for x in (found.supplied, found.dissipated)]
    return Balance(
        t - t[0],
        {s.name: energies[:, k] for k, s in enumerate(network.storages)},
        {p.name: flows[0][:, k] for k, p in enumerate(network.ports)},
        {r.name: flows[1][:, k] for k, r in enumerate(network.resistors)},
    )


def _sum(parts: dict[str, Array], t: Array) -> Array:
    return np.sum(list(parts.values()), axis=0) if parts else np.zeros(t.size)


def _plain(name: str) -> str:
    return name.replace(" ", "_")


def _draw_stored(axes: Axes, t: Array, found: Balance) -> None:
    """Energies on top of each other, the largest below."""
    order = sorted(found.stored, key=lambda name: -float(np.abs(found.stored[name]).max()))
    apart, rest = (order, []) if len(order) <= _MOST else (order[: _MOST - 1], order[_MOST - 1 :])
    layers = {literal(name, 24): found.stored[name] for name in apart}
    if rest:
        layers[f"{len(rest)} others"] = np.sum([found.stored[name] for name in rest], axis=0)
    unit, index = scaled("stored energy", "J", found.total_stored), envelope(found.total_stored)
    bottom = np.zeros(index.size)
    for (name, values), colour in zip(layers.items(), CATEGORIES, strict=False):
        top = bottom + unit(values[index])
        axes.fill_between(t[index], bottom, top, color=colour, linewidth=0, alpha=0.85, label=name)
        bottom = top
    axes.plot(t[index], unit(found.total_stored[index]), color=INK, linewidth=0.9, label="all storages")
    columns = _NARROW if max(map(len, layers), default=0) < _SHORT else _WIDE
    _headroom(axes, -(-(len(layers) + 1) // columns))
    axes.set_ylabel(unit.label)
    axes.legend(loc="upper left", ncols=columns, borderaxespad=0.1)


def _draw_powers(axes: Axes, t: Array, found: Balance) -> None:
    into, out = found.powers()
    unit = scaled("power", "W", into, out)
    for values, colour, name, dashes in (
        (into, AFTER, "supplied", (None, None)), (out, BEFORE, "dissipated", (4, 1.5)),
    ):  # fmt: skip
        index = envelope(values)
        axes.plot(t[index], unit(values[index]), color=colour, linewidth=1.1, dashes=dashes, label=name)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    _headroom(axes)
    axes.set_ylabel(unit.label)
    axes.legend(loc="upper left", ncols=2, borderaxespad=0.1)


def _draw_cumulated(axes: Axes, t: Array, found: Balance) -> None:
    change = found.total_stored - found.total_stored[0]
    rows = (
        (found.total_supplied, AFTER, "supplied", "-", 1.6),
        (found.total_dissipated, BEFORE, "dissipated", (0, (4, 1.5)), 1.4),
        (change, CATEGORIES[2], "stored since the beginning", "-", 1.1),
    )
    unit = scaled("energy", "J", *(values for values, *_ in rows))
    for values, colour, name, style, width in rows:
        index = envelope(values)
        axes.plot(t[index], unit(values[index]), color=colour, linestyle=style, linewidth=width, label=name)
    _headroom(axes)
    axes.set_ylabel(unit.label)
    axes.legend(loc="upper left", ncols=3, borderaxespad=0.1)


def _draw_error(axes: Axes, t: Array, found: Balance) -> None:
    """The error over the largest energy supplied, in a power of ten that suits."""
    relative = found.error / found.turned_over if found.turned_over > 0.0 else found.error
    largest = float(np.abs(relative).max())
    exponent = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    index = envelope(relative)
    axes.plot(t[index], relative[index] / 10.0**exponent, color=INK, linewidth=0.9)
    axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    axes.set_ylabel(f"error over\nsupplied ($10^{{{exponent}}}$)")


def _headroom(axes: Axes, rows: int = 1) -> None:
    """Leave room for the rows of a legend."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + (0.1 + 0.15 * rows) * (high - low))
