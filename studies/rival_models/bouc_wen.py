"""Bouc–Wen elements of one and of several terms with free exponents, before the mass and in its loop.

    dz_i = dv [1 − (β_i sgn(z_i dv) + γ_i) |z_i|^n_i]

    before the mass   y = L [w₀ u + Σ w_i z_i],  v = u over the largest input, L of second order
    in the loop       q̈ + 2ζω q̇ + ω² (q + Σ h_i z_i) = ω² u,  y = w q,  v = q

The scale of ``z`` is free beside its weight: it is chosen so that ``dz = dv`` at the origin. β and γ are free, so that
loops may harden as in the benchmark of Noël and Schoukens, and an exponent is free from 0.5 to 5.

References: Bouc 1967; Wen 1976; Ismail, Ikhouane, Rodellar 2009; Noël, Schoukens 2016.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phnn.recordings.recording import Recording
from studies.rival_models.hysteresis import Operator, Separable, SeparableRival, Static, Structure, discretised
from studies.rival_models.rival import Scales, State, Stepper, run_in

Array = NDArray[np.float64]

# Saturation of z at the start, over the largest input, of one term and of three; asinh of least and largest β and γ;
# ln of the exponents.
_REACH = {1: (0.3,), 3: (0.1, 0.25, 0.6)}
_BENT, _EXPONENT, _HEIGHT = 9.0, (np.log(0.5), 0.0, np.log(5.0)), 20.0
_PACE = 0.5  # largest ω times the step of the integration; most steps a sample
_MOST_STEPS = 32


@njit(cache=True, error_model="numpy")
def _slope(z: float, change: float, beta: float, gamma: float, exponent: float) -> float:
    """Return dz of a change of the input."""
    side = 1.0 if z * change > 0.0 else -1.0
    return change * (1.0 - (beta * side + gamma) * abs(z) ** exponent)


@njit(cache=True, error_model="numpy")
def _before(z: Array, last: float, u: Array, law: Array, out: Array) -> None:
    """Move the states z (K,) along inputs by Heun's rule; ``law`` is (K, 3) of β, γ and n."""
    for k in range(u.size):
        change = u[k] - last
        for i in range(z.size):
            beta, gamma, n = law[i]
            first = _slope(z[i], change, beta, gamma, n)
            z[i] += 0.5 * (first + _slope(z[i] + first, change, beta, gamma, n))
            out[k, i] = z[i]
        last = u[k]


@njit(cache=True, error_model="numpy")
def _rates(x: Array, u: float, omega: float, zeta: float, law: Array) -> Array:
    """Return the rates of (q, q̇, z_1…); ``law`` is (K, 4) of h, β, γ and n."""
    out, force = np.empty(x.size), u - x[0]
    for i in range(law.shape[0]):
        force -= law[i, 0] * x[2 + i]
        out[2 + i] = _slope(x[2 + i], x[1], law[i, 1], law[i, 2], law[i, 3])
    out[0], out[1] = x[1], omega * omega * force - 2.0 * zeta * omega * x[1]
    return out


@njit(cache=True, error_model="numpy")
def _within(x: Array, last: float, u: Array, dt: float, steps: int, omega: float, zeta: float, law: Array) -> Array:
    """Move the state (2 + K,) along inputs that are straight between samples, by Runge–Kutta steps; return q (N,)."""
    out, h = np.empty(u.size), dt / steps
    for k in range(u.size):
        for j in range(steps):
            u0, u1 = last + (u[k] - last) * j / steps, last + (u[k] - last) * (j + 1) / steps
            um = 0.5 * (u0 + u1)
            f0 = _rates(x, u0, omega, zeta, law)
            f1 = _rates(x + 0.5 * h * f0, um, omega, zeta, law)
            f2 = _rates(x + 0.5 * h * f1, um, omega, zeta, law)
            f3 = _rates(x + h * f2, u1, omega, zeta, law)
            x += h * (f0 + 2.0 * (f1 + f2) + f3) / 6.0
        out[k], last = x[0], u[k]
    return out


@dataclass(frozen=True)
class BoucWen(Operator):
    """Terms before the mass, and the input itself."""

    count: int

    ridge = 1e-9

    @property
    def states(self) -> int:  # type: ignore[override]
        return self.count

    @property
    def shape(self) -> tuple[Array, Array, Array]:
        bent = [np.arcsinh(0.5 / r) for r in _REACH[self.count]]
        first = np.array([(b, b, _EXPONENT[1]) for b in bent]).ravel()
        low, high = ((-_BENT, -_BENT, _EXPONENT[0]), (_BENT, _BENT, _EXPONENT[2]))
        return first, np.tile(low, self.count), np.tile(high, self.count)

    def law(self, shape: Array) -> Array:
        """Return (K, 3) of β, γ and n."""
        table = shape.reshape(self.count, -1)
        return np.column_stack([np.sinh(table[:, :2]), np.exp(table[:, 2])])

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        z, out = state[:-1].copy(), np.empty((u.size, self.count))
        _before(z, float(state[-1]), np.ascontiguousarray(u), self.law(shape), out)
        return np.column_stack([u, out]), np.array([*z, u[-1]])

    def rest(self, shape: Array, u: float) -> tuple[Array, Array]:
        # Along a ramp: one jump is no solution of the equation.
        columns, state = self.run(shape, np.zeros(self.states + 1), np.linspace(0.0, u, 200), np.zeros(200))
        return columns[-1:], state


