"""Plots of signals: measured and simulated outputs over time, hysteresis loops, and the energy balance.

`compare` draws outputs with the residual below, and `loops` output over input by frequency. `energy` draws what is
stored, supplied and dissipated, and what the balance misses. What all plots share stands first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from phnn.diagnose.diagnosis import Diagnosis
from phnn.errors import InputRefused
from phnn.integrate.equations import power_balance
from phnn.model import Model
from phnn.network.system import PortHamiltonianSystem
from phnn.parameters import prefixed, quantity
from phnn.prediction import Predicted
from phnn.predictor import model_of, predict
from phnn.recordings import Campaign, campaign_of
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording
from phnn.report.figures import draw_trace, envelope, errors_into, outputs_into, telling_stretch
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, FAINT, INK, MEASURED, RC, finish, literal, new_figure
from phnn.report.formatting import DASH, finite, listing, percent
from phnn.signals.least_squares import HARMONICS, deviation, harmonic_weights
from phnn.trajectory import Trajectory

if TYPE_CHECKING:
    from phnn.modal.model import ModalFit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """Response in one recording of a single sine.

    Attributes:
        name: of the recording; frequency [Hz]; amplitude: of the input.
        gain: ``Y_1/U_1``; std: its standard deviation by the noise, of either part.
        harmonics: (4,) ``|Y_k|/|Y_1|`` for k = 2 … 5.
    """

    name: str
    frequency: float
    amplitude: float
    gain: complex
    std: float
    harmonics: Array


def point(recording: Recording) -> Point | None:
    """Return the response in a recording of a single sine, by its last whole periods; None of any other recording."""
    drive = excitation_of(recording.u, recording.dt)
    if drive.kind != "sine" or drive.cycles < 1.0 or not np.isfinite(recording.y).all():
        return None
    period = recording.period or 1.0 / drive.low_Hz
    # The first period holds the transient.
    whole = max(1, int(drive.cycles + 1e-6) - (recording.start.state != "periodic"))
    rows = slice(max(drive.span[0], drive.span[1] - round(whole * period / recording.dt)), drive.span[1])
    if period / recording.dt < 2 * HARMONICS + 2:
        return None
    waves = harmonic_weights(recording.t[rows], period)
    into, out = waves[0] @ recording.u[rows], waves @ recording.y[rows]
    noise = recording.noise if recording.noise_found else np.nan
    std = noise * deviation(waves[0], recording.noise_correlation) / np.sqrt(2.0) / abs(into)
    return Point(
        recording.name, 1.0 / period, float(abs(into)), complex(out[0] / into), float(std),
        np.abs(out[1:]) / abs(out[0]),
    )  # fmt: skip


# Recordings that are drawn where nobody chose some: more do not fit on a screen.
MOST = 12


@dataclass(frozen=True)
class Plot:
    """A kind of plot: how it is drawn, and the same as tables.

    Attributes:
        draw: returns a new figure of all panels.
        tables: everything that is drawn, by the ending of a file's name; columns have units, ``_1`` for none.
    """

    draw: Callable[[], Figure]
    tables: Mapping[str, pd.DataFrame]

    def figure(self) -> Figure:
        """Return a figure in the look of all figures."""
        with rc_context(RC):
            return self.draw()


def scaled(name: str, unit: str, *values: Any) -> tuple[float, str]:
    """Return the size of the unit in which values read well, and their axis label; none for ``1``."""
    sizes = [np.abs(np.asarray(v)[np.isfinite(v)]).max(initial=0.0) for v in values]
    size, shown = prefixed(float(max(sizes, default=0.0)), unit)
    return size, name if shown == "1" else f"{name} ({shown})"


def column(name: str, unit: str) -> str:
    """Return the name of a column with its unit."""
    return f"{name}_{unit.replace(' ', '')}"


def network_model(given: Any) -> Model:
    """Return the model that is given, see `phnn.predictor.model_of`. Raises InputRefused for a model of modes."""
    model = model_of(given)
    if not isinstance(model, Model):
        raise InputRefused(
            "a model of phnn modes has no inputs of its own here: give phnn.Model(phnn.Setup(model.to_network()))"
        )
    return model


def predictions(given: Any, campaign: Campaign | str | Path, recordings: Sequence[str] | None) -> tuple[Predicted, ...]:
    """Return the predictions of the recordings that are drawn; see `chosen`."""
    return predict(given, chosen(campaign, recordings))


def chosen(campaign: Campaign | str | Path, recordings: Sequence[str] | None) -> Campaign:
    """Return a campaign of the recordings that are named, or of the first dozen whose output was recorded. Raises
    InputRefused where there is no recording of a name, or none that can be drawn."""
    campaign = campaign_of(campaign)
    known = {r.name: r for r in campaign.recordings if bool(np.isfinite(r.y).any())}
    strange = [name for name in recordings or () if name not in known]
    if strange:
        raise InputRefused(f"no recording {strange[0]!r} with an output; there are {listing(known)}")
    if not known:
        raise InputRefused(f"{campaign.folder}: no output was recorded: there is nothing to compare a model with")
    kept = [known[name] for name in recordings] if recordings else list(known.values())[:MOST]
    return replace(campaign, recordings=tuple(kept))


def compare(
    model: Model | ModalFit | Diagnosis | str | Path,
    campaign: Campaign | str | Path,
    *,
    recordings: Sequence[str] | None = None,
) -> Figure:
    """Draw measured and simulated outputs with fit % and RMSE, and the residuals with ± 2 deviations of the noise.

        figure = phnn.plot.compare("out/model", phnn.read("recordings/"))

    Of a recording with many cycles those are shown where the residual is largest. Samples that give zero and initial
    state are shaded: they are not scored.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        campaign: recordings with outputs.
        recordings: names of those to draw; the first twelve if left out.

    Returns:
        A figure with the output above and the residual below, for each recording.

    Raises:
        InputRefused: there is no such model or recording.
        SolverFailed: a step has no solution.
    """
    return outputs(model, campaign, recordings).figure()


def outputs(model: Any, campaign: Campaign | str | Path, recordings: Sequence[str] | None = None) -> Plot:
    """Return what `compare` draws; ``shown_1`` of its table is 1 for the samples that are drawn."""
    predicted = predictions(model, campaign, recordings)

    def draw() -> Figure:
        columns = min(2, len(predicted))
        rows = -(-len(predicted) // columns)
        figure = new_figure(10.1 if columns > 1 else 7.2, 3.7 * rows)
        for place, one in zip(figure.subfigures(rows, columns, squeeze=False).flat, predicted, strict=False):
            above, below = place.subplots(2, 1, height_ratios=[2.0, 1.2])
            _draw(above, below, one)
        return figure

    return Plot(draw, {"": pd.concat(map(_table, predicted), ignore_index=True)})


def _shown(one: Predicted) -> slice:
    """Return the samples that are drawn."""
    scored = np.zeros(one.y.size, dtype=bool)
    scored[one.scored] = True
    return telling_stretch(one.recording.u, one.recording.y - one.y, scored)


def _draw(above: Axes, below: Axes, one: Predicted) -> None:
    r, part = one.recording, _shown(one)
    t, unit, scores = r.t[part], r.units.output, one.document("")
    size = DASH if (rmse := finite(scores["rmse"])) is None else quantity(rmse, unit)
    simulated = f"simulated: fit {percent(scores['fit_percent'], 2)} %, RMSE {size}"
    outputs_into(above, t, [(r.y[part], MEASURED, "measured", 4.0), (one.y[part], AFTER, simulated, 1.2)], unit)
    noise = r.noise if r.noise_found else None
    errors_into(below, t, [((r.y - one.y)[part], AFTER, "residual", 0.8)], noise, unit)
    # The samples before the scored ones.
    if part.start < one.scored.start < part.stop:
        below.axvspan(*r.t[[part.start, one.scored.start]], color=FAINT, alpha=0.6, linewidth=0, zorder=0)
    use = ", held out" if one.held_out or r.mask("confirmation").any() else ""
    shown = "" if part == slice(0, one.y.size) else ", where the residual is largest"
    above.set_title(literal(r.name, 30) + use + shown)


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


def loops(
    model: Model | ModalFit | Diagnosis | str | Path,
    campaign: Campaign | str | Path,
    *,
    recordings: Sequence[str] | None = None,
) -> Figure:
    """Draw hysteresis loops, the output over the input in the last period, measured and simulated.

        figure = phnn.plot.loops(diagnosis.model, campaign)

    Recordings of one frequency share a panel.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        campaign: recordings with outputs, some of which repeat.
        recordings: names of those to draw, also some that do not repeat: these are drawn as a whole. The first twelve
            that repeat if left out.

    Returns:
        A figure with a panel for each frequency, the lowest first.

    Raises:
        InputRefused: there is no such model or recording, or nothing repeats.
        SolverFailed: a step has no solution.
    """
    return hysteresis(model, campaign, recordings).figure()


def hysteresis(model: Any, campaign: Campaign | str | Path, recordings: Sequence[str] | None = None) -> Plot:
    """Return what `loops` draws."""
    campaign = campaign_of(campaign)
    if recordings is None:
        recordings = [r.name for r in campaign.recordings if r.period is not None and np.isfinite(r.y).any()][:MOST]
        if not recordings:
            raise InputRefused("no recording repeats, so that there is no loop: name some to draw them as a whole")
    predicted = list(predictions(model, campaign, recordings))
    # Lowest frequency first, what does not repeat last; large loops before small ones, which they would hide.
    predicted.sort(key=lambda one: (-(one.recording.period or 0.0), -float(np.ptp(one.recording.u))))
    panels: list[tuple[str, list[Predicted]]] = []
    last = None
    for one in predicted:
        period = one.recording.period
        if last is None or period is None or abs(period / last - 1.0) > _ALIKE:
            last, title = period, literal(one.recording.name, 34) if period is None else quantity(1.0 / period, "Hz")
            panels.append((title, []))
        panels[-1][1].append(one)

    def draw() -> Figure:
        columns = min(3, len(panels))
        rows = -(-len(panels) // columns)
        figure = new_figure(3.6 * columns + (1.4 if columns == 1 else 0.2), 3.2 * rows)
        for place, (title, some) in enumerate(panels, start=1):
            _draw_loops(figure.add_subplot(rows, columns, place), title, some)
        return figure

    return Plot(draw, {"": pd.concat(map(_loop_table, predicted), ignore_index=True)})


def _draw_loops(axes: Axes, title: str, some: Sequence[Predicted]) -> None:
    r = some[0].recording
    across, x_label = scaled("input", r.units.input, *(one.recording.u for one in some))
    up, y_label = scaled("output", r.units.output, *(one.recording.y for one in some))
    for number, one in enumerate(some):
        rows, u = one.recording.last_periods(1.0), one.recording.u
        for y, colour, name, width in ((one.recording.y, MEASURED, "measured", 4.0), (one.y, AFTER, "simulated", 1.2)):
            draw_trace(
                axes, u[rows] / across, y[rows], up, color=colour, linewidth=width,
                label=name if number == 0 else None, zorder=2.0 if name == "measured" else 3.0,
            )  # fmt: skip
    axes.set_title(title)
    finish(axes, x_label, y_label)


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


# Storages that have a colour of their own; the smallest others are joined.
_MOST = 6


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

    def total(self, part: str) -> Array:
        """Return (n+1,) energy [J] of all that is ``stored``, ``supplied`` or ``dissipated``."""
        parts: dict[str, Array] = getattr(self, part)
        return sum(parts.values(), np.zeros(self.t.size))

    @property
    def error(self) -> Array:
        """Return (n+1,) ``H(t) − H(0) − supplied + dissipated`` [J]; a rounding error."""
        stored = self.total("stored")
        return stored - stored[0] - self.total("supplied") + self.total("dissipated")

    @property
    def turned_over(self) -> float:
        """Return the largest energy that was supplied, or taken back [J]: the measure of the error."""
        return float(np.abs(self.total("supplied")).max())

    def plot(self) -> Plot:
        """Return stored energy, cumulated balance and its error, with all energies at the nodes."""
        content = {"time_s": self.t}
        parts = {"stored": self.stored, "supplied": self.supplied, "dissipated": self.dissipated}
        content |= {f"{what}_{n.replace(' ', '_')}_J": x for what, some in parts.items() for n, x in some.items()}
        content |= {f"{what}_J": self.total(what) for what in parts} | {"balance_error_J": self.error}
        return Plot(self._draw, {"": pd.DataFrame(content)})

    def _draw(self) -> Figure:
        figure = new_figure(7.6, 7.2)
        above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=[1.2, 1.2, 0.7])
        size, label = scaled("time", "s", self.t)
        t = self.t / size
        _draw_stored(above, t, self)
        _draw_cumulated(middle, t, self)
        _draw_error(below, t, label, self)
        below.set_xlim(t[0], t[-1])
        return figure


def energy(model: Model | Diagnosis | str | Path, t: ArrayLike, u: ArrayLike, **options: Any) -> Figure:
    """Draw the energy balance of a model from rest under an input: passivity as it can be seen.

        figure = phnn.plot.energy(model, t, 75.0 * np.sin(2.0 * np.pi * 10.0 * t))

    What is dissipated never falls, and stored energy grows by no more than what is supplied. Without a mass or force
    that anchors them, joules are known up to one common factor.

    Args:
        model: a model, a diagnosis (its final model), or the folder of either.
        t: (N,) time [s], increasing in equal steps; u: (N,) input, SI.
        options: ``input_before``, ``further`` and ``substeps`` as of `phnn.Model.simulate`.

    Returns:
        A figure with energy by storage, cumulated balance, and error of the balance.

    Raises:
        InputRefused: there is no such model, an input that cannot be simulated.
        SolverFailed: a step has no solution.
    """
    return balance(network_model(model).trajectory(t, u, **options)).plot().figure()


def balance(trajectory: Trajectory) -> Balance:
    """Return what `energy` draws, from the first recorded sample on."""
    network = trajectory.setup.network
    first = int(trajectory.nodes[trajectory.lead])
    power = power_balance(trajectory)
    with torch.no_grad():
        energies = PortHamiltonianSystem(network).energies(torch.from_numpy(trajectory.states)).numpy()[first:]
    t = np.append(0.0, np.cumsum(trajectory.h))[first:]
    works = [np.pad(np.cumsum(x.numpy()[first:], axis=0), ((1, 0), (0, 0))) for x in (power.supplied, power.dissipated)]
    return Balance(
        t - t[0],
        {s.name: energies[:, k] for k, s in enumerate(network.storages)},
        {p.name: works[0][:, k] for k, p in enumerate(network.ports)},
        {r.name: works[1][:, k] for k, r in enumerate(network.resistors)},
    )


def _draw_stored(axes: Axes, t: Array, energies: Balance) -> None:
    """Energies on top of each other, the largest below."""
    order = sorted(energies.stored, key=lambda name: -float(np.abs(energies.stored[name]).max()))
    apart, rest = (order, []) if len(order) <= _MOST else (order[: _MOST - 1], order[_MOST - 1 :])
    layers = {literal(name, 24): energies.stored[name] for name in apart}
    if rest:
        layers[f"{len(rest)} others"] = np.sum([energies.stored[name] for name in rest], axis=0)
    total = energies.total("stored")
    (size, label), index = scaled("stored energy", "J", total), envelope(total)
    bottom = np.zeros(index.size)
    for (name, values), colour in zip(layers.items(), CATEGORIES, strict=False):
        top = bottom + values[index] / size
        axes.fill_between(t[index], bottom, top, color=colour, linewidth=0, alpha=0.85, label=name)
        bottom = top
    axes.plot(t[index], total[index] / size, color=INK, linewidth=0.9, label="all storages")
    # Short names, as `q_1`, stand five in a row.
    columns = 5 if max(map(len, layers), default=0) < 10 else 3
    finish(axes, "", label, "upper left", 0.1 + 0.15 * -(-(len(layers) + 1) // columns), ncols=columns)


def _draw_cumulated(axes: Axes, t: Array, energies: Balance) -> None:
    stored = energies.total("stored")
    rows = (
        (energies.total("supplied"), AFTER, "supplied", "-", 1.6),
        (energies.total("dissipated"), BEFORE, "dissipated", (0, (4, 1.5)), 1.4),
        (stored - stored[0], CATEGORIES[2], "stored since the beginning", "-", 1.1),
    )
    size, label = scaled("energy", "J", *(values for values, *_ in rows))
    for values, colour, name, style, width in rows:
        draw_trace(axes, t, values, size, color=colour, linestyle=style, linewidth=width, label=name)
    finish(axes, "", label, "upper left", 0.25, ncols=3)


def _draw_error(axes: Axes, t: Array, time: str, energies: Balance) -> None:
    """The error over the largest energy supplied, in a power of ten that suits."""
    relative = energies.error / energies.turned_over if energies.turned_over > 0.0 else energies.error
    largest = float(np.abs(relative).max())
    exponent = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    draw_trace(axes, t, relative, 10.0**exponent, color=INK, linewidth=0.9)
    axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    finish(axes, time, f"error over\nsupplied ($10^{{{exponent}}}$)", None)
