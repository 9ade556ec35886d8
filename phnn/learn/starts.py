"""The models a run can train, each from its start."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.identification.base import identify_base
from phnn.identification.plan import Options
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import held_by_statement
from phnn.identification.starting_points import MECHANICAL, drive_amplitude, mechanical_points, middle_frequency
from phnn.intake import LIMITS
from phnn.integrate.differentiable import simulated
from phnn.integrate.scheme import can_compile
from phnn.learn.settings import TARGET, accepted, instantiate
from phnn.learn.solvers import NetworkPlant, Plant, discrete_gradient, windows_of
from phnn.models.actuator import hrc
from phnn.models.neural import STARTS, LearnedLaws, Motion, effort_and_flow, held, neural_hrc, resolved_slope, staggered
from phnn.models.store import load
from phnn.network.elements import Modulation, MultiPort, Network
from phnn.network.system import PortHamiltonianSystem
from phnn.nn.learned_system import LearnedSystem, NeuralODE, Scales
from phnn.nn.multi_ports import LearnedDissipation, LearnedRatio
from phnn.recordings.manifest import shown
from phnn.recordings.recording import Campaign, Recording, dominant_frequency

NETWORKS = ("hrc", "neural_hrc", "hybrid")
# Share of the typical flows that a learned multi-port carries at the start.
_LITTLE = 1e-4
STAGGERED = "staggered"
# Models of latent states, and from where they start.
LATENT, LATENT_STARTS = ("fully_neural", "neural_ode"), ("linear", "random", STAGGERED, "parametric")
# Of a neural ODE: rate of the fast lag over that of the highest frequency, and what each slow lag adds to the gain.
_FAST, _SLOW = 1.5, 0.1
# Points at which its perceptron is fitted, in typical sizes.
_POINTS, _REACH = 4000, 1.5
# Layers that are less curved than usual carry a linear field within some percent.
_GENTLE = 0.5

# Electrical stiffness of a hysteron over the mechanical one, and the width of a closed dead zone over the drive.
_SHARE, _CLOSED = 0.15, 1e-6
# Largest counts of what a model is made of.
_MOST = {"hysterons": LIMITS.hysterons, "states": LIMITS.elements, "width": LIMITS.units, "spring_width": LIMITS.units}
# Relaxation rates of such hysterons over the middle frequency.
_RATES = (30.0, 1.0)


def plant_for(model: Mapping[str, Any], campaign: Campaign, seed: int, base: str | None = None) -> Plant:
    """Return the untrained plant of a run.

    Args:
        model: ``kind`` and its arguments. ``hrc`` is the parametric network, ``neural_hrc`` takes the arguments of
            `neural_hrc` and `LearnedLaws`. ``start`` of both: ``parametric`` begins from the identified base model,
            ``none`` from one of the recordings' gain whose hysterons have no dead zone, ``staggered`` (of ``hrc``) from
            the dead zones that the drive alone gives, with which learned resistors begin under ``none``.
            ``hybrid`` is ``hrc`` with a `LearnedDissipation` of ``width`` on all hysterons and the mass together, and
            with ``ratio`` a transducer ratio that follows the displacement by a `LearnedRatio`.
            ``fully_neural`` is a `LearnedSystem` and ``neural_ode`` a `NeuralODE` of ``states`` and ``width``; their
            ``start`` is ``linear``, relaxations with the gain and the band of the recordings, or ``random``; of the
            former also ``staggered``, hysterons with the thresholds that the drive alone gives, or ``parametric``, the
            identified base model.
            Instead of ``kind``, ``_target_`` names a class or function of the user's own, which the other arguments are
            passed to: it makes a network, a system, or a law of one effort for all ``hysterons``.
        base: folder of an identified base model, to save its identification.

    Raises:
        InputRefused: an unknown kind or argument.
    """
    arguments = dict(model)
    recordings = [r for r in campaign.recordings if r.mask("identification").any()]
    if arguments.get(TARGET):
        return _custom(arguments, campaign, recordings, seed, base)
    arguments.pop(TARGET, None)
    kind = arguments.pop("kind")
    if kind in LATENT:
        _check(kind, arguments, ("states", "width", "start"))
        return _latent(arguments | {"kind": kind}, campaign, recordings, seed, base)
    if kind not in NETWORKS:
        raise InputRefused(f"model.kind = {kind!r}: choose one of {', '.join((*NETWORKS, *LATENT))}")
    form = {"neural_hrc": tuple(f.name for f in fields(LearnedLaws)), "hybrid": ("width", "ratio")}.get(kind, ())
    _check(kind, arguments, ("hysterons", "start", *form))
    hysterons, start = int(arguments.get("hysterons", 2)), str(arguments.get("start", "parametric"))
    if kind != "neural_hrc" and start not in (*STARTS, STAGGERED):
        raise InputRefused(f"model.start = {start!r}: choose {', '.join((*STARTS, STAGGERED))}")
    values = _values(campaign, hysterons, start, base, seed)
    motion = motion_of(recordings)
    if kind == "neural_hrc":
        if start == "none":
            # A closed dead zone is no start to be fitted to.
            values = {n: v for n, v in values.items() if not n.startswith("d_")}
        laws = LearnedLaws(**{n: v for n, v in arguments.items() if n in form})
        network = neural_hrc(hysterons, laws, start, values, motion, seed=seed)
    else:
        if start == STAGGERED:
            values |= _dead_zones(values, hysterons, motion)
        network = hrc(hysterons, values)
        if kind == "hybrid":
            network = _with_multi_port(network, motion, int(arguments.get("width", 16)), seed)
        if arguments.get("ratio"):
            network = network.extend(modulations=(Modulation("alpha", "q", LearnedRatio(state_scale=motion.reach)),))
    network = held(network, held_by_statement(campaign.known))
    return NetworkPlant(network, typical_states(network, recordings))


def _with_multi_port(network: Network, motion: Motion, width: int, seed: int) -> Network:
    """Return the actuator with one learned dissipation on its hysterons and its mass, nearly silent at first."""
    charges = [s.name for s in network.storages if s.name.startswith("Q_")]
    values = {n: p.value for n, p in network.parameters.items()}
    typical = [effort_and_flow(i + 1, values, motion) for i in range(len(charges))]
    typical.append((motion.speed, values["k"] * motion.reach))
    efforts, flows = [e for e, _ in typical], [_LITTLE * f for _, f in typical]
    law = LearnedDissipation(len(typical), 0, efforts, flows, width=width, seed=seed)
    return network.extend(multi_ports=(MultiPort("learned", law, (*charges, "p")),))


def _custom(
    arguments: Mapping[str, Any], campaign: Campaign, recordings: Sequence[Recording], seed: int, base: str | None
) -> Plant:
    """Build the network or system of a user's class or function; put a law of one effort on every hysteron instead."""
    known = {n: arguments[n] for n in ("hysterons", "start") if n in arguments}
    taken = accepted(arguments[TARGET])
    # What the configuration of learned hysterons holds beside them is for those classes that know it.
    for_laws = [f.name for f in fields(LearnedLaws) if f.name not in taken]
    thing = instantiate({n: v for n, v in arguments.items() if n not in ("kind", *for_laws, *(known.keys() - taken))})
    if isinstance(thing, nn.Module) and not isinstance(thing, PortHamiltonianSystem):
        hysterons = int(known.get("hysterons", 2))
        values = _values(campaign, hysterons, str(known.get("start", "parametric")), base, seed)
        network = held(hrc(hysterons, values), held_by_statement(campaign.known))
        for i in range(1, hysterons + 1):
            network = network.replace(f"hysteron_{i}", copy.deepcopy(thing))
        thing = network
    if not isinstance(thing, Network | PortHamiltonianSystem):
        raise InputRefused(
            f"{arguments[TARGET]} makes a {type(thing).__name__}: it must make a Network, a PortHamiltonianSystem, or "
            "a torch module that is a law of one effort"
        )
    return NetworkPlant(thing, typical_states(thing, recordings))


