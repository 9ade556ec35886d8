"""Identify an actuator from nothing but recordings, as in Fig. 9 but from starting points that race.

Mass–spring–dampers of several resonances → hysterons of many sizes added → heats of nonlinear least squares on a few
recordings → the best on all recordings.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused, PhnnError
from phnn.identification.evaluate import with_starts
from phnn.identification.fit import TOLERANCE, UNIDENTIFIED, Fit, fit, fit_problem, unidentified, variables_from
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, starts_unknown
from phnn.identification.starting_points import (
    DEFAULT_MASS,
    FORMS,
    RESONANCES_HZ,
    linear_part,
    mechanical_points,
    random_starts,
    with_form,
)
from phnn.models.actuator import hrc
from phnn.parameters import Parameter
from phnn.recordings.recording import Anchor, Recording, dominant_frequency
from phnn.recordings.units import same_kind
from phnn.rescue import late
from phnn.setup import Setup

Array = NDArray[np.float64]

_ENOUGH = 5
# A recording without a frequency counts as this much slower than the slowest that has one.
_SLOWER = 0.1


def representative_subset(plan: Plan) -> Plan:
    """Return the plan with at most five recordings, spread over amplitude and frequency.

    Beginning with the largest input, each further one is the farthest from those chosen (Gonzalez 1985), in decades of
    the input's range and of its dominant frequency.
    """
    if len(plan.recordings) <= _ENOUGH:
        return plan
    places = _places(plan.recordings)
    chosen = [int(np.argmax(places[:, 0]))]
    while len(chosen) < _ENOUGH:
        apart = np.linalg.norm(places[:, None] - places[chosen], axis=2).min(axis=1)
        apart[chosen] = -1.0
        chosen.append(int(np.argmax(apart)))
    return replace(plan, recordings=tuple(plan.recordings[i] for i in sorted(chosen)))


def _places(recordings: tuple[Recording, ...]) -> Array:
    """Return (R, 2) decades of the input's range and of its dominant frequency."""
    ranges = np.array([float(np.ptp(r.u)) for r in recordings])
    frequencies = np.array([dominant_frequency(r) for r in recordings])
    known = frequencies[frequencies > 0.0]
    frequencies = np.where(frequencies > 0.0, frequencies, _SLOWER * known.min() if known.size else 1.0)
    return np.log10(np.column_stack([np.maximum(ranges, max(1e-3 * ranges.max(), 1e-300)), frequencies]))


# Parameters that the common factor scales: any one of them, once known, fixes it.
_SCALED = ("m", "k", "b", "alpha", "C_", "rho_")
_SLOW = "held: undetermined, because the recordings are so slow that no mass and no damping shows"
# Evaluations on all recordings by which the best is chosen, and of the best.
_SHORT, _FULL = 15, 50
# Places and evaluations of the heats in which starting points race; relative change of the cost at which one stops.
_HEATS, _ROUGH = ((100, 6), (6, 12), (3, 40)), 1e-4
# Two that cost the same but for this share have met; a weighted mean square up to this one leaves nothing to gain.
_MET, _NOISE = 1e-3, 1.4
# Starts that cost at most this many times the best one go on to all recordings.
_NEARLY = 1.3
# Bound on the simulations of the whole plan in a fit.
EVALUATIONS = 60
# What is not tried of a base model when the time of a diagnosis is up.
FURTHER_STARTS = "further starts of the base model"


def identify_actuator(
    plan: Plan, known: Mapping[str, Anchor], hysterons: int | str, starts: int, seed: int, setup: Setup | None = None
) -> Fit:
    """Return the HRC actuator fitted to the identification samples of a plan, no starting values needed.

    Args:
        plan: recordings and sub-steps.
        known: anchors; a known parameter is held at its value.
        hysterons: number of hysterons, or one of `FORMS` in their place.
        starts: starting points per resonance.
        seed: of the random starting points.
        setup: start from this setup alone instead.
    """
    slow = is_quasi_static(plan)
    held = _held(known, slow)
    if setup is not None:
        return fit_identified(setup, plan, held)
    anchored = {n: a.value for n, a in known.items()}
    check_known(known, hrc(0 if isinstance(hysterons, str) else hysterons).parameters)
    points = mechanical_points(plan, anchored)[: 1 if slow else None]
    if isinstance(hysterons, str):
        points = [s for p in points for s in with_form(p, plan, hysterons)]
    elif hysterons:
        points = [s for p in points for s in random_starts(p, plan, hysterons, anchored, starts, seed)]
    finished = _finished(points, plan, held)
    more = not late(FURTHER_STARTS)
    by_known_starts = _from_known_starts(plan, known, hysterons, starts, seed) if more else None
    best = min((f for f in (*finished, by_known_starts) if f is not None), key=lambda f: f.cost)
    return fit_identified(best.setup, plan, held, _FULL, best)


