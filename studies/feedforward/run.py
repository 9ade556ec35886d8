"""The study of inverses from recordings to table and figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from phnn.identification.base import Progress, quiet
from phnn.identification.options import Options
from phnn.recordings import read
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, RC, new_figure, png, quiet_grid
from phnn.report.formatting import markdown_table
from phnn.results import Place, claim
from studies.feedforward.tracking import (
    COMMANDS,
    HEADS,
    RATES,
    Commands,
    Models,
    commands,
    identified,
    output,
    row,
    table,
)
from studies.recordings import Conditions, write_recordings
from studies.results import write_results

RESULTS = ("recordings", "feedforward.md", "feedforward.csv", "feedforward.png")
_COLOURS = dict(zip(COMMANDS, (BEFORE, CATEGORIES[1], AFTER), strict=True))
_TITLES = {"none": "V = q/G", "linear": "linear inverse", "full": "inverse of the identified model"}
# Starts of the nonlinear stage of the identification; more take longer.
_STARTS = 1
_FAST, _MICRO = 100.0, 1e-6


def run_feedforward(out: Path, seed: int, draws: int, noise_um: float, progress: Progress = quiet) -> str:
    """Make recordings, identify, drive plants; writes `RESULTS` and returns the table as text.

    Args:
        seed: of the recordings, the plants and the noise; draws: plants at each frequency.
        noise_um: standard deviation of the sensor's noise [µm].

    Raises:
        InputRefused: a folder that holds files of others, or a noise that is not positive.
    """
    conditions, rng = Conditions(noise_um=noise_um, seed=seed), np.random.default_rng(seed)
    with claim(out, "feedforward", (), RESULTS) as place:
        progress("make recordings")
        folder = (place / "recordings").own_folder()
        write_recordings(folder, conditions)
        progress("identify with and without hysterons")
        models = identified(read(folder), Options(seed=seed, starts=_STARTS))
        rows = []
        for frequency in RATES:
            progress(f"drive plants at {frequency:g} Hz")
            rows.append(row(models, frequency, noise_um * 1e-6, draws, rng))
        return _written(place, models, table(rows))


def _written(place: Place, models: Models, cells: list[list[str]]) -> str:
    text = "\n".join(["Tracking errors, root mean square [nm]", "", *markdown_table(HEADS, cells), ""])
    with rc_context(RC):
        (place / "feedforward.png").write(png(_drawn(models, commands(models, _FAST))))
    columns = pd.DataFrame(cells, columns=HEADS).to_csv(index=False)
    write_results(place, {"feedforward.csv": columns, "feedforward.md": text})
    return text


def _drawn(models: Models, found: Commands) -> Figure:
    """Commands and tracking errors at the highest frequency, the plant being the identified model."""
    figure = new_figure(9.6, 5.4)
    voltages, errors = figure.subplots(2, 1, sharex=True)
    for name in COMMANDS:
        missed = output(models.full.fit.setup, found, name) - found.reference
        voltages.step(found.t, found.voltages[name], where="post", color=_COLOURS[name], label=_TITLES[name], lw=1.0)
        errors.plot(found.t, missed / _MICRO, color=_COLOURS[name], linewidth=1.0)
    voltages.set_ylabel("command (V)")
    errors.set_ylabel("tracking error (µm)")
    errors.set_xlabel("time (s)")
    figure.legend(*voltages.get_legend_handles_labels(), loc="outside upper right", ncols=len(COMMANDS))
    for axes in (voltages, errors):
        quiet_grid(axes)
    return figure