def _latent(
    arguments: Mapping[str, Any], campaign: Campaign, recordings: Sequence[Recording], seed: int, base: str | None
) -> Plant:
    """Return a model of latent states at its start."""
    kind = arguments["kind"]
    known = LATENT_STARTS[: 2 if kind == "neural_ode" else None]
    start, scales = arguments.get("start", "linear"), scales_of(recordings)
    if start not in known:
        raise InputRefused(f"model.start = {start!r}: choose {' or '.join(known)}")
    states, width = int(arguments.get("states", 4)), int(arguments.get("width", 32))
    if kind == "neural_ode":
        core = NeuralODE(scales, states, width, seed)
        if start == "linear":
            _lags(core, recordings, torch.Generator().manual_seed(seed))
        # Its states are of order one.
        return Plant(core, torch.ones(states, dtype=torch.float64))
    size, motion = torch.tensor([scales.output, *[1.0] * (states - 1)], dtype=torch.float64), motion_of(recordings)
    if start == "random" or states <= 2:
        return NetworkPlant(LearnedSystem(states, ("voltage",), width, scales, seed), size)
    hysterons = range(1, states - 1)
    near = hrc(states - 2, _values(campaign, states - 2, start, base if start == "parametric" else None, seed))
    values = {n: p.value for n, p in near.parameters.items()}
    if start == STAGGERED:
        near = hrc(states - 2, values | _dead_zones(values, states - 2, motion))
    elif start == "parametric":
        near = hrc(states - 2, values | {f"rho_{i}": resolved_slope(i, values, motion) for i in hysterons})
    else:
        for i in hysterons:
            near = near.replace(f"hysteron_{i}", "linear", (f"rho_{i}",))
    given = PortHamiltonianSystem(near)
    system = LearnedSystem.near(given, scales, width, seed, typical_states(given, recordings))
    return near_to(NetworkPlant(system, size), NetworkPlant(given, size), campaign.recordings, system.from_given)


