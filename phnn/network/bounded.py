"""Physical parameter values as functions of free coordinates: whatever an optimiser does, bounds hold.

    positive:    θ = θ₀ exp(δ(z)),      any other:   θ = θ₀ + s δ(z)

    δ(z) = z for |z| ≤ Δ/2,     beyond:  |δ| = Δ/2 (1 + w/(1 + w)) < Δ,   w = 2|z|/Δ − 1

The reference ``θ₀`` is the value that was set last, where ``z = 0`` gives it back to the last bit; ``s`` is a typical
change, and ``Δ`` the distance to the bound in units of ``δ``, on either side its own.

Parameters of an actuator span 1e-9 to 1e5, while optimisers move all coordinates by similar amounts. Hence a coordinate
measures the relative change of a positive parameter (``dθ/dz = θ``) and changes by ``s`` of any other. Over half of the
decades to the bound the logarithm is exact, the coordinate of `phnn.parameters`: a common factor of several parameters,
which the displacement hardly shows, is then a straight valley, and a parameter trains as its inverse does. Softplus
has neither property: it counts relative changes downwards, absolute ones upwards. Near the bound ``δ`` is rational, for
``exp(z)`` of a step far too large overflows, and the slope of a logistic function vanishes so fast that a parameter
driven to its bound stays there.

Laws multiply parameters, and 32 bits reach only 38 decades. In 32 bits the range ``Δ`` therefore ends after three
decades, or a thousand times the reference (or the typical change, where that is larger), also inside wider bounds. The
law with the most factors, the doubly bent spring, multiplies eight of them by the sixth power of its state: 24 decades,
so that energy, effort and power stay finite for states up to a hundred times typical ones.

Reparametrisation onto the admissible set: Stan Reference Manual, constraint transforms.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.parameters import Parameter

# A side without a bound ends this many decades, or typical changes, away from the reference: farther than any training
# goes, near enough that squares of the result fit into 32 bits. Setting a value moves the reference.
_DECADES, _CHANGES = 9.0, 1e9
# The same where numbers are shorter than 64 bits; changes in units of the reference or of a typical change.
_SHORT_DECADES = 3.0
_SHORT_CHANGES = 10.0**_SHORT_DECADES

# Rows of the table: reference, Δ/2 and gain upwards, the same downwards, lowest and highest value, 1 if positive, 1 if
# not, and the lesser Δ/2 (negative for a value on a bound).
_ROWS = 10
_REFERENCE, _UP, _GAIN, _DOWN = 0, slice(1, 3), 2, slice(3, 5)
_LOWEST, _HIGHEST, _LOGARITHMIC, _LINEAR, _NEAR = range(5, _ROWS)
# Beyond this many Δ/2 a coordinate makes no difference even in 64 bits.
_ENOUGH = 1e15
# Dimensionless weights are of order one; products of several this large still fit into 32 bits.
LARGEST_WEIGHT = 1e6


class BoundedParameters(nn.Module):
    """Free physical parameters of a network; each has a coordinate ``z``, the scalar `nn.Parameter` that is trained.

    Values are read with `values` or `value` and set with `assign`. States of this module (``state_dict``) hold
    coordinates ``z.NAME`` and references ``reference.NAME``, and bring back values to the last bit. Bounds are those of
    the parameters and no part of a state: one with a reference outside them is refused.

    Args:
        parameters: by name, with value and bounds.

    Attributes:
        z: the coordinates by name.
        reference: the references by name, as buffers [SI].
    """

    table: Tensor

    def __init__(self, parameters: Mapping[str, Parameter]) -> None:
        super().__init__()
        self.declared = dict(parameters)
        self.relative = all(p.positive for p in self.declared.values())
        self.place = {name: k for k, name in enumerate(self.declared)}
        self.z = nn.ParameterDict()
        # One by one: torch sorts what comes in a dict.
        for name in self.declared:
            self.z[name] = nn.Parameter(torch.zeros((), dtype=torch.float64))
        self.reference = nn.Module()
        for name, parameter in self.declared.items():
            self.reference.register_buffer(name, torch.tensor(parameter.value, dtype=torch.float64))
        rows = torch.tensor([_row(p) for p in self.declared.values()], dtype=torch.float64).reshape(-1, _ROWS)
        self.register_buffer("table", rows.mT.contiguous(), persistent=False)
        self.register_load_state_dict_pre_hook(_check_references)
        self.register_load_state_dict_post_hook(_take_references)

    def __contains__(self, name: str) -> bool:
        return name in self.declared

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> BoundedParameters:
        """Convert to other numbers; a value beyond the shorter range of these becomes the reference."""
        long = self.table.dtype == torch.float64
        values = {name: self._at(name, z.detach()).item() for name, z in self.z.items()} if long else {}
        super()._apply(fn, recurse)
        if long and self.table.dtype != torch.float64:
            near = _in_short_range(self.table[_NEAR], self.table)
            far = [name for name, z in self.z.items() if not z.detach().abs() <= near[self.place[name]]]
            self.assign({name: values[name] for name in far if math.isfinite(values[name])})
        return self

    def values(self) -> dict[str, Tensor]:
        """Return the present values [SI] by name, differentiable by the coordinates.

        Raises:
            SolverFailed: a coordinate is not finite.
        """
        # As `self.z.values()`, at a tenth of the time.
        coordinates: list[Tensor] = [z for z in self.z._parameters.values() if z is not None]
        if not coordinates:
            return {}
        if any(z.ndim for z in coordinates):
            # Lent for the time of a call (`torch.func.functional_call`), a coordinate may be a batch.
            return {name: self.value(name) for name in self.declared}
        z = torch.stack(coordinates)
        values = self._near(z)
        if values is None:
            check_weights(self.z)
            values = _physical(z, self.table)
        return dict(zip(self.declared, values.unbind(), strict=True))

    def _near(self, z: Tensor) -> Tensor | None:
        """Return (F,) values if all ``|z| ≤ Δ/2``, the usual case, in a fifth of the operations; else None."""
        try:
            # Also false for NaN.
            near = bool((z.detach().abs() <= _in_short_range(self.table[_NEAR], self.table)).all())
        except RuntimeError:
            # Inside vmap coordinates have no numbers.
            near = False
        if not near:
            return None
        if self.relative:
            return self.table[_REFERENCE] * torch.exp(z)
        delta = self.table[_GAIN] * z
        return self.table[_REFERENCE] * torch.exp(self.table[_LOGARITHMIC] * delta) + self.table[_LINEAR] * delta

    def value(self, name: str) -> Tensor:
        """Return (...) present value of one parameter [SI]."""
        check_weights(self.z)
        return self._at(name, self.z[name])

    def _at(self, name: str, z: Tensor) -> Tensor:
        return _physical(z, self.table[:, self.place[name]].reshape(-1, *[1] * z.ndim))

    def slope(self, name: str) -> float:
        """Return ``dθ/dz`` at the present value."""
        with torch.enable_grad():
            z = self.z[name].detach().requires_grad_(True)
            return float(torch.autograd.grad(self._at(name, z), z)[0])

    @torch.no_grad()
    def assign(self, values: Mapping[str, float]) -> None:
        """Set physical values [SI]; each becomes the reference of its coordinate, which starts again at zero.

        Raises:
            InputRefused: an unknown name, or a value that is not finite or outside the parameter's bounds; then nothing
                is set.
        """
        rows = {}
        for name, value in values.items():
            if name not in self.declared:
                raise InputRefused(f"no free parameter {name!r}: there are {', '.join(self.declared) or 'none'}")
            # A parameter itself refuses what it cannot be.
            rows[name] = replace(self.declared[name], value=float(value))
        for name, parameter in rows.items():
            self._refer(name, parameter)
            self.reference.get_buffer(name).fill_(parameter.value)
            self.z[name].zero_()

    def _refer(self, name: str, parameter: Parameter) -> None:
        """Make a parameter's value the reference of its coordinate."""
        row = torch.tensor(_row(parameter), dtype=torch.float64)
        self.table[:, self.place[name]] = row.to(self.table)


