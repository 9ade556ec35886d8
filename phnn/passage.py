"""Signals on their way through the measuring chain of a setup, and derivatives by its parameters.

What is stated of a recording's sensor and input becomes blocks of the chain with fixed parameters (`sensing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain import AMPLIFIERS, LINEAR, MEMORYLESS, REMEMBERING, SENSORS, SOURCES
from phnn.errors import InputRefused
from phnn.laws.namespace import TINY
from phnn.network.bondgraph.description import integral_unit
from phnn.parameters import as_table, constant
from phnn.recordings.recording import Recording
from phnn.setup import Block, Setup, Source
from phnn.signals.reconstruct import mean_input

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


Array = NDArray[np.float64]


def amplified(setup: Setup, fine: Any, h: Array, before: Any) -> tuple[Any, Any]:
    """Through all amplifier blocks: the voltage at the port (n, 3), and what it was before the first step.

    Args:
        fine: (n, 3) command at the start, middle and end of the steps ``h`` (n,).
        before: the constant command before them, under which all blocks are in equilibrium.
    """
    for block in setup.amplifier:
        fine, before = _through(block, fine, h, before, _values(setup, block))
    return fine, before


def amplifier_changes(
    setup: Setup, fine: Array, h: Array, before: float, names: Sequence[str]
) -> dict[str, tuple[Array, float]]:
    """Changes (n, 3) of the voltage at the port, and of what it was before, by the named parameters of the blocks."""
    changes: dict[str, tuple[Array, float]] = {}
    for block in setup.amplifier:
        values = _values(setup, block)
        if block.kind in MEMORYLESS and changes:
            slope, earlier = _change(_through(block, fine + 1j * TINY, h, before + 1j * TINY, values))
            changes = {n: (slope * c, earlier * b) for n, (c, b) in changes.items()}
        else:
            moved = {n: (fine + 1j * TINY * c, before + 1j * TINY * b) for n, (c, b) in changes.items()}
            changes = {n: _change(_through(block, f, h, b, values)) for n, (f, b) in moved.items()}
        for n in (n for n in block.parameters if n in names):
            own, known = _change(_through(block, fine, h, before, _values(setup, block, n))), changes.get(n)
            changes[n] = own if known is None else (own[0] + known[0], own[1] + known[1])
        fine, before = _through(block, fine, h, before, values)
    return changes


def _through(block: Block, fine: Any, h: Array, before: Any, values: Sequence[Any]) -> tuple[Any, Any]:
    law = AMPLIFIERS[block.kind]
    return law(fine, h, before, *values), law(np.full((1, 3), before), np.ones(1), before, *values)[0, 0]


def _change(moved: tuple[Any, Any]) -> tuple[Array, float]:
    return np.imag(moved[0]) / TINY, float(np.imag(moved[1])) / TINY


def place_of(setup: Setup, source: Source) -> int:
    """Which port of the network a source acts on."""
    return [p.name for p in setup.network.ports].index(source.port)


def source_input(setup: Setup, source: Source, h: Array, lead: float, perturbed: str = "") -> Any:
    """(n,) means of a source over the steps ``h`` (n,).

    Args:
        lead: duration [s] of a run-in, during which sources are silent.
        perturbed: a parameter that takes a complex step; the result is complex then.
    """
    starts = np.concatenate([[0.0], np.cumsum(h)[:-1]]) - lead
    times = starts[:, None] + h[:, None] * np.array([0.0, 0.5, 1.0])
    found = mean_input(SOURCES[source.kind](times, *_values(setup, source, perturbed)))
    return np.where(times[:, 1] > 0.0, found, 0.0)


def sensed(
    setup: Setup, nodes: NDArray[np.int64], h: Array
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64] | slice]:
    """Nodes of the steps at which the sensor is evaluated, their times [s] from the first node, and the samples among
    them.

    If a block has a state, these are the nodes of all steps, as fast motion between two samples changes that state.
    Otherwise they are the nodes of the samples.

    Args:
        nodes: of the samples; h: (n,) steps.
    """
    times = np.concatenate([[0.0], np.cumsum(h)])
    if any(b.kind in REMEMBERING for b in setup.sensor):
        return np.arange(times.size), times, nodes
    return nodes, times[nodes], slice(None)


def measured(setup: Setup, q: Array, times: Array) -> Array:
    """(N,) what the sensor makes of the network's output at the samples."""
    for block in setup.sensor:
        q = SENSORS[block.kind](q, times, *_values(setup, block))
    return q


def measured_changes(setup: Setup, q: Array, times: Array, changes: Array, names: Sequence[str]) -> Array:
    """(N, M) changes of the sensor's output by changes (N, M) of the network's, and by the sensor's own parameters.

    Args:
        q: (N,) the network's output at the samples, of the times ``times`` (N,).
        names: parameters whose changes the first columns are; those of a sensor block are added to theirs.
    """
    y, times = q[:, None], times[:, None]
    for block in setup.sensor:
        law, values = SENSORS[block.kind], _values(setup, block)
        own = {n: np.imag(law(y, times, *_values(setup, block, n))) / TINY for n in block.parameters if n in names}
        if block.kind in LINEAR:
            changes = law(changes, times, *values)
        elif block.kind not in REMEMBERING:
            changes = changes * (np.imag(law(y + 1j * TINY, times, *values)) / TINY)
        else:
            changes = np.imag(law(y + 1j * TINY * changes, times, *values)) / TINY
        for name, change in own.items():
            changes[:, names.index(name)] += change[:, 0]
        y = law(y, times, *values)
    return changes


def _values(setup: Setup, block: Block | Source, perturbed: str = "") -> list[Any]:
    """Values of the parameters of a block or source, one of them with a complex step."""
    values = [setup.parameters[p].value for p in block.parameters]
    return [complex(v, TINY) if p == perturbed else v for p, v in zip(block.parameters, values, strict=True)]