@torch.no_grad()
def _lags(core: NeuralODE, recordings: Sequence[Recording], random: torch.Generator) -> None:
    """Fit one fast lag and slow ones over the recorded band, ``−λ_i x_i + λ_i c_i u``, in the last layer."""
    n = core.states
    slow = [2.0 * np.pi * dominant_frequency(r) * core.scales.time for r in recordings]
    spread = torch.logspace(np.log10(min(slow)), np.log10(max(slow)), n - 1, dtype=torch.float64)
    rates = torch.cat([torch.tensor([_FAST]).double(), spread])
    gains = torch.full((n,), _SLOW, dtype=torch.float64)
    gains[0] = 1.0 - _SLOW * (n - 1)
    points = _REACH * (2.0 * torch.rand(_POINTS, n + 1, generator=random, dtype=torch.float64) - 1.0)
    wanted = rates * (gains * points[:, -1:] - points[:, :-1])
    for weight in core.field.weights[:-1]:
        weight.mul_(_GENTLE)
    core.field.fit(points, wanted)
    core.readout.fill_(1.0)


def _dead_zones(values: Mapping[str, float], hysterons: int, motion: Motion) -> dict[str, float]:
    """Return the thresholds and slopes that the drive alone gives."""
    zones = {}
    for i in range(1, hysterons + 1):
        zones[f"d_{i}"], zones[f"rho_{i}"], _ = staggered(i, *effort_and_flow(i, values, motion))
    return zones


def _check(kind: str, arguments: Mapping[str, Any], known: Sequence[str]) -> None:
    for name, value in arguments.items():
        if name not in known:
            raise InputRefused(f"model.{name}: {kind} takes {', '.join(known)}")
        most = _MOST.get(name)
        if most is not None and not (type(value) is int and 0 <= value <= most):
            raise InputRefused(f"model.{name}={shown(value)} must be a whole number from 0 to {most}")


