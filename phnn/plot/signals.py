"""Plots of signals: measured and simulated outputs over time, hysteresis loops, locations, and the energy balance.

`compare` draws outputs with the residual below, `loops` output over input by frequency, and `location` the share of the
explainable residual that each location predicts. `energy` draws what is stored, supplied and dissipated, and what the
balance misses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from phnn.diagnose.diagnosis import Diagnosis
from phnn.errors import InputRefused
from phnn.integrate.residual import power_balance
from phnn.model import Model
from phnn.network.system import PortHamiltonianSystem
from phnn.parameters import prefixed, quantity
from phnn.plot.panels import (
    MOST,
    Array,
    Panels,
    chosen,
    column,
    grid,
    hide_unused,
    network_model,
    predictions,
    scaled,
    under_each_other,
)
from phnn.prediction import Predicted
from phnn.recordings import Campaign, campaign_of
from phnn.report.document import Location
from phnn.report.figures import draw_trace, envelope, height_of, locations_into, telling_stretch
from phnn.report.figures.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    FAINT,
    INK,
    MEASURED,
    RC,
    headroom,
    literal,
    quiet_grid,
    say,
)
from phnn.report.formatting import DASH, finite, percent
from phnn.trajectory import Trajectory

if TYPE_CHECKING:
    from phnn.modal.fit import ModalFit

# The band of the residual's panel, in standard deviations of the noise.
_BAND = 2.0
# Share of the samples whose residuals fill the panel: a single jump must not flatten all others.
_USUAL = 99.5


@dataclass(frozen=True)
class Outputs:
    """Predicted recordings.

    Attributes:
        found: one for each pair of panels.
    """

    found: tuple[Predicted, ...]

    def draw(self, axes: Any = None) -> Panels:
        """(R, 2) axes: output and residual of each recording."""
        count = len(self.found)
        with rc_context(RC):
            pairs = _pairs(count) if axes is None else grid(axes, count, 2, 0.0, 0.0)
            for (above, below), one in zip(pairs, self.found, strict=True):
                _draw(above, below, one)
        return pairs

    def tables(self) -> dict[str, pd.DataFrame]:
        """Samples of all recordings; ``shown_1`` is 1 for those that are drawn."""
        return {"": under_each_other(_table(one) for one in self.found)}


def compare(
    model: Model | ModalFit | Diagnosis | str | Path,
    campaign: Campaign | str | Path,
    *,
    recordings: Sequence[str] | None = None,
    axes: Any = None,
) -> Panels:
    """Draw measured and simulated outputs with fit % and RMSE, and the residuals with ± 2 deviations of the noise.

        axes = phnn.plot.compare("out/model", phnn.read("recordings/"))

    Of a recording with many cycles those are shown where the residual is largest. Samples that give zero and initial
    state are shaded: they are not scored.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        campaign: recordings with outputs.
        recordings: names of those to draw; the first twelve if left out.
        axes: (R, 2) axes to draw into.

    Returns:
        (R, 2) axes: output above and residual below, for each recording.

    Raises:
        InputRefused: there is no such model or recording, or another number of axes.
        SolverFailed: a step has no solution.
    """
    return Outputs(predictions(model, campaign, recordings)).draw(axes)


def _pairs(count: int) -> Panels:
    """(R, 2) axes of a new figure, pairs above each other."""
    columns = min(2, count)
    rows = -(-count // columns)
    width = 10.1 if columns > 1 else 7.2
    panels = grid(None, 2 * rows, columns, width, 3.7 * rows, height_ratios=[2.3, 1.0] * rows)
    places = [(2 * (i // columns), i % columns) for i in range(rows * columns)]
    pairs = np.array([[panels[row, place], panels[row + 1, place]] for row, place in places], dtype=object)
    hide_unused(pairs, 2 * count)
    return pairs[:count]


def _shown(one: Predicted) -> slice:
    """The samples that are drawn."""
    scored = np.zeros(one.y.size, dtype=bool)
    scored[one.scored] = True
    return telling_stretch(one.recording.u, one.recording.y - one.y, scored)


def _draw(above: Axes, below: Axes, one: Predicted) -> None:
    r, part = one.recording, _shown(one)
    error = r.y - one.y
    time = scaled("time", "s", r.t[part])
    out = scaled("displacement" if r.units.output == "m" else "output", r.units.output, r.y[part])
    usual = max(float(np.percentile(np.abs(error[part]), _USUAL)), _BAND * r.noise if r.noise_found else 0.0)
    left = scaled("residual", r.units.output, usual)
    for y, colour, name, width in ((r.y, MEASURED, "measured", 4.0), (one.y, AFTER, _legend(one), 1.2)):
        draw_trace(above, time(r.t[part]), y[part], out.size, color=colour, label=name, linewidth=width)
    draw_trace(below, time(r.t[part]), error[part], left.size, color=AFTER, linewidth=0.8)
    if r.noise_found:
        for edge in (-_BAND, _BAND):
            below.axhline(
                float(left(edge * r.noise)), color=INK, linewidth=0.9, dashes=(4, 2),
                label="± 2 × noise" if edge > 0.0 else None,
            )  # fmt: skip
        below.legend(loc="upper right", borderaxespad=0.1)
    # The samples before the scored ones.
    if part.start < one.scored.start < part.stop:
        below.axvspan(*time(r.t[[part.start, one.scored.start]]), color=FAINT, alpha=0.6, linewidth=0, zorder=0)
    above.set_title(_title(one, part))
    above.set_ylabel(out.label)
    headroom(above, 0.2)
    above.legend(loc="upper left", ncols=2, borderaxespad=0.1)
    reach = float(left(usual)) or 1.0
    # Room for the legend above what is usual.
    below.set_ylim(-1.4 * reach, 2.1 * reach)
    below.set_ylabel(left.label)
    below.set_xlabel(time.label)
    for axes in (above, below):
        axes.margins(x=0.01)
        axes.set_xlim(*(float(time(t)) for t in r.t[part][[0, -1]]))
        quiet_grid(axes)


def _legend(one: Predicted) -> str:
    scores = one.document("")
    rmse = finite(scores["rmse"])
    size = DASH if rmse is None else quantity(rmse, one.recording.units.output)
    return f"simulated: fit {percent(scores['fit_percent'], 2)} %, RMSE {size}"


def _title(one: Predicted, part: slice) -> str:
    r = one.recording
    use = ", held out" if one.held_out or r.mask("confirmation").any() else ""
    if part == slice(0, r.t.size):
        return literal(r.name, 40) + use
    size, unit = prefixed(float(r.t[-1]), "s")
    first, last, whole = (f"{t / size:.3g}" for t in (r.t[part.start], r.t[part.stop - 1], r.t[-1]))
    return f"{literal(r.name, 30)}{use}: {first} to {last} of {whole} {unit}"


def _table(one: Predicted) -> pd.DataFrame:
    r, shown = one.recording, np.zeros(one.y.size, dtype=np.int64)
    shown[_shown(one)] = 1
    unit = r.units.output
    return pd.DataFrame(
        {
            "recording": r.name,
            "time_s": r.t,
            column("input", r.units.input): r.u,
            column("measured", unit): r.y,
            column("simulated", unit): one.y,
            column("residual", unit): r.y - one.y,
            column("noise", unit): r.noise if r.noise_found else np.nan,
            "shown_1": shown,
        }
    )


# Frequencies that differ by less than this share have one panel.
_ALIKE = 0.005


@dataclass(frozen=True)
class Loops:
    """Recordings of each panel.

    Attributes:
        found: by the panel's title; those of one frequency, the largest first.
    """

    found: dict[str, tuple[Predicted, ...]]

    def draw(self, axes: Any = None) -> Panels:
        """(F,) axes, one for each frequency."""
        count = len(self.found)
        columns = min(3, count)
        rows = -(-count // columns)
        with rc_context(RC):
            if axes is None:
                panels = grid(None, rows, columns, 3.6 * columns + (1.4 if columns == 1 else 0.2), 3.2 * rows)
                hide_unused(panels, count)
                panels = panels.reshape(-1)[:count]
            else:
                panels = grid(axes, 1, count, 0.0, 0.0)[0]
            for one, (title, some) in zip(panels, self.found.items(), strict=True):
                _draw_loops(one, title, some)
        return panels

    def tables(self) -> dict[str, pd.DataFrame]:
        """The loops that are drawn."""
        return {"": under_each_other(_loop_table(one) for some in self.found.values() for one in some)}


def loops(
    model: Model | ModalFit | Diagnosis | str | Path,
    campaign: Campaign | str | Path,
    *,
    recordings: Sequence[str] | None = None,
    axes: Any = None,
) -> Panels:
    """Draw hysteresis loops, the output over the input in the last period, measured and simulated.

        axes = phnn.plot.loops(diagnosis.model, campaign)

    Recordings of one frequency share a panel.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        campaign: recordings with outputs, some of which repeat.
        recordings: names of those to draw, also some that do not repeat: these are drawn as a whole. The first twelve
            that repeat if left out.
        axes: one for each frequency to draw into.

    Returns:
        (F,) axes, from the lowest frequency to the highest.

    Raises:
        InputRefused: there is no such model or recording, nothing repeats, or another number of axes.
        SolverFailed: a step has no solution.
    """
    return hysteresis(model, campaign, recordings).draw(axes)


def hysteresis(model: Any, campaign: Campaign | str | Path, recordings: Sequence[str] | None = None) -> Loops:
    """What `loops` draws."""
    campaign = campaign_of(campaign)
    if recordings is None:
        recordings = [r.name for r in campaign.recordings if r.period is not None and np.isfinite(r.y).any()][:MOST]
        if not recordings:
            names = ", ".join(r.name for r in chosen(campaign, None).recordings)
            raise InputRefused(
                f"no recording repeats, so that there is no loop: name some of {names} to draw as a whole"
            )
    found = sorted(predictions(model, campaign, recordings), key=_order)
    panels: dict[str, list[Predicted]] = {}
    last = None
    for one in found:
        period = one.recording.period
        if last is None or period is None or abs(period / last - 1.0) > _ALIKE:
            last, title = period, literal(one.recording.name, 34) if period is None else quantity(1.0 / period, "Hz")
            while title in panels:
                # Another panel whose shortened name or rounded frequency is the same.
                title += "′"
            panels[title] = []
        panels[title].append(one)
    return Loops({title: tuple(some) for title, some in panels.items()})


def _order(one: Predicted) -> tuple[float, float]:
    """Lowest frequency first, what does not repeat last; large loops before small ones, which they would hide."""
    period = one.recording.period
    return (np.inf if period is None else 1.0 / period, -float(np.ptp(one.recording.u)))


def _draw_loops(axes: Axes, title: str, some: Sequence[Predicted]) -> None:
    r = some[0].recording
    into = scaled("voltage" if r.units.input == "V" else "input", r.units.input, *(one.recording.u for one in some))
    out = scaled(
        "displacement" if r.units.output == "m" else "output", r.units.output, *(one.recording.y for one in some)
    )
    for number, one in enumerate(some):
        rows, u = one.recording.last_periods(1.0), one.recording.u
        for y, colour, name, width in ((one.recording.y, MEASURED, "measured", 4.0), (one.y, AFTER, "simulated", 1.2)):
            draw_trace(
                axes, into(u[rows]), y[rows], out.size, color=colour, linewidth=width,
                label=name if number == 0 else None, zorder=2.0 if name == "measured" else 3.0,
            )  # fmt: skip
    axes.set_title(title)
    axes.set_xlabel(into.label)
    axes.set_ylabel(out.label)
    axes.legend(loc="best")
    quiet_grid(axes)


def _loop_table(one: Predicted) -> pd.DataFrame:
    r, rows = one.recording, one.recording.last_periods(1.0)
    return pd.DataFrame(
        {
            "recording": r.name,
            "frequency_Hz": np.nan if r.period is None else 1.0 / r.period,
            "time_s": r.t[rows],
            column("input", r.units.input): r.u[rows],
            column("measured", r.units.output): r.y[rows],
            column("simulated", r.units.output): one.y[rows],
        }
    )


_NOTHING = "The residual as a whole is not significant: there is nothing to locate."


@dataclass(frozen=True)
class Locations:
    """Attributes:
    found: where the mismatch is; None where there is none.
    """

    found: Location | None

    def draw(self, axes: Any = None) -> Axes:
        """Draw the bars, or a sentence where nothing is located."""
        with rc_context(RC):
            height = 2.0 if self.found is None else height_of(self.found)
            panel: Axes = grid(axes, 1, 1, 7.2, height)[0, 0]
            if self.found is None:
                say(panel, _NOTHING)
                panel.set_xlabel("share of the explainable residual (1)")
            else:
                locations_into(panel, self.found)
        return panel

    def tables(self) -> dict[str, pd.DataFrame]:
        """Locations, their shares, and which is best or tied with the best."""
        rows = []
        if self.found is not None:
            rank = {**dict.fromkeys(self.found.tied, "tied"), self.found.name: "best"}
            rows = [(name, score, rank.get(name, "")) for name, score in self.found.scores]
        return {"": pd.DataFrame(rows, columns=["location", "share_of_explainable_residual_1", "rank"])}


def location(diagnosis: Diagnosis, *, ax: Axes | None = None) -> Axes:
    """Draw the share of the explainable residual that each location predicts on recordings left out.

        ax = phnn.plot.location(diagnosis)

    Args:
        diagnosis: a finished diagnosis.
        ax: axes to draw into.

    Returns:
        The axes; they hold a sentence where the diagnosis has located nothing.
    """
    return located(diagnosis).draw(ax)


def located(diagnosis: Diagnosis) -> Locations:
    """What `location` draws.

    Raises:
        InputRefused: it is no diagnosis.
    """
    if not hasattr(diagnosis, "places"):
        raise InputRefused(
            f"a {type(diagnosis).__name__} has no locations: give a diagnosis, what phnn.diagnose(folder) returns"
        )
    if diagnosis.location is None:
        return Locations(None)
    name, *tied = diagnosis.places
    scores = tuple(sorted(diagnosis.location.scores.items(), key=lambda item: -item[1]))
    return Locations(Location(name, diagnosis.detail, tuple(tied), scores, (), (), ()))


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
    # Room for the rows of the legend.
    headroom(axes, 0.1 + 0.15 * -(-(len(layers) + 1) // columns))
    axes.set_ylabel(unit.label)
    axes.legend(loc="upper left", ncols=columns, borderaxespad=0.1)


def _draw_powers(axes: Axes, t: Array, found: Balance) -> None:
    into, out = found.powers()
    unit = scaled("power", "W", into, out)
    for values, colour, name, dashes in (
        (into, AFTER, "supplied", (None, None)), (out, BEFORE, "dissipated", (4, 1.5)),
    ):  # fmt: skip
        draw_trace(axes, t, values, unit.size, color=colour, linewidth=1.1, dashes=dashes, label=name)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    headroom(axes, 0.25)
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
        draw_trace(axes, t, values, unit.size, color=colour, linestyle=style, linewidth=width, label=name)
    headroom(axes, 0.25)
    axes.set_ylabel(unit.label)
    axes.legend(loc="upper left", ncols=3, borderaxespad=0.1)


def _draw_error(axes: Axes, t: Array, found: Balance) -> None:
    """The error over the largest energy supplied, in a power of ten that suits."""
    relative = found.error / found.turned_over if found.turned_over > 0.0 else found.error
    largest = float(np.abs(relative).max())
    exponent = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    draw_trace(axes, t, relative, 10.0**exponent, color=INK, linewidth=0.9)
    axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    axes.set_ylabel(f"error over\nsupplied ($10^{{{exponent}}}$)")
