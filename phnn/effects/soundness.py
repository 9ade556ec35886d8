"""The requirements on every effect: declared parameters, structure, strength and derivatives.

The checks apply to the effects of the catalogue and to those given to `phnn.effects.register`. They add an effect to a
base model with a short recording that moves it; each refuses an effect with cause and remedy.
"""

from __future__ import annotations

import string
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import torch
from matplotlib.mathtext import MathTextParser

from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.effects.effect import Effect, Scales
from phnn.effects.kinds import LOCATIONS
from phnn.errors import InputRefused, PhnnError
from phnn.integrate.equations import check, power_balance
from phnn.laws import STORAGE_LAWS
from phnn.models.actuator import from_paper
from phnn.models.network_file import load_network
from phnn.network import Network, PortHamiltonianSystem
from phnn.recordings.recording import Recording, Units, unrecorded
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate


@dataclass(frozen=True, eq=False)
class Home:
    """A base model, the sizes met in its recordings, and one of them."""

    setup: Setup
    scales: Scales
    drive: Recording


@cache
def actuator() -> Home:
    """Return the piezo actuator of the paper: two amplitudes of a sine from rest."""
    scales = Scales(
        voltage=75.0, displacement=1.2e-4, velocity=0.1, stiffness=24579.0, transducer=0.046, slowest=20.0,
        fastest=150.0, duration=0.02, noise=5e-8,
    )  # fmt: skip
    t = np.arange(401) * 5e-5
    u = 75.0 * np.sin(2 * np.pi * 100.0 * t) * np.where(t < 0.01, 0.4, 1.0)
    return Home(Setup(from_paper()), scales, unrecorded("home", t, u))


@cache
def tanks() -> Home:
    """Return a pump that fills two tanks by swells of two sizes."""
    scales = Scales(
        voltage=1e-4, displacement=1.4e-3, velocity=2e-4, stiffness=1.0, transducer=1.0, slowest=0.02, fastest=0.05,
        duration=100.0, noise=1e-6,
    )  # fmt: skip
    t = np.arange(401) * 0.25
    u = 5e-5 * (1.0 - np.cos(2 * np.pi * 0.04 * t)) * np.where(t < 50.0, 0.4, 1.0)
    return Home(Setup(load_network(config_folder() / "network" / "tanks.yaml")), scales, unrecorded("home", t, u))


@cache
def rig() -> Home:
    """Return a specimen with dry friction that a table moves to and fro, with two amplitudes."""
    scales = Scales(
        voltage=4e-3, displacement=4e-3, velocity=0.1, stiffness=1e4, transducer=1.0, slowest=2.0, fastest=4.0,
        duration=1.0, noise=1.0, effort=1e3,
    )  # fmt: skip
    t = np.arange(401) * 2.5e-3
    u = 4e-3 * np.sin(2 * np.pi * 4.0 * t) * np.where(t < 0.5, 0.4, 1.0)
    setup = Setup(load_network(config_folder() / "network" / "friction_rig.yaml"))
    # A friction that turns round at once would show the smallest play at its full height.
    return Home(setup.with_values({"v_s": 0.1}), scales, replace(unrecorded("home", t, u), units=Units("m", "N")))


def home_of(effect: Effect) -> Home | None:
    """Return the first base model to which an effect can be added, of the actuator, the tanks and the rig; None if it
    applies to none of them."""
    return next((h for h in (actuator(), tanks(), rig()) if effect.can_be_added_to(h.setup)), None)


@cache
def base_of(home: Home) -> Trajectory:
    """Return the simulation without an effect."""
    return simulate(home.setup, home.drive)


# The first grid point changes the output hardly; multiplied by this factor, its strength is visible.
_SEEN = 50.0


def point(effect: Effect, home: Home) -> dict[str, float]:
    """Return the first point of the effect's grid, scaled to a visible strength."""
    return effect.scaled(effect.grid(home.scales)[0], _SEEN)


def added(effect: Effect, values: dict[str, float], home: Home) -> Trajectory:
    """Return the simulation with one effect at parameter values [SI]."""
    return simulate(effect.add_to(home.setup, values), home.drive)


# Largest relative residual of the compiled simulation in the torch module's equations, and rounding of its structure.
_RESIDUAL, _ROUNDING = 1e-10, 1e-12
# Every seventh state of a simulation is checked.
_EVERY = 7


