"""The modal model: its parameters, and what its modes and forces do under the inputs of an experiment.

As a port-Hamiltonian network it reads

    q̇_i = ω_i² p_i,     ṗ_i = −q_i − 2ζ_i ω_i p_i + Σ_j b_ij (u_j − e_j),     ẋ_j = Σ_i b_ij q̇_i = y_j

Each mode is a spring of stiffness one, an inertia ``1/ω_i²`` and a damper ``2ζ_i/ω_i``. The ratios ``b_ij`` are
transformers: they join the ports and the storages of the elements to the momenta, so that ``J`` is skew. The parts of
an element are laws of `phnn.laws`:

    stop         `spring` on the deflection s with the resistor `yielding`, ṡ = ẋ − max(|s| − r, 0) sign(s)/τ
    softening    `softening_spring` on the extension x;  hardening: `hardening_spring`
    drag         resistor `quadratic_drag` on ẋ

The stop of `phnn.modal.elements` is the limit ``τ → 0``. The slow part has no network: it follows the mean square of
the period before, and what it stores changes without a port that supplies it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.integrate.cache import inline, loop_entry
from phnn.integrate.roots import eliminate
from phnn.laws.resistor import quadratic_drag
from phnn.laws.storage import hardening_spring_mean_effort, softening_spring_mean_effort, spring_mean_effort
from phnn.modal.elements import HARDENING, SLOW, SOFTENING, STOP, PortElement
from phnn.modal.experiment import Experiment
from phnn.network.elements import Coupling, Network, Port, Resistor, Storage
from phnn.parameters import Parameter, as_table, constant, positive, signed

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Time in which a stop slides back to its threshold, times the highest natural frequency. At a velocity v the stop
# exceeds its threshold by τ|v|: at the fastest mode by this share of the amplitude of x.
_SLIP = 1e-6
# Names of the constants.
_STIFFNESS, _SLIP_TIME = "stiffness", "slip_time"


class _Part(NamedTuple):
    """What one part of an element adds to a network: its storage, its resistor, or both."""

    storage: Storage | None
    resistor: Resistor | None
    parameters: tuple[Parameter, ...]


def _modal_parameters(model: ModalModel, unit: str) -> list[Parameter]:
    """The parameters of the modes, the ratios, and the constants."""
    table = [constant(_STIFFNESS, 1.0, "1", "modal stiffness in coordinates in which it is one")]
    if (model.k[:, model.element.kinds == STOP] > 0.0).any():
        slip = _SLIP / float(model.omega.max())
        table.append(constant(_SLIP_TIME, slip, "s", "time in which a stop slides to its threshold"))
    for i, (w, z) in enumerate(zip(model.omega.tolist(), model.zeta.tolist(), strict=True), start=1):
        table.append(positive(f"m_{i}", w**-2, "s2", f"inertia of mode {i}, 1/ω²"))
        table.append(positive(f"c_{i}", 2.0 * z / w, "s", f"damping of mode {i}, 2ζ/ω"))
    typical = float(np.abs(model.b).max()) or 1.0
    for (i, j), b in np.ndenumerate(model.b):
        name, told = f"b_{i + 1}_{j + 1}", f"ratio between mode {i + 1} and port {j + 1}"
        table.append(signed(name, float(b), f"J1/2/{unit}", 0.0 if b else typical, typical, told))
    return table


def _parts(model: ModalModel, ratios: Sequence[dict[str, str]], unit: str) -> list[tuple[int, _Part]]:
    """The parts of the elements at all ports, each with the index of its port."""
    kinds = model.element.kinds.tolist()
    if any(kind == SLOW and (model.k[:, a] > 0.0).any() for a, kind in enumerate(kinds)):
        raise StructureViolated(
            "self_heating at the ports follows the mean square of the previous period, and a network knows no period: "
            "take a model without self_heating, or simulate this one with phnn.predict"
        )
    return [
        (j, _part(kinds[a], f"{j + 1}_{a + 1}", ratios[j], (float(k), float(model.thresholds[j, a])), unit))
        for (j, a), k in np.ndenumerate(model.k)
        if k > 0.0
    ]


def _part(kind: int, number: str, on: dict[str, str], values: tuple[float, float], unit: str) -> _Part:
    """One part on the extension of a port.

    Args:
        number: of the port and the part, ``j_a``; on: momentum to ratio of the port.
        values: weight k > 0 and threshold r of the part; unit: of the inputs.
    """
    weight, extension = f"k_{number}", f"J/{unit}"
    if kind == HARDENING:
        own = positive(weight, values[0], f"{unit}4/J3", "coefficient of a hardening spring")
        return _Part(Storage(f"x_{number}", "hardening_spring", (weight,), extension), None, (own,))
    if kind not in (STOP, SOFTENING):
        own = positive(weight, values[0], f"{unit}3 s2/J2", "coefficient of a drag")
        return _Part(None, Resistor(f"drag_{number}", "quadratic_drag", dict(on), (weight,)), (own,))
    reach = f"r_{number}"
    table = (
        positive(weight, values[0], f"{unit}2/J", "stiffness of a stop or a softening spring"),
        positive(reach, values[1], extension, "extension at which it slides or softens"),
    )
    if kind == SOFTENING:
        return _Part(Storage(f"x_{number}", "softening_spring", (weight, reach), extension), None, table)
    deflection = f"s_{number}"
    slip = Resistor(f"stop_{number}", "yielding", {deflection: 1.0}, (weight, reach, _SLIP_TIME))
    return _Part(Storage(deflection, "spring", (weight,), extension), slip, table)


# While the forces at the ports are constant over a step, modes move as in closed form, and the work done on them is
# ``Σ_j f_j Δx_j``: what they store more and what their dampers lose. An element gives the step's mean force ``ē_j``
# as a discrete gradient (Gonzalez 1996), so that ``ē_j Δx_j`` is what it stores more plus what it loses. Both
# balances are exact, and therefore every step is passive, whatever its length, within a period of slow springs.
# ``Δx`` follows from
#
#     Δx = Δx⁰ + C (u − ē(Δx)),     C_jl = Σ_i b_ij (1 − a_i) b_il,
#
# with ``Δx⁰`` without forces and ``a_i`` what is left of a displacement after a step; C shrinks with the square of the
# step, and the equation is solved by Newton's method.
#
# References: Gonzalez 1996, J. Nonlinear Sci. 6; Visintin 1994, Differential Models of Hysteresis, ch. III (stops).

# The integration stops at a larger Δx, before anything overflows; the largest Δx before the first step, not zero
# because changes are compared with it.
_LARGEST, _LEAST = 1e200, 1e-300
# Harmonic oscillators have decayed to this before the period that counts; periods at most.
_DECAYED, _PERIODS = 1e-4, 11


class Structure(NamedTuple):
    """Modes and ports: omega, zeta (M,) frequencies [rad/s] and damping ratios; b (M, P) ratios."""

    omega: Array
    zeta: Array
    b: Array


class Integrated(NamedTuple):
    """A period: q (n, M) at the steps' beginnings; s̄ (n, P, count) with ``ē = Σ k s̄``; whether steps were solved."""

    q: Array
    s: Array
    solved: bool