def identify_form(plan: Plan, known: Mapping[str, Anchor], hysterons: Fit) -> tuple[str, Fit]:
    """Return the form of hysteresis that fits best in the place of hysterons, and its fit.

    Args:
        hysterons: a fit with these, from whose mass, spring and damper all forms begin.
    """
    held, values = _held(known, is_quasi_static(plan)), hysterons.setup.values()
    linear = linear_part(values)
    best = min(_finished([s for f in FORMS for s in with_form(linear, plan, f)], plan, held), key=lambda f: f.cost)
    return best.setup.name, fit_identified(best.setup, plan, held, _FULL, best)


def _held(known: Mapping[str, Anchor], slow: bool) -> dict[str, str]:
    """What is not estimated: by a statement, for want of a common factor, or because nothing moves fast enough."""
    return held_by_statement(known) | (_held_quasi_static(known) if slow else {})


def _finished(points: Sequence[Setup], plan: Plan, held: Mapping[str, str]) -> list[Fit]:
    """Return the short fits to a whole plan from the best of starting points."""
    finished: list[Fit] = []
    for first in _raced(points, representative_subset(plan), held):
        if finished and late(FURTHER_STARTS):
            break
        finished.append(fit_identified(first.setup, plan, held, _SHORT, first, tolerance=_ROUGH))
    return finished


def _raced(points: Sequence[Setup], plan: Plan, held: Mapping[str, str]) -> list[Fit]:
    """Return the fits from the best of several starting points and from those that nearly equal it, the best first.

    The first steps say little about where a start ends: several of the best go on from where they are. Of starts that
    have met only one goes on; a start that has reached the noise ends the race.
    """
    field: list[tuple[Setup, Fit | None]] = [(setup, None) for setup in points]
    heat: list[Fit] = []
    for places, evaluations in _HEATS:
        heat = []
        for setup, before in field[:places]:
            if heat and late(FURTHER_STARTS):
                break
            try:
                heat.append(fit_identified(setup, plan, held, evaluations, before, tolerance=_ROUGH))
            except PhnnError:
                continue
            if heat[-1].chi2 <= _NOISE:
                return heat[-1:]
        if not heat:
            raise PhnnError("no starting point of the identification could be simulated: check units and sampling")
        heat.sort(key=lambda f: f.cost)
        heat = heat[:1] + [f for g, f in itertools.pairwise(heat) if f.cost > (1.0 + _MET) * g.cost]
        field = [(f.setup, f) for f in heat]
    return [f for f in heat if f.cost <= _NEARLY * heat[0].cost]


def _from_known_starts(
    plan: Plan, known: Mapping[str, Anchor], hysterons: int | str, starts: int, seed: int
) -> Fit | None:
    """Return a fit whose parameters come from the recordings of known start, and then the unknown initial states.

    Unknown initial states make many local optima. None where all starts are known, or none, and where the recordings
    of known start do not identify the model by themselves.
    """
    certain = tuple(r for r in plan.recordings if not starts_unknown(r))
    if not 0 < len(certain) < len(plan.recordings):
        return None
    try:
        first = identify_actuator(replace(plan, recordings=certain), known, hysterons, starts, seed)
        return fit_identified(first.setup, plan, held_by_statement(known), _FULL, with_starts(first.setup, plan))
    except PhnnError:
        return None


def check_known(known: Mapping[str, Anchor], parameters: Mapping[str, Parameter]) -> None:
    """Refuse an anchor of a parameter that the model does not have, or in a unit of something else.

    Raises:
        InputRefused: names the parameter.
    """
    strangers = sorted(set(known) - set(parameters))
    if strangers:
        raise InputRefused(f"known: no parameter {strangers[0]}; this model has {', '.join(parameters)}")
    for name, anchor in known.items():
        unit = parameters[name].unit
        if anchor.unit and unit and not same_kind(anchor.unit, unit):
            raise InputRefused(
                f"known: {name} is in {unit}, its stated unit is one of the kind of {anchor.unit}: correct it"
            )


