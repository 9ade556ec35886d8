"""An amplifier that clips, with a sharp or a soft knee."""

from __future__ import annotations

from phnn.effects import Effect, Scales, at_amplifier, between, kinds, limit

_MOST = limit("V_max", "V", "amplifier limit", 1e3).plausibly(5.0, 2e3, "piezo amplifiers end between 5 V and 2 kV")
_BOOK = "Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14"
_SHARPNESS = between("n_V", "1", "sharpness of the limit", 1.0, 200.0)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Limits somewhat below the largest command; no small strength exists to start from."""
    return [{"V_max": share * scales.voltage} for share in (0.995, 0.98, 0.95, 0.9, 0.8, 0.65, 0.5)]


def grid_soft(scales: Scales) -> list[dict[str, float]]:
    """Limits below and above the largest command, from the gentlest to a nearly sharp knee."""
    shares = (0.5, 0.7, 0.85, 1.0, 1.2, 1.6, 2.5, 5.0)
    return [{"V_max": share * scales.voltage, "n_V": n} for share in shares for n in (2.0, 4.0, 12.0)]


EFFECT = Effect(
    name="amplifier_saturation",
    kind=kinds.LIMIT,
    equation=r"V = \mathrm{clip}(u, \pm V_{max})",
    statement="The amplifier saturates: beyond {V_max} the voltage no longer follows the command, at any frequency.",
    fingerprint="Flat tops begin at one amplitude of the command, at every frequency and on both sides.",
    separation="Sines of rising amplitude about two offsets of the voltage: a limit of the amplifier stays at its "
    "voltage, a stop at its displacement.",
    references=(_BOOK,),
    declares=(_MOST,),
    adds=at_amplifier("saturation"),
    grid=grid,
    neighbours=("contact_stop", "cubic_stiffness"),
).or_as(
    equation=r"V = u\,(1 + |u/V_{max}|^{n})^{-1/n}",
    statement="The amplifier saturates: towards {V_max} the voltage follows the command less and less, at any "
    "frequency, with a knee of sharpness {n_V}.",
    references=("Rapp 1991, Effects of HPA-nonlinearity on a 4-DPSK/OFDM signal, 2nd ECSC", _BOOK),
    declares=(_MOST, _SHARPNESS),
    adds=at_amplifier("soft_saturation"),
    grid=grid_soft,
)