class _Period(NamedTuple):
    """Arrays for q (n, M) and s̄ (n, P, count) of the period that is returned."""

    q: Array
    s: Array


@inline
def _keep(modes: Any, step: Any, now: Any, out: Any) -> None:
    """Write a step's q and s̄ into the period; before the modes move."""
    for i in range(modes.q.size):
        out.q[now, i] = modes.q[i]
    for j in range(step.dx.size):
        for a in range(step.parts.shape[1]):
            out.s[now, j, a] = step.parts[j, a]


@loop_entry
def _march(u: Array, modes: ModeState, parts: Parts, ports: PortState, step: Step, periods: int, out: _Period) -> bool:
    """Fill ``out`` with the last of some periods; False where a step has no solution."""
    largest = _LEAST
    prepare(modes, ports, step)
    for number in range(periods * len(u)):
        now = number % len(u)
        if now == 0 and number > 0:
            close_period(ports, len(u))
        release(modes, step)
        largest = extend(u[now], parts, ports, step, largest)
        if not 0.0 < largest < _LARGEST:
            return False
        _keep(modes, step, now, out)
        move_ports(parts, ports, step)
        move_modes(u[now], modes, step)
    return True


def propagator_of(omega: Array, zeta: Array, h: float) -> Array:
    """(4, M) entries of ``exp(A h)``, ``A = [[0, 1], [−ω², −2ζω]]``, row by row; ζ < 1."""
    damped = omega * np.sqrt(1.0 - zeta**2)
    decay, cosine = np.exp(-zeta * omega * h), np.cos(damped * h)
    sine = np.sin(damped * h) / damped
    return np.stack(
        [
            decay * (cosine + zeta * omega * sine),
            decay * sine,
            -decay * omega**2 * sine,
            decay * (cosine - zeta * omega * sine),
        ]
    )


