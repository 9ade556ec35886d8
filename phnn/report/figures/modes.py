"""Figures of a study of modes: the strongest resonance at every amplitude, and the spectrum of the residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment, Study
from phnn.modal.fit import ModalFit
from phnn.modal.response import response
from phnn.modal.study import Result
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, FAINT, MEASURED, literal, new_figure, quiet_grid
from phnn.report.formatting import Unit, display_unit, short, words

Array = NDArray[np.float64]

# Half width of the resonance that is shown, in half-power widths; bands of the spectra in an octave.
_WIDE, _BANDS = 8.0, 12


def draw_resonance(result: Result) -> Figure:
    """Responses where they move most with amplitude, one panel for each model."""
    study = result.study
    levels = range(len(study.levels))
    measured = [response(study.identification(i)) for i in levels]
    f, lines = study.frequencies, study.lines
    peak = np.abs(measured[0][lines])
    moved = np.abs(measured[-1][lines] - measured[0][lines]) if len(study.levels) > 1 else peak
    line, out, into = np.unravel_index(int(moved.argmax()), moved.shape)
    centre = f[lines[line]]
    near = result.alone[0].model
    zeta = near.zeta[np.abs(near.omega / (2.0 * np.pi) - centre).argmin()]
    shown = lines[np.abs(f[lines] - centre) <= _WIDE * 2.0 * zeta * centre]
    models = [c.fit for c in {id(c): c for c in (result.candidates[0], result.final)}.values()]
    figure = new_figure(10.1, 3.6)
    panels = figure.subplots(1, len(models), sharey=True, squeeze=False)[0]
    unit = display_unit(float(peak.max()), study.units[1])
    for axes, fit in zip(panels, models, strict=True):
        for i in levels:
            experiments = study.identification(i)
            modelled = response([replace(e, y=fit.predict(e)) for e in experiments])
            colour, last = CATEGORIES[i % len(CATEGORIES)], axes is panels[-1]
            label = f"{study.levels[i][0].amplitude:.3g} {study.units[0]}"
            sizes = [np.abs(g[shown, out, into]) / unit.scale for g in (measured[i], modelled)]
            axes.plot(f[shown], sizes[0], "o", color=colour, markersize=4.5, alpha=0.3, markeredgewidth=0.0)
            axes.plot(f[shown], sizes[1], color=colour, linewidth=1.3, label=label if last else None)
        axes.set_title(f"one model: {literal(_words(fit))}")
        axes.set_xlabel("frequency (Hz)")
        quiet_grid(axes)
    panels[0].set_ylabel(
        f"{literal(study.outputs[out])} by {literal(study.inputs[into])} ({unit.name}/{study.units[0]})"
    )
    panels[-1].legend()
    return figure


def draw_left(result: Result) -> Figure:
    """Spectra of what models leave of the recordings that are held out, or of the fitted ones where none are."""
    study = result.study
    figure = new_figure(10.1, 3.6)
    panels = figure.subplots(1, len(study.levels), squeeze=False)[0]
    for i, axes in enumerate(panels):
        experiments = study.held_out(i) or study.identification(i)
        power = _power(study, [e.y for e in experiments])
        unit = display_unit(float(np.sqrt(power[1].max())), study.units[1])
        _draw(axes, power, unit, MEASURED, "measured")
        _draw(axes, _left(study, result.candidates[0].fit, experiments), unit, BEFORE, "one linear model")
        if result.final is not result.candidates[0]:
            label = literal(f"one model, {_words(result.final.fit)}")
            _draw(axes, _left(study, result.final.fit, experiments), unit, AFTER, label)
        _draw(axes, _left(study, result.alone[i], experiments), unit, CATEGORIES[2], "linear, this amplitude alone")
        noise = float(np.mean([e.spread**2 for e in experiments])) * len(study.outputs)
        width = 2.0 * np.diff(_edges(study)) * study.dt
        _draw(axes, (power[0], noise * width), unit, FAINT, "difference between periods, if white")
        axes.set_title(f"{study.levels[i][0].amplitude:.3g} {study.units[0]}")
        axes.set_xlabel("frequency (Hz)")
        axes.set_ylabel(f"effective value in a twelfth of an octave ({unit.name})")
        quiet_grid(axes)
    panels[-1].legend()
    return figure


def _words(fit: ModalFit) -> str:
    return " + ".join(words(n) for n in fit.model.element.names) or "linear"


def _left(study: Study, fit: ModalFit, experiments: tuple[Experiment, ...]) -> tuple[Array, Array]:
    """Draw the spectrum of a model's residual; nothing if the model cannot be integrated."""
    try:
        return _power(study, [e.y - fit.predict(e) for e in experiments])
    except SolverFailed:
        return np.ones(1), np.zeros(1)


def _edges(study: Study) -> Array:
    f = study.frequencies[study.lines]
    return f[0] * 2.0 ** np.linspace(0.0, np.log2(f[-1] / f[0]), max(2, int(_BANDS * np.log2(f[-1] / f[0]))))


def _power(study: Study, signals: list[Array]) -> tuple[Array, Array]:
    """Centre of each band and the mean square in it, all outputs together."""
    edges, n = _edges(study), len(signals[0])
    density = np.mean([2.0 * (np.abs(np.fft.rfft(x, axis=0)) ** 2).sum(axis=1) / n**2 for x in signals], axis=0)
    total, _ = np.histogram(study.frequencies, bins=edges, weights=density)
    return np.sqrt(edges[1:] * edges[:-1]), total


def _draw(axes: Axes, power: tuple[Array, Array], unit: Unit, colour: str, label: str) -> None:
    some = power[1] > 0.0
    axes.loglog(power[0][some], np.sqrt(power[1][some]) / unit.scale, color=colour, linewidth=1.2, label=label)


def resonance_title(result: Result) -> str:
    """What that figure shows, in a sentence."""
    levels = ", ".join(f"{short(level[0].amplitude)} {result.study.units[0]}" for level in result.study.levels)
    return f"The resonance that moves most, at {levels}: measured (dots) and by one model (lines)."
