"""``phnn plot``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.commands.terminal import status
from phnn.errors import InputRefused
from phnn.plot.frequency import residual_tests, response, whiteness
from phnn.plot.panels import MOST, Plot, chosen, model_of, network_model
from phnn.plot.signals import balance, hysteresis, outputs
from phnn.recordings import Campaign, read
from phnn.report.figures.style import svg
from phnn.report.page import literal_text
from phnn.results import claim
from phnn.trajectory import simulate

# Endings of the tables' names, of all kinds.
_TABLES = ("", "_spectrum", "_measured")
# Arguments that a kind does not take; all others take no frequencies and no amplitude.
_OF_BODE = ("--frequencies", "--amplitude")
_NOT_TAKEN = {"bode": ("--recording",)}
_OPTIONS = ("recording", "frequencies", "amplitude")
# Frequencies between the two that are given.
_POINTS = 40


def plot(
    kind: str,
    model: Path,
    folder: Path | None,
    out: Path,
    options: Mapping[str, Any],
    outside: bool = False,
    overwrite: bool = False,
) -> None:
    """Draw one kind of plot; writes ``KIND.svg`` and its data, ``KIND.csv``, and of some kinds a further table.

    Args:
        kind: compare, residuals, loops, bode or energy.
        model: of a model or a diagnosis; folder: of recordings, not needed for a response with ``frequencies`` and
            ``amplitude``.
        options: ``manifest`` of the folder; ``recording``: names of the recordings to draw; ``frequencies``: lowest and
            highest [Hz]; ``amplitude``: of the input, SI.

    Raises:
        InputRefused: what a kind needs is not given, or cannot be used.
    """
    recording = options["recording"]
    _check(kind, {f"--{name}": options[name] for name in _OPTIONS})
    inputs, files = [model] if folder is None else [model, folder], [f"{kind}.svg"]
    results = (f"{kind}.svg", *(f"{kind}{end}.csv" for end in _TABLES))
    with claim(out, "plot", inputs, results, overwrite=overwrite) as place, status():
        campaign = None if folder is None else read(folder, options["manifest"], allow_outside=outside)
        found = _computed(kind, model_of(model, outside), campaign, options)
        _tell(kind, campaign, recording)
        (place / f"{kind}.svg").write(svg(found.figure()))
        for end, table in found.tables.items():
            files.append(f"{kind}{end}.csv")
            safe = table.map(lambda value: literal_text(value) if isinstance(value, str) else value)
            (place / files[-1]).write(safe.to_csv(index=False).encode())
    for name in files:
        print(out / name)


def _check(kind: str, given: Mapping[str, object]) -> None:
    """Refuse what a kind of plot does not take."""
    for name, value in given.items():
        if value is not None and name in _NOT_TAKEN.get(kind, _OF_BODE):
            raise InputRefused(f"phnn plot {kind} does not take {name}: leave it out")
    if kind == "energy" and isinstance(named := given["--recording"], list) and len(named) > 1:
        raise InputRefused("phnn plot energy draws one recording: give --recording once")


def _tell(kind: str, campaign: Campaign | None, recording: Sequence[str] | None) -> None:
    """Say where not all recordings are drawn."""
    count = 0 if campaign is None or recording else len(campaign.recordings)
    if kind in ("compare", "residuals", "loops") and count > MOST:
        print(f"at most {MOST} of {count} recordings are drawn: choose others with --recording NAME")


def _computed(kind: str, simulator: Any, campaign: Campaign | None, options: Mapping[str, Any]) -> Plot:
    recording = options["recording"]
    if kind == "bode":
        return response(simulator, _spaced(options["frequencies"]), options["amplitude"], campaign=campaign).plot()
    if campaign is None:
        raise InputRefused(f"phnn plot {kind}: no recordings: name their folder after that of the model")
    if kind == "compare":
        return outputs(simulator, campaign, recording)
    if kind == "residuals":
        return whiteness(residual_tests(simulator, campaign, recording))
    if kind == "loops":
        return hysteresis(simulator, campaign, recording)
    found = network_model(simulator)
    return balance(simulate(found.setup, chosen(campaign, recording).recordings[0], found.substeps)).plot()


def _spaced(ends: Sequence[float] | None) -> NDArray[np.float64] | None:
    """Frequencies [Hz] between the lowest and the highest, at equal ratios."""
    if ends is None:
        return None
    low, high = ends
    if not 0.0 < low < high < np.inf:
        raise InputRefused(f"--frequencies {low:g} {high:g}: give the lowest and the highest, both positive [Hz]")
    return np.geomspace(low, high, _POINTS)
