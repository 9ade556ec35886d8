"""The few elementary functions laws are written in: one source for floats, arrays, tensors and numba.

A law written with these names runs unchanged

* in python on floats, numpy arrays and torch tensors,
* inside compiled kernels on ``float64``,
* inside compiled kernels on ``complex128`` whose imaginary part is a tiny perturbation. With
  ``Im z ≈ 1e-140`` the first-order rules used here are exact to rounding, so that
  ``Im f(x + i·1e-140)/1e-140 = f'(x)`` (complex-step derivative, Squire & Trapp 1998).

Comparisons act on the value alone: write ``real(x) > real(y)``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload, register_jitable

# The perturbation of a complex step: far below any value that matters, so that it stays small even where a motion has
# died away, and its square vanishes.
TINY = 1e-140

_INLINE = {"error_model": "numpy", "forceinline": True}
# Marks a helper that laws call, so that compiled code can call it too; in python it stays as it is.
shared = register_jitable(**_INLINE)


def _torch_of(*values: Any) -> Any:
    """Return the torch module if one of the values is a tensor (then it has been imported), else None."""
    torch = sys.modules.get("torch")
    if torch is not None:
        for v in values:
            if isinstance(v, torch.Tensor):
                return torch
    return None


def real(x: Any) -> Any:
    """Return the value without its perturbation."""
    return x if _torch_of(x) else np.real(x)


def where(condition: Any, a: Any, b: Any) -> Any:
    """Return ``a`` where the condition holds, else ``b``; both are evaluated."""
    torch = _torch_of(condition, a, b)
    if not torch:
        # A number stays a number: an array without dimensions cannot be multiplied by a tensor.
        return np.where(condition, a, b)[()]
    if isinstance(condition, torch.Tensor) and isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        return torch.where(condition, a, b)
    tensor = next(v for v in (a, b, condition) if isinstance(v, torch.Tensor))
    dtype = torch.float64 if tensor.dtype == torch.bool else tensor.dtype
    a, b = (torch.as_tensor(v, dtype=dtype, device=tensor.device) for v in (a, b))
    return torch.where(torch.as_tensor(condition, device=tensor.device), a, b)


def certain(condition: Any) -> bool:
    """Return whether a scalar evaluation may leave early; arrays and tensors, whose entries may differ, never do."""
    return bool(condition) if isinstance(condition, bool | np.bool_) else False


def reciprocal(x: Any) -> Any:
    """Return ``1/x``; a perturbation costs no second division, which is why inner loops prefer it."""
    return 1.0 / x


def _elementary(name: str, slope: Callable[[Any], Any] | None = None) -> Callable[[Any], Any]:
    """Return a function of numpy, or of torch for tensors, with its slope where numpy's value of a perturbed number
    differs from that of the number alone."""

    def function(x: Any) -> Any:
        torch = _torch_of(x)
        if torch or slope is None or not np.iscomplexobj(x):
            return getattr(torch or np, name)(x)
        return getattr(np, name)(np.real(x)) + 1j * slope(np.real(x)) * np.imag(x)

    function.__name__ = name
    return function


exp, sqrt, log1p, tanh = map(_elementary, ("exp", "sqrt", "log1p", "tanh"))
sin, cos = _elementary("sin", np.cos), _elementary("cos", lambda x: -np.sin(x))


def maximum(a: Any, b: Any) -> Any:
    """Return the larger value, with its perturbation."""
    return where(real(a) >= real(b), a, b)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller value, with its perturbation."""
    return where(real(a) <= real(b), a, b)


def absolute(x: Any) -> Any:
    """Absolute value of the value, its perturbation following the sign."""
    return where(real(x) >= 0.0, x, -x)


@overload(real, strict=False, jit_options=_INLINE)
def _real(x: Any) -> Any:
    if isinstance(x, types.Complex):
        return lambda x: x.real
    return lambda x: x


def _alike(function: Any, compiled: Any) -> None:
    """Make a function known to compiled code, the same for floats and complex numbers."""
    overload(function, strict=False, jit_options=_INLINE)(lambda *_: compiled)


_alike(where, lambda condition, a, b: a if condition else b)
_alike(maximum, lambda a, b: a if real(a) >= real(b) else b)
_alike(minimum, lambda a, b: a if real(a) <= real(b) else b)
_alike(absolute, lambda x: x if real(x) >= 0.0 else -x)
_alike(certain, lambda condition: condition)


def _smooth(function: Any, value: Any, slope: Any) -> None:
    """Make a function known to compiled code by its value at ``x`` and by its slope, given ``x`` and the value."""
    value_of, slope_of = shared(value), shared(slope)

    @overload(function, strict=False, jit_options=_INLINE)
    def typed(x: Any) -> Any:
        if not isinstance(x, types.Complex):
            return lambda x: value_of(x)

        def perturbed(x: Any) -> Any:
            y = value_of(x.real)
            return complex(y, slope_of(x.real, y) * x.imag)

        return perturbed


_smooth(reciprocal, lambda x: 1.0 / x, lambda x, y: -y * y)
_smooth(exp, lambda x: math.exp(x), lambda x, y: y)
_smooth(sqrt, lambda x: math.sqrt(x), lambda x, y: 0.5 / y)
_smooth(log1p, lambda x: math.log1p(x), lambda x, y: 1.0 / (1.0 + x))
_smooth(tanh, lambda x: math.tanh(x), lambda x, y: 1.0 - y * y)
_smooth(sin, lambda x: math.sin(x), lambda x, y: math.cos(x))
_smooth(cos, lambda x: math.cos(x), lambda x, y: -math.sin(x))