def march(
    u: Array,
    structure: Structure,
    parts: Parts,
    h: float,
    begin: Array | None = None,
    before: Array | None = None,
    periods: int | None = None,
) -> Integrated:
    """Integrate a periodic input until the transient of the modes is over, or for a dozen periods; return the last one.

    Args:
        u: (n, P) force of each step, constant over it; h: step [s].
        begin: (2, M) q and q̇ to begin with, zero if left out; stops begin without stress.
        before: (P,) mean square of the extensions before the first period, zero if left out.
        periods: how many are integrated; as many as the transient takes if left out.
    """
    n, (count, number) = len(u), structure.b.shape
    if periods is None:
        slowest = float((structure.zeta * structure.omega).min()) * n * h
        periods = 1 + min(_PERIODS, int(np.ceil(-np.log(_DECAYED) / max(slowest, 1e-12))))
    q, v = np.zeros((2, count)) if begin is None else begin.copy()
    calm = np.zeros(number) if before is None else before.copy()
    modes = ModeState(propagator_of(structure.omega, structure.zeta, h), structure.b, q, v)
    ports = PortState(np.zeros(number), np.zeros(number), calm, np.zeros(parts.k.shape))
    out = _Period(np.empty((n, count)), np.empty((n, *parts.k.shape)))
    solved = _march(u, modes, parts, ports, step_of(h, parts.k.shape), periods, out)
    return Integrated(*out, bool(solved))


# Steps in a period of the fastest mode, at least.
_STEPS = 8
# Unit of rates in the shapes of outputs [rad/s].
RATE = 2e3 * np.pi


