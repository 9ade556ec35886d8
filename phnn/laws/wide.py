"""Laws with as many weights as one likes: a sum over equal units, written once for tensors and for the kernel.

    resistor:  φ(ε)    = combine(ε, Σ_i unit(ε, *w_i), *head)
    storage:   ē(a, b) = combine(a, b, Σ_i unit(a, b, *w_i), *head),     H(x) = x ē(0, x)

The weights are physical (positive ones positive, scales of effort and flow included) and lie in one flat vector
``[*head, *w_1, *w_2, …]``. Units and combinations are written with `phnn.laws.namespace`.

Monotone and convex units are made of the hinge (squareplus, Barron 2021) and its slope, a step from 0 to 1,

    S(y) = (y + r)/2,   σ(y) = S'(y) = S²/(1 + S²),   r(y) = √(4 + y²) = S + 1/S.

They have the shape of softplus and the logistic function for the price of a square root, and their differences are
rational in ``S``: with ``A = S(a)``, ``B = S(b)`` and ``P = A B``

    S(b) − S(a) = (b − a) P/(1 + P),        σ(b) − σ(a) = (b − a) (A + B)/((1 + P) r(a) r(b)),
    S(b) − S(a) − σ(a) (b − a) = (b − a)² P/((1 + P)² r(a)),

sums and products of positive numbers, in which nothing cancels however close ``a`` and ``b`` are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numba

from phnn.errors import StructureViolated
from phnn.laws.namespace import absolute, exp, maximum, real, reciprocal, shared, sqrt, where


@dataclass(frozen=True)
class WideLaw:
    """A sum over units: a sector law ``ε φ(ε; w) ≥ 0``, or the mean effort of an energy ``H(x; w) ≥ H(0) = 0``.

    Attributes:
        name: as used by torch modules and the kernel.
        unit: ``unit(*arguments, *w_i)``.
        combine: ``combine(*arguments, sum, *head)``, the flow or the mean effort.
        head: number of weights before those of the units.
        per_unit: number of weights of a unit.
        monotone: whether the flow, or the effort, is non-decreasing.
        arguments: ``effort`` of a resistor; ``a, b`` of a storage, the ends of a step.
    """

    name: str
    unit: Callable[..., Any]
    combine: Callable[..., Any]
    head: int
    per_unit: int
    monotone: bool
    arguments: tuple[str, ...] = ("effort",)


WIDE_RESISTORS: dict[str, WideLaw] = {}
WIDE_STORAGES: dict[str, WideLaw] = {}


def register_wide(law: WideLaw) -> None:
    """Make an additive-unit law available under its name.

    Raises:
        StructureViolated: the name is taken.
    """
    table = WIDE_RESISTORS if law.arguments == ("effort",) else WIDE_STORAGES
    if law.name in table:
        raise StructureViolated(f"an additive-unit law called {law.name!r} exists already: choose another name")
    table[law.name] = law


# Torch modules that are passive for all weights by their form: the exact type, and the laws whose kernels evaluate it.
MODULES: dict[type, tuple[str, ...]] = {}
_EVALUATED_BY = ("forward", "weights", "energy", "mean_effort", "mean_efforts", "lower", "root")


def register_compiled(module: type, *laws: str) -> None:
    """Declare that modules of a type are passive for all weights, and are evaluated by the kernels of some laws.

    Only this very type is meant: a subclass may evaluate something else.

    Args:
        module: its ``law`` names one of the laws, and ``weights()`` gives the vector that this law takes.
        laws: names of additive-unit laws; none if it has no kernel.

    Raises:
        StructureViolated: no additive-unit law has such a name.
    """
    for name in laws:
        if name not in WIDE_RESISTORS and name not in WIDE_STORAGES:
            known = ", ".join((*WIDE_RESISTORS, *WIDE_STORAGES))
            raise StructureViolated(f"no additive-unit law is called {name!r}: register it first; there are {known}")
    MODULES[module] = laws


def is_passive_by_form(law: Any) -> bool:
    """Return whether a module is of a registered type and has no evaluation of its own."""
    return type(law) in MODULES and not any(name in vars(law) for name in _EVALUATED_BY)


def form_of(law: Any) -> str:
    """Return the name of the additive-unit law that evaluates a module; empty where only torch can."""
    name = str(getattr(law, "law", "")) if is_passive_by_form(law) else ""
    return name if name in MODULES.get(type(law), ()) else ""


def has_kernel(law: Any) -> bool:
    """Return whether compiled code evaluates a law: one that is named, or a torch module of a registered form."""
    return isinstance(law, str) or bool(form_of(law))


def evaluated(law: WideLaw, weights: Any, *arguments: Any) -> Any:
    """Return (...) ``φ(ε)`` of a resistor, ``ē(a, b)`` of a storage, of flat weights (head + U·per_unit,)."""
    units = weights[law.head :].reshape(-1, law.per_unit)
    total = law.unit(*(x[..., None] for x in arguments), *(units[:, j] for j in range(law.per_unit))).sum(-1)
    return law.combine(*arguments, total, *(weights[i] for i in range(law.head)))


@cache
def compiled(law: WideLaw) -> Any:
    """Compile the loop over units for floats and complex numbers; it allocates nothing and counts no references.

    Returns:
        ``evaluate(*arguments, theta, first, count)`` of ``count`` units, weights from ``theta[first]`` on.
    """
    given = ", ".join(law.arguments)
    head = "".join(f", theta[first + {i}]" for i in range(law.head))
    unit = "".join(f", theta[at + {j}]" for j in range(law.per_unit))
    text = f"""
