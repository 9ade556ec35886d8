"""How long does an identification take?

    python -m benchmarks.identify

Nine parameters (the mass is held: without it there is one common factor) from the sines of 1, 50, 100 and 150 Hz at
75 V, simulated by the reference solver, with white noise of 0.05 µm. Everybody starts from the same wrong values and
minimises the same cost, the weighted sum of squares without the zero of each recording; everybody solves with the
settings that give 1e-5 in q. What they end at is judged by one tight solver.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.optimize import least_squares

from benchmarks import peers, peers_scipy
from benchmarks.case import NAMES, TRUTH, Array, Solve, march_alone, setup_with, sine
from benchmarks.forward import SUBSTEPS
from benchmarks.ladder import Choice, Solver, choose
from benchmarks.reference import reference
from benchmarks.table import RESULTS, Contender, goal, machine, rows, show, timed, write_csv
from phnn.identification.fit import fit
from phnn.identification.plan import Plan
from phnn.identification.staged import identify_actuator
from phnn.recordings.recording import Anchor, Recording

FREQUENCIES = (1.0, 50.0, 100.0, 150.0)  # Hz
NOISE = 0.05e-6  # m
SEED = 7
TARGET = 1e-5
# Relative change of the cost, and of the logarithms, at which everybody stops.
STOP = 1e-5
HELD = "m"
FREE = tuple(n for n in NAMES if n != HELD)
# In turns up and down, stiffness up. With stiffness down all of them end in the same wrong minimum.
OFF = {n: 1.5 ** (-1) ** i for i, n in enumerate(FREE)}
START = TRUTH * np.array([OFF.get(n, 1.0) for n in NAMES])
GOAL = 20.0
# Excess of the final cost up to which two results are the same.
SAME = 1e-3
# s, far beyond the goal: who is not done by then is stopped, and its time is a lower bound.
LIMIT = 60.0
# In the logarithm of a parameter. The error of an adaptive solver is not smooth in the parameters: smaller steps
# than this find its noise instead of a slope.
_DIFFERENCE = 3e-3
_JUDGE = 1e-9
CASE = "four sines, nine parameters"


def last_call_of(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Remember the last call of a function: optimisers ask for residual and Jacobian one after the other."""
    last: dict[bytes, Array] = {}

    def remembered(z: Array) -> Array:
        key = z.tobytes()
        if key not in last:
            last.clear()
            last[key] = function(z)
        return last[key]

    return remembered


def recorded() -> tuple[Recording, ...]:
    """The four recordings with noise."""
    blank = tuple(sine(f) for f in FREQUENCIES)
    rng = np.random.default_rng(SEED)
    return tuple(
        replace(r, y=q + NOISE * rng.standard_normal(q.size), noise=NOISE)
        for r, q in zip(blank, reference(blank)[0], strict=True)
    )


def theta_of(z: Array) -> Array:
    """(10,) parameters from the logarithms of the free ones."""
    return np.insert(np.exp(z), NAMES.index(HELD), TRUTH[NAMES.index(HELD)])


Z_START = np.log(np.delete(START, NAMES.index(HELD)))


def residual(recordings: Sequence[Recording], outputs: Sequence[Array]) -> Array:
    """(R·N,) weighted residual, the zero of every recording taken out."""
    rough = [(r.y - q) / r.noise for r, q in zip(recordings, outputs, strict=True)]
    return np.concatenate([x - x.mean() for x in rough])


def own(recordings: tuple[Recording, ...], choice: Choice) -> Solve:
    """phnn's own nonlinear least squares from the common start."""
    substeps = {r.name: int(s) for r, s in zip(recordings, choice.settings or (), strict=True)}
    plan = Plan(recordings, substeps, workers=1)

    def solve() -> Array:
        values = fit(setup_with(START), plan, FREE, tolerance=STOP).setup.values()
        return np.array([values[n] for n in NAMES])

    return solve


def own_from_nothing(recordings: tuple[Recording, ...], choice: Choice) -> Solve:
    """phnn's whole staged identification, which is told the mass and no starting values."""
    substeps = {r.name: int(s) for r, s in zip(recordings, choice.settings or (), strict=True)}
    plan = Plan(recordings, substeps, workers=1)

    def solve() -> Array:
        found = identify_actuator(plan, {HELD: Anchor(TRUTH[NAMES.index(HELD)])}, 2, 2, SEED)
        values = found.setup.values()
        return np.array([values[n] for n in NAMES])

    return solve


class OutOfTime(Exception):
    """An identification took longer than `LIMIT`."""


def by_differences(recordings: Sequence[Recording], choice: Choice) -> Solve:
    """scipy's least squares around one of its solvers, the Jacobian from two points a parameter."""
    path = peers_scipy.PATHS[choice.solver.name][choice.solver.note]

    def solve() -> Array:
        end = time.perf_counter() + LIMIT

        def at(z: Array) -> Array:
            if time.perf_counter() > end:
                raise OutOfTime
            theta = theta_of(z)
            pairs = zip(recordings, choice.settings or (), strict=True)
            return residual(recordings, [path(r, theta, s) for r, s in pairs])

        kept = last_call_of(at)

        def jacobian(z: Array) -> Array:
            here = kept(z)
            return np.column_stack([(at(z + step) - here) / _DIFFERENCE for step in _DIFFERENCE * np.eye(z.size)])

        try:
            return theta_of(least_squares(kept, Z_START, jacobian, ftol=STOP, xtol=STOP, gtol=None).x)
        except OutOfTime:
            return np.full(len(NAMES), np.nan)

    return solve


