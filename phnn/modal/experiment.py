"""Periodic experiments: one mean period of every input and every output, grouped by how strongly they were driven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phnn.check.consistency import contaminated
from phnn.errors import InputRefused
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Campaign, Recording

Array = NDArray[np.float64]

# Power of an excited line over the strongest; amplitudes of one level differ by less than this factor.
_EXCITED, _ALIKE = 1e-4, 1.25
# Share of the strongest input below which one is not driven; of the strongest combination, below which none is apart.
_DRIVEN, _APART = 1e-6, 1e-3


@dataclass(frozen=True, eq=False)
class Experiment:
    """One mean period in the steady state.

    Attributes:
        name: the recording's, without its output's.
        held_out: never used to fit or to choose.
        u: (N, P) inputs; y: (N, O) outputs without their means, SI.
        spread: (O,) effective difference of a period from the mean period.
        zero_order: whether the input is held between samples; otherwise it is taken as band-limited.
    """

    name: str
    held_out: bool
    u: Array
    y: Array
    spread: Array
    zero_order: bool

    @property
    def amplitude(self) -> float:
        """Effective value of all inputs together, the root of their summed squares."""
        return float(np.sqrt((self.u - self.u.mean(axis=0)).var(axis=0).sum()))


@dataclass(frozen=True, eq=False)
class Study:
    """All experiments.

    Attributes:
        dt: s; inputs, outputs: their names; units: of input and output.
        levels: experiments by amplitude, in ascending order; each has some for identification.
        apart: amplitudes that are held out as a whole, in ascending order; never used to fit or to choose.
        left_out: experiments of identification that were not used, with the reason.
    """

    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, str]
    levels: tuple[tuple[Experiment, ...], ...]
    left_out: Mapping[str, str]
    apart: tuple[tuple[Experiment, ...], ...] = ()

    @property
    def frequencies(self) -> Array:
        """(N//2 + 1,) Hz."""
        return np.asarray(np.fft.rfftfreq(len(self.levels[0][0].u), self.dt), dtype=np.float64)

    @cached_property
    def lines(self) -> NDArray[np.int64]:
        """Excited lines, the mean not among them."""
        power = sum(np.abs(np.fft.rfft(e.u, axis=0)) ** 2 for level in self.levels for e in level)
        total = np.asarray(power).sum(axis=1)
        total[0] = 0.0
        # The line at half the sampling rate has no phase.
        last = len(self.levels[0][0].u) // 2 + len(self.levels[0][0].u) % 2
        return np.flatnonzero(total[:last] > _EXCITED * total.max())

    def identification(self, level: int) -> tuple[Experiment, ...]:
        """What a level has to be fitted to."""
        return tuple(e for e in self.levels[level] if not e.held_out)

    def held_out(self, level: int) -> tuple[Experiment, ...]:
        """What a level has for confirmation."""
        return tuple(e for e in self.levels[level] if e.held_out)


def study_of(campaign: Campaign) -> Study:
    """The experiments of a campaign.

    Raises:
        InputRefused: a recording is not periodic or has no output, recordings differ in rate, period, inputs, outputs
            or units, one is partly held out, or those at some amplitude cannot tell the inputs apart.
    """
    grouped = experiments_of(campaign)
    for r in campaign.recordings:
        _check_output(r)
    first = next(iter(grouped.values()))
    _check_alike(grouped, first)
    noticed = contaminated(campaign.recordings, {r: excitation_of(r.drive, r.dt) for r in campaign.recordings})
    experiments, left_out = [], {}
    for name, views in grouped.items():
        found = experiment_of(name, views)
        reasons = [f.text for r in views for f in noticed[r.name]]
        if reasons and not found.held_out:
            left_out[name] = reasons[0]
        else:
            experiments.append(found)
    levels = _levels(experiments)
    study = Study(
        dt=first[0].dt,
        inputs=("input", *first[0].further),
        outputs=tuple(r.measures or "output" for r in first),
        units=(first[0].units.input, first[0].units.output),
        levels=tuple(level for level in levels if not all(e.held_out for e in level)),
        left_out=left_out,
        apart=tuple(level for level in levels if all(e.held_out for e in level)),
    )
    if not study.levels:
        raise InputRefused(
            f"{campaign.folder}: no experiment is left for identification ({len(left_out)} left out as contaminated): "
            f"record some again, or say `use: identification` for others in recordings.yaml"
        )
    for level in range(len(study.levels)):
        _check_level(study, level, campaign.folder)
    return study


def _check_periodic(r: Recording) -> None:
    if r.start.state != "periodic":
        raise InputRefused(
            f"{r.source}: recording {r.name!r} is not said to be in a periodic steady state: modes are read off "
            f"periodic recordings; record one and say `start: periodic` in recordings.yaml"
        )
    if not r.cycle:
        raise InputRefused(
            f"{r.source}: recording {r.name!r} shows no period of a whole number of samples: record two whole periods "
            f"or more, or describe arrays of single ones by `axes` in recordings.yaml"
        )
    if r.interpolation == "linear":
        raise InputRefused(
            f"{r.source}: recording {r.name!r} has an input that is linear between samples, which modes are not read "
            f"off: say `input: band_limited` or `input: zero_order`, whichever is nearer"
        )


def _check_output(r: Recording) -> None:
    if not np.isfinite(r.y).all():
        raise InputRefused(f"{r.source}: recording {r.name!r} has no output: leave it out")


def _check_level(study: Study, level: int, folder: str) -> None:
    """That a level has enough experiments that differ enough to tell all inputs apart."""
    found, inputs = study.identification(level), len(study.inputs)
    where = f"{folder}: at {study.levels[level][0].amplitude:.3g} {study.units[0]} (all inputs together)"
    if len(found) < inputs:
        raise InputRefused(
            f"{where} there are {len(found)} experiments for identification, {len(study.held_out(level))} held out, to "
            f"tell {inputs} inputs apart: use or record at least {inputs} realisations at each amplitude"
        )
    u = np.stack([np.fft.rfft(e.u, axis=0)[study.lines] for e in found], axis=2)
    size = np.sqrt((np.abs(u) ** 2).mean(axis=(0, 2)))
    for name, driven in zip(study.inputs, size, strict=True):
        if driven < _DRIVEN * size.max():
            raise InputRefused(f"{where} input {name!r} is not driven: leave it out, or drive it like the others")
    strengths = np.linalg.svd(u / size[:, None], compute_uv=False)
    if np.median(strengths[:, -1] / strengths[:, 0]) < _APART:
        raise InputRefused(
            f"{where} the inputs {', '.join(study.inputs)} move together in all experiments: give each another "
            f"realisation, or other signs, in every experiment"
        )


def _check_alike(grouped: Mapping[str, Sequence[Recording]], first: Sequence[Recording]) -> None:
    def kind(views: Sequence[Recording]) -> tuple[object, ...]:
        r = views[0]
        units = {v.units for v in views}
        return r.cycle, float(f"{r.dt:.9g}"), tuple(r.further), tuple(v.measures for v in views), *units

    for name, views in grouped.items():
        if kind(views) != kind(first):
            raise InputRefused(
                f"{views[0].source}: experiment {name!r} differs from {first[0].source} in sampling rate, period, "
                f"inputs, outputs or units: put what differs into a folder of its own"
            )
        if len({v.units for v in views}) > 1:
            raise InputRefused(
                f"{views[0].source}: outputs in {', '.join(sorted({v.units.output for v in views}))} cannot be added "
                f"up to one error: put those of each unit into a folder of its own"
            )


def experiments_of(campaign: Campaign) -> dict[str, list[Recording]]:
    """The recordings of a campaign by their experiment: one for each output.

    Raises:
        InputRefused: one is not periodic.
    """
    grouped: dict[str, list[Recording]] = {}
    for r in campaign.recordings:
        _check_periodic(r)
        grouped.setdefault(r.name.removesuffix(f".{r.measures}") if r.measures else r.name, []).append(r)
    return grouped


def experiment_of(name: str, views: Sequence[Recording]) -> Experiment:
    """The mean period of recordings that share their inputs.

    Raises:
        InputRefused: they are partly held out.
    """
    size = views[0].cycle
    y = np.stack([_periods(r.y, size) for r in views], axis=-1)
    u = np.stack([_periods(x, size).mean(axis=0) for x in (views[0].u, *views[0].further.values())], axis=-1)
    uses = {part.use for r in views for part in r.parts} - {"nuisance"}
    if len(uses) != 1:
        raise InputRefused(
            f"{views[0].source}: experiment {name!r} is partly for identification and partly held out: say `use: "
            f"identification` or `use: confirmation` for each recording in recordings.yaml"
        )
    return Experiment(
        name=name,
        held_out=uses == {"confirmation"},
        u=np.ascontiguousarray(u),
        y=y.mean(axis=0) - y.mean(axis=(0, 1)),
        spread=np.sqrt(y.var(axis=0).mean(axis=0)),
        zero_order=views[0].interpolation == "zero_order",
    )


def _periods(x: Array, size: int) -> Array:
    """(periods, size)."""
    return x[: x.size // size * size].reshape(-1, size)


def _levels(experiments: Sequence[Experiment]) -> tuple[tuple[Experiment, ...], ...]:
    levels: list[list[Experiment]] = []
    for e in sorted(experiments, key=lambda e: e.amplitude):
        if levels and e.amplitude <= _ALIKE * levels[-1][0].amplitude:
            levels[-1].append(e)
        else:
            levels.append([e])
    return tuple(tuple(sorted(level, key=lambda e: (e.held_out, e.name))) for level in levels)