def _values(campaign: Campaign, hysterons: int, start: str, base: str | None, seed: int) -> dict[str, float]:
    """Return the starting values of the physical parameters."""
    if base is not None:
        values = load(Path(base))[0].values()
    elif start == "parametric":
        values = identify_base(campaign, Options(seed=seed))[0].setup.values()
    else:
        values = unfitted(campaign, hysterons)
    wanted = hrc(hysterons).parameters
    return {n: v for n, v in values.items() if n in wanted}


def unfitted(campaign: Campaign, hysterons: int) -> dict[str, float]:
    """Return parameters with the recordings' static gain, a usual resonance, and relaxations for dead zones.

    They are not fitted first: a linear model takes hysteresis for a lag and loses its mass on the way.
    """
    plan = identification_plan(campaign, 1)
    anchored = {n: a.value for n, a in campaign.known.items() if n in hrc(hysterons).parameters}
    points = mechanical_points(plan, anchored)
    mechanical = points[len(points) // 2].values()
    values = {n: mechanical[n] for n in MECHANICAL}
    omega = 2.0 * np.pi * middle_frequency(plan.recordings)
    for i in range(hysterons):
        c = values["alpha"] ** 2 / (_SHARE * values["k"])
        values |= {f"C_{i + 1}": c, f"rho_{i + 1}": _RATES[i % len(_RATES)] * omega * c}
        values |= {f"d_{i + 1}": _CLOSED * drive_amplitude(plan.recordings)}
    # Stiffness gives up what the hysterons take while they stick, so that the small-signal gain stays.
    return values | {"k": values["k"] / (1.0 + 0.5 * _SHARE * hysterons)} | anchored


def scales_of(recordings: Sequence[Recording]) -> Scales:
    """Scale time by the highest main frequency, ``1/(2π f)``, input by its largest value, output by half its range."""
    fastest = max(dominant_frequency(r) for r in recordings)
    largest = max(float(np.abs(r.u).max()) for r in recordings)
    return Scales(1.0 / (2.0 * np.pi * fastest), largest, motion_of(recordings).reach)


def motion_of(recordings: Sequence[Recording]) -> Motion:
    """Return half the largest range of the output [m], and the largest velocity of a sine of that size [m/s]."""
    halves = [(0.5 * float(np.ptp(r.y)), dominant_frequency(r)) for r in recordings]
    return Motion(max(h for h, _ in halves), max(2.0 * np.pi * f * h for h, f in halves))


def near_to(plant: NetworkPlant, known: NetworkPlant, recordings: Sequence[Recording], factor: Tensor) -> NetworkPlant:
    """Let the first iterations of a plant begin at another one's states (N, n), times a matrix (n, n)."""
    windows = windows_of(recordings, 0, 1)
    try:
        with torch.no_grad():
            for w in windows:
                x = simulated(known.system, torch.zeros(len(factor)).double(), known.inputs(w.mean), w.h)
                plant.near[w.name] = w.times, x @ factor.mT
    except SolverFailed:
        plant.near.clear()
    return plant


def near_known_part(plant: NetworkPlant, recordings: Sequence[Recording]) -> None:
    """Begin the first iterations at the states of the network without its laws on several variables."""
    network = plant.network
    known = replace(network, multi_ports=(), shared_energies=())
    if known.resistors and not can_compile(network) and can_compile(known):
        near_to(plant, NetworkPlant(known, plant.scale), recordings, torch.eye(len(plant.scale)).double())


def typical_states(given: Network | PortHamiltonianSystem, recordings: Sequence[Recording]) -> Tensor:
    """Return (n,) the largest untrained states on the recordings; one where it stays at zero or cannot run."""
    plant = NetworkPlant(given, torch.ones(len(given.state_names), dtype=torch.float64))
    windows = windows_of(recordings, 0, 1)
    try:
        with torch.no_grad():
            paths = discrete_gradient(plant, windows, torch.zeros(len(windows), plant.scale.numel()).double())
    except SolverFailed:
        return plant.scale
    largest = torch.stack([x.abs().amax(0) for x in paths]).amax(0)
    return torch.where(largest > 0.0, largest, 1.0)
