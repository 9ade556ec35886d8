"""Hysteresis loops: output over input, measured and simulated, by frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes

from phnn.diagnosis.diagnosis import Diagnosis
from phnn.errors import InputRefused
from phnn.model import Model
from phnn.plot.panels import MOST, Panels, chosen, column, grid, hide_unused, predictions, scaled, under_each_other
from phnn.prediction import Predicted
from phnn.recordings import Campaign, campaign_of
from phnn.report.figures.style import AFTER, MEASURED, RC, literal, quiet_grid
from phnn.report.reduction import envelope
from phnn.units import quantity

if TYPE_CHECKING:
    from phnn.modal.store import StoredModes

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
                _draw(one, title, some)
        return panels

    def tables(self) -> dict[str, pd.DataFrame]:
        """The loops that are drawn."""
        return {"": under_each_other(_table(one) for some in self.found.values() for one in some)}


def loops(
    model: Model | StoredModes | Diagnosis | str | Path,
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


def _draw(axes: Axes, title: str, some: Sequence[Predicted]) -> None:
    r = some[0].recording
    into = scaled("voltage" if r.units.input == "V" else "input", r.units.input, *(one.recording.u for one in some))
    out = scaled(
        "displacement" if r.units.output == "m" else "output", r.units.output, *(one.recording.y for one in some)
    )
    for number, one in enumerate(some):
        rows, u = one.recording.last_periods(1.0), one.recording.u
        for y, colour, name, width in ((one.recording.y, MEASURED, "measured", 4.0), (one.y, AFTER, "simulated", 1.2)):
            index = envelope(y[rows])
            axes.plot(
                into(u[rows][index]), out(y[rows][index]), color=colour, linewidth=width,
                label=name if number == 0 else None, zorder=2.0 if name == "measured" else 3.0,
            )  # fmt: skip
    axes.set_title(title)
    axes.set_xlabel(into.label)
    axes.set_ylabel(out.label)
    axes.legend(loc="best")
    quiet_grid(axes)


def _table(one: Predicted) -> pd.DataFrame:
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
