"""Simulations behind the pictures of the effect pages: a base model without and with one effect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.effects import Effect, Scales
from phnn.effects.soundness import home_of, rig, tanks
from phnn.errors import PhnnError
from phnn.identification.problem import own_columns
from phnn.models import from_paper
from phnn.recordings.recording import Recording, unrecorded
from phnn.setup import NOTHING, Setup
from phnn.trajectory import Trajectory, simulate

Array = NDArray[np.float64]

# Largest change of the output that a picture shows, as a share of the largest output: well visible and still plausible.
SHOWN = 0.10
# A change is close enough to SHOWN within this factor; each correction may multiply a strength by at most _LEAP.
_CLOSE, _LEAP, _CORRECTIONS = 1.1, 1e3, 8
# A first grid point changes next to nothing and is made this much stronger.
_FIRST = 10.0
# Changes above this share of the output are not drawn: limits that cut most of the signal away.
_TOO_MUCH = 0.3
# Sampling interval [s] of the actuator's scene, and the noise that its scales state [m].
_DT, _NOISE = 5e-5, 5e-8
# Voltage [V] of the held step and samples of its rise, which is no steeper than the sine of 150 Hz.
_HELD, _RISE = 60.0, 20


@dataclass(frozen=True, eq=False)
class Scene:
    """A base model and a drive.

    Attributes:
        setup: the base model; drive: the recording that moves it; base: its simulation; scales: sizes met in it.
        loops: name of a stretch of the drive and its first and last sample.
        words: names of input and output; units: how to draw them, as (unit, factor from SI).
    """

    setup: Setup
    drive: Recording
    base: Trajectory
    scales: Scales
    loops: tuple[tuple[str, int, int], ...]
    words: tuple[str, str]
    units: tuple[tuple[str, float], tuple[str, float]]


@dataclass(frozen=True, eq=False)
class Shown:
    """A simulated effect.

    Attributes:
        effect: form of the effect; values: its parameters [SI]; y: (N,) output with it.
        change: (N,) difference to the base model; left: (N,) part of it that no small change of the base model's
            parameters and no constant removes.
        setup: with the effect.
    """

    effect: Effect
    values: dict[str, float]
    y: Array
    change: Array
    left: Array
    setup: Setup


@cache
def actuator_scene() -> Scene:
    """Sines of two amplitudes at 20 Hz, one at 150 Hz, and a held step, on the actuator of the paper."""
    pieces = [
        _sine(20.0, 30.0, 2), _sine(20.0, 75.0, 2), _sine(150.0, 75.0, 6), np.zeros(400),
        np.linspace(0.0, _HELD, _RISE), np.full(3600, _HELD),
    ]  # fmt: skip
    u = np.concatenate(pieces)
    ends = np.cumsum([p.size for p in pieces])
    slow, fast = round(1.0 / 20.0 / _DT), round(1.0 / 150.0 / _DT)
    loops = (
        ("20 Hz, 30 V", ends[0] - slow, ends[0]),
        ("20 Hz, 75 V", ends[1] - slow, ends[1]),
        ("150 Hz, 75 V", ends[2] - fast, ends[2]),
    )
    setup, drive = Setup(from_paper()), unrecorded("drive", np.arange(u.size) * _DT, u, "linear")
    base = simulate(setup, drive)
    reach = float(np.abs(base.y).max())
    scales = Scales(
        voltage=75.0, displacement=reach, velocity=2.0 * np.pi * 150.0 * reach,
        stiffness=setup.values()["k"], transducer=setup.values()["alpha"], slowest=20.0, fastest=150.0,
        duration=float(drive.t[-1]), noise=_NOISE,
    )  # fmt: skip
    units = (("V", 1.0), ("µm", 1e6))
    return Scene(setup, drive, base, scales, loops, ("voltage", "displacement"), units)


@cache
def tank_scene() -> Scene:
    """A pump that fills two tanks in swells of two sizes."""
    home = tanks()
    base, last = simulate(home.setup, home.drive), home.drive.t.size
    units = (("mL/s", 1e6), ("mL", 1e6))
    loops = (("small swell", 100, 200), ("large swell", last - 101, last - 1))
    return Scene(home.setup, home.drive, base, home.scales, loops, ("inflow", "volume of the tank"), units)


@cache
def rig_scene() -> Scene:
    """A specimen that a table moves to and fro with two amplitudes."""
    home = rig()
    units = (("mm", 1e3), ("N", 1.0))
    loops = (("1.6 mm", 100, 201), ("4 mm", 300, 401))
    base = simulate(home.setup, home.drive)
    return Scene(home.setup, home.drive, base, home.scales, loops, ("imposed motion", "force"), units)


def scene_of(effect: Effect) -> Scene:
    """The scene to which an effect can be added."""
    return {tanks(): tank_scene, rig(): rig_scene}.get(home_of(effect), actuator_scene)()


def shown(effect: Effect) -> Shown:
    """The grid point of an effect, of a visible strength, that the base model can compensate least."""
    scene = scene_of(effect)
    found = [s for values in effect.grid(scene.scales) if (s := _at(effect, values, scene)) is not None]
    moderate = [s for s in found if np.abs(s.change).max() < _TOO_MUCH * np.abs(scene.base.y).max()]
    return max(moderate or found, key=lambda s: float(np.sqrt(np.mean(s.left**2))))


def _at(effect: Effect, values: dict[str, float], scene: Scene) -> Shown | None:
    """The effect at a grid point with a strength that is well visible; None where it cannot be simulated."""
    wanted, factor = SHOWN * float(np.abs(scene.base.y).max()), _FIRST if effect.strength else 1.0
    found = None
    for _ in range(_CORRECTIONS):
        try:
            found = _simulated(effect, effect.scaled(values, factor) if effect.strength else values, scene)
        except PhnnError:
            return found
        size = float(np.abs(found.change).max())
        if effect.strength is None or size == 0.0 or 1.0 / _CLOSE < size / wanted < _CLOSE:
            break
        factor *= float(np.clip(wanted / size, 1.0 / _LEAP, _LEAP))
    return found


def _simulated(effect: Effect, values: dict[str, float], scene: Scene) -> Shown:
    setup = effect.add_to(scene.setup, values)
    y = simulate(setup, scene.drive).y + _of_this_recording(setup, scene)
    change = y - scene.base.y
    return Shown(effect, values, y, change, change - _compensated(change, scene), setup)


def _of_this_recording(setup: Setup, scene: Scene) -> Array:
    """Terms that every recording has in a size of its own, such as lines of the mains: here of random sizes."""
    if setup.own == NOTHING:
        return np.zeros(scene.drive.t.size)
    columns = own_columns(replace(scene.drive, y=scene.base.y), setup.own)
    terms = columns @ np.random.default_rng(0).standard_normal(columns.shape[1])
    return np.asarray(SHOWN * np.abs(scene.base.y).max() / np.abs(terms).max() * terms)


@cache
def _sensitivities(scene: Scene) -> Array:
    """(N, P + 1) orthonormal basis of what parameters of the base model and a constant can change."""
    columns = np.column_stack([np.ones(scene.drive.t.size), output_derivatives(scene.base, list(scene.setup.free))])
    sizes = np.linalg.norm(columns, axis=0)
    return np.linalg.qr(columns[:, sizes > 0.0] / sizes[sizes > 0.0])[0]


def _compensated(change: Array, scene: Scene) -> Array:
    basis = _sensitivities(scene)
    return np.asarray(basis @ (basis.T @ change))


def _sine(frequency: float, amplitude: float, periods: int) -> Array:
    """Whole periods of a sine, which begins and ends at zero."""
    t = np.arange(round(periods / frequency / _DT)) * _DT
    return np.asarray(amplitude * np.sin(2.0 * np.pi * frequency * t))