def held_by_statement(known: Mapping[str, Anchor]) -> dict[str, str]:
    """Return what is not estimated because the manifest states it, or because nothing fixes the common factor."""
    wrong = [n for n, a in known.items() if a.value <= 0.0]
    if wrong:
        raise InputRefused(f"known: {wrong[0]} = {known[wrong[0]].value:g} must be positive, in SI units")
    held = held_at(known)
    if not fixes_common_factor(known):
        held["m"] = f"held at {DEFAULT_MASS:g} kg: voltage and displacement identify values up to one common factor"
    return held


def is_quasi_static(plan: Plan) -> bool:
    """Return whether all recordings are so slow that the longest lag of a likely actuator, that of critical damping at
    the lowest resonance, leaves less than the noise of them: then no mass and no damping shows."""
    lag = 1.0 / (np.pi * RESONANCES_HZ[0])
    excitations = [(r, r.excitation) for r in plan.recordings]
    # Steps excite whatever the sampling can show.
    highest = [0.5 / r.dt if e.kind == "steps" else e.high_Hz for r, e in excitations]
    speeds = [np.pi * f * float(np.ptp(r.y)) for (r, _), f in zip(excitations, highest, strict=True)]
    return all(speed * lag < r.noise for (r, _), speed in zip(excitations, speeds, strict=True))


def _held_quasi_static(known: Mapping[str, Anchor]) -> dict[str, str]:
    """Return the mass and damping, which slow recordings do not determine, and the stiffness, unless something else
    fixes the common factor."""
    fixed = fixes_common_factor(n for n in known if n not in ("m", "b"))
    return {n: _SLOW for n in ("m", "b", "k") if n not in known and not (fixed and n == "k")}


def held_at(known: Mapping[str, Anchor]) -> dict[str, str]:
    """The reason why each anchor is not estimated: its stated value, with its standard deviation where it has one."""
    return {n: f"held at the stated {a.value:g}" + (f" ± {a.std:g}" if a.std > 0.0 else "") for n, a in known.items()}


def fixes_common_factor(known: Iterable[str]) -> bool:
    """Return whether one of the known parameters fixes the factor that voltage and displacement leave open."""
    return any(n.startswith(_SCALED) for n in known)


def stated_only(held: Mapping[str, str]) -> dict[str, str]:
    """Return what is held by a statement; what an earlier fit could not identify is left out, to be asked again."""
    return {n: why for n, why in held.items() if not why.endswith(UNIDENTIFIED)}


def fit_identified(
    setup: Setup,
    plan: Plan,
    held: Mapping[str, str],
    max_evaluations: int = EVALUATIONS,
    origin: Fit | None = None,
    keep: Sequence[str] = (),
    tolerance: float = TOLERANCE,
) -> Fit:
    """Fit what the recordings identify; the rest is held at its value and reported.

    Args:
        keep: parameters that are estimated wherever some output depends on them.
        tolerance: where to stop, as of `phnn.identification.fit.fit`.
    """
    free = [n for n in setup.free if n not in held]
    reasons = dict(held)
    problem = Problem(setup, plan, variables_from(setup, plan, free, origin))
    start = problem.variables.start(setup)
    jacobian = problem.jacobian(start)
    for name in unidentified(jacobian, free):
        if name not in keep or not jacobian[:, free.index(name)].any():
            reasons[name] = _reason(setup, name)
    names = [n for n in free if n not in reasons]
    if names != free:
        problem = Problem(setup, plan, replace(problem.variables, names=tuple(names)))
    fitted = fit_problem(problem, reasons, max_evaluations, tolerance)
    weak = [n for n in unidentified(fitted.jacobian, names) if n not in keep]
    if not weak:
        return fitted
    reasons |= {n: _reason(fitted.setup, n) for n in weak}
    identified = [n for n in names if n not in weak]
    return fit(fitted.setup, plan, identified, reasons, max_evaluations, tolerance, fitted)


def _reason(setup: Setup, name: str) -> str:
    p = setup.parameters[name]
    return f"held at {p.value:.4g} {p.unit}: {UNIDENTIFIED}"
