"""The solvers of a step, in the exported subset of Python: the equations of a step set to zero without derivatives.

They find the same root as `phnn.integrate.roots` and `phnn.integrate.solve`, to the same tolerance. Slopes are taken
from the values that were seen, because no target has the complex steps of the package. The state ``s`` holds the
unknowns ``y``, what is left of the equations, ``force``, and the size of their terms, ``size``.

The names below stand for functions and tables of the program.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.roots import NOTHING, RELAXED, TOLERANCE
from phnn.laws.namespace import absolute, where

_FAR = 1e300
_STRICT = 12
_ITERATIONS = 300
# A slope between two values is believed if they differ by more than this share of the equation's terms.
_SEEN = 1e-8
# Relative step of a finite difference, and the least one.
_STEP, _LEAST = 1e-7, 1e-30
_HALVINGS = 30
_SUFFICIENT = 1e-4
# What rounding of the unknowns leaves, as a share of their part in an equation.
_ROUNDING = 4e-16

UNKNOWNS = 1
FLOORS: Any = ((1.0,),)


def balance(s: Any) -> None:
    """Fills ``force`` and ``size`` at the unknowns ``y``."""
    raise NotImplementedError


def solve_one(s: Any) -> Any:
    """Find the unknown ``y[0]`` by secant steps inside a bracket; 1 where it was found, 0 otherwise."""
    low, high, last, reach = -_FAR, _FAR, _FAR, 1.0
    before, before_value, slope, exhausted = 0.0, 0.0, s.slope, 0.0
    for iteration in range(_ITERATIONS):
        balance(s)
        value, size, y = s.force[0], s.size[0], s.y[0]
        if absolute(value) <= where(iteration < _STRICT, TOLERANCE, RELAXED) * size + NOTHING or exhausted > 0.0:
            s.slope = slope
            return 1.0
        if not absolute(value) < _FAR:
            return 0.0
        if iteration > 0 and absolute(value - before_value) > _SEEN * size and y != before:
            secant = (value - before_value) / (y - before)
            slope = where(secant > 0.0, secant, slope)
        before, before_value = y, value
        low = where(value > 0.0, low, y)
        high = where(value > 0.0, y, high)
        step = y - value / slope
        if step >= low and step <= high and absolute(value) <= 0.5 * last:
            s.y[0] = step
        elif low > -_FAR and high < _FAR:
            s.y[0] = 0.5 * (low + high)
            exhausted = where(s.y[0] <= low or s.y[0] >= high, 1.0, 0.0)
        else:
            s.y[0] = y - reach * value / FLOORS[0][0]
            reach = 2.0 * reach
        last = where(iteration > 0, absolute(value), _FAR)
    return 0.0


def fill_jacobian(s: Any) -> None:
    """Derivatives of the equations by finite differences; the equations are left as they are."""
    for i in range(UNKNOWNS):
        s.base[i] = s.force[i]
        s.scale[i] = s.size[i]
    for i in range(UNKNOWNS):
        kept = s.y[i]
        s.y[i] = kept + _STEP * (absolute(kept) + s.scale[i] / FLOORS[0][i]) + _LEAST
        change = s.y[i] - kept
        balance(s)
        for j in range(UNKNOWNS):
            s.jacobian[j][i] = (s.force[j] - s.base[j]) / change
        s.y[i] = kept
    for i in range(UNKNOWNS):
        s.force[i] = s.base[i]
        s.size[i] = s.scale[i]


def newton_step(s: Any) -> None:
    """Solve ``jacobian · step = −force`` by elimination with row exchanges."""
    for i in range(UNKNOWNS):
        s.step[i] = -s.force[i]
        for j in range(UNKNOWNS):
            s.matrix[i][j] = s.jacobian[i][j]
    for k in range(UNKNOWNS):
        for i in range(UNKNOWNS):
            if i > k and absolute(s.matrix[i][k]) > absolute(s.matrix[k][k]):
                for j in range(UNKNOWNS):
                    kept = s.matrix[k][j]
                    s.matrix[k][j] = s.matrix[i][j]
                    s.matrix[i][j] = kept
                kept = s.step[k]
                s.step[k] = s.step[i]
                s.step[i] = kept
        for i in range(UNKNOWNS):
            if i != k:
                share = s.matrix[i][k] / s.matrix[k][k]
                for j in range(UNKNOWNS):
                    s.matrix[i][j] = s.matrix[i][j] - share * s.matrix[k][j]
                s.step[i] = s.step[i] - share * s.step[k]
    for k in range(UNKNOWNS):
        s.step[k] = s.step[k] / s.matrix[k][k]


def merit(s: Any) -> Any:
    """Sum of the squared equations, each by its scale."""
    total = 0.0
    for j in range(UNKNOWNS):
        total = total + s.force[j] * s.force[j] / FLOORS[0][j]
    return total


def is_solved(s: Any, tolerance: Any, rounding: Any) -> Any:
    """Whether what is left of the equations is rounding."""
    solved = 1.0
    for j in range(UNKNOWNS):
        rounded = 0.0
        for i in range(UNKNOWNS):
            rounded = rounded + absolute(s.jacobian[j][i] * s.y[i])
        if not absolute(s.force[j]) <= tolerance * s.size[j] + rounding * rounded + NOTHING:
            solved = 0.0
    return solved


def solve_many(s: Any) -> Any:
    """Find the unknowns by damped Newton steps, the first with the derivatives of the step before."""
    balance(s)
    for iteration in range(_ITERATIONS):
        strict = iteration < _STRICT
        if is_solved(s, where(strict, TOLERANCE, RELAXED), where(strict, _ROUNDING, 1e-13)) > 0.0:
            return 1.0
        if iteration > 0 or s.known < 1.0:
            fill_jacobian(s)
            s.known = 1.0
        newton_step(s)
        start = merit(s)
        for j in range(UNKNOWNS):
            s.begun[j] = s.y[j]
        part, found = 1.0, 0.0
        for _halving in range(_HALVINGS):
            if found < 1.0:
                for j in range(UNKNOWNS):
                    s.y[j] = s.begun[j] + part * s.step[j]
                balance(s)
                if merit(s) <= (1.0 - _SUFFICIENT * part) * start:
                    found = 1.0
                part = 0.5 * part
        if found < 1.0 and iteration > 0:
            return is_solved(s, RELAXED, 1e-13)
    return 0.0