def evaluate({given}, theta, first, count):
    total = 0.0
    for i in range(count):
        at = first + {law.head} + {law.per_unit} * i
        total += unit({given}{unit})
    return combine({given}, total{head})
"""
    scope: dict[str, Any] = {
        "unit": numba.njit(law.unit, error_model="numpy", forceinline=True),
        "combine": numba.njit(law.combine, error_model="numpy", forceinline=True),
    }
    # The text is built from counts only.
    exec(text, scope)
    # Set, because the flag is inherited from whatever is compiled around it.
    return numba.njit(scope["evaluate"], error_model="numpy", forceinline=False)


@shared
def hinge(y: Any) -> Any:
    """Return ``S(y)`` and ``r(y)``, the former as ``1/S(−y)`` where the sum would cancel."""
    r = sqrt(4.0 + y * y)
    large = 0.5 * (absolute(y) + r)
    return where(real(y) >= 0.0, large, reciprocal(large)), r


@shared
def _hinge_rise(c: Any, d: Any) -> Any:
    """Return ``S(c + d) − S(c)``."""
    product = hinge(c)[0] * hinge(c + d)[0]
    return d * product * reciprocal(1.0 + product)


@shared
def _step_rise(c: Any, d: Any) -> Any:
    """Return ``σ(c + d) − σ(c)``."""
    start, r_start = hinge(c)
    end, r_end = hinge(c + d)
    return d * (start + end) * reciprocal((1.0 + start * end) * r_start * r_end)


@shared
def damping_unit(effort: Any, weight: Any, gain: Any, position: Any) -> Any:
    """Return ``w tanh(k ε + c)``, by one exponential that cannot overflow: half the price of the library's function."""
    y = gain * effort + position
    decay = exp(-2.0 * absolute(y))
    size = (1.0 - decay) * reciprocal(1.0 + decay)
    return weight * where(real(y) >= 0.0, size, -size)


def symmetric_damping_unit(effort: Any, weight: Any, gain: Any, position: Any) -> Any:
    """Return ``w tanh(k |ε| + c)``: the same for both signs, so that ``φ`` is odd."""
    return damping_unit(absolute(effort), weight, gain, position)


def damping_combine(effort: Any, total: Any, offset: Any) -> Any:
    """Return ``φ = ε max(g₀ + Σ, 0)``."""
    conductance = offset + total
    return effort * maximum(conductance, 0.0 * conductance)


def monotone_unit(
    effort: Any, w_step: Any, k_step: Any, c_step: Any, w_up: Any, k_up: Any, c_up: Any, w_down: Any, k_down: Any,
    c_down: Any,
) -> Any:  # fmt: skip
    """Sum a step and hinges: ``w₀ [σ(k₀ε + c₀) − σ(c₀)] + w₁ [S(k₁ε − c₁) − S(−c₁)] − w₂ [S(−k₂ε − c₂) − S(−c₂)]``."""
    step = w_step * _step_rise(c_step, k_step * effort)
    return step + w_up * _hinge_rise(-c_up, k_up * effort) - w_down * _hinge_rise(-c_down, -k_down * effort)


def monotone_combine(effort: Any, total: Any, slope: Any) -> Any:
    """Return ``φ = a ε + Σ``."""
    return slope * effort + total


def convex_unit(a: Any, b: Any, weight: Any, gain: Any, position: Any) -> Any:
    """Return ``w [(S(kb + c) − S(ka + c))/(kb − ka) − σ(c)]``, symmetric: of a hinge less its tangent at 0.

    With ``A, B, C = S(ka + c), S(kb + c), S(c)`` the bracket is ``AB/(1 + AB) − C²/(1 + C²)``, and in
    ``AB − C² = ½ (A + C)(B − C) + ½ (B + C)(A − C)`` the differences are proportional to ``b`` and to ``a``.
    """
    to_a = gain * a
    to_b = gain * b
    zero, r_zero = hinge(position)
    at_a = hinge(to_a + position)[0]
    at_b = hinge(to_b + position)[0]
    by_a = 1.0 + at_a * zero
    by_b = 1.0 + at_b * zero
    rise = (at_a + zero) * at_b * to_b * by_a + (at_b + zero) * at_a * to_a * by_b
    # Products in this order are the same number when the ends are exchanged; all of them in one overflow in 32 bits.
    return 0.5 * weight * (rise * reciprocal(by_a * by_b)) * reciprocal((1.0 + at_a * at_b) * r_zero)


def convex_combine(a: Any, b: Any, total: Any, curvature: Any) -> Any:
    """Return ``ē = c (a + b)/2 + Σ`` with the curvature ``c``."""
    return 0.5 * curvature * (a + b) + total


register_wide(WideLaw("damping", damping_unit, damping_combine, 1, 3, monotone=False))
register_wide(WideLaw("symmetric_damping", symmetric_damping_unit, damping_combine, 1, 3, monotone=False))
register_wide(WideLaw("monotone", monotone_unit, monotone_combine, 1, 9, monotone=True))
register_wide(WideLaw("convex", convex_unit, convex_combine, 1, 3, monotone=True, arguments=("a", "b")))
