"""Passivity-based control of an actuator: a passive circuit at its voltage port, and the same law sampled.

The voltage port of Proposition 1 is collocated: with ``V`` goes the current ``i = α q̇``. A circuit whose voltage is
taken off a constant ``u*`` is therefore a spring and a damper on the mass. The law, and the circuit that it is:

    V = u* − (1/α) [k_s (q − q*) + c v̂ + c a² η],   v̂ = ω s/(s + ω) (q − q*),   η̇ = (q − q*) − a η
    V = u* − Q_s/C_s − Q_f/C_f,   Q̇_s = i,   Q̇_f = i − G Q_f/C_f − λ/L,   λ̇ = Q_f/C_f
    1/C_s = (k_s + c a)/α²,   1/C_f = c (ω − a)/α²,   G = C_f (ω + a),   1/L = C_f a ω

``C_f`` is the filter of the derivative, ``L`` the integral. All elements are positive for ``0 < a < ω``. ``Q_s − α q``
is constant (a Casimir function), so ``u*`` is no source: it is in the initial charge ``Q_s = α (q − q*) − C_s u*``.
docs/control.md has the energy of the closed loop, what the leak of a passive integral costs, and a criterion of
stability without it.

References: Ortega, van der Schaft, Maschke & Escobar 2002, "Interconnection and damping assignment passivity-based
control"; van der Schaft & Jeltsema 2014, "Port-Hamiltonian Systems Theory", on control by interconnection.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from torch import Tensor

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import kernel
from phnn.integrate.program import compile_network
from phnn.integrate.scheme import obstacle
from phnn.inverse.blocks import FlatNetwork
from phnn.model import Model
from phnn.network.elements import Coupling, Network, Port, Resistor, Storage, interconnect
from phnn.network.roles import linearised_at_rest
from phnn.network.system import PortHamiltonianSystem
from phnn.parameters import as_table, constant
from phnn.setup import Setup
from phnn.signals.sampling import series

__all__ = ["Controller", "Mechanics", "Run", "Sampled", "shape", "simulate"]

Array = NDArray[np.float64]

# Default integral and corner of the derivative's filter, as shares of the natural frequency of the closed loop.
_INTEGRAL, _CORNER = 0.4, 6.0
# Factor by which the gains of a sampled law may grow before its loop is unstable.
_MARGIN = 1.5
# Share of its flow at twice the charge below which a hysteron counts as silent.
_SILENT = 1e-12


class Mechanics(NamedTuple):
    """Hold what small motions of an actuator show.

    Attributes:
        m: mass [kg]; b: linear damping [N s/m]; alpha: transducer ratio [N/V].
        k: stiffness of the spring [N/m]; elastic: the same with the charges of all hysterons held.
        q, p: places of displacement and momentum in the state.
    """

    m: float
    b: float
    alpha: float
    k: float
    elastic: float
    q: int
    p: int


@dataclass(frozen=True)
class Controller:
    """Hold a control law and the model that it was made for; `shape` makes it.

    Attributes:
        network: the model; mechanics: its small motions.
        stiffness: ``k_s`` [N/m]; damping: ``c`` [N s/m]; integral: ``a`` [1/s]; corner: ``ω`` [rad/s].
        limits: lowest and highest voltage [V].
    """

    network: Network
    mechanics: Mechanics
    stiffness: float
    damping: float
    integral: float
    corner: float
    limits: tuple[float, float]

    @cached_property
    def circuit(self) -> Network:
        """Return the law as a passive network: current into the port ``current``, voltage out of it."""
        c, w, a, square = self.damping, self.corner, self.integral, self.mechanics.alpha**2
        filtering = c * (w - a) / square
        values = [
            constant("control_C_s", square / (self.stiffness + c * a), "F"),
            constant("control_C_f", 1.0 / filtering, "F"),
            constant("control_G", (w + a) / filtering, "S"),
            *([constant("control_L", filtering / (a * w), "H")] if a > 0.0 else []),
        ]
        storages = (
            Storage("control_Q_s", "capacitor", ("control_C_s",), "C"),
            Storage("control_Q_f", "capacitor", ("control_C_f",), "C"),
            *((Storage("control_flux", "capacitor", ("control_L",), "Wb"),) if a > 0.0 else ()),
        )
        return Network(
            storages,
            (Resistor("control_damping", "linear", {"control_Q_f": 1.0}, ("control_G",)),),
            (Coupling("control_flux", "control_Q_f"),) if a > 0.0 else (),
            (Port("current", {"control_Q_s": 1.0, "control_Q_f": 1.0}, unit="A"),),
            as_table(values),
            output="control_Q_s",
        )

    def closed_loop(self) -> Network:
        """Return actuator and circuit as one network; the wanted displacement is in its state, see `begin`."""
        return interconnect(self.network, self.network.ports[0].name, self.circuit, "current")

    @torch.no_grad()
    def equilibrium(self, q_star: float) -> tuple[Tensor, float]:
        """Return the equilibrium (12) at a displacement and the voltage that holds it.

        It is the member of the set that a slow motion from rest in one direction reaches: every charge is ``α q*``, or
        at the end of its dead zone where that comes first.

        Args:
            q_star: displacement [m].

        Returns:
            ``x*`` (n,) in SI and ``u*`` [V].

        Raises:
            InputRefused: ``q*`` is not finite, or ``u*`` is outside the limits.
        """
        if not math.isfinite(q_star):
            raise InputRefused(f"q_star = {q_star}: give a finite displacement in metres")
        system, part = PortHamiltonianSystem(self.network), self.mechanics
        x = torch.zeros(len(self.network.storages), dtype=torch.float64)
        u = torch.zeros(len(self.network.ports), dtype=torch.float64)
        moved = system.structure(x)[:, part.p] * q_star

        def stays(share: Tensor) -> Tensor:
            flow, twice = (system.vector_field(times * share * moved, u).abs() for times in (1.0, 2.0))
            return flow <= _SILENT * twice

        high = torch.ones_like(x)
        low = stays(high).to(x.dtype)
        for _ in range(60):
            middle = 0.5 * (low + high)
            resting = stays(middle)
            low, high = torch.where(resting, middle, low), torch.where(resting, high, middle)
        x = low * moved
        x[part.q] = q_star
        voltage = -system.vector_field(x, u)[part.p].item() / part.alpha
        if not self.limits[0] <= voltage <= self.limits[1]:
            raise InputRefused(
                f"q_star = {q_star:g} m takes {voltage:.4g} V, outside of {self.limits[0]:g} to {self.limits[1]:g} V: "
                "give a displacement nearer to zero, or wider limits"
            )
        return x, voltage

    def begin(self, x: Tensor, q_star: float) -> Tensor:
        """Return the state of the closed loop when it is switched on.

        Args:
            x: (..., n) state of the actuator; its equilibrium ``x*`` gives that of the closed loop.
            q_star: displacement that is wanted [m].

        Returns:
            (..., N) states of ``closed_loop()``, those of the circuit first.

        Raises:
            InputRefused: as of `equilibrium`.
        """
        states = x.new_zeros(*x.shape[:-1], len(self.circuit.storages))
        shift = self.circuit.parameters["control_C_s"].value * self.equilibrium(q_star)[1]
        states[..., 0] = self.mechanics.alpha * (x[..., self.mechanics.q] - q_star) - shift
        return torch.cat([states, x], dim=-1)

    def sampled(self, dt: float, *, leak: bool = False, bandwidth: float | None = None) -> Sampled:
        """Return the law for a converter that samples and holds; see `Sampled`.

        Args:
            dt: sample time [s].
            leak: keep the leak of the integral, with which the law is passive; without it no offset remains.
            bandwidth: corner of the two lags through which the reference passes [rad/s]; None: half the natural
                frequency of the closed loop; ``math.inf``, no lag, for references that are smooth.

        Raises:
            InputRefused: a time or bandwidth that is not positive, a loop that is unstable when sampled, or a law of
                the model without compiled code.
        """
        natural = math.sqrt((self.mechanics.elastic + self.stiffness) / self.mechanics.m)
        return Sampled(self, dt, leak, natural / 2.0 if bandwidth is None else bandwidth)


class Sampled:
    """Return a voltage [V] for a measured displacement [m], once in every sample time; `Controller.sampled` makes it.

        law = controller.sampled(5e-5)
        voltage = law(measured, reference)             # held until the next sample

    The desired state moves with the reference ``r``: its charges follow the velocity by the model's compiled step, and
    ``u* = (m r̈ + b ṙ − Σ_i J_pi ē_i)/α`` with the mean efforts of this step. The feedback is that of `phnn.control` on
    ``d = y − r``, with ``v̂ = (1 − e^{−ω dt}) (d − n)/dt`` and ``n`` the filtered ``d``. The integral stops while the
    voltage is at a limit and would be pushed further. The law begins with the actuator at rest at zero.
    """

    def __init__(self, controller: Controller, dt: float, leak: bool, bandwidth: float) -> None:
        if not (0.0 < dt < math.inf and bandwidth > 0.0):
            raise InputRefused(f"dt = {dt} s, bandwidth = {bandwidth} rad/s: give positive numbers")
        part, a = controller.mechanics, controller.integral
        self._dt, self._limits, self._part = dt, controller.limits, part
        self._lag, self._smooth = (-math.expm1(-w * dt) for w in (controller.corner, bandwidth))
        # η grows by gain times d, and decays.
        leak = leak and a > 0.0
        self._decay, self._gain = (math.exp(-a * dt), -math.expm1(-a * dt) / a) if leak else (1.0, dt)
        self._by = controller.stiffness, controller.damping * self._lag / dt, controller.damping * a**2
        self._check()
        moved = FlatNetwork(Setup(controller.network)).imposed
        self._step, self._silent = _stepper(moved, dt), np.zeros(len(moved.ports))
        self._heavy = moved.parameters[moved.storages[part.p].parameters[0]].value
        self._x = np.zeros(len(moved.storages))
        self._row = _structure(controller.network)[part.p]
        self._first = self._q = self._v = self._n = self._eta = 0.0

    def _check(self) -> None:
        """Refuse a loop that is unstable, with the charges held or let go, for the gains or those with the margin."""
        part, (k_s, slope, k_i) = self._part, self._by
        for stiffness in (part.k, part.elastic):
            rates = [[0.0, 1.0, 0.0], [-stiffness / part.m, -part.b / part.m, 1.0 / part.m], [0.0, 0.0, 0.0]]
            motion = expm(np.array(rates) * self._dt)[:2]
            for times in (1.0, _MARGIN):
                law = np.array([k_s + slope, 0.0, -slope, k_i])
                loop = np.diag([0.0, 0.0, 1.0 - self._lag, self._decay])
                loop[2:, 0] = self._lag, self._gain
                loop[:2, :2] = motion[:, :2]
                loop[:2] -= times * np.outer(motion[:, 2], law)
                # Without an integral its state is no part of the loop.
                order = 4 if k_i > 0.0 else 3
                largest = np.abs(np.linalg.eigvals(loop[:order, :order])).max()
                if largest >= 1.0:
                    raise InputRefused(
                        f"dt = {self._dt:g} s: with {times:g} times its gains the sampled loop is unstable, with an "
                        f"eigenvalue of {largest:.4g}: sample faster, or lower the damping, stiffness or integral"
                    )

    def __call__(self, measured: float, reference: float) -> float:
        """Return the voltage [V] with which the displacement shall be at the reference [m] at the next sample."""
        part, (k_s, slope, k_i) = self._part, self._by
        d = measured - self._q
        self._first += self._smooth * (reference - self._first)
        after = self._q + self._smooth * (self._first - self._q)
        v = (after - self._q) / self._dt
        self._x[part.p] = self._heavy * v
        self._x, efforts = self._step(self._x, self._silent)
        force = part.m * (v - self._v) / self._dt + part.b * v - self._row @ efforts
        free = float(force - k_s * d - slope * (d - self._n) - k_i * self._eta) / part.alpha
        voltage = min(max(free, self._limits[0]), self._limits[1])
        if voltage == free or (free - voltage) * d * part.alpha > 0.0:
            self._eta = self._decay * self._eta + self._gain * d
        self._n += self._lag * (d - self._n)
        self._x[part.q] = self._q = after
        self._v = v
        return voltage


class Run(NamedTuple):
    """Hold a simulated loop: (N,) time [s], true and measured displacement [m], voltage from each sample on [V]."""

    t: Array
    displacement: Array
    measured: Array
    voltage: Array


def shape(
    model: Model | Setup | Network,
    *,
    stiffness: float | None = None,
    damping: float | None = None,
    integral: float | None = None,
    corner: float | None = None,
    limits: tuple[float, float] = (-math.inf, math.inf),
) -> Controller:
    """Return the passivity-based controller of an actuator: energy shaping and damping injection at its voltage port.

        controller = phnn.control.shape(phnn.models.hrc(hysterons=2), limits=(-100.0, 150.0))
        x_star, u_star = controller.equilibrium(50e-6)
        closed = phnn.PortHamiltonianSystem(controller.closed_loop())

    Args:
        model: identified or learned, of the kind of Proposition 1: one mass, on which the voltage acts with a constant
            ratio; springs and hysterons on it alone.
        stiffness: ``k_s`` [N/m]; None: that of the model's spring at rest.
        damping: ``c`` [N s/m]; None: critical damping of mass and springs, less the damping of the model.
        integral: ``a`` [1/s]; None: 0.4 of the natural frequency of the closed loop; 0: none.
        corner: ``ω`` [rad/s]; None: six times the natural frequency.
        limits: lowest and highest voltage [V].

    Raises:
        InputRefused: a model of another structure or with blocks that the law would ignore, or a gain out of its range.
    """
    network = _network_of(model)
    part = _mechanics(network)
    k_s = part.k if stiffness is None else stiffness
    total = part.elastic + k_s
    if not (0.0 < k_s < math.inf and total > 0.0):
        raise InputRefused(f"stiffness = {k_s:g} N/m: give a positive, finite one")
    natural = math.sqrt(total / part.m)
    c = max(2.0 * natural * part.m - part.b, 0.1 * part.b) if damping is None else damping
    a = _INTEGRAL * natural if integral is None else integral
    w = _CORNER * natural if corner is None else corner
    if not 0.0 < c < math.inf:
        raise InputRefused(f"damping = {c:g} N s/m: give a positive, finite one")
    if not 0.0 <= a < w < math.inf:
        raise InputRefused(f"integral = {a:g} 1/s, corner = {w:g} rad/s: give 0 or more, and a finite corner above it")
    if not limits[0] < limits[1]:
        raise InputRefused(f"limits = {limits}: give the lowest voltage, then the highest")
    return Controller(network, part, k_s, c, a, w, limits)


def simulate(
    plant: Model | Setup | Network,
    law: Callable[[float, float], float],
    reference: ArrayLike,
    dt: float,
    *,
    noise: float = 0.0,
    seed: int = 0,
    substeps: int = 4,
) -> Run:
    """Return a plant's motion from rest under a sampled law whose voltage is held between the samples.

        run = phnn.control.simulate(plant, controller.sampled(5e-5), reference, 5e-5, noise=5e-8, seed=1)

    A sample costs one call of the law and one of the compiled steps. `phnn.simulate` takes ``closed_loop()``, the loop
    in continuous time without noise, through all steps in one call.

    Args:
        plant: the actuator.
        law: measured displacement and the reference of the next sample [m] → voltage [V]; a `Sampled` or any other.
        reference: (N,) wanted displacement at the samples [m].
        dt: sample time [s].
        noise: standard deviation of the white noise of the measured displacement [m]; seed: of this noise.
        substeps: integration steps of the plant in a sample time.

    Raises:
        InputRefused: a value that is not finite or out of its range, or a plant without compiled code or with blocks
            beside its network.
        SolverFailed: a step has no solution.
    """
    network, wanted = _network_of(plant), series("reference", reference)
    if not (0.0 < dt < math.inf and substeps >= 1 and 0.0 <= noise < math.inf and np.isfinite(wanted).all()):
        raise InputRefused(
            f"dt = {dt} s, substeps = {substeps}, noise = {noise} m: give a positive time and count, noise of zero or "
            "more, and a finite reference"
        )
    output, step = network.state_names.index(network.output), _stepper(network, dt, substeps)
    x, u = np.zeros(len(network.state_names)), np.zeros(len(network.ports))
    errors: Array = noise * np.random.default_rng(seed).standard_normal(wanted.size)
    q, voltage = np.empty_like(wanted), np.empty_like(wanted)
    for k, ahead in enumerate([*wanted[1:].tolist(), *wanted[-1:].tolist()]):
        q[k] = x[output]
        u[0] = voltage[k] = law(float(q[k] + errors[k]), ahead)
        x = step(x, u)[0]
    return Run(np.arange(wanted.size, dtype=np.float64) * dt, q, q + errors, voltage)


def _stepper(network: Network, dt: float, substeps: int = 1) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Return the function of state (n,) and inputs (P,) to the state after ``dt`` and the mean efforts until then."""
    if reason := obstacle(network):
        raise InputRefused(reason)
    program, n = compile_network(network), len(network.state_names)
    theta, h = program.theta(network), np.full(substeps, dt / substeps)
    states, efforts = np.empty((substeps + 1, n)), np.empty((substeps, n))

    def step(x: Array, u: Array) -> tuple[Array, Array]:
        if kernel.march(program, theta, x, np.tile(u, (substeps, 1)), h, states, efforts) < substeps:
            raise SolverFailed(f"no solution of the step under {u[0]:.6g} V: use more sub-steps, or set limits")
        return states[-1].copy(), efforts.mean(0)

    return step


