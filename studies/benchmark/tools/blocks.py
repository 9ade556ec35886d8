"""Blocks of an augmented actuator: at each place, static functions of local signals and first-order states driven by
them, and where their outputs enter.

In the linear fractional representation of the base model, a place is a row of inputs ``w`` and a row of outputs ``z``:

    amplifier    z = V, V̇           w adds to the voltage
    coupling     z = V, q            w adds to the force
    mechanical   z = q, v, v̇         w adds to the force
    hysteron     z = q, v, V_i       w adds to the force, or multiplies the thresholds
    electrical   z = V_i             w adds to the force, through states that integrate
    thermal      z = V, v            w adds to the force, through slow states
    sensor       z = q, v            w adds to the output

A block is linear in its coefficients and zero in the base model, so that to first order the output changes by the
base model's response to each function.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import input_force, output_derivatives
from phnn.diagnosis.filters import low_pass, play_operator, rate
from phnn.diagnosis.linearised_fit import LinearisedFit
from phnn.effects import Scales
from phnn.network.roles import thresholds
from phnn.simulate import Trajectory

Array = NDArray[np.float64]
Channel = tuple[str, str]

# Thresholds of ramps and radii of plays, in units of the largest value.
_RAMPS, _RADII = (0.3, 0.6, 0.8), (0.05, 0.15, 0.3, 0.6)
# Time constants of fast and of slow first-order states, in periods of the slowest and the fastest excitation.
_FAST, _SLOW = (0.02, 0.1), (0.1, 0.5, 2.5)
_SMOOTH = 0.02


@dataclass(frozen=True)
class Blocks:
    """Attributes:
    columns: (N, F) weighted responses of the output; channels: (F,) place and channel that each belongs to.
    """

    columns: Array
    channels: tuple[Channel, ...]

    def of(self, places: Iterable[str]) -> list[int]:
        """Columns of some places."""
        wanted = set(places)
        return [i for i, (place, _) in enumerate(self.channels) if place in wanted]

    def of_channel(self, channel: Channel) -> list[int]:
        """Columns of a channel."""
        return [i for i, found in enumerate(self.channels) if found == channel]


@dataclass(frozen=True)
class _Signals:
    """(n,) local signals during the steps, in units of their largest value; ``h``: steps [s]; ``y``: (N,) samples."""

    q: Array
    v: Array
    voltage: Array
    rate: Array
    held: tuple[Array, ...]
    h: Array
    y: Array
    t: Array


def blocks(linearised: LinearisedFit) -> Blocks:
    """Responses of all functions of all blocks."""
    found = linearised.plan.each(
        lambda _, trajectory: raw_responses(trajectory, linearised.scales), linearised.trajectories
    )
    return Blocks(linearised.stack([columns for columns, _ in found]), found[0][1])


def raw_responses(trajectory: Trajectory, scales: Scales) -> tuple[Array, tuple[Channel, ...]]:
    """(N, F) changes of the output [m] by each function, and the channels that these belong to."""
    s = _signals(trajectory, scales)
    volts, forces, outputs = (list(of(s, scales)) for of in (_amplifier, _forces, _sensor))
    names = thresholds(trajectory.setup.network)
    values = trajectory.setup.network.parameters
    varied = [(c, n, values[n].value * f) for c, f in _on_thresholds(s) for n in names]
    unit = scales.stiffness * scales.displacement
    pushed = np.column_stack(
        [*(input_force(trajectory, scales.voltage * f) for _, f in volts), *(unit * f for _, f in forces)]
    )
    through = output_derivatives(trajectory, (), (), pushed, [(n, f) for _, n, f in varied])
    columns = np.hstack([through, *(scales.displacement * f[:, None] for _, f in outputs)])
    channels = (*(c for c, _ in volts), *(c for c, _ in forces), *(c for c, _, _ in varied), *(c for c, _ in outputs))
    return columns, channels


def _signals(trajectory: Trajectory, scales: Scales) -> _Signals:
    u, h = trajectory.u[:, 0], trajectory.h
    slope = np.gradient(u, np.cumsum(h)) / (2.0 * np.pi * scales.fastest)
    network, states = trajectory.setup.network, trajectory.states
    mid = 0.5 * (states[1:] + states[:-1])
    held = tuple(
        mid[:, i] / max(float(np.abs(mid[:, i]).max()), 1e-300)
        for i, name in enumerate(network.state_names)
        if name.startswith("Q_")
    )
    return _Signals(
        trajectory.mid_displacement / scales.displacement, trajectory.velocity / scales.velocity, u / scales.voltage,
        slope / scales.voltage, held, h, trajectory.y / scales.displacement, trajectory.t,
    )  # fmt: skip


def _static(x: Array) -> Iterator[Array]:
    yield from (x**3, x**5)
    for c in _RAMPS:
        yield from (np.maximum(x - c, 0.0), np.maximum(-x - c, 0.0))


def _amplifier(s: _Signals, scales: Scales) -> Iterator[tuple[Channel, Array]]:
    for share in _FAST:
        yield ("amplifier", "lag"), low_pass(s.voltage, s.h, share / scales.fastest, float(s.voltage[0])) - s.voltage
    for x in (s.voltage**3, s.voltage**5, *(np.sign(s.voltage) * np.maximum(abs(s.voltage) - c, 0.0) for c in _RAMPS)):
        yield ("amplifier", "limit"), x
    for c in _RAMPS:
        excess = np.sign(s.rate) * np.maximum(np.abs(s.rate) - c, 0.0)
        yield ("amplifier", "slew"), low_pass(excess, s.h, _FAST[1] / scales.fastest, 0.0)
    yield ("amplifier", "offset"), np.ones_like(s.q)


def _forces(s: _Signals, scales: Scales) -> Iterator[tuple[Channel, Array]]:
    slow = [share / scales.slowest for share in _SLOW]
    yield ("coupling", "square of the voltage"), s.voltage**2
    yield ("coupling", "voltage times displacement"), s.voltage * s.q
    for tau in slow:
        yield ("coupling", "past voltage"), s.voltage * low_pass(np.abs(s.voltage), s.h, tau, float(abs(s.voltage[0])))
    yield ("mechanical", "even spring"), s.q**2
    for x in (s.q**3, s.q**5):
        yield ("mechanical", "odd spring"), x
    for c in _RAMPS:
        yield ("mechanical", "stop"), np.maximum(s.q - c, 0.0)
        yield ("mechanical", "stop"), np.maximum(-s.q - c, 0.0)
    for x in (s.v * np.abs(s.v), s.v**3):
        yield ("mechanical", "drag"), x
    for width in (_SMOOTH, 5.0 * _SMOOTH):
        yield ("mechanical", "friction"), np.tanh(s.v / width)
    for tau in slow:
        yield ("mechanical", "memory"), s.q - low_pass(s.q, s.h, tau, float(s.q[0]))
    speed = s.v
    for share in _FAST:
        yield ("mechanical", "mode"), speed - low_pass(speed, s.h, share / scales.fastest, 0.0)
    yield ("mechanical", "load"), np.ones_like(s.q)
    for radius in _RADII:
        yield ("hysteron", "play"), play_operator(s.q, radius)
    for held in s.held:
        for tau in slow:
            yield ("electrical", "leakage"), low_pass(held, s.h, tau, 0.0)
    power = s.v**2
    for tau in (*slow, 10.0 * slow[-1]):
        yield ("thermal", "warmth"), s.voltage * low_pass(power, s.h, tau, 0.0)


def _on_thresholds(s: _Signals) -> Iterator[tuple[Channel, Array]]:
    for x in (s.q, s.q**2):
        yield ("hysteron", "by displacement"), x
    for x in (np.abs(s.v), np.sqrt(np.abs(s.v) + 1e-6)):
        yield ("hysteron", "by rate"), x


def _sensor(s: _Signals, scales: Scales) -> Iterator[tuple[Channel, Array]]:
    h = np.diff(s.t, prepend=s.t[0])
    yield ("sensor", "curve"), s.y**2
    yield ("sensor", "curve"), s.y**3
    for share in _FAST:
        yield ("sensor", "lag"), low_pass(s.y, h, share / scales.fastest, float(s.y[0])) - s.y
    yield ("sensor", "lag"), rate(s.y, s.t) / (2.0 * np.pi * scales.fastest)
    for radius in _RADII[:2]:
        yield ("sensor", "play"), play_operator(s.y, radius) - s.y
    # A first-order state without an input: what is left of its start.
    for share in (0.3, 3.0):
        yield ("sensor", "drift"), np.exp(-s.t / (share * max(scales.duration, 1e-300)))
