"""An amplifier that loses gain about zero: crossover distortion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Scales, no_range
from phnn.parameters import Parameter, constant, signed
from phnn.setup import Block, Setup

_BAND, _SHARE = "delta_U", "a_U"


def _added(setup: Setup, values: Mapping[str, float], share: Parameter) -> Setup:
    band = replace(signed(_BAND, values[_BAND], "V", 1e3, 0.1, "half width of the dead band"), lower=0.0)
    return setup.with_block("amplifier", Block("dead_band", (share.name, _BAND)), (share, band))


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V = u − clip(u, ±δ)``: nothing comes through within ``±δ``."""
    return _added(setup, values, constant(_SHARE, 1.0, "1", "gain lost in the dead band"))


def build_partly(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V = u − a clip(u, ±δ)``: the share ``a`` of the gain is lost within ``±δ``."""
    share = Parameter(_SHARE, values[_SHARE], "1", 0.0, 1.0, typical=0.1, description="gain lost in the dead band")
    return _added(setup, values, share)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Bands of several widths."""
    return [{_BAND: share * scales.voltage, _SHARE: 1.0} for share in (1e-3, 0.01, 0.05)]


def grid_partly(scales: Scales) -> list[dict[str, float]]:
    """A tenth of the gain lost within bands of several widths."""
    return [{_SHARE: 0.1, _BAND: share * scales.voltage} for share in (0.02, 0.1, 0.3)]


_WHOLE = Effect(
    name="amplifier_dead_band",
    location="amplifier",
    kind="static",
    equation=r"V = u - \mathrm{clip}(u, \pm\delta_U)",
    statement="The amplifier has a dead band: nothing comes through while its command is within {delta_U} of zero, and "
    "beyond that the voltage is less by as much.",
    fingerprint="Plateaus about zero volts, at one voltage whatever the frequency.",
    separation="A small sine about an offset well above the dead band: there the amplifier is straight.",
    references=("Horowitz & Hill 2015, The Art of Electronics, sec. 2.4 (crossover distortion)",),
    passive=False,
    strength=_BAND,
    one_sided=True,
    grid=grid,
    build=build,
    parameters=(_BAND, _SHARE),
    plausible=no_range(_BAND, _SHARE),
    rescale=lambda values, factor: {**values, _BAND: max(factor, 0.0) * values[_BAND]},
    needs_command=True,
    neighbours=("amplifier_saturation",),
)
EFFECT = replace(
    _WHOLE,
    forms=(
        replace(
            _WHOLE,
            equation=r"V = u - a_U\,\mathrm{clip}(u, \pm\delta_U)",
            statement="The amplifier loses the share {a_U} of its gain while its command is within {delta_U} of zero.",
            grid=grid_partly,
            build=build_partly,
            strength=_SHARE,
            parameters=(_SHARE, _BAND),
            rescale=lambda values, factor: {**values, _SHARE: min(max(factor * values[_SHARE], 0.0), 1.0)},
        ),
    ),
)
