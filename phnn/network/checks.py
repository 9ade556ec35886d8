"""Checks of the torch module of a network: names, learned laws, and the tensors that it is evaluated at.

Here are also the efforts of energies that are torch functions, the terms of a power balance, the one reading of all
parameters for all that one call evaluates, and the modulator states: their drives, their rates, and their values after
a step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, wraps
from threading import get_ident
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, StructureViolated
from phnn.laws import MEMORY_LAWS
from phnn.laws.other import advanced
from phnn.laws.sector import READ, check_energy, check_sector
from phnn.laws.wide import form_of, is_passive_by_form
from phnn.network.bounded import check_weights


class PowerBalance(NamedTuple):
    """``dH/dt = Σ supplied − Σ dissipated``; the defect is a rounding error.

    Attributes:
        stored: (...) ``∇Hᵀ ẋ`` [W].
        dissipated: (..., R) ``ε_r φ_r(ε_r) ≥ 0`` of every resistor [W].
        supplied: (..., P) ``ψ(u) gᵀ∇H`` of every port [W].
        defect: (...) ``stored − Σ supplied + Σ dissipated`` [W].
    """

    stored: Tensor
    dissipated: Tensor
    supplied: Tensor
    defect: Tensor


P = ParamSpec("P")
R = TypeVar("R")

# The thread that is evaluating a system, and the values that it has read.
Present = tuple[int, dict[str, Tensor]] | None


def present_of(system: Any) -> dict[str, Tensor] | None:
    """Return the values read for the evaluation that is going on in this thread, None outside of one."""
    present = None if torch.compiler.is_compiling() else system._present
    return present[1] if present is not None and present[0] == get_ident() else None


def evaluation(method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """Make a method of a system read and check all parameters once, for itself and all that it calls."""

    @wraps(method)
    def evaluate(system: Any, *args: P.args, **kwargs: P.kwargs) -> R:
        if torch.compiler.is_compiling() or present_of(system) is not None:
            return method(system, *args, **kwargs)
        # The constants too: what is read most often is then found at once.
        system._present = (get_ident(), {**system.constants._buffers, **system.present_values()})
        try:
            return method(system, *args, **kwargs)
        finally:
            system._present = None

    return evaluate


Array = NDArray[np.float64]


def check_name(name: str, holder: nn.Module) -> None:
    """Refuse what torch cannot register: a dot, or an attribute that the holding module has already."""
    if not name or "." in name or hasattr(holder, name):
        raise StructureViolated(f"torch cannot register the name {name!r}: rename it (no dots, no python method names)")


def check_state(x: Tensor, names: Sequence[str]) -> None:
    """Refuse states (..., n) whose last dimension is not the number of state names."""
    if x.shape[-1:] != (len(names),):
        raise InputRefused(
            f"a state has shape {tuple(x.shape)}: its last dimension must be {len(names)} ({', '.join(names)})"
        )


# Relative differences |b − a|/max(|a|, |b|) below which the quotient's slope, and its value, have lost too
# many digits: an error of eps/δ² in the slope and of eps/δ in the value.
_SLOPE_LOST = 1e-3
_VALUE_LOST = 1e-5
_ANY = 1e-100
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def slope_of(energy: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
    """Return ``H'(x)`` of an elementwise energy, itself differentiable where gradients are enabled."""
    wanted = torch.is_grad_enabled()
    # A graph that x carries must be kept, not detached; inside a no-grad solve nothing has to be kept.
    z = x if wanted and x.requires_grad else x.detach().requires_grad_(True)
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(energy(z).sum(), z, create_graph=wanted)
    return slope