def sources(network: Network) -> list[bool]:
    """Return the storages whose energy is not bounded below."""
    return [not STORAGE_LAWS[s.law].bounded for s in network.storages]


def faults(setup: Setup, home: Home) -> list[str]:
    """The defects of a setup's structure on a home's recording, each as half a sentence; empty if there are none.

    Weights aside, the network must be passive: ``J = −Jᵀ``, ``D = Dᵀ ≥ 0``, energies not negative, and in every step
    the ports supply the energy that is stored and dissipated.
    """
    trajectory = simulate(setup, home.drive)
    if not np.isfinite(trajectory.y).all():
        return ["its output is not finite"]
    system = PortHamiltonianSystem(setup.network)
    x, unbounded = torch.from_numpy(trajectory.states)[::_EVERY], torch.tensor(sources(setup.network))
    with torch.no_grad():
        j, d, held = system.structure(x), system.dissipation(x), system.energies(x)
    lost = torch.linalg.eigvalsh(d) + _ROUNDING * d.abs().amax((-2, -1))[:, None]
    balance = power_balance(trajectory, system)
    size = balance.supplied.abs().sum(-1) + balance.dissipated.abs().sum(-1) + held.abs().max()
    sound = {
        "the compiled simulation does not solve the network's equations": check(trajectory, system=system) < _RESIDUAL,
        "J is not skew-symmetric": torch.equal(j, -j.mT),
        "D is not symmetric": torch.equal(d, d.mT),
        "D has a negative eigenvalue": bool((lost >= 0.0).all()),
        "an energy is negative": bool((held[:, ~unbounded] >= 0.0).all()),
        "power is not balanced": bool((balance.defect.abs() <= _ROUNDING * size).all()),
        "a resistor feeds energy in": bool((balance.dissipated >= -_ROUNDING * size[:, None]).all()),
    }
    return [text for text, holds in sound.items() if not holds]


Check = Callable[[Effect, Home], None]

# Least change of the output by an effect at a visible strength, as a share of the output.
_MOVES = 1e-4
# Factors of the strength, and the factor by which the change must fall from one to the next.
_WEAKER, _FALLS = (1e-2, 1e-4), (0.2, 0.02)
# Factors by which the first-order estimate of a strength may be wrong.
_FACTORS = (-3.0, 0.0, 0.5, 20.0)
# Relative step of a finite difference, its largest error, and the share of samples that kinks may spoil.
_STEP, _WRONG, _SPOILT = 1e-5, 1e-4, 0.05


def _require(effect: Effect, holds: bool, cause: str) -> None:
    if not holds:
        raise InputRefused(f"effect {effect.name}: {cause}")


def words(effect: Effect, home: Home) -> None:
    """The location is known, and a report can show statement and equation."""
    _require(effect, effect.location in LOCATIONS, f"no location is called {effect.location!r}; use one of {LOCATIONS}")
    strange = {name for _, name, _, _ in string.Formatter().parse(effect.statement) if name} - set(effect.parameters)
    _require(effect, not strange, f"its statement names {sorted(strange)}, which it does not declare")
    try:
        MathTextParser("path").parse(f"${effect.equation}$")
    except ValueError as error:
        raise InputRefused(f"effect {effect.name}: its equation is no LaTeX that can be set: {error}") from None


def place(effect: Effect, home: Home) -> None:
    """It can be added once and not twice."""
    _require(effect, bool((effect.applies.__doc__ or "").strip()), "its condition has no docstring to be shown")
    _require(effect, effect.can_be_added_to(home.setup), f"it cannot be added to {home.setup.name}")
    once = effect.add_to(home.setup, effect.grid(home.scales)[0])
    _require(effect, not effect.can_be_added_to(once), "it can be added twice: let its condition refuse that")


def grid(effect: Effect, home: Home) -> None:
    """Every grid point gives all declared parameters, and a setup that has them and can be simulated."""
    before = set(home.setup.parameters)
    for values in effect.grid(home.scales):
        declared = set(values) == set(effect.parameters)
        _require(effect, declared, f"its grid gives {sorted(values)}, it declares {sorted(effect.parameters)}")
        setup = effect.add_to(home.setup, values)
        new = set(setup.parameters) - before
        _require(effect, new == set(values), f"it adds the parameters {sorted(new)}, it declares {sorted(values)}")
        kept = {name: setup.parameters[name].value for name in values} == values
        _require(effect, kept, f"the setup has other parameter values than the grid's {values}")
        finite = bool(np.isfinite(simulate(setup, home.drive).y).all())
        _require(effect, finite, f"the output is not finite at {values}")


