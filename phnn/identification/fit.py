"""Fit a setup to a campaign: bounded nonlinear least squares with covariance and identifiability."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import norm
from scipy.stats import t as student

from phnn.identification.covariance import Scatter, bread, held_anchors, residual_by_anchors, scatter
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, Variables, variables_of, without_nuisances
from phnn.recordings.excitation import unknown_instants
from phnn.recordings.recording import Recording
from phnn.rescue import accounted, used_up
from phnn.setup import Setup
from phnn.signals.least_squares import triangle

Array = NDArray[np.float64]

# Relative change of the sum of squares and of the variables at which a fit stops.
TOLERANCE = 3e-7
# A parameter whose estimation coordinate is uncertain by more than this is not identified by the recordings.
_UNIDENTIFIED = 1.5
# How the reason ends for which such a parameter is held.
UNIDENTIFIED = "these recordings do not identify it"
# Units of masses and moments of inertia.
_INERTIAS = ("kg", "kg m2", "kg m²")
# A parameter follows a held one where its coordinate moves by more than this share of the held one's; the followers
# make up for a change where they leave less than this share of it in the output.
_FOLLOWS, _MADE_UP = 0.05, 1e-3
# A combination of parameters, each scaled to a unit norm of its column, that changes the output by less than this.
_NULL = 1e-6
# A model that takes less than this share of the output's squares explains nothing of it.
EXPLAINS = 0.1


class Slopes:
    """The (N, K) derivatives of a residual, which take megabytes of a long campaign and may be let go of.

    Args:
        values: the numbers; again: computes the same numbers again; without it they are kept.
    """

    def __init__(self, values: Array, again: Callable[[], Array] | None = None) -> None:
        self._values: Array | None = values
        self._again = again

    @property
    def values(self) -> Array:
        """Return the (N, K) derivatives; where they were let go of, all recordings are simulated for them."""
        values = self._values
        if values is None and self._again is not None:
            # What is known already costs nothing of what a search may spend, wherever it is asked for.
            with accounted():
                self._values = values = self._again()
        return np.zeros((0, 0)) if values is None else values

    def forget(self) -> None:
        """Let go of the numbers until somebody asks for them."""
        self._values = self._values if self._again is None else None

    def __reduce__(self) -> tuple[type[Slopes], tuple[Array]]:
        return Slopes, (self.values,)  # another process has recordings of its own


@dataclass(frozen=True)
class Fit:
    """A fitted setup.

    Attributes:
        setup: with the estimates.
        plan: recordings, with the estimated instants of their jumps, and sub-steps of the fit.
        variables, z: what was moved and where it ended.
        held: parameters that were not estimated, with the reason.
        residual: (N,) weighted residual of the fitted samples; slopes: its derivatives by ``z``.
        evaluations: simulations of the whole plan.
        anchors: standard deviations [SI] of the held anchors, by name.
        use: which samples were fitted.
    """

    setup: Setup
    plan: Plan
    variables: Variables
    z: Array
    held: Mapping[str, str]
    residual: Array
    slopes: Slopes
    evaluations: int
    anchors: Mapping[str, float] = field(default_factory=dict)
    use: str = "identification"

    @property
    def jacobian(self) -> Array:
        """Return (N, K) derivatives of the residual by ``z``."""
        return self.slopes.values

    def on(self, recordings: Sequence[Recording]) -> Fit:
        """Return the same fit on equal recordings, as one that comes from another process has copies of them."""
        plan = replace(self.plan, recordings=tuple(recordings))
        problem = (self.setup, plan, self.variables, self.use)
        return replace(self, plan=plan, slopes=_slopes(self.jacobian, problem, self.z))

    @cached_property
    def slices(self) -> list[slice]:
        """Return the rows of every recording in residual and Jacobian."""
        ends = np.cumsum([0, *(int(r.mask(self.use).sum()) for r in self.plan.recordings)])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]

    @property
    def chi2(self) -> float:
        """Return the weighted sum of squares over its number of samples; 1 at the noise floor."""
        return float(self.residual @ self.residual / self.residual.size)

    @property
    def cost(self) -> float:
        """Return the weighted sum of squares."""
        return float(self.residual @ self.residual)

    @cached_property
    def explained(self) -> float:
        """Share of the weighted squares of the fitted outputs, without their nuisances, that the model takes."""
        recordings = self.plan.recordings
        nothing = sum(np.sum((without_nuisances(r.y, r.mask(self.use), r) / r.noise) ** 2) for r in recordings)
        return 1.0 - self.cost / max(float(nothing), 1e-300)

    @property
    def beyond_noise(self) -> float:
        """Return the weighted sum of squares above that of the noise, one for each sample; 0 where it is less."""
        return max(self.cost - self.residual.size, 0.0)

    @cached_property
    def by_anchors(self) -> Array:
        """(K, A) derivatives of ``z`` by the held anchors; one more sweep of sensitivities, where somebody asks."""
        if not self.anchors or not self.z.size:
            return np.zeros((self.z.size, len(self.anchors)))
        problem = Problem(self.setup, self.plan, self.variables)
        columns = residual_by_anchors(problem, self.z, tuple(self.anchors))
        return self._change(columns)

    def _change(self, columns: Array) -> Array:
        """Change (K, …) of ``z`` where the residual changes by ``columns`` (N, …): ``−(JᵀJ)⁻¹ Jᵀ columns``."""
        return np.asarray(-bread(self.jacobian) @ (self.jacobian.T @ columns))

    @cached_property
    def scatter(self) -> Scatter:
        """Return the covariance of ``z`` by the noise and by what the model misses, and its degrees of freedom."""
        return scatter(self.residual, self.jacobian, self.plan.recordings, self.slices)

    @cached_property
    def by_numerics(self) -> Array:
        """(K,) by how much the numerical error of solver and reconstruction has moved ``z``; two more simulations.

        The bound on that error is for what the parameters cannot take up. What they take up, a few tenths of their
        standard errors, is the same in every repetition and is not corrected.
        """
        # Its module measures fits.
        from phnn.identification.base import numerical_error

        if not self.z.size or self.use != "identification":
            return np.zeros(self.z.size)
        return self._change(numerical_error(self).error)

    @cached_property
    def exact_anchors(self) -> Array:
        """(K, K) covariance of ``z`` where the held anchors are exact: its `scatter`, and the square of the known but
        uncorrected numerical shift, as the Guide to the Expression of Uncertainty in Measurement has it (F.2.4.5)."""
        return np.asarray(self.scatter.covariance + np.outer(self.by_numerics, self.by_numerics))

    @cached_property
    def covariance(self) -> Array:
        """Return (K, K) covariance of ``z``: `exact_anchors`, and the errors of the held anchors."""
        variances = np.square(np.array(list(self.anchors.values()), dtype=float))
        return np.asarray(self.exact_anchors + (self.by_anchors * variances) @ self.by_anchors.T)

    @cached_property
    def open_directions(self) -> tuple[dict[str, float], ...]:
        """Return the parameters that move together without any recording noticing, with the change of each coordinate.

        The first of each is the one that is held because the recordings do not identify it. An exponent of one for all
        is a common factor: only ratios are known.
        """
        weak = [n for n, why in self.held.items() if why.endswith(UNIDENTIFIED) and n in self.setup.parameters]
        if not weak or not self.z.size or self.use != "identification":
            return ()
        problem = Problem(self.setup, self.plan, self.variables)
        p = self.setup.parameters
        columns = residual_by_anchors(problem, self.z, tuple(weak)) * [p[n].slope(p[n].value) for n in weak]
        moves = self._change(columns)
        alone, unexplained = (np.linalg.norm(c, axis=0) for c in (columns, columns + self.jacobian @ moves))
        directions = []
        for name, move, size, rest in zip(weak, moves.T, alone, unexplained, strict=True):
            with_it = {n: float(m) for n, m in zip(self.variables.names, move, strict=False) if abs(m) > _FOLLOWS}
            # The output depends on it well enough, and the others make up for all of that.
            if with_it and size > 1.0 / _UNIDENTIFIED and rest < _MADE_UP * size:
                directions.append({name: 1.0, **with_it})
        return tuple(directions)

    def open_statement(self) -> str:
        """Return one sentence on what the recordings leave open; empty where they leave nothing."""
        clauses = []
        for direction in self.open_directions:
            names = f"{', '.join([*direction][:-1])} and {[*direction][-1]}"
            if all(abs(e - 1.0) < _FOLLOWS for e in direction.values()):
                clauses.append(f"a common factor of {names} is open: only their ratios are known")
            else:
                moved = ", ".join(f"{n}^{e:.2g}" for n, e in direction.items())
                clauses.append(f"{names} can change together ({moved}) without any change of the output")
        remedy = "; state one of them under `known` in recordings.yaml" if clauses else ""
        driven = not clauses or any(np.ptp(r.drive) > 0.0 for r in self.plan.recordings)
        return ("" if driven else "The input is constant, so this is a free decay: ") + "; ".join(clauses) + remedy

    def nothing_statement(self) -> str:
        """Return one sentence where the model explains nothing of the output; empty where it does."""
        if self.explained >= EXPLAINS:
            return ""
        share = max(100.0 * self.explained, 0.0)
        return (
            f"The model explains {share:.2g} % of the power of the output, which is nothing: whether something is "
            f"missing in it cannot be judged. Compare the columns, their units and the wiring, or drive the system more"
        )

    def ratios(self) -> dict[str, tuple[float, float]]:
        """Return the ratios that are known where a common factor is open, each with its standard error."""
        ratios = {}
        p, order = self.setup.parameters, {n: i for i, n in enumerate(self.variables.names)}
        for direction in self.open_directions:
            if all(abs(e - 1.0) < _FOLLOWS and p[n].positive for n, e in direction.items()):
                # The one that is divided by is the one whose unit is that of an inertia, else the held one.
                by = next((n for n in direction if p[n].unit in _INERTIAS), next(iter(direction)))
                for name in (n for n in direction if n != by):
                    weights = np.zeros(self.z.size)
                    for n, sign in ((name, 1.0), (by, -1.0)):
                        if n in order:
                            weights[order[n]] += sign
                    value = p[name].value / p[by].value
                    ratios[f"{name}/{by}"] = value, value * float(weights @ self.covariance @ weights) ** 0.5
        return ratios

    def note(self, name: str) -> str:
        """Return why a parameter has no standard error; empty where it has one."""
        others = next(([n for n in d if n != name] for d in self.open_directions if name in d), None)
        if others is not None:
            return f"known only relative to {', '.join(others)}"
        unknown = not np.isfinite(self.std().get(name, 0.0))
        return self.held.get(name, "not identified by these recordings" if unknown else "")

    def std(self) -> dict[str, float]:
        """Return the standard errors of the estimated parameters and of the held anchors, SI; infinite where the
        recordings do not identify one, alone or together with others."""
        names, covariance = self.joint_covariance()
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        loose = {n for direction in self.open_directions for n in direction}
        estimated = zip(self.variables.names, spread, strict=False)
        known = [s <= _UNIDENTIFIED and n not in loose for n, s in estimated] + [True] * len(self.anchors)
        sizes = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return {n: float(s) if k else float("inf") for n, s, k in zip(names, sizes, known, strict=True)}

    def interval(self, name: str, share: float = 0.95, anchored: bool = True) -> tuple[float, float] | None:
        """Ends [SI] of the interval that contains a parameter with a probability; None where nothing is known of it.

        It is symmetric in the estimation coordinate, so that a positive parameter has a positive interval, and as wide
        as Student's t asks for at the degrees of freedom of the covariance. The errors of anchors are normal.

        Args:
            share: the probability.
            anchored: count the errors of the held anchors too; without them the anchors are taken as exact.
        """
        size = self.std().get(name, np.inf)
        if not np.isfinite(size):
            return None
        p = self.setup.parameters[name]
        if name not in self.variables.names:
            reach = float(norm.ppf(0.5 + 0.5 * share)) * size * anchored
            return p.value - reach, p.value + reach
        i = self.variables.names.index(name)
        noise = float(self.scatter.covariance[i, i])
        total = float((self.covariance if anchored else self.exact_anchors)[i, i])
        # The other parts of the variance count as known (Satterthwaite 1946).
        freedom = float(self.scatter.freedom[i]) * (total / noise) ** 2
        reach = float(student.ppf(0.5 + 0.5 * share, freedom)) * total**0.5
        z = p.to_coordinate(p.value)
        return p.from_coordinate(z - reach), p.from_coordinate(z + reach)

    def estimates(self, names: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Return value, standard error and 95 % interval of parameters, SI; None where they were not estimated."""
        parameters, std = self.setup.parameters, self.std()
        return {
            n: {"value": p.value, "unit": p.unit, "std": std.get(n), "interval_95": self.interval(n)}
            for n, p in ((n, parameters[n]) for n in names)
        }

    def joint_covariance(self) -> tuple[tuple[str, ...], Array]:
        """Return the names and covariance (P, P), SI, of the estimated parameters and the held anchors together.

        Errors of quantities that combine several parameters need it: ``k/m`` is known far better than ``k`` and an
        anchored ``m`` are each, as both errors go together.
        """
        parameters, count = self.setup.parameters, len(self.variables.names)
        slopes = np.array([parameters[n].slope(parameters[n].value) for n in self.variables.names])
        variances = np.square(np.array(list(self.anchors.values()), dtype=float))
        across = slopes[:, None] * self.by_anchors[:count] * variances
        estimated = slopes[:, None] * self.covariance[:count, :count] * slopes
        both = np.block([[estimated, across], [across.T, np.diag(variances)]])
        return (*self.variables.names, *self.anchors), both

    @property
    def initial_states(self) -> dict[str, Array]:
        """Estimated initial states by recording; those of the others follow from their start."""
        return {n: state for n in self.variables.unknown if (state := self.initial(n)) is not None}

    def initial(self, name: str) -> Array | None:
        """Estimated initial state of a recording, or None."""
        recording = next(r for r in self.plan.recordings if r.name == name)
        return self.variables.initial(recording, self.z)