def quotient_of(energy: Callable[[Tensor], Tensor], a: Tensor, b: Tensor) -> Tensor:
    """Return ``(H(b) − H(a))/(b − a) = ∫₀¹ H'(a + τ (b − a)) dτ`` of an elementwise energy, accurate as ``b → a``.

    The quotient keeps the power balance exactly but cancels when ``b → a``; the integral, by Gauss–Legendre quadrature,
    is accurate exactly there. Both are used where they are good.
    """
    difference = b - a
    size = torch.maximum(a.abs(), b.abs()).detach()
    close = difference.detach().abs() <= _SLOPE_LOST * size
    tiny = difference.detach().abs() <= _VALUE_LOST * size
    # Each form is evaluated only on arguments that are good for it: an inf in the unused branch of a `where`
    # would turn into NaN on the way back.
    apart = torch.where(close, a + torch.where(size > 0.0, size, _ANY), b)
    quotient = (energy(apart) - energy(a)) / (apart - a)
    nearby = torch.where(close, difference, torch.zeros_like(difference))
    nodes = 0.5 * (1.0 + torch.as_tensor(_NODES, dtype=a.dtype, device=a.device))
    weights = 0.5 * torch.as_tensor(_WEIGHTS, dtype=a.dtype, device=a.device)
    integral = slope_of(energy, a.unsqueeze(-1) + nearby.unsqueeze(-1) * nodes) @ weights
    with torch.no_grad():
        resolved = close & ~tiny
        safe = torch.where(resolved, difference, torch.ones_like(difference))
        value = (energy(a + safe) - energy(a)) / safe
        correction = torch.where(resolved, value - integral, torch.zeros_like(integral))
    return torch.where(close, integral + correction, quotient)


def energy_of(law: nn.Module) -> Callable[[Tensor], Tensor]:
    """Return the energy ``H`` of a module; of one whose form does not keep it passive ``max(H(x) − H(0), 0)``.

    Training may carry the latter below its energy at rest, so that it could deliver energy from there.
    """
    energy: Callable[[Tensor], Tensor] = law.energy  # type: ignore[assignment]
    if is_passive_by_form(law):
        return energy
    return lambda x: torch.relu(energy(x) - energy(torch.zeros_like(x)))


def mean_effort_of(law: nn.Module, a: Tensor, b: Tensor) -> Tensor:
    """Return (...) ``(H(b) − H(a))/(b − a)`` from the start to the end of a step, ``H'(a)`` where they are equal."""
    if is_passive_by_form(law):
        return law.mean_effort(a, b)  # type: ignore[operator]
    energy = energy_of(law)
    return slope_of(energy, a) if a is b else quotient_of(energy, a, b)


def mean_efforts_of(law: nn.Module, a: Tensor, b: Tensor) -> Tensor:
    """Return (..., k) discrete gradient of a shared energy over a step, ``∇H(a)`` for ``a = b``.

    That of a module of unknown form goes from ``a`` to ``b`` one variable after the other (Itoh & Abe 1988).
    """
    if is_passive_by_form(law):
        return law.mean_efforts(a, b)  # type: ignore[operator]
    energy = energy_of(law)
    if a is b:
        return slope_of(energy, a)
    starts, ends = a.unbind(-1), b.unbind(-1)

    def moved(k: int, y: Tensor) -> Tensor:
        others = [one.reshape(*one.shape, *[1] * (y.ndim - one.ndim)) for one in (*ends[:k], *starts[k + 1 :])]
        return energy(torch.stack(torch.broadcast_tensors(*others[:k], y, *others[k:]), dim=-1))

    efforts = [quotient_of(partial(moved, k), starts[k], ends[k]) for k in range(len(starts))]
    return torch.stack(efforts, dim=-1)


def check_factor(law: nn.Module, name: str) -> None:
    """Refuse a module as the factor of a ratio that is not in float64 or not finite; any other value is passive."""
    _check_module(law, name)
    _checked_finite(_of_arrays(law)(_ORDINARY), f"{name}, a {type(law).__name__}", "f")