class Seen(NamedTuple):
    """Spectra of one period, on all lines or on some: s (F,) rad/s, q (F, M), forces f (F, P), s̄ (F, P, count)."""

    s: Complex
    q: Complex
    force: Complex
    parts: Complex

    @property
    def columns(self) -> Complex:
        """(F, 2 M + P) what outputs are made of: q, q̇ over the reference rate, and forces."""
        return np.concatenate([self.q, self.q * self.rate[:, None], self.force], axis=1)

    @property
    def rate(self) -> Complex:
        """(F,) by which q̇ is q in those columns."""
        return np.asarray(self.s / RATE)

    def at(self, lines: NDArray[np.int64], scale: float) -> Seen:
        """On some lines only, in other units."""
        return Seen(self.s[lines], *(scale * x[lines] for x in (self.q, self.force, self.parts)))


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Modes with one kind of element at every port; the output shapes are fitted separately.

    Attributes:
        omega, zeta: (M,) natural frequencies [rad/s] and damping ratios.
        b: (M, P) ratios between modes and ports, over the square root of a mode's static compliance.
        delay: (O,) of the outputs [s].
        element: at the ports; k: (P, count) weights of its parts; thresholds: (P, count) theirs.
    """

    omega: Array
    zeta: Array
    b: Array
    delay: Array
    element: PortElement
    k: Array
    thresholds: Array

    @property
    def structure(self) -> Structure:
        """The modes and their ratios to the ports."""
        return Structure(self.omega, self.zeta, self.b)

    @property
    def parts(self) -> Parts:
        """The parts of the element at every port."""
        return Parts(self.element.kinds, self.k, self.thresholds)

    def to_network(self, ports: Sequence[str] = (), unit: str = "V") -> Network:
        """Build the port-Hamiltonian network of this structure.

            network = model.to_network()
            phnn.PortHamiltonianSystem(network).structure(x)     # (n, n) J = −Jᵀ

        The energy is ``H = ½ Σ (q_i² + q̇_i²/ω_i²)`` and what the parts of the elements store. Parts of weight zero are
        left out. Output shapes and delays of a fit observe only; they are no part of the network.

        Args:
            ports: (P,) names of the inputs; ``port_1``, ``port_2``, … if left out.
            unit: of the inputs u_j; the extension x_j has the unit J/unit, because ``u_j ẋ_j`` is a power.

        Returns:
            A network with storages ``q_i`` and ``p_i = q̇_i/ω_i²``, one more for each stop (its deflection ``s_j_a``)
            and each softening or hardening spring (the extension ``x_j_a``), and the output ``q_1``. Modes i, ports j
            and parts a count from 1.

        Raises:
            StructureViolated: the model has a slow part, which no network expresses.
            InputRefused: another number of names than there are ports, or two alike.
        """
        modes, count = self.b.shape
        names = tuple(ports) or tuple(f"port_{j}" for j in range(1, count + 1))
        if len(names) != count or len(set(names)) != count:
            raise InputRefused(
                f"ports {', '.join(names)}: give {count} different names, one for each port of the model"
            )
        numbers = range(1, modes + 1)
        ratios = [{f"p_{i}": f"b_{i}_{j}" for i in numbers} for j in range(1, count + 1)]
        parts = _parts(self, ratios, unit)
        storages = [Storage(f"q_{i}", "spring", (_STIFFNESS,), "J1/2") for i in numbers]
        storages += [part.storage for _, part in parts if part.storage]
        storages += [Storage(f"p_{i}", "capacitor", (f"m_{i}",), "J1/2 s") for i in numbers]
        dampers = [Resistor(f"damper_{i}", "linear", {f"p_{i}": 1.0}, (f"c_{i}",)) for i in numbers]
        couplings = [Coupling(f"q_{i}", f"p_{i}") for i in numbers]
        couplings += [Coupling(p.storage.name, of, b) for j, p in parts if p.storage for of, b in ratios[j].items()]
        return Network(
            storages=tuple(storages),
            resistors=(*dampers, *(part.resistor for _, part in parts if part.resistor)),
            couplings=tuple(couplings),
            ports=tuple(Port(name, on, unit=unit) for name, on in zip(names, ratios, strict=True)),
            parameters=as_table([*_modal_parameters(self, unit), *(p for _, part in parts for p in part.parameters)]),
            output="q_1",
        )

    def substeps(self, dt: float) -> int:
        """Steps in a sampling interval."""
        return max(2, int(np.ceil(_STEPS * dt * self.omega.max() / (2.0 * np.pi))))

    def transfer(self, s: Complex) -> Complex:
        """(F, M) ``q_i`` by the force on its mode."""
        return np.asarray(self.omega**2 / (s[:, None] ** 2 + 2.0 * self.zeta * self.omega * s[:, None] + self.omega**2))

    def seen(self, experiment: Experiment, dt: float) -> Seen:
        """What the modes and the elements do under the inputs of an experiment.

        Raises:
            SolverFailed: a step has no solution, because an element is too stiff for the step.
        """
        f = np.asarray(np.fft.rfftfreq(len(experiment.u), dt), dtype=np.float64)
        s = np.asarray(2j * np.pi * f, dtype=np.complex128)
        drive = np.asarray(np.fft.rfft(experiment.u, axis=0), dtype=np.complex128)
        if experiment.zero_order:
            drive = drive * _of_hold(f, dt)[:, None]
        q = self.transfer(s) * (drive @ self.b.T)
        # A held input has images above half the sampling rate, which modes fold back: only time integration has them.
        if not self.k.size and not experiment.zero_order:
            return Seen(s, q, drive, np.zeros((f.size, *self.k.shape), dtype=complex))
        return self._marched(experiment, drive, q, f, dt)

    def _marched(self, experiment: Experiment, drive: Complex, q: Complex, f: Array, dt: float) -> Seen:
        """The same by integration in time."""
        size, count = len(experiment.u), self.substeps(dt)
        h, n = dt / count, len(experiment.u) * count
        hold = _of_hold(f, h)[:, None]
        if experiment.zero_order:
            steps = np.repeat(experiment.u, count, axis=0)
        else:
            fine = np.zeros((n // 2 + 1, drive.shape[1]), dtype=complex)
            # Steps whose spectrum, held over each, is that of the input.
            fine[: f.size] = drive / hold
            steps = np.fft.irfft(fine, n, axis=0) * count
        s = np.asarray(2j * np.pi * f, dtype=np.complex128)
        begin = np.stack([np.fft.irfft(x, size, axis=0)[0] for x in (q, s[:, None] * q)])
        before = 2.0 * (np.abs(q @ self.b)[1:] ** 2).sum(axis=0) / size**2
        done = march(steps, self.structure, self.parts, h, begin, before)
        if not done.solved:
            raise SolverFailed(f"{experiment.name}: {self.element.name} is too stiff for steps of {h:.3g} s")
        parts = np.fft.rfft(done.s, axis=0)[: f.size] / count * hold[:, :, None]
        integrated = np.asarray(np.fft.rfft(done.q[::count], axis=0), dtype=np.complex128)
        return Seen(s, integrated, drive - (self.k * parts).sum(axis=2), parts)


def _of_hold(f: Array, h: float) -> Complex:
    """Spectrum of a value held for a time h."""
    return np.asarray(np.sinc(f * h) * np.exp(-1j * np.pi * f * h))


# Iterations of a step, those with whole Newton steps, and the change of Δx, over the largest so far, that ends them.
_MOST, _WHOLE, _SETTLED = 60, 20, 1e-11


class Parts(NamedTuple):
    """Parts of the elements: kinds (count,) of `phnn.modal.elements`; k, r (P, count) weights and thresholds."""

    kinds: NDArray[np.int64]
    k: Array
    r: Array


class ModeState(NamedTuple):
    """The modes: propagator (4, M) of one step, rows of ``exp(A h)``; b (M, P) ratios; q, v = q̇ (M,)."""

    propagator: Array
    b: Array
    q: Array
    v: Array


class PortState(NamedTuple):
    """The ports: (P,) extensions x, Σ x² of this period, ⟨x²⟩ of the one before; s (P, count) of the stops."""

    x: Array
    square: Array
    before: Array
    s: Array


class Step(NamedTuple):
    """The unknowns of a step and the memory of its solution.

    Attributes:
        h: length [s].
        c (P, P), free (P,): Δx of the ports by constant forces, and Δx⁰ without forces.
        dx, ebar (P,): Δx and ē; parts (P, count): s̄.
        stiff (P,), off (P, 1), jacobian (P, P): slopes of ē, residual and matrix of Newton's method.
    """

    h: float
    c: Array
    free: Array
    dx: Array
    ebar: Array
    parts: Array
    stiff: Array
    off: Array
    jacobian: Array


def step_of(h: float, shape: tuple[int, ...]) -> Step:
    """The memory of a step of length h, zero, for (P, count) parts."""
    one, square = (shape[0],), (shape[0], shape[0])
    return Step(h, *(np.zeros(size) for size in (square, one, one, one, shape, one, (shape[0], 1), square)))


_spring, _softening = inline(spring_mean_effort), inline(softening_spring_mean_effort)
_hardening, _drag = inline(hardening_spring_mean_effort), inline(quadratic_drag)


@inline
def _held(s: Any, dx: Any, r: Any) -> Any:
    """Deflection of a stop after Δx: what goes beyond its threshold slides."""
    return min(max(s + dx, -r), r)


@inline
def _mean_part(kind: Any, x: Any, dx: Any, h: Any, r: Any, s: Any, before: Any) -> Any:
    """Mean of one part over a step from x to x + dx: the law's discrete gradient for the weight one."""
    y = x + dx
    if kind == STOP:
        return _spring(s, _held(s, dx, r), 1.0)
    if kind == SOFTENING:
        return _softening(x, y, 1.0, r)
    if kind == HARDENING:
        return _hardening(x, y, 1.0)
    if kind == SLOW:
        return _spring(x, y, 1.0) / (1.0 + before / (r * r))
    return _drag(dx, 0.0, 1.0) / (h * h)