def fit(
    setup: Setup,
    plan: Plan,
    names: Sequence[str],
    held: Mapping[str, str] | None = None,
    max_evaluations: int = 40,
    tolerance: float = TOLERANCE,
    origin: Fit | None = None,
) -> Fit:
    """Estimate the named parameters from the identification samples of a plan.

    Args:
        setup: model with starting values and bounds.
        names: parameters to estimate.
        held: reasons why others are not estimated, carried along.
        max_evaluations: bound on the simulations of the plan.
        tolerance: relative change of the cost and of ``z`` at which to stop.
        origin: an earlier fit whose estimated initial states to start from.
    """
    problem = Problem(setup, plan, variables_from(setup, plan, names, origin))
    return fit_problem(problem, held, max_evaluations, tolerance)


def fit_problem(
    problem: Problem, held: Mapping[str, str] | None = None, max_evaluations: int = 40, tolerance: float = TOLERANCE
) -> Fit:
    """Estimate the variables of a problem, which begins at the values of its template; arguments as of `fit`."""
    setup, variables = problem.template, problem.variables
    lower, upper = variables.bounds(setup)
    start = np.clip(variables.start(setup), lower + 1e-12, upper - 1e-12)
    z, evaluations = start, 1
    if start.size:
        optimum = least_squares(
            problem.size,
            start,
            jac=problem.slopes,
            bounds=(lower, upper),
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=None,
            max_nfev=max_evaluations,
            callback=_ends,
        )
        z, evaluations = optimum.x, int(optimum.nfev)
    residual = problem.residual(z)
    jacobian = problem.jacobian(z) if z.size else np.zeros((residual.size, 0))
    return Fit(
        setup=variables.setup(setup, z),
        plan=replace(problem.plan, recordings=tuple(variables.timed(r, z) for r in problem.plan.recordings)),
        variables=variables,
        z=z,
        held=dict(held or {}),
        residual=residual,
        slopes=_slopes(jacobian, (setup, problem.plan, variables, problem.use), z),
        evaluations=evaluations,
        anchors=held_anchors(problem),
        use=problem.use,
    )


