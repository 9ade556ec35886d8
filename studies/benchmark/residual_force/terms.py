"""The table of candidate terms: what each is, and the effect of the catalogue whose law it is.

A term acts on the base model as a force on its mass, as currents through its hysterons, or as a change of its output.
Effects with memory are filtered signals over grids of their time constants. Terms without an effect are the products
of displacement, velocity and voltage that a general library has (Brunton, Proctor & Kutz 2016): the catalogue does not
list them. What belongs to the base, ``q``, ``v`` and ``u``, is no term, for the base is estimated along with them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from studies.benchmark.residual_force import signals
from studies.benchmark.residual_force.states import States

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Action:
    """What a term does; None for nothing.

    Attributes:
        force: (N,) [N]; current: (N, H) through the hysterons [A]; output: (N,) [m].
    """

    force: Array | None = None
    current: Array | None = None
    output: Array | None = None


@dataclass(frozen=True)
class Term:
    """A candidate.

    Attributes:
        name: formula; effect: of the catalogue, empty where it lists none; action: by the states of a recording.
    """

    name: str
    effect: str
    action: Callable[[States], Action]


@dataclass(frozen=True)
class Sizes:
    """Largest values in all recordings, by which thresholds and time constants are graded.

    Attributes:
        q, v, u, du: as in `States`; slowest, fastest: frequencies of the excitation [Hz]; duration: of the longest
            recording [s]; dt: shortest interval [s]; noise: deviation of the output's noise [m].
    """

    q: float
    v: float
    u: float
    du: float
    slowest: float
    fastest: float
    duration: float
    dt: float
    noise: float


def table_of(sizes: Sizes) -> tuple[Term, ...]:
    """All terms."""
    return (*_polynomials(), *_mechanical(sizes), *_hysterons(sizes), *_coupling(sizes), *_amplifier(sizes),
            *_sensor(sizes))  # fmt: skip


def _forced(name: str, effect: str, law: Callable[[States], Array]) -> Term:
    return Term(name, effect, lambda s: Action(force=law(s)))


def _seen(name: str, effect: str, law: Callable[[States], Array]) -> Term:
    return Term(name, effect, lambda s: Action(output=law(s)))


def _at(law: Callable[[States, float], Array], value: float) -> Callable[[States], Array]:
    """A law with a threshold or a time constant."""
    return lambda s: law(s, float(value))


def _mode(s: States, frequency: float, damping: float) -> Array:
    return signals.resonant(s.q, s.dt, min(frequency, 0.4 / s.dt), damping)


def _polynomials() -> list[Term]:
    """Monomials of ``q, v, u`` up to the third degree, and those of single laws beyond."""
    return [
        _forced("q^2", "quadratic_stiffness", lambda s: s.q**2),
        _forced("q^3", "cubic_stiffness", lambda s: s.q**3),
        _forced("q^5", "cubic_stiffness", lambda s: s.q**5),
        _forced("|v|v", "quadratic_drag", lambda s: np.abs(s.v) * s.v),
        _forced("v^3", "quadratic_drag", lambda s: s.v**3),
        _forced("u^2", "electrostriction", lambda s: s.u**2),
        _forced("q v", "", lambda s: s.q * s.v),
        _forced("q^2 v", "", lambda s: s.q**2 * s.v),
        _forced("|v|", "", lambda s: np.abs(s.v)),
        _forced("u v", "", lambda s: s.u * s.v),
        _forced("u^3", "", lambda s: s.u**3),
        _forced("q u^2", "", lambda s: s.q * s.u**2),
        _forced("q^2 u", "", lambda s: s.q**2 * s.u),
        _forced("t q", "", lambda s: s.t * s.q),
        Term("e^3 C", "", lambda s: Action(force=s.alpha * np.sum(s.e**3, axis=1))),
    ]


def _mechanical(sizes: Sizes) -> list[Term]:
    found = [
        _forced(f"tanh(v/{share:g})", "coulomb_friction", _at(lambda s, c: np.tanh(s.v / c), share * sizes.v))
        for share in (0.001, 0.01)
    ]
    found += [
        _forced(f"max(q-{share:g},0)", "contact_stop", _at(lambda s, c: np.maximum(s.q - c, 0.0), share * sizes.q))
        for share in (0.5, 0.65, 0.8, 0.9, 0.95)
    ]
    for tau in np.geomspace(0.1 / sizes.fastest, 2.0 * sizes.duration, 8):
        found.append(_forced(f"relax(q,{tau:.2g})", "creep", _at(lambda s, c: signals.relaxed(s.q, s.dt, c), tau)))
    for frequency in np.geomspace(0.2 * sizes.fastest, 20.0 * sizes.fastest, 24):
        for damping in (0.02, 0.1):
            found.append(
                _forced(
                    f"mode(q,{frequency:.0f},{damping:g})", "second_mode",
                    partial(_mode, frequency=float(frequency), damping=damping),
                )
            )  # fmt: skip
    return found


def _hysterons(sizes: Sizes) -> list[Term]:
    """Thresholds move the voltage ``± d/2`` at which a hysteron slips: ``δi = −ρ s sgn(e) ½ d κ x``."""

    def threshold(law: Callable[[States], Array]) -> Callable[[States], Action]:
        return lambda s: Action(current=-s.slope * s.slips * 0.5 * s.width * law(s)[:, None])

    found = [
        _forced(f"play(q,{share:g})", "extra_hysteron", _at(lambda s, c: signals.played(s.q, c), share * sizes.q))
        for share in (0.01, 0.03, 0.1, 0.2, 0.35, 0.5)
    ]
    return [
        *found,
        Term("d q", "hysteresis_asymmetry", threshold(lambda s: s.q)),
        Term("d |v|", "rate_dependent_threshold", threshold(lambda s: np.abs(s.v))),
        Term("G e", "charge_leakage", lambda s: Action(current=s.e)),
    ]


def _coupling(sizes: Sizes) -> list[Term]:
    """Factors ``1 + κ x`` of the transducer ratio change the force ``α(V − Σe)`` and the current ``αv``."""

    def ratio(law: Callable[[States], Array]) -> Callable[[States], Action]:
        def action(s: States) -> Action:
            x = s.alpha * law(s)
            current = -np.repeat((x * s.v)[:, None], s.e.shape[1], axis=1)
            return Action(force=x * (s.u - s.e.sum(axis=1)), current=current)

        return action

    def heat(s: States, tau: float) -> Array:
        slipping = np.maximum(np.abs(s.e) - 0.5 * s.width, 0.0)
        power = s.b * s.v**2 + np.sum(s.slope * slipping * np.abs(s.e), axis=1)
        return signals.relaxed(power, s.dt, tau, settled=False)

    def loss(s: States, coercive: float, tau: float) -> Array:
        return signals.relaxed(np.maximum(np.abs(s.u) / coercive - 1.0, 0.0), s.dt, tau, settled=False)

    found = [Term("alpha q", "displacement_coupling", ratio(lambda s: s.q))]
    for span in (0.05, 0.3, 2.0):
        tau = span * sizes.duration
        found.append(Term(f"alpha heat({tau:.2g})", "self_heating", ratio(_at(heat, tau))))
    for share in (0.3, 0.6, 0.85):
        for span in (0.1, 0.3, 1.0, 3.0):
            level, tau = share * sizes.u, span * sizes.duration
            law = ratio(partial(loss, coercive=level, tau=tau))
            found.append(Term(f"alpha loss({level:.3g},{tau:.2g})", "depolarisation", law))
    return found


def _amplifier(sizes: Sizes) -> list[Term]:
    def through(name: str, effect: str, law: Callable[[States], Array]) -> Term:
        return _forced(name, effect, lambda s: s.alpha * law(s))

    found: list[Term] = []
    for tau in np.geomspace(0.3 * sizes.dt, 0.3 / sizes.fastest, 4):
        low = _at(lambda s, c: signals.relaxed(s.u, s.dt, c) - s.u, float(tau))
        late = _at(lambda s, c: signals.delayed(s.u, s.dt, c) - s.u, float(tau))
        found.append(through(f"low(u,{tau:.2g})-u", "amplifier_lowpass", low))
        found.append(through(f"u(t-{tau:.2g})-u", "delay", late))
    for share in (0.5, 0.7, 0.8, 0.9, 0.95):
        clipped = _at(lambda s, c: np.clip(s.u, -c, c) - s.u, share * sizes.u)
        found.append(through(f"clip(u,{share:g})-u", "amplifier_saturation", clipped))
    for share in (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98):
        limited = _at(lambda s, c: signals.slewed(s.u, c * s.dt) - s.u, share * sizes.du)
        found.append(through(f"slew(u,{share:g})-u", "slew_limit", limited))
    return found


def _sensor(sizes: Sizes) -> list[Term]:
    found = [
        _seen("y: q^2", "sensor_nonlinearity", lambda s: s.q**2),
        _seen("y: q^3", "sensor_nonlinearity", lambda s: s.q**3),
        _seen("y: t", "sensor_drift", lambda s: s.t),
        _seen("y: t q", "", lambda s: s.t * s.q),
    ]
    for tau in np.geomspace(0.3 * sizes.dt, 0.3 / sizes.fastest, 4):
        lag = _at(lambda s, c: signals.relaxed(s.q, s.dt, c) - s.q, float(tau))
        found.append(_seen(f"y: low(q,{tau:.2g})-q", "sensor_lag", lag))
    widest = 0.03 * sizes.q
    for width in np.geomspace(min(0.3 * sizes.noise, 0.1 * widest), widest, 4):
        behind = _at(lambda s, c: signals.played(s.q, c) - s.q, float(width))
        found.append(_seen(f"y: play(q,{width:.2g})-q", "output_backlash", behind))
    return found


def effects_of(table: Sequence[Term]) -> tuple[str, ...]:
    """The effects that some term is the law of, each once."""
    return tuple(dict.fromkeys(term.effect for term in table if term.effect))
