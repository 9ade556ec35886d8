"""The stated properties of a recording's sensor and input, as blocks of the measuring chain with fixed parameters."""

from __future__ import annotations

from dataclasses import replace

from phnn.errors import InputRefused
from phnn.network.bondgraph.description import integral_unit
from phnn.parameters import as_table, constant
from phnn.recordings.recording import Recording
from phnn.setup import Block, Setup

_LAG = "tau_sensor"
_RATE = Block("rate")


def sensing(setup: Setup, recording: Recording) -> Setup:
    """The setup with the known sensor of a recording between the network and its other sensor blocks.

    The sensor belongs to the recording: one model serves recordings by several sensors. So does an input that is the
    displacement of a motion of which the network takes the velocity: its rate then drives the network.
    """
    setup, said = _moved(setup, recording), recording.sensor
    blocks = (
        *((_RATE,) if setup.network.senses and not recording.measures else ()),
        *((_RATE,) if said.derivative else ()),
        *((Block("lag", (_LAG,)),) if said.lag else ()),
        *((Block("rectification"),) if said.rectified else ()),
    )
    if not blocks or setup.sensor[: len(blocks)] == blocks:
        return setup
    known = (constant(_LAG, said.lag, "s", "time constant of the sensor, as stated"),) if said.lag else ()
    return replace(
        setup,
        sensor=(*blocks, *setup.sensor),
        block_parameters=as_table((*(setup.block_parameters or {}).values(), *known)),
    )


def is_displacement(setup: Setup, recording: Recording) -> bool:
    """Whether the recorded input is the integral over time of what the first port takes, by their units."""
    port = next(iter(setup.network.ports), None)
    return port is not None and recording.units.input == integral_unit(port.unit) != "1"


def _moved(setup: Setup, recording: Recording) -> Setup:
    """The setup with the rate of a recorded displacement before its other amplifier blocks.

    Raises:
        InputRefused: the displacement is said to be held between the samples, and a jump has no rate.
    """
    if setup.amplifier[:1] == (_RATE,) or not is_displacement(setup, recording):
        return setup
    if recording.interpolation == "zero_order":
        raise InputRefused(
            f"{recording.source}: input: zero_order: a displacement that is held and jumps has no velocity: "
            f"write input: cubic or linear in recordings.yaml"
        )
    return replace(setup, amplifier=(_RATE, *setup.amplifier))
