"""What a recording says of its sensor, as blocks of the measuring chain with fixed parameters."""

from __future__ import annotations

from dataclasses import replace

from phnn.parameters import as_table, constant
from phnn.recordings.recording import Recording
from phnn.setup import Block, Setup

_LAG = "tau_sensor"


def sensing(setup: Setup, recording: Recording) -> Setup:
    """The setup with the known sensor of a recording between the network and its other sensor blocks.

    The sensor belongs to the recording: one model serves recordings by several sensors.
    """
    said = recording.sensor
    blocks = (
        *((Block("rate"),) if said.derivative else ()),
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