def _check_references(module: BoundedParameters, state: Mapping[str, Tensor], prefix: str, *_: object) -> None:
    """Refuse a state with a reference outside its parameter's bounds, before anything is loaded.

    Raises:
        InputRefused: names the parameter, its value and what is accepted.
    """
    for name, declared in module.declared.items():
        if (value := state.get(f"{prefix}reference.{name}")) is not None:
            _referenced(declared, value)


@torch.no_grad()
def _take_references(module: BoundedParameters, _: object) -> None:
    """Follow the references that have been loaded."""
    for name, declared in module.declared.items():
        module._refer(name, _referenced(declared, module.reference.get_buffer(name)))


def _referenced(declared: Parameter, reference: Tensor) -> Parameter:
    """Return the parameter at a reference; in 32 bits one on its bound may have been rounded beyond it."""
    value = float(reference)
    near = min(max(value, declared.lower), declared.upper)
    rounded = reference.dtype == torch.float32 and math.isclose(value, near, rel_tol=1e-6)
    return replace(declared, value=near if rounded else value)


def _row(p: Parameter) -> list[float]:
    """Return the column of the table of one parameter."""
    far = _DECADES * math.log(10.0) if p.positive else _CHANGES
    if p.positive:
        down = math.log(p.value / p.lower) if p.lower > 0.0 else far
        up = math.log(p.upper / p.value) if math.isfinite(p.upper) else far
        gain = 1.0
    else:
        down, up, gain = (p.value - p.lower) / p.typical, (p.upper - p.value) / p.typical, p.typical
    down, up = min(down, far), min(up, far)
    # From a value on its bound both directions lead inside: else the slope outwards were zero, and it would stay there.
    upwards = [0.5 * up, gain] if up > 0.0 else [0.5 * down or 1.0, -gain if down > 0.0 else 0.0]
    downwards = [0.5 * down, gain] if down > 0.0 else [0.5 * up or 1.0, -gain if up > 0.0 else 0.0]
    lowest = p.lower if p.value == p.lower else math.nextafter(p.lower, math.inf)
    highest = p.upper if p.value == p.upper else math.nextafter(p.upper, -math.inf)
    if p.positive:
        lowest = max(lowest, math.nextafter(0.0, 1.0))
    near = 0.5 * min(up, down) if up > 0.0 and down > 0.0 else -1.0
    return [p.value, *upwards, *downwards, lowest, highest, float(p.positive), float(not p.positive), near]


