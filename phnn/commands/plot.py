"""``phnn plot``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.commands.terminal import status
from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.intake.json_file import load_json
from phnn.intake.limits import LIMITS
from phnn.output import claim
from phnn.plot.balance import balance
from phnn.plot.correlations import whiteness
from phnn.plot.hysteresis import hysteresis
from phnn.plot.locations import Locations
from phnn.plot.outputs import outputs
from phnn.plot.panels import MOST, Plot, chosen, model_of, network_model
from phnn.plot.response import response
from phnn.recordings import Campaign, read
from phnn.report.document import Location
from phnn.report.figures.style import svg
from phnn.report.reading import read_document
from phnn.simulate import simulate

_DIAGNOSIS = "diagnosis.json"
# Frequencies between the two that are given.
_POINTS = 40


def plot(
    kind: str,
    model: Path,
    folder: Path | None,
    out: Path,
    manifest: Path | None = None,
    recording: Sequence[str] | None = None,
    frequencies: Sequence[float] | None = None,
    amplitude: float | None = None,
    outside: bool = False,
    overwrite: bool = False,
) -> None:
    """Draw one kind of plot; writes ``KIND.svg`` and its data, ``KIND.csv``, and of some kinds a further table.

    Args:
        kind: compare, residuals, loops, bode, location or energy.
        model: of a model or a diagnosis; folder: of recordings, not needed for a location or, with ``frequencies`` and
            ``amplitude``, for a response.
        recording: names of the recordings to draw.
        frequencies: lowest and highest [Hz]; amplitude: of the input, SI.

    Raises:
        InputRefused: what a kind needs is not given, or cannot be used.
    """
    inputs = [model] if folder is None else [model, folder]
    with status():
        if kind == "location":
            found: Plot = Locations(_located(model, outside))
        else:
            campaign = None if folder is None else read(folder, manifest, allow_outside=outside)
            found = _computed(kind, model, campaign, recording, frequencies, amplitude, outside)
        tables = {f"{kind}{end}.csv": table for end, table in found.tables().items()}
        drawn = svg(np.ravel(found.draw())[0].figure)
        with claim(out, "plot", inputs, (f"{kind}.svg", *tables), overwrite=overwrite) as place:
            (place / f"{kind}.svg").write(drawn)
            for name, table in tables.items():
                (place / name).write(table.to_csv(index=False).encode())
    if folder is not None and kind in ("compare", "residuals") and recording is None and campaign is not None:
        count = len(campaign.recordings)
        if count > MOST:
            print(f"the first {MOST} of {count} recordings are drawn: choose others with --recording NAME")
    for name in (f"{kind}.svg", *tables):
        print(out / name)


def _computed(
    kind: str,
    model: Path,
    campaign: Campaign | None,
    recording: Sequence[str] | None,
    frequencies: Sequence[float] | None,
    amplitude: float | None,
    outside: bool,
) -> Plot:
    simulator = model_of(model, outside)
    if kind == "bode":
        return response(simulator, _spaced(frequencies), amplitude, campaign=campaign)
    if campaign is None:
        raise InputRefused(f"phnn plot {kind}: no recordings: name their folder after that of the model")
    if kind == "compare":
        return outputs(simulator, campaign, recording)
    if kind == "residuals":
        return whiteness(simulator, campaign, recording)
    if kind == "loops":
        return hysteresis(simulator, campaign, recording)
    found = network_model(simulator)
    return balance(simulate(found.setup, chosen(campaign, recording).recordings[0], found.substeps))


def _spaced(ends: Sequence[float] | None) -> NDArray[np.float64] | None:
    """Frequencies [Hz] between the lowest and the highest, at equal ratios."""
    if ends is None:
        return None
    low, high = ends
    if not 0.0 < low < high < np.inf:
        raise InputRefused(f"--frequencies {low:g} {high:g}: give the lowest and the highest, both positive [Hz]")
    return np.geomspace(low, high, _POINTS)


def _located(folder: Path, outside: bool) -> Location | None:
    """The location in the ``diagnosis.json`` of a folder, as the report reads it."""
    path = folder / _DIAGNOSIS
    remedy = "give the folder of a diagnosis"
    source = named_file(path, (folder,), "", remedy, outside)
    content = load_json(source, LIMITS.json_bytes, "a diagnosis", remedy)
    return read_document(content if isinstance(content, dict) else {}).location