def _network_of(model: Model | Setup | Network) -> Network:
    """Return the network of a model that is nothing else."""
    setup = model.setup if isinstance(model, Model) else model
    if isinstance(setup, Network):
        return setup
    if not isinstance(setup, Setup):
        raise InputRefused(f"model: a {type(model).__name__}: give a Model, a Setup or a Network")
    if blocks := [b.kind for b in (*setup.amplifier, *setup.sensor)] + [b.kind for b in setup.sources]:
        raise InputRefused(
            f"{setup.name} has {', '.join(blocks)} beside its network, which the control law would ignore: give its "
            "network alone, setup.network, if that is meant"
        )
    return setup.network


@torch.no_grad()
def _structure(network: Network) -> Array:
    """Return ``J`` (n, n) at rest."""
    rest = torch.zeros(len(network.storages), dtype=torch.float64)
    return PortHamiltonianSystem(network).structure(rest).numpy()


def _mechanics(network: Network) -> Mechanics:
    """Return the small motions of an actuator; refuse another network."""
    flat, value = FlatNetwork(Setup(network)), {name: p.value for name, p in network.parameters.items()}
    port, q, p, mass = network.ports[0], flat.output, flat.momentum, flat.mass.name
    others = network.modulations or network.memories or network.multi_ports or network.shared_energies
    linear = port.law == "linear" and not others
    if not linear or any(len(r.on) != 1 for r in network.resistors):
        raise InputRefused(
            "the control law is known for a linear voltage port, constant ratios and resistors on one storage each: "
            "leave out the port law, modulations, modulator states, multi-ports and resistors between storages"
        )
    j = _structure(network)
    if np.delete(np.delete(j, p, 0), p, 1).any():
        raise InputRefused("springs and hysterons of the model act on more than the one mass: give a model of one mass")

    def number(given: str | float) -> float:
        return value[given] if isinstance(given, str) else given

    springs = -linearised_at_rest(network)[0][p] * j[:, p]
    dampers = [r for r in network.resistors if mass in r.on and r.law == "linear"]
    return Mechanics(
        m=value[flat.mass.parameters[0]],
        b=sum(value[r.parameters[0]] * number(r.on[mass]) ** 2 for r in dampers),
        alpha=number(port.on[mass]),
        k=float(springs[q]),
        elastic=float(np.delete(springs, p).sum()),
        q=q,
        p=p,
    )