def structure(effect: Effect, home: Home) -> None:
    """The network stays port-Hamiltonian; active parts lie outside it or are declared as energy sources."""
    setup = effect.add_to(home.setup, point(effect, home))
    defects = faults(setup, home)
    _require(effect, not defects, f"with it {', and '.join(defects)}: use laws that keep the structure")
    inside = setup.network != home.setup.network
    outside = bool(setup.amplifier or setup.sensor or setup.own != home.setup.own)
    _require(effect, inside != outside, "it adds nothing, or acts inside and outside the network: make two effects")
    passive = inside and not any(sources(setup.network))
    _require(
        effect, effect.passive == passive, f"its addition is {'' if passive else 'not '}passive, and says otherwise"
    )


def strength(effect: Effect, home: Home) -> None:
    """It changes the output, and changes it less at smaller strength."""
    values = point(effect, home)
    is_nuisance = effect.add_to(home.setup, values).own != home.setup.own
    moved = [_change(effect, values, home)]
    if is_nuisance:
        # The amplitudes and phases of lines and the drift of a sensor are nuisances: they do not change the simulation.
        _require(effect, moved[0] == 0.0, "it is a nuisance of each recording, but changes the simulation")
        return
    _require(effect, moved[0] > _MOVES, f"it changes the output by {moved[0]:.2g} of it only: begin its grid higher")
    if not effect.parameters:
        return  # The effect has no strength that could be reduced.
    weak = values
    for share in _WEAKER:
        if effect.strength is None:
            # A limit above every command has no effect.
            first = effect.parameters[0]
            weak = values | {first: values[first] * (1.0 + 1.0 / share)}
        else:
            weak = effect.scaled(weak, _WEAKER[0])
        moved.append(_change(effect, weak, home))
    falls = all(after <= most * before for (before, after), most in zip(pairwise(moved), _FALLS, strict=True))
    _require(effect, falls, f"it does not vanish with its strength: it changes the output by {moved}")


def scaling(effect: Effect, home: Home) -> None:
    """The values stay physical for every factor of the strength."""
    values = point(effect, home)
    for factor in _FACTORS:
        scaled = effect.scaled(values, factor)
        _require(effect, set(scaled) == set(values), "scaling changes which parameters have values")
        finite = bool(np.isfinite(added(effect, scaled, home).y).all())
        _require(effect, finite, f"the output is not finite where its strength is multiplied by {factor:g}")


def derivatives(effect: Effect, home: Home) -> None:
    """Derivatives of the output by its free parameters agree with central differences."""
    setup = effect.add_to(home.setup, point(effect, home))
    names = [name for name in setup.free if name in effect.parameters]
    got = output_derivatives(simulate(setup, home.drive), names)
    for k, name in enumerate(names):
        value = setup.parameters[name].value
        step = _STEP * (abs(value) or setup.parameters[name].typical)
        ends = [simulate(setup.with_values({name: value + s}), home.drive).y for s in (step, -step)]
        wanted = (ends[0] - ends[1]) / (2.0 * step)
        size = float(np.abs(wanted).max())
        _require(effect, size > 0.0, f"the output does not depend on {name}: declare it constant, or leave it out")
        # The simulation has kinks. A finite difference may straddle one, so that a few samples may differ.
        spoilt = float((np.abs(got[:, k] - wanted) > _WRONG * size).mean())
        _require(effect, spoilt < _SPOILT, f"the derivative by {name} is wrong in {spoilt:.0%} of the samples")


def _change(effect: Effect, values: dict[str, float], home: Home) -> float:
    """Largest change of the output by an effect, relative to the output."""
    base = base_of(home).y
    return float(np.abs(added(effect, values, home).y - base).max() / np.abs(base).max())


CHECKS: tuple[Check, ...] = (
    words, place, grid, structure, strength, scaling, derivatives,
)  # fmt: skip


def check_effect(effect: Effect, home: Home) -> None:
    """Every check, for the effect and all its forms.

    Raises:
        InputRefused: one of them fails; the message has cause and remedy.
    """
    for form in (effect, *effect.forms):
        for condition in CHECKS:
            try:
                condition(form, home)
            except InputRefused:
                raise
            except (PhnnError, KeyError, ValueError, TypeError) as error:
                raise InputRefused(f"effect {effect.name}: {condition.__name__}: {error!r}") from error
