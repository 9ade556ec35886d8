"""Texts that exported files of every language share."""

from __future__ import annotations

from phnn.exporting.program import Program

_HOLD = {
    "linear": "the input runs straight from the last value to the given one",
    "zero_order": "the input has the given value since the last call",
}


def header(program: Program) -> str:
    """What an exported file is, in a few lines of text."""
    inputs = ", ".join(f"{n} [{unit}]" for n, unit in program.inputs)
    name, unit = program.output
    text = (
        f"{program.title}: exported by phnn.\n\n"
        f"Input: {inputs}. Output: what is measured of {name} [{unit}], SI.\n"
        f"A call of step advances the model by DT = {program.dt:g} s in {program.substeps} power-preserving step(s);\n"
        f"{_HOLD[program.hold]}. The output is that at the end of DT.\n"
        f"{_begin(program)}"
    )
    # In a text of Python it would begin an escape.
    return text.replace("\\", "/")


def _begin(program: Program) -> str:
    if program.from_rest:
        return "init begins in the equilibrium under a constant input, in which hysterons are empty."
    return "init begins in the state of rest that was computed at the export; its input only fills the amplifier."


def constants_about(program: Program) -> list[str]:
    """What the constants are."""
    return [
        "Parameters P_ in SI units, and constants D_ that follow from them and from the step H.",
        "Whoever changes a parameter or the step exports the model again.",
    ]