def check(
    law: nn.Module, *, storage: bool | None = None, reads: int = 0, ports: int | None = None, name: str = "the law"
) -> None:
    """Try a torch module as a law of a network, on points over 24 decades of both signs.

        phnn.nn.check(MyResistor())          # StructureViolated: … φ(0.05) = -0.2, so that ε φ(ε) = -0.01 < 0 …

    A trial proves nothing between its points. Laws of `phnn.nn` are passive by their form: of them only the weights are
    looked at.

    Args:
        law: ``φ(ε)`` of a resistor, with ``ε φ(ε) ≥ 0``; or a storage with ``energy(x) ≥ energy(0)``.
        storage: which of both it is; None: a storage if it has an ``energy``.
        reads: how many states a resistor is called with, ``φ(ε, q)``; a law on one effort reads one at most.
        ports: of a law on several efforts together, or of an energy of several storages: how many these are. They are
            tried at random points over as many decades, of a fixed seed.
        name: what the message calls it.

    Raises:
        StructureViolated: with the remedy, and the counterexample where the law is not passive.
        SolverFailed: a weight is not finite.
    """
    _check_module(law, name)
    known = is_passive_by_form(law) and getattr(law, "ROLE", "") in ("multi_port", "shared_energy")
    if form_of(law) or (ports is not None and known):
        return
    name = f"{name}, a {type(law).__name__}"
    energetic = storage if storage is not None else hasattr(law, "energy")
    try:
        if ports is not None:
            _check_shared(law, ports, name) if energetic else _check_multi_port(law, ports, reads, name)
        elif energetic:
            check_energy(_of_arrays(law.energy), name)  # type: ignore[arg-type]
        elif reads:
            for q in READ:
                check_sector(_of_arrays(partial(_reading, law, q)), name, read=q)
        else:
            check_sector(_of_arrays(law), name)
    except (RuntimeError, TypeError, AttributeError, IndexError, ValueError) as error:
        called = "energy(x)" if energetic else "forward(effort, q)" if reads else "forward(effort)"
        raise StructureViolated(f"{name}: {called} fails on tensors of many points: {error}") from error


def _check_module(law: nn.Module, name: str) -> None:
    """Refuse what is no torch module in float64 with finite weights."""
    if not isinstance(law, nn.Module):
        raise StructureViolated(f"{name} is {law!r}: give a law's name or a torch module")
    for label, tensor in law.named_parameters():
        if tensor.dtype != torch.float64:
            raise StructureViolated(f"{label} in {name} is {tensor.dtype}: convert the law with .double()")
    check_weights(law, f"{name}: ")


# Points at which laws on several variables are tried, and those where a law must be finite.
_TRIALS = 4000
# Share of their entries that are zero; rounding, relative to the sum of the absolute terms.
_ZEROS, _ROUNDING = 0.1, 1e-9
_ORDINARY = np.concatenate([-np.logspace(2, -12, 15), [0.0], np.logspace(-12, 2, 15)])


def _points(columns: int) -> Array:
    """Return (K, columns) points over 24 decades, some with zeros, some with entries of one size."""
    random, shape = np.random.default_rng(0), (_TRIALS, columns)
    # Entries of one size in half of the points, of different sizes in the others.
    apart = random.choice([0.0, 1.0], (_TRIALS, 1)) * random.uniform(-6.0, 6.0, shape)
    sizes = 10.0 ** np.clip(random.uniform(-12.0, 12.0, (_TRIALS, 1)) + apart, -12.0, 12.0)
    return random.standard_normal(shape) * sizes * (random.uniform(size=shape) > _ZEROS)


def _check_multi_port(law: nn.Module, ports: int, reads: int, name: str) -> None:
    """Try whether ``εᵀφ(ε, q) ≥ 0``."""
    points = _points(ports + reads)
    efforts, read = points[:, :ports], points[:, ports:]
    with torch.no_grad():
        given = [torch.from_numpy(efforts), torch.from_numpy(read)][: 2 if reads else 1]
        flows = law(*given).double().numpy()
    if flows.shape != efforts.shape:
        raise StructureViolated(f"{name}: gives {flows.shape[1:]} flows for {efforts.shape[1:]} efforts: give as many")
    ordinary = np.abs(points).max(axis=1) <= _ORDINARY[-1]
    _checked_finite(flows[ordinary], name, "φ")
    powers = efforts * flows
    power, size = powers.sum(axis=1), np.abs(powers).sum(axis=1)
    low = power < -_ROUNDING * size
    if low.any():
        k = int(np.argmin(np.where(low, power / np.where(low, size, 1.0), np.inf)))
        raise StructureViolated(
            f"{name}: at ε = {_listed(efforts[k])} φ = {_listed(flows[k])}, so that εᵀφ = {power[k]:.3g} < 0 and it "
            "delivers power: use a law with εᵀφ(ε) ≥ 0 (LearnedDissipation, LearnedCoupling)"
        )


