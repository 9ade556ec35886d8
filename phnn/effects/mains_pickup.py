"""Lines of the mains in the measured output."""

from __future__ import annotations

from dataclasses import replace

from phnn.effects import Effect, OfEveryRecording, Placed, Scales, constant, kinds
from phnn.parameters import as_table
from phnn.setup import Setup

_HARMONICS = (1, 2, 3)


def lines(setup: Setup, parameters: Placed) -> Setup:
    """Lines at ``f_m`` and its second and third harmonic, with an amplitude and phase for each recording."""
    table = as_table((*(setup.block_parameters or {}).values(), *parameters.values()))
    added = tuple(n * parameters["f_m"].value for n in _HARMONICS)
    return replace(setup, own=setup.own._replace(lines=(*setup.own.lines, *added)), block_parameters=table)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point for each of the two frequencies of mains."""
    return [{"f_m": 50.0}, {"f_m": 60.0}]


EFFECT = Effect(
    name="mains_pickup",
    kind=kinds.LINES,
    equation=r"y = q + \sum_{n=1}^{3} (a_n \cos 2\pi n f_m t + b_n \sin 2\pi n f_m t)",
    statement="The measurement picks up the mains: lines at {f_m} and its harmonics stand in the output, with an "
    "amplitude and phase of their own in every recording.",
    fingerprint="Narrow lines at the mains and its harmonics whose phase is another one in every recording.",
    separation="A recording at zero voltage with the actuator held fast: pickup does not change, a shaking base has "
    "no effect any more.",
    references=("Ott 2009, Electromagnetic Compatibility Engineering, ch. 2",),
    declares=(
        constant("f_m", "Hz", "frequency of the mains").plausibly(
            49.5, 60.6, "grids hold 50 or 60 Hz within 1 % (EN 50160)"
        ),
    ),
    adds=OfEveryRecording(lines),
    grid=grid,
    neighbours=("base_motion",),
)