def _in_short_range(half: Tensor, table: Tensor) -> Tensor:  # half: (...), table: (10, ...)
    """Return (...) half ranges ``Δ/2``, shortened for numbers of less than 64 bits; see the module's docstring."""
    if table.dtype == torch.float64:
        return half
    # In units of the gain, which is zero where a value cannot move at all.
    gain = table[_GAIN].abs().clamp_min(torch.finfo(table.dtype).tiny)
    changes = torch.clamp(table[_REFERENCE].abs() / gain, min=1.0)
    most = torch.where(table[_LINEAR] > 0.0, _SHORT_CHANGES * changes, _SHORT_DECADES * math.log(10.0))
    return torch.minimum(half, 0.5 * most)


def _physical(z: Tensor, table: Tensor) -> Tensor:  # z: (...), table: (10, ...)
    """Return (...) values of coordinates."""
    half, gain = torch.where(z >= 0.0, table[_UP], table[_DOWN])
    half = _in_short_range(half, table)
    inner = torch.clamp(z, -half, half)
    beyond = torch.clamp((z - inner) / half, -_ENOUGH, _ENOUGH)
    delta = gain * (inner + half * beyond / (1.0 + beyond.abs()))
    value = table[_REFERENCE] * torch.exp(table[_LOGARITHMIC] * delta) + table[_LINEAR] * delta
    return torch.clamp(value, table[_LOWEST], table[_HIGHEST])


def check_weights(module: nn.Module, owner: str = "", largest: float = math.inf) -> None:
    """Refuse parameters of a module that are not finite or not at most ``largest`` in size.

    A NaN would otherwise pass for silence in laws that cut off (``max(NaN, 0)``), and reach results without a name.

    Args:
        module: any module; its buffers are not looked at.
        owner: what stands before a parameter's name in the message.
        largest: bound on every entry.

    Raises:
        SolverFailed: names the parameter, its value and the remedy.
        InputRefused: a parameter is in 16 bits, which hold no product of several weights.
    """
    if torch.compiler.is_compiling():
        return
    named = [(name, p.detach()) for name, p in module.named_parameters() if p.numel()]
    try:
        # Also false for NaN. Versions count no change by way of ``.data``, so that nothing is remembered.
        if not named or _largest([values for _, values in named]) <= min(largest, sys.float_info.max):
            return
    except RuntimeError:
        # Inside vmap a value has no number; what it maps over is checked outside.
        return
    for name, values in named:
        if values.dtype not in (torch.float32, torch.float64):
            raise InputRefused(f"the parameter {owner}{name} is {values.dtype}: convert with .double() or .float()")
        worst = _largest([values])
        if not worst <= min(largest, sys.float_info.max):
            raise SolverFailed(
                f"the parameter {owner}{name} is not finite or too large (its largest entry is {worst:g}): a step of "
                "the optimiser was too large; load the last good state and lower the rate of learning"
            )


def _largest(tensors: list[torch.Tensor]) -> float:
    """Return the largest absolute entry; NaN where an entry is, or where a tensor is not in 32 or 64 bits."""
    if any(t.dtype not in (torch.float32, torch.float64) for t in tensors):
        return math.nan
    return float(torch.cat([t.reshape(-1) for t in tensors]).abs().amax())


def is_finite(values: torch.Tensor) -> bool:
    """Return whether all entries are finite; true where that cannot be asked, inside vmap."""
    try:
        return bool(torch.isfinite(values).all())
    except RuntimeError:
        return True