@inline
def _slope(kind: Any, x: Any, dx: Any, h: Any, r: Any, s: Any, before: Any) -> Any:
    """About how fast that mean grows with dx."""
    y = x + dx
    if kind == STOP:
        return 0.5 if abs(s + dx) < r else 0.0
    if kind == SOFTENING:
        return 0.5 / (1.0 + (y / r) ** 2) ** 1.5
    if kind == HARDENING:
        return 0.25 * (x * x + 2.0 * x * y + 3.0 * y * y)
    if kind == SLOW:
        return 0.5 / (1.0 + before / (r * r))
    return 2.0 * abs(dx) / (h * h)


@inline
def _newton(u: Any, step: Any, largest: Any, share: Any) -> Any:
    """Move Δx by a share of a Newton step; returns the largest residual and the largest Δx so far."""
    change = 0.0
    for j in range(step.dx.size):
        step.off[j, 0] = step.free[j] - step.dx[j]
        for m in range(step.dx.size):
            step.off[j, 0] += step.c[j, m] * (u[m] - step.ebar[m])
            step.jacobian[j, m] = step.c[j, m] * step.stiff[m]
        step.jacobian[j, j] += 1.0
    eliminate(step.jacobian, step.off)
    for j in range(step.dx.size):
        change = max(change, abs(step.off[j, 0]))
        step.dx[j] += share * step.off[j, 0]
        largest = max(largest, abs(step.dx[j]))
    return change, largest


