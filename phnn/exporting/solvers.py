"""The solvers of a step, in the exported subset of Python: the equations of a step set to zero without derivatives.

They find the same root as `phnn.integrate.roots` and `phnn.integrate.kernel`, to the same tolerance. Slopes are taken
from the values that were seen, because no target has the complex steps of the package. The state ``s`` holds the
unknowns ``y``, what is left of the equations, ``force``, and the size of their terms, ``size``.

The names below stand for functions and tables of the program.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.roots import NOTHING, RELAXED, TOLERANCE, gradient_defect, radau_defects
from phnn.laws.namespace import absolute, maximum, where

_FAR = 1e300
_STRICT = 12
_ITERATIONS = 300
# A slope between two values is believed if they differ by more than this share of the equation's terms.
_SEEN = 1e-8
# By how much of its terms a finite difference is to change an equation, its least step as a share of the unknown,
# and the least of all.
_STEP, _FINEST, _LEAST = 1e-8, 1e-9, 1e-30
_HALVINGS = 30
_SUFFICIENT = 1e-4
# What rounding of the unknowns leaves, as a share of their part in an equation.
_ROUNDING = 4e-16

UNKNOWNS = 1
FLOORS: Any = ((1.0,),)
H = 1.0


def _of_program(*_: Any) -> Any:
    """Stand for a function of the program."""
    raise NotImplementedError


# ``balance(s)`` fills ``force`` and ``size`` at the unknowns ``y``.
# ``lost(s, state)`` is the flow into the resistors of a storage, ``mean_effort(a, b)`` its mean effort between states.
# ``value(s, y, x, other, current)`` is an equation at the unknown ``y``, and the size of its terms.
# ``first_stage(s, two, x, current)`` is the first stage for a given second one.
balance = lost = mean_effort = value = first_stage = _of_program


def root(s: Any, x: Any, other: Any, current: Any, guess: Any, floor: Any, slope: Any) -> Any:
    """Return the root of an increasing equation by secant steps inside a bracket, and the last slope; 1e300 for none.

    ``slope`` is tried first, and one step of the least slope ``floor`` leads beyond the root.
    """
    low, high, last, reach = -_FAR, _FAR, _FAR, 1.0
    before, before_value, y, exhausted = 0.0, 0.0, guess, 0.0
    for iteration in range(_ITERATIONS):
        defect, size = value(s, y, x, other, current)
        if absolute(defect) <= where(iteration < _STRICT, TOLERANCE, RELAXED) * size + NOTHING or exhausted > 0.0:
            return y, slope
        if not absolute(defect) < _FAR:
            return _FAR, floor
        if iteration > 0 and absolute(defect - before_value) > _SEEN * size and y != before:
            secant = (defect - before_value) / (y - before)
            slope = where(secant > 0.0, secant, slope)
        before, before_value = y, defect
        low = where(defect > 0.0, low, y)
        high = where(defect > 0.0, y, high)
        step = y - defect / slope
        if step >= low and step <= high and absolute(defect) <= 0.5 * last:
            y = step
        elif low > -_FAR and high < _FAR:
            y = 0.5 * (low + high)
            exhausted = where(y <= low or y >= high, 1.0, 0.0)
        else:
            y = y - reach * defect / floor
            reach = 2.0 * reach
        last = where(iteration > 0, absolute(defect), _FAR)
    return _FAR, floor


def balance_value(s: Any, y: Any, x: Any, other: Any, current: Any) -> Any:
    """Return the equation of a step with one unknown."""
    s.y[0] = y
    balance(s)
    return s.force[0], s.size[0]


def solve_one(s: Any) -> Any:
    """Find the unknown ``y[0]``; 1 where it was found, 0 otherwise."""
    y, slope = root(s, 0.0, 0.0, 0.0, s.y[0], FLOORS[0][0], s.slope)
    s.slope = slope
    return where(y < _FAR, 1.0, 0.0)


def first_stage_value(s: Any, y: Any, x: Any, other: Any, current: Any) -> Any:
    """Return the first equation of Radau IIA at its first stage, for a given second one."""
    taken = lost(s, y)
    defect, _unused = radau_defects(y - x, other - x, current, H, taken, 0.0)
    return defect, absolute(y) + absolute(other) + absolute(x) + H * (absolute(current) + absolute(taken))


def second_stage_value(s: Any, y: Any, x: Any, other: Any, current: Any) -> Any:
    """Return the second equation at the second stage, with the first stage that solves the first one."""
    taken, one = lost(s, y), first_stage(s, y, x, current)
    _unused, defect = radau_defects(one - x, y - x, current, H, 0.0, taken)
    return defect, absolute(one) + absolute(y) + absolute(x) + H * (absolute(current) + absolute(taken))


def first_root(s: Any, two: Any, x: Any, current: Any) -> Any:
    """Return the first stage for a given second one."""
    one, _unused = root(s, x, two, current, two, 1.5, 1.5)
    return one


def radau(s: Any, x: Any, current: Any) -> Any:
    """Return both stages of a storage under a constant current; the second is its end state."""
    two, _unused = root(s, x, 0.0, current, x, 2.5, 2.5)
    return first_stage(s, two, x, current), two


def gradient_value(s: Any, y: Any, x: Any, other: Any, current: Any) -> Any:
    """Return the equation of the discrete gradient at the end state."""
    taken = lost(s, mean_effort(x, y))
    defect = gradient_defect(y - x, current, H, taken)
    return defect, absolute(y) + absolute(x) + H * (absolute(current) + absolute(taken))


def gradient(s: Any, x: Any, current: Any) -> Any:
    """Return the end state of a storage under a constant current."""
    end, _unused = root(s, x, 0.0, current, x, 1.0, 1.0)
    return end


def fill_jacobian(s: Any) -> None:
    """Derivatives of the equations by finite differences; the equations are left as they are.

    Steps are such that the slope known before would change an equation by `_STEP`: a slope that was too small, of a law
    that is steep at one place, is corrected from iteration to iteration.
    """
    for i in range(UNKNOWNS):
        s.base[i] = s.force[i]
        s.scale[i] = s.size[i]
        if s.known < 1.0:
            s.jacobian[i][i] = FLOORS[0][i]
    for i in range(UNKNOWNS):
        kept = s.y[i]
        slope = maximum(absolute(s.jacobian[i][i]), FLOORS[0][i])
        s.y[i] = kept + _STEP * s.scale[i] / slope + _FINEST * absolute(kept) + _LEAST
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
    """Return the sum of the squared equations, each by its scale."""
    total = 0.0
    for j in range(UNKNOWNS):
        total = total + s.force[j] * s.force[j] / FLOORS[0][j]
    return total


def is_solved(s: Any, tolerance: Any, rounding: Any) -> Any:
    """Return whether what is left of the equations is rounding."""
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
        part, accepted = 1.0, 0.0
        for _halving in range(_HALVINGS):
            if accepted < 1.0:
                for j in range(UNKNOWNS):
                    s.y[j] = s.begun[j] + part * s.step[j]
                balance(s)
                if merit(s) <= (1.0 - _SUFFICIENT * part) * start:
                    accepted = 1.0
                part = 0.5 * part
        if accepted < 1.0 and iteration > 0:
            return is_solved(s, RELAXED, 1e-13)
    return 0.0