@dataclass(frozen=True)
class Loop(Structure):
    """Terms in the loop of the mass; parameters are ln ω/rate and ln ζ, then h, asinh β, asinh γ and ln n of each."""

    operator: BoucWen

    @property
    def bounds(self) -> tuple[Array, Array]:
        _, low, high = self.operator.shape
        both = ((low, -_HEIGHT), (high, _HEIGHT))
        (low, high), (least, most) = (
            [np.insert(s.reshape(-1, 3), 0, h, axis=1).ravel() for s, h in both], ((-4.6, -6.9), (5.7, 2.0))
        )  # fmt: skip
        return np.array([*least, *low]), np.array([*most, *high])

    def start(self, omega: float, zeta: float) -> Array:
        shape = self.operator.shape[0].reshape(-1, 3)
        return np.array([np.log(omega), np.log(zeta), *np.insert(shape, 0, 0.3, axis=1).ravel()])

    def parted(self, x: Array) -> tuple[Array, Array]:
        return x[:2], x[2:]

    def filter(self, x: Array, dt: float, held: bool = False) -> tuple[Array, Array]:
        return discretised(np.append(x[:2], 0.0), self.scales.rate, dt, held)

    def path(self, x: Array, state: Array, u: Array, dt: float) -> Array:
        """Return q (N,) under scaled inputs; the state (q, q̇, z_1…, last input) is moved on."""
        table = x[2:].reshape(-1, 4)
        law = np.column_stack([table[:, :1], np.sinh(table[:, 1:3]), np.exp(table[:, 3:])])
        omega, dt = np.exp(x[0]), dt * self.scales.rate
        steps = int(np.clip(np.ceil(omega * dt / _PACE), 1, _MOST_STEPS))
        inner = state[:-1].copy()
        out = _within(inner, float(state[-1]), np.ascontiguousarray(u), dt, steps, omega, np.exp(x[1]), law)
        state[:-1], state[-1] = inner, u[-1]
        return np.asarray(out)

    def rest(self, x: Array, u: float, dt: float) -> Array:
        """Return the state after a slow ramp to a scaled input and a rest there."""
        state = np.zeros(self.operator.count + 3)
        if u:
            self.path(x, state, np.concatenate([np.linspace(0.0, u, 1000), np.full(1000, u)]), dt)
        return state

    def stepper(self, fitted: Separable, dt: float) -> Stepper:
        return _Stepper(fitted, dt)

    def columns(self, x: Array, recording: Recording) -> Array:
        u, cycle = recording.u / self.scales.u, run_in(recording)
        before = u[0] if recording.start.state != "rest" else recording.start.input_before / self.scales.u
        if cycle:
            u = np.concatenate([u[-cycle:], u])
        q = self.path(x, self.rest(x, float(before), recording.dt), u, recording.dt)
        return q[cycle:, None]


class _Stepper(Stepper):
    """The state is (q, q̇, z_1…, last scaled input)."""

    def __init__(self, fitted: Separable, dt: float) -> None:
        assert isinstance(fitted.structure, Loop)
        self.dt, self._fitted, self._loop = dt, fitted, fitted.structure

    def rest(self, u: float) -> State:
        return self._loop.rest(self._fitted.x, u / self._loop.scales.u, self.dt)

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        state = state.copy()
        q = self._loop.path(self._fitted.x, state, u / self._loop.scales.u, self.dt)
        return state, q * float(self._fitted.weights[0])


class BoucWenRival(SeparableRival):
    """A number of terms before the mass or in its loop, from the best linear model."""

    source, leading = "Bouc 1967; Wen 1976; Ismail, Ikhouane, Rodellar 2009", 1

    def __init__(self, place: str, count: int) -> None:
        self.place, self.sizes = place, ((Static(1), 0), (BoucWen(count), 0))
        self.words = f"mass, spring and damper with {count} Bouc–Wen terms {place}, free exponents"

    def join(self, operator: Operator, lags: int, scales: Scales) -> Structure:
        looped = self.place == "in the loop" and isinstance(operator, BoucWen)
        return Loop(operator, lags, scales) if looped else Structure(operator, lags, scales)  # type: ignore[arg-type]

    def warm(self) -> None:
        _before(np.zeros(1), 0.0, np.zeros(2), np.ones((1, 3)), np.zeros((2, 1)))
        _within(np.zeros(3), 0.0, np.zeros(2), 1.0, 1, 1.0, 1.0, np.ones((1, 4)))


before_1, before_3 = partial(BoucWenRival, "before the mass", 1), partial(BoucWenRival, "before the mass", 3)
loop_1, loop_3 = partial(BoucWenRival, "in the loop", 1), partial(BoucWenRival, "in the loop", 3)
