"""The picture of an effect page: loops without and with the effect, and the change of the output over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from effect_scenes import Scene, Shown, scene_of
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from phnn.report.figures.style import AFTER, BEFORE, DPI, FAINT, MEASURED, RC

_SIZE = (8.8, 5.4)  # inch
# Height of the drive in the background, as a share of the largest change.
_DRIVE = 0.8


def draw(shown: Shown, path: Path) -> None:
    """Write the picture of a simulated effect as PNG."""
    scene = scene_of(shown.effect)
    with rc_context(RC):
        figure = Figure(_SIZE)
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, len(scene.loops), height_ratios=(1.15, 1.0))
        for i, (name, first, last) in enumerate(scene.loops):
            _loop(figure.add_subplot(grid[0, i]), shown, scene, name, slice(first, last + 1), i == 0)
        _change(figure.add_subplot(grid[1, :]), shown, scene)
        figure.savefig(path, dpi=DPI, metadata={"Software": None})


def _loop(axes: Axes, shown: Shown, scene: Scene, name: str, part: slice, first: bool) -> None:
    (u_unit, u_scale), (y_unit, y_scale) = scene.units
    u = u_scale * scene.drive.u[part]
    axes.plot(u, y_scale * scene.base.y[part], color=MEASURED, linewidth=2.4, label="base model")
    axes.plot(u, y_scale * shown.y[part], color=AFTER, linewidth=1.2, label="with the effect")
    axes.set_title(name)
    axes.set_xlabel(f"{scene.words[0]} [{u_unit}]")
    if first:
        axes.set_ylabel(f"{scene.words[1]} [{y_unit}]")
        axes.legend(loc="upper left")


def _change(axes: Axes, shown: Shown, scene: Scene) -> None:
    y_unit, y_scale = scene.units[1]
    t, change, left = scene.drive.t, y_scale * shown.change, y_scale * shown.left
    reach = max(float(np.abs(change).max()), float(np.abs(left).max()))
    drive = scene.drive.u / np.abs(scene.drive.u).max()
    axes.fill_between(t, 0.0, _DRIVE * reach * drive, color=FAINT, alpha=0.45, linewidth=0.0, label="drive, scaled")
    axes.plot(t, change, color=AFTER, linewidth=1.0, label="with the effect, less the base model")
    axes.plot(t, left, color=BEFORE, linewidth=1.0, label="part that no other parameters of the base model explain")
    axes.set_title("Change of the output")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"difference [{y_unit}]")
    axes.margins(x=0.01)
    axes.set_ylim(-1.1 * reach, 1.1 * reach)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.28), ncols=3)
