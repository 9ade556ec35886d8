"""An amplifier that clips, at once or softly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Plausible, Scales, no_range
from phnn.parameters import Parameter
from phnn.setup import Block, Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V = clip(u, ±V_max)`` before the port."""
    return setup.with_block("amplifier", Block("saturation", ("V_max",)), (_limit(values["V_max"]),))


def _limit(volts: float) -> Parameter:
    return Parameter("V_max", volts, "V", 1e-3 * volts, 1e3 * volts, positive=True, description="amplifier limit")


def grid(scales: Scales) -> list[dict[str, float]]:
    """Limits somewhat below the largest command; there is no small strength to start from."""
    return [{"V_max": share * scales.voltage} for share in (0.995, 0.98, 0.95, 0.9, 0.8, 0.65, 0.5)]


def build_soft(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V = u/(1 + |u/V_max|ⁿ)^{1/n}`` before the port: the limit is approached, the sooner the larger ``n``."""
    sharpness = Parameter("n_V", values["n_V"], "1", 1.0, 200.0, positive=True, description="sharpness of the limit")
    block = Block("soft_saturation", ("V_max", "n_V"))
    return setup.with_block("amplifier", block, (_limit(values["V_max"]), sharpness))


def grid_soft(scales: Scales) -> list[dict[str, float]]:
    """Limits below and above the largest command, from the gentlest to a nearly sharp knee."""
    shares = (0.5, 0.7, 0.85, 1.0, 1.2, 1.6, 2.5, 5.0)
    return [{"V_max": share * scales.voltage, "n_V": n} for share in shares for n in (2.0, 4.0, 12.0)]


_HARD = Effect(
    name="amplifier_saturation",
    location="amplifier",
    kind="limit",
    equation=r"V = \mathrm{clip}(u, \pm V_{max})",
    statement="The amplifier saturates: beyond {V_max} the voltage no longer follows the command, at any frequency.",
    fingerprint="Flat tops begin at one amplitude of the command, at every frequency and on both sides.",
    separation="Sines of rising amplitude about two offsets of the voltage: a limit of the amplifier stays at its "
    "voltage, a stop at its displacement.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    passive=False,
    strength=None,
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("V_max",),
    plausible={"V_max": Plausible(5.0, 2e3, "piezo amplifiers end between 5 V and 2 kV")},
    needs_command=True,
    neighbours=("contact_stop", "cubic_stiffness"),
)
EFFECT = replace(
    _HARD,
    forms=(
        replace(
            _HARD,
            equation=r"V = u\,(1 + |u/V_{max}|^{n})^{-1/n}",
            statement="The amplifier saturates: towards {V_max} the voltage follows the command less and less, at any "
            "frequency, with a knee of sharpness {n_V}.",
            references=("Rapp 1991, Effects of HPA-nonlinearity on a 4-DPSK/OFDM signal, 2nd ECSC", *_HARD.references),
            grid=grid_soft,
            build=build_soft,
            parameters=("V_max", "n_V"),
            plausible={"V_max": Plausible(5.0, 2e3, "piezo amplifiers end between 5 V and 2 kV"), **no_range("n_V")},
        ),
    ),
)