def _slopes(jacobian: Array, problem: tuple[Setup, Plan, Variables, str], z: Array) -> Slopes:
    """Return the derivatives of a problem's residual at ``z``, which it can compute again."""
    return Slopes(jacobian, (lambda: Problem(*problem).jacobian(z)) if z.size else None)


def _ends(intermediate_result: OptimizeResult) -> None:
    """End an optimisation after a step where the budget of the move is used up."""
    if used_up():
        raise StopIteration


def carried(initial: Array, known: Setup, wanted: Setup, default: Array) -> Array:
    """The initial state (N,) of a setup where another one begins at ``initial``: ``default`` in states it has not."""
    earlier = dict(zip(known.network.state_names, initial, strict=True))
    return np.array([earlier.get(state, v) for state, v in zip(wanted.network.state_names, default, strict=True)])


def variables_from(setup: Setup, plan: Plan, names: Sequence[str], origin: Fit | None) -> Variables:
    """The variables of a fit that begins at the initial states of an earlier one; what it had not begins anew."""
    variables = variables_of(setup, plan, names)
    return variables if origin is None else continued(variables, setup, plan, origin)


def continued(variables: Variables, setup: Setup, plan: Plan, origin: Fit) -> Variables:
    """Return variables that begin where an earlier fit is; what it had not stays as it is."""
    timed = [origin.variables.timed(r, origin.z) for r in plan.recordings]
    variables = replace(variables, instants={r.name: x for r in timed if (x := unknown_instants(r)).size})
    known = origin.initial_states
    moved = {n: carried(known[n], origin.setup, setup, x0) if n in known else x0 for n, x0 in variables.origin.items()}
    return replace(variables, origin=moved)