def jax_residual(recordings: Sequence[Recording], choice: Choice) -> Callable[[Any], Any]:
    """(R·N,) weighted residual at the logarithms, by diffrax, all recordings at once."""
    u, dt = peers.arrays(recordings)
    y = jnp.array(np.stack([r.y for r in recordings]))
    tolerances = jnp.array(choice.settings)
    kind = next(k for k in peers.KINDS if k in choice.solver.name)
    knots = peers.VARIANTS[choice.solver.note]
    place = NAMES.index(HELD)

    def at(z: Any) -> Any:
        theta = jnp.insert(jnp.exp(z), place, TRUTH[place])
        one = partial(peers.solution, kind, knots, None, theta)
        rough = (y - jax.vmap(one)(u, dt, tolerances)[0]) / NOISE
        return (rough - rough.mean(axis=1, keepdims=True)).ravel()

    return at


def by_optimistix(recordings: Sequence[Recording], choice: Choice) -> Solve:
    """diffrax inside optimistix' Levenberg–Marquardt, forward-mode Jacobian, one compiled function."""
    at = jax_residual(recordings, choice)
    optimiser: Any = optimistix.LevenbergMarquardt(rtol=STOP, atol=STOP)

    @jax.jit
    def run(z: Any) -> Any:
        options = {"jac": "fwd"}
        return optimistix.least_squares(lambda z, _: at(z), optimiser, z, options=options, throw=False).value

    return lambda: theta_of(np.asarray(run(jnp.array(Z_START))))


def by_jacfwd(recordings: Sequence[Recording], choice: Choice) -> Solve:
    """diffrax inside scipy's least squares, the optimiser that phnn uses, with its forward-mode Jacobian."""
    at = jax_residual(recordings, choice)
    value, slope = jax.jit(at), jax.jit(jax.jacfwd(at))

    def solve() -> Array:
        found = least_squares(
            lambda z: np.asarray(value(z)), Z_START, lambda z: np.asarray(slope(z)), ftol=STOP, xtol=STOP, gtol=None
        )
        return theta_of(found.x)

    return solve


def contenders(recordings: tuple[Recording, ...]) -> list[Contender]:
    """phnn and the peers; diffrax with whichever of its solvers is faster here."""
    truth = reference(recordings)[0]

    def pick(variants: Sequence[Solver]) -> Choice:
        (choice,) = choose(variants, truth, (TARGET,))
        return choice

    march = pick([Solver("phnn", SUBSTEPS, partial(march_alone, recordings))])
    diffrax = pick([v for kind in peers.KINDS for v in peers.forward(recordings, kind, together=True)])
    radau, lsoda = (pick(peers_scipy.forward(recordings, name)) for name in ("scipy Radau", "scipy LSODA"))
    return [
        _entered("phnn, least squares from the common start", march, own(recordings, march)),
        _entered("phnn, whole identification from nothing", march, own_from_nothing(recordings, march)),
        _entered(f"{diffrax.solver.name}, optimistix", diffrax, by_optimistix(recordings, diffrax)),
        _entered(f"{diffrax.solver.name}, scipy least squares", diffrax, by_jacfwd(recordings, diffrax)),
        _entered("scipy Radau, two-point Jacobian", radau, by_differences(recordings, radau), warm=True),
        _entered("scipy LSODA, two-point Jacobian", lsoda, by_differences(recordings, lsoda), warm=True),
    ]


def _entered(name: str, choice: Choice, solve: Solve, warm: bool = False) -> Contender:
    return Contender(CASE, TARGET, name, choice.setting(), choice.error, solve, warm)


def judged(recordings: Sequence[Recording], theta: Array) -> float:
    """Weighted sum of squares by one tight solver; infinite where there is no result."""
    if not np.isfinite(theta).all():
        return float("inf")
    tight = residual(recordings, [peers_scipy.lsoda_on_samples(r, theta, _JUDGE) for r in recordings])
    return float(tight @ tight)


def first_call(contender: Contender) -> float:
    """Seconds of the very first run, compiling included."""
    begin = time.perf_counter()
    if contender.solve is not None:
        contender.solve()
    return time.perf_counter() - begin


def main() -> int:
    """Identify, print, write ``identify.csv``."""
    print(machine())
    print(f"seed of the noise {SEED}; start: every parameter off by a factor 1.5, in turns up and down")
    recordings = recorded()
    found = contenders(recordings)
    compiled = [float("nan") if c.warm else first_call(c) for c in found]
    seconds, values = timed([replace(c, warm=True) for c in found], budget=6.0)
    table = rows(found, seconds)
    costs = [judged(recordings, np.asarray(v)) for v in values]
    table["cost"], table["excess"] = costs, np.array(costs) / min(costs) - 1.0
    table["first_call"] = compiled
    show(table.drop(columns=["case", "target"]), f"{CASE}: cost is over {sum(r.t.size for r in recordings)} samples")
    write_csv(table, RESULTS / "identify.csv")
    late = table.loc[~np.isfinite(table["cost"]), "solver"]
    for name in late:
        print(f"{name}: stopped after {LIMIT:g} s, its time and ratio are lower bounds")
    # The first two lines are phnn's own.
    for _, line in table.iloc[2:].iterrows():
        if line["excess"] <= SAME or line["solver"] in set(late):
            goal(f"identification against {line['solver']}", line["ratio"], GOAL)
        else:
            print(f"{line['solver']}: not compared, its cost is {line['excess']:.1e} above the least")
    return 0


if __name__ == "__main__":
    sys.exit(main())
