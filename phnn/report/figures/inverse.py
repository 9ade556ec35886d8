"""An inverse: the reference and what is reached, the error, and the command."""

from __future__ import annotations

from matplotlib.figure import Figure

from phnn.inverse import Inverse
from phnn.report.figures.style import AFTER, BEFORE, FAINT, MEASURED, new_figure, quiet_grid
from phnn.report.formatting import display_unit
from phnn.report.reduction import envelope


def draw_inverse(found: Inverse, input_unit: str, output_unit: str) -> Figure:
    """Draw three panels over time: output, error with what was out of reach marked, command."""
    figure = new_figure(9.6, 6.6)
    outputs, errors, commands = figure.subplots(3, 1, sharex=True)
    unit = display_unit(float(abs(found.reference).max()), output_unit)
    fine = display_unit(float(abs(found.error).max()), output_unit)
    for values, colour, width, text in (
        (found.reference, MEASURED, 3.0, "reference"),
        (found.reached, AFTER, 1.1, "reached by the model"),
    ):
        rows = envelope(values)
        outputs.plot(found.t[rows], values[rows] / unit.scale, color=colour, linewidth=width, label=text)
    rows = envelope(found.error)
    errors.plot(found.t[rows], found.error[rows] / fine.scale, color=AFTER, linewidth=1.0)
    for stretch in found.missed:
        if stretch.causes:
            errors.axvspan(stretch.start, stretch.end, color=BEFORE, alpha=0.12, linewidth=0.0)
    rows = envelope(found.voltage)
    commands.plot(found.t[rows], found.voltage[rows], color=AFTER, linewidth=1.1)
    for limit in found.options.limits or ():
        commands.axhline(limit, color=FAINT, linewidth=1.0)
    outputs.set_ylabel(f"output ({unit.name})")
    errors.set_ylabel(f"error ({fine.name})")
    commands.set_ylabel(f"command ({input_unit})")
    commands.set_xlabel("time (s)")
    figure.legend(*outputs.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    for axes in (outputs, errors, commands):
        quiet_grid(axes)
    return figure