def unidentified(jacobian: Array, names: Sequence[str]) -> list[str]:
    """Return the names that the recordings cannot identify, worst first, from the sensitivities alone.

    A parameter is dropped while some direction of the scaled Jacobian leaves a coordinate uncertain by more than
    a factor ``e^1.5``; what is dropped is the largest entry of the weakest direction. So is one for which the others
    make up exactly, together with the initial states in the further columns: a free decay does not tell the mass.
    """
    further, sizes = jacobian[:, len(names) :], np.linalg.norm(jacobian[:, : len(names)], axis=0)
    jacobian = jacobian[:, : len(names)]
    if names and further.any() and sizes.all():
        basis = np.linalg.qr(further / np.maximum(np.linalg.norm(further, axis=0), 1e-300))[0]
        alone = (jacobian - basis @ (basis.T @ jacobian)) / sizes
        _, singular, rows = np.linalg.svd(alone, full_matrices=False)
        if singular[-1] < _NULL:
            worst = int(np.argmax(np.abs(rows[-1])))
            fewer = np.delete(np.hstack([jacobian, further]), worst, axis=1)
            return [names[worst], *unidentified(fewer, [n for n in names if n != names[worst]])]
    remaining = list(range(len(names)))
    dropped: list[str] = []
    square = triangle(jacobian)
    while remaining:
        _, singular, rows = np.linalg.svd(square[:, remaining], full_matrices=False)
        spread = np.sqrt(np.sum((rows / np.maximum(singular, 1e-100)[:, None]) ** 2, axis=0))
        if spread.max() <= _UNIDENTIFIED and singular[-1] > 1e-10 * singular[0]:
            break
        worst = remaining[int(np.argmax(np.abs(rows[-1])))]
        dropped.append(names[worst])
        remaining.remove(worst)
    return dropped