@inline
def _respond(parts: Any, ports: Any, step: Any) -> None:
    """Fill what the elements respond to Δx: ē, its parts and its slopes."""
    for j in range(step.dx.size):
        step.ebar[j] = 0.0
        step.stiff[j] = 0.0
        for a in range(parts.kinds.size):
            kind, k, r, s = parts.kinds[a], parts.k[j, a], parts.r[j, a], ports.s[j, a]
            step.stiff[j] += k * _slope(kind, ports.x[j], step.dx[j], step.h, r, s, ports.before[j])
            step.parts[j, a] = _mean_part(kind, ports.x[j], step.dx[j], step.h, r, s, ports.before[j])
            step.ebar[j] += k * step.parts[j, a]


@inline
def extend(u: Any, parts: Any, ports: Any, step: Any, largest: Any) -> Any:
    """Solve a step for Δx, ē and its parts; returns the largest Δx so far, or -1 where no solution was found."""
    for iteration in range(_MOST):
        # Stops have kinks, between which whole steps may go back and forth.
        change, largest = _newton(u, step, largest, 1.0 if iteration < _WHOLE else 0.5)
        _respond(parts, ports, step)
        if change <= _SETTLED * largest:
            return largest
    return -1.0


@inline
def prepare(modes: Any, ports: Any, step: Any) -> None:
    """Fill the extensions at the start, and C."""
    for i in range(modes.q.size):
        for j in range(step.dx.size):
            ports.x[j] += modes.b[i, j] * modes.q[i]
            for m in range(step.dx.size):
                step.c[j, m] += modes.b[i, j] * (1.0 - modes.propagator[0, i]) * modes.b[i, m]


@inline
def release(modes: Any, step: Any) -> None:
    """Fill Δx⁰: how the extensions move without forces."""
    for j in range(step.dx.size):
        step.free[j] = 0.0
    for i in range(modes.q.size):
        moved = (modes.propagator[0, i] - 1.0) * modes.q[i] + modes.propagator[1, i] * modes.v[i]
        for j in range(step.dx.size):
            step.free[j] += modes.b[i, j] * moved


@inline
def move_modes(u: Any, modes: Any, step: Any) -> None:
    """Advance the modes under the forces u − ē."""
    a = modes.propagator
    for i in range(modes.q.size):
        g = 0.0
        for j in range(step.dx.size):
            g += modes.b[i, j] * (u[j] - step.ebar[j])
        y = modes.q[i] - g
        modes.q[i], modes.v[i] = (
            g + a[0, i] * y + a[1, i] * modes.v[i],
            a[2, i] * y + a[3, i] * modes.v[i],
        )


@inline
def move_ports(parts: Any, ports: Any, step: Any) -> None:
    """Advance the extensions and the stops by Δx."""
    for j in range(step.dx.size):
        for a in range(parts.kinds.size):
            if parts.kinds[a] == STOP:
                ports.s[j, a] = _held(ports.s[j, a], step.dx[j], parts.r[j, a])
        ports.x[j] += step.dx[j]
        ports.square[j] += ports.x[j] * ports.x[j]


@inline
def close_period(ports: Any, n: Any) -> None:
    """Keep the mean square of the period that ends for the slow springs of the next one."""
    for j in range(ports.x.size):
        ports.before[j] = ports.square[j] / n
        ports.square[j] = 0.0
