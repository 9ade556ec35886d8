"""The location of the mismatch: whose local variables predict the residual of recordings that were left out.

For every location the residual of some recordings is regressed (ridge) on the responses to the location's
local functions, base sensitivities free beside them; the fit then predicts the residual of the others. The
score is the share of the explainable residual that is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import LOCATING, Locating
from phnn.derivatives import input_force, output_derivatives
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnosis.dictionary import FORCE, GROUPS, OUTPUT, PARAMETER, VOLTAGE, Group
from phnn.diagnosis.lines import drift_share, line_share
from phnn.network.roles import hysterons, ratios
from phnn.simulate import Trajectory

Array = NDArray[np.float64]

_RIDGES = (1e-6, 1e-4, 1e-2, 1e-1, 1.0)
# Stretches of time that are left out in turn where there is one recording.
_FOLDS = 6


@dataclass(frozen=True)
class Responses:
    """Responses of the output to all local functions.

    Attributes:
        columns: (N, F) weighted, centred, normalised.
        norms: (F,) what the columns were divided by.
        owner: (F,) index into `GROUPS`.
    """

    columns: Array
    norms: Array
    owner: NDArray[np.int64]

    @property
    def tests(self) -> Array:
        """(N, F') those columns that do not depend on the residual they are held against."""
        return self.columns[:, [not GROUPS[i].searched for i in self.owner]]


@dataclass(frozen=True)
class Location:
    """Where the mismatch is.

    Attributes:
        name: best location; detail: its best kind of element.
        tied: locations that explain as much.
        scores: share that each location explains; details: the same by ``location/detail``.
        ranks: by either name, the share by which locations and kinds of elements are compared: what no other recording
            can tell of counts less there, for nothing has tested it.
        group: index of the best group; weights: its fitted coefficients, with their covariance.
    """

    name: str
    detail: str
    tied: tuple[str, ...]
    scores: dict[str, float]
    details: dict[str, float]
    ranks: dict[str, float]
    group: int
    weights: Array
    weight_covariance: Array


@dataclass(frozen=True)
class _Products:
    """Inner products of the base and of the columns beside it, over the rows of every fold.

    Attributes:
        grams: (K+F, K+F) of the base and the columns with themselves; rights: (K+F,) with the residual.
        squares: of the residual with itself.
        base: K, how many of them belong to the base; size: number of all rows.
    """

    grams: Sequence[Array]
    rights: Sequence[Array]
    squares: Sequence[float]
    base: int
    size: int

    @cached_property
    def alone(self) -> float:
        """Sum of squares on the left-out folds with the base alone."""
        return self.error(np.arange(self.base))

    def error(self, use: NDArray[np.int64], ridges: Sequence[float] = (0.0,)) -> float:
        """Sum of squares on the left-out folds, each predicted from all others by a few of the columns, with the best
        of some ridges on those beside the base."""
        block = np.ix_(use, use)
        grams, rights = [g[block] for g in self.grams], [b[use] for b in self.rights]
        total_gram, total_right = np.sum(grams, axis=0), np.sum(rights, axis=0)

        def left(ridge: float) -> float:
            # The base was fitted to all recordings: what is left out may move it only weakly.
            penalty = np.diag(np.where(use < self.base, 1.0, ridge) + 1e-12)
            total = 0.0
            for gram, right, square in zip(grams, rights, self.squares, strict=True):
                w = np.linalg.solve(total_gram - gram + penalty, total_right - right)
                total += square - float(2.0 * w @ right - w @ gram @ w)
            return total

        return min(left(ridge) for ridge in ridges)


def responses(linearised: LinearisedFit) -> Responses:
    """One forward-sensitivity sweep a recording with all local functions as right-hand sides."""
    parts = linearised.plan.each(lambda r, t: _responses_of(t, linearised), linearised.trajectories)
    columns = linearised.stack([p[0] for p in parts])
    norms = np.linalg.norm(columns, axis=0)
    usable = norms > 1e-12 * norms.max()
    # A function that these recordings never excite keeps its place, as a column of zeros.
    norms = np.where(usable, norms, np.inf)
    return Responses(columns / norms, norms, parts[0][1])


def _responses_of(trajectory: Trajectory, linearised: LinearisedFit) -> tuple[Array, NDArray[np.int64]]:
    """(N, F) responses of one recording and the owners of the columns: forces, varied parameters, outputs."""
    scales = linearised.scales
    owners: dict[str, list[int]] = {FORCE: [], PARAMETER: [], OUTPUT: []}
    forces, varied, outputs = [], [], []
    network = trajectory.setup.network
    for index, group in enumerate(GROUPS):
        functions = group.functions(trajectory, scales)
        if not _exists(group, linearised):
            functions = np.zeros_like(functions)
        if group.enters == OUTPUT:
            outputs.append(functions * scales.sensed)
            owners[OUTPUT] += [index] * functions.shape[1]
        elif group.enters == PARAMETER:
            names = group.varied(network)
            varied += [(n, network.parameters[n].value * f) for n in names for f in functions.T]
            owners[PARAMETER] += [index] * (functions.shape[1] * len(names))
        else:
            unit = scales.stiffness * scales.displacement
            volts = group.enters == VOLTAGE
            forces.append(input_force(trajectory, functions * scales.voltage) if volts else functions * unit)
            owners[FORCE] += [index] * functions.shape[1]
    through = output_derivatives(trajectory, (), (), np.hstack(forces), varied)
    return np.hstack([through, *outputs]), np.array(owners[FORCE] + owners[PARAMETER] + owners[OUTPUT])


def _exists(group: Group, linearised: LinearisedFit) -> bool:
    """Whether the system has such a place: hysterons, a transducer, an amplifier whose command was recorded."""
    network = linearised.fit.setup.network
    if group.location in ("hysteron", "electrical"):
        return bool(hysterons(network))
    if group.location in ("coupling", "thermal"):
        return bool(ratios(network))
    return not (group.location == "amplifier" and linearised.terminals)


def locate(linearised: LinearisedFit, given: Responses | None = None, rule: Locating = LOCATING) -> Location:
    """Score every location by generalisation to left-out recordings.

    Args:
        given: responses of the local functions, where they are known.
        rule: when two locations explain a residual equally well.
    """
    found = given if given is not None else responses(linearised)
    folds = _products(linearised, found)
    details = {f"{g.location}/{g.detail}": _generalise(folds, found.owner == i) for i, g in enumerate(GROUPS)}
    # Lines have a phase of their own in every recording: only their frequency can be known from others. Nothing can of
    # a slow drift: functions that other recordings test come first where they explain much of the same.
    ranks = dict(details)
    untested = rule.drift_weight
    for detail, saved, worth in (("environment/lines", line_share, 1.0), ("sensor/drift", drift_share, untested)):
        share = min(saved(linearised) / _explainable(linearised), 1.0)
        details[detail], ranks[detail] = max(details[detail], share), max(ranks[detail], worth * share)
    names = list(dict.fromkeys(g.location for g in GROUPS))
    scores = {}
    for name in names:
        members = [i for i, g in enumerate(GROUPS) if g.location == name]
        joint = _generalise(folds, np.isin(found.owner, members))
        # A location may be explained best by one kind of element or by several together.
        inside = [f"{name}/{GROUPS[i].detail}" for i in members]
        scores[name], ranks[name] = (max([joint] + [of[d] for d in inside]) for of in (details, ranks))
    best = max(names, key=lambda n: ranks[n])
    detail = max((g.detail for g in GROUPS if g.location == best), key=lambda d: ranks[f"{best}/{d}"])
    group = next(i for i, g in enumerate(GROUPS) if (g.location, g.detail) == (best, detail))
    weights, covariance = _weights(linearised, found, group)
    tied = tuple(n for n in names if n != best and ranks[n] >= ranks[best] - rule.tied)
    return Location(best, detail, tied, scores, details, ranks, group, weights, covariance)


def _folds(linearised: LinearisedFit) -> list[NDArray[np.int64]]:
    """Rows to leave out together: recordings, or stretches of time where there is one recording."""
    blocks: Sequence[slice] = linearised.slices
    if len(blocks) == 1:
        rows = np.arange(blocks[0].start, blocks[0].stop)
        return list(np.array_split(rows, _FOLDS))
    groups: list[list[int]] = [[] for _ in range(min(_FOLDS, len(blocks)))]
    for i in range(len(blocks)):
        groups[i % len(groups)].append(i)
    return [np.concatenate([np.arange(blocks[i].start, blocks[i].stop) for i in g]) for g in groups]


def _products(linearised: LinearisedFit, found: Responses) -> _Products:
    """Those of the base with all columns: every group of functions takes its own of them."""
    r, base = linearised.residual, linearised.basis
    # Projected columns need no help from the base to fit all recordings, so that its prior shrinks nothing true.
    columns = linearised.project(found.columns)
    grams, rights, squares = [], [], []
    for fold in _folds(linearised):
        design, left = np.hstack([base[fold], columns[fold]]), r[fold]
        grams.append(design.T @ design)
        rights.append(design.T @ left)
        squares.append(float(left @ left))
    return _Products(grams, rights, squares, base.shape[1], r.size)


def _generalise(folds: _Products, chosen: NDArray[np.bool_]) -> float:
    """Share of the explainable residual predicted on what was left out, best over the ridge grid.

    Args:
        chosen: (F,) the columns that may explain it.
    """
    if not chosen.any():
        return 0.0
    use = np.concatenate([np.arange(folds.base), folds.base + np.flatnonzero(chosen)])
    explained = folds.alone - folds.error(use, _RIDGES)
    return float(np.clip(explained / _at_least(folds.alone - folds.size, folds.size), 0.0, 1.0))


def _explainable(linearised: LinearisedFit) -> float:
    """Sum of squares in excess of the noise."""
    r = linearised.residual
    return _at_least(float(r @ r) - r.size, r.size)


def _at_least(excess: float, size: int) -> float:
    """An excess is known only to the spread of a sum of squares; below that no share of it can be large."""
    return max(excess, 2.0 * (2.0 * size) ** 0.5)


def _weights(linearised: LinearisedFit, found: Responses, group: int) -> tuple[Array, Array]:
    """Coefficients of one group's functions fitted to the whole residual, in the units of the functions."""
    mine = found.owner == group
    x = linearised.project(found.columns[:, mine])
    gram = x.T @ x + 1e-4 * np.eye(x.shape[1])
    inverse = np.linalg.inv(gram)
    weights = inverse @ (x.T @ linearised.residual)
    rest = linearised.residual - x @ weights
    spread = float(rest @ rest / rest.size)
    norms = found.norms[mine]
    return weights / norms, spread * (inverse @ (x.T @ x) @ inverse) / np.outer(norms, norms)


def group_of(location: Location) -> Group:
    """The dictionary group behind a location."""
    return GROUPS[location.group]


def recording_scores(linearised: LinearisedFit) -> dict[str, float]:
    """Residual over noise of every identification recording."""
    return {
        r.name: float(np.sqrt(np.mean(linearised.fit.residual[s] ** 2)))
        for r, s in zip(linearised.plan.recordings, linearised.slices, strict=True)
    }


def strongest_frequencies(linearised: LinearisedFit, count: int = 5) -> list[float]:
    """Frequencies [Hz] that carry most of the residual above the noise, over all recordings."""
    peaks: list[tuple[float, float]] = []
    for recording, rows in zip(linearised.plan.recordings, linearised.slices, strict=True):
        r = linearised.fit.residual[rows]
        power = np.abs(np.fft.rfft(r * np.hanning(r.size))) ** 2 / (0.375 * r.size)
        grid = np.fft.rfftfreq(r.size, recording.dt)
        top = [i for i in np.argsort(power)[-3:] if power[i] > 10.0 and grid[i] > 0.0]
        peaks += [(float(power[i]), float(grid[i])) for i in top]
    return [round(f, 3) for _, f in sorted(peaks, reverse=True)[:count]]


def strongest_times(linearised: LinearisedFit, count: int = 3) -> list[float]:
    """Instants [s] of the largest residuals in the recording that fits worst."""
    worst = max(recording_scores(linearised).items(), key=lambda item: item[1])[0]
    for recording, rows in zip(linearised.plan.recordings, linearised.slices, strict=True):
        if recording.name == worst:
            r = np.abs(linearised.fit.residual[rows])
            t = recording.t[recording.mask("identification")]
            return [float(x) for x in t[np.sort(np.argsort(r)[-count:])]]
    return []