def _check_shared(law: nn.Module, ports: int, name: str) -> None:
    """Try whether ``H(x) ≥ H(0)``."""
    points = np.concatenate([np.zeros((1, ports)), _points(ports)])
    with torch.no_grad():
        values = law.energy(torch.from_numpy(points)).double().numpy()  # type: ignore[operator]
    if values.shape != points.shape[:1]:
        raise StructureViolated(
            f"{name}: gives an energy of shape {values.shape} for {len(points)} states: give one each"
        )
    _checked_finite(values[np.abs(points).max(axis=1) <= _ORDINARY[-1]], name, "H")
    low = values < values[0] - _ROUNDING * np.maximum(np.abs(values), np.abs(values[0]))
    if low.any():
        k = int(np.argmin(np.where(low, values, np.inf)))
        raise StructureViolated(
            f"{name}: H({_listed(points[k])}) = {values[k]:.6g} J lies below H(0) = {values[0]:.6g} J, so that it can "
            "deliver energy from rest: use an energy with its minimum at zero (LearnedEnergy)"
        )


def _checked_finite(values: Array, name: str, value: str) -> None:
    if not np.isfinite(values).all():
        raise StructureViolated(f"{name}: {value} is not finite at arguments up to {_ORDINARY[-1]:g}: give one that is")


def _listed(values: Array) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"


def _reading(law: nn.Module, q: float, effort: Tensor) -> Tensor:
    """Return the flow of a law that reads a constant state."""
    return law(effort, torch.full_like(effort, q))


def _of_arrays(function: Callable[[Tensor], Tensor]) -> Callable[[Array], Array]:
    """Return a function of tensors as one of arrays, without gradients."""

    def call(points: Array) -> Array:
        with torch.no_grad():
            values = function(torch.from_numpy(points)).double().numpy()
        if values.shape != points.shape:
            raise ValueError(f"of {points.shape} points it makes {values.shape} values; act on each point alone")
        return values

    return call


def middle_of(system: Any, a: Tensor, b: Tensor) -> Tensor:
    """Return (..., n) what laws read during a step: energy variables in its middle, modulator states at its start."""
    middle = 0.5 * (a + b)
    if not system.network.memories:
        return middle
    first = len(system.network.storages)
    return torch.cat([middle[..., :first], a.expand_as(middle)[..., first:]], dim=-1)


def drives_of(
    system: Any,
    efforts: Tensor,  # (..., n) efforts of the storages, of a state or averaged over a step
    x: Tensor,  # (..., n+M) state that modulated laws read
    u: Tensor,  # (..., P)
    dissipated: Mapping[int, Tensor] | None = None,
) -> Tensor:
    """Return (..., M) what drives every memory.

    Args:
        dissipated: powers (...) of some resistors by their numbers; those of the others are ``ε φ(ε)``.
    """
    epsilon = system.branch_efforts(efforts, x)
    powers, actions = epsilon * system.branch_flows(epsilon, x), system.actions(u)
    network, known = system.network, dissipated or {}
    drives = {r.name: known.get(k, powers[..., k]) for k, r in enumerate(network.resistors)}
    drives |= {s.name: efforts[..., k] for k, s in enumerate(network.storages)}
    drives |= {p.name: actions[..., k] for k, p in enumerate(network.ports)}
    none = torch.zeros_like(efforts[..., 0])
    return torch.stack([sum((drives[n] for n in network.drives_of(m)), none) for m in network.memories], dim=-1)


def rates_of(system: Any, z: Tensor, driven: Tensor) -> Tensor:
    """Return (..., M) ``ż`` of modulator states under their drives."""
    laws = [(MEMORY_LAWS[m.law], [*map(system.value, m.parameters)]) for m in system.network.memories]
    rates = [law.rate(z[..., k], driven[..., k], *values) for k, (law, values) in enumerate(laws)]
    return torch.stack(rates, dim=-1)


def ends_of(system: Any, z: Tensor, driven: Tensor, h: float | Tensor) -> Tensor:
    """Return (..., M) modulator states at the end of steps ``h`` [s] from ``z``, exactly under constant drives."""
    return advanced(z, h, rates_of(system, z, driven), decays_of(system))


def decays_of(system: Any) -> Tensor:
    """Return (M,) rates at which that flow decays."""
    memories = system.network.memories
    return torch.stack([MEMORY_LAWS[m.law].decay(*map(system.value, m.parameters)) for m in memories])
