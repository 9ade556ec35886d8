"""Periodic experiments: one mean period of every input and every output, grouped by how strongly they were driven.

The best linear approximation of a nonlinear system under random-phase multisines is ``G = Y Uᴴ (U Uᴴ)⁻¹`` over its
realisations (Pintelon & Schoukens 2012, System Identification, ch. 4). Its poles are found by the eigensystem
realisation of its impulse response (Juang & Pappa 1985), for which python-control serves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phnn.check import contaminated
from phnn.errors import InputRefused
from phnn.recordings.recording import Campaign, Recording, Units

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


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
        """Return the effective value of all inputs together, the root of their summed squares."""
        return float(np.sqrt((self.u - self.u.mean(axis=0)).var(axis=0).sum()))


@dataclass(frozen=True, eq=False)
class Study:
    """All experiments.

    Attributes:
        dt: s; inputs, outputs: their names; units: of inputs and outputs.
        levels: experiments by amplitude, in ascending order; each has some for identification.
        apart: amplitudes that are held out as a whole, in ascending order; never used to fit or to choose.
        left_out: experiments of identification that were not used, with the reason.
    """

    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Units
    levels: tuple[tuple[Experiment, ...], ...]
    left_out: Mapping[str, str]
    apart: tuple[tuple[Experiment, ...], ...] = ()

    @property
    def frequencies(self) -> Array:
        """Return (N//2 + 1,) Hz."""
        return np.asarray(np.fft.rfftfreq(len(self.levels[0][0].u), self.dt), dtype=np.float64)

    @cached_property
    def lines(self) -> NDArray[np.int64]:
        """Return the excited lines, the mean not among them."""
        power = sum(np.abs(np.fft.rfft(e.u, axis=0)) ** 2 for level in self.levels for e in level)
        total = np.asarray(power).sum(axis=1)
        total[0] = 0.0
        # The line at half the sampling rate has no phase.
        return np.flatnonzero(total[: (len(self.levels[0][0].u) + 1) // 2] > _EXCITED * total.max())

    def identification(self, level: int) -> tuple[Experiment, ...]:
        """Return what a level has to be fitted to."""
        return tuple(e for e in self.levels[level] if not e.held_out)

    def held_out(self, level: int) -> tuple[Experiment, ...]:
        """Return what a level has for confirmation."""
        return tuple(e for e in self.levels[level] if e.held_out)


def study_of(campaign: Campaign) -> Study:
    """Return the experiments of a campaign.

    Raises:
        InputRefused: a recording is not periodic or has no output, recordings differ in rate, period, inputs, outputs
            or units, one is partly held out, or those at some amplitude cannot tell the inputs apart.
    """
    grouped = experiments_of(campaign)
    for r in campaign.recordings:
        if not np.isfinite(r.y).all():
            raise InputRefused(f"{r.source}: recording {r.name!r} has no output: leave it out")
    first = next(iter(grouped.values()))
    _check_alike(grouped, first)
    noticed = contaminated(campaign.recordings)
    experiments, left_out = [], {}
    for name, views in grouped.items():
        experiment = experiment_of(name, views)
        reasons = [f.text for r in views for f in noticed[r.name]]
        if reasons and not experiment.held_out:
            left_out[name] = reasons[0]
        else:
            experiments.append(experiment)
    levels = _levels(experiments)
    study = Study(
        dt=first[0].dt,
        inputs=("input", *first[0].further),
        outputs=tuple(r.measures or "output" for r in first),
        units=first[0].units,
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


def _check_level(study: Study, level: int, folder: str) -> None:
    """That a level has enough experiments that differ enough to tell all inputs apart."""
    runs, inputs = study.identification(level), len(study.inputs)
    where = f"{folder}: at {study.levels[level][0].amplitude:.3g} {study.units[0]} (all inputs together)"
    if len(runs) < inputs:
        raise InputRefused(
            f"{where} there are {len(runs)} experiments for identification, {len(study.held_out(level))} held out, to "
            f"tell {inputs} inputs apart: use or record at least {inputs} realisations at each amplitude"
        )
    u = np.stack([np.fft.rfft(e.u, axis=0)[study.lines] for e in runs], axis=2)
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
    """Return the recordings of a campaign by their experiment: one for each output.

    Raises:
        InputRefused: one is not periodic.
    """
    grouped: dict[str, list[Recording]] = {}
    for r in campaign.recordings:
        _check_periodic(r)
        grouped.setdefault(r.name.removesuffix(f".{r.measures}") if r.measures else r.name, []).append(r)
    return grouped


def experiment_of(name: str, views: Sequence[Recording]) -> Experiment:
    """Return the mean period of recordings that share their inputs.

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
    """Return (periods, size)."""
    return x[: x.size // size * size].reshape(-1, size)


def _levels(experiments: Sequence[Experiment]) -> tuple[tuple[Experiment, ...], ...]:
    levels: list[list[Experiment]] = []
    for e in sorted(experiments, key=lambda e: e.amplitude):
        if levels and e.amplitude <= _ALIKE * levels[-1][0].amplitude:
            levels[-1].append(e)
        else:
            levels.append([e])
    return tuple(tuple(sorted(level, key=lambda e: (e.held_out, e.name))) for level in levels)


# Blocks of the Hankel matrix; orders that are tried; damping ratio above which a pole is no mode.
_BLOCKS, _ORDERS, _DAMPED = 150, range(2, 61, 2), 0.2
# An order is good enough when it leaves this much more than the best one; a mode matters from this share on.
_ENOUGH, _MATTERS = 1.3, 2e-3
# Delays that are tried, in sampling intervals.
_DELAYS = np.arange(0.0, 3.01, 0.1)


def response(u: Complex, y: Complex) -> Complex:
    """Return (N//2 + 1, O, P) the best linear approximation from spectra (…, P, R), (…, O, R); zero at the mean."""
    conjugate = u.conj().transpose(0, 2, 1)
    square = u @ conjugate
    size = np.trace(square, axis1=1, axis2=2).real[:, None, None] + 1e-300
    # Lines that are not excited would be divided by nothing.
    ridge = 1e-12 * size.max() * np.eye(u.shape[1])
    g = np.asarray((y @ conjugate) @ np.linalg.inv(square + ridge))
    g[0] = 0.0
    return g


def first_modes(study: Study, experiments: Sequence[Experiment]) -> tuple[Array, Array, Array, float]:
    """Return the modes of some experiments on the excited lines, the fewest that describe them well: ω (M,) rad/s,
    ζ (M,), directions of the ports b (M, P) of length 1, and the delay in samples.

    Raises:
        InputRefused: there is no oscillation within the excited lines.
    """
    import control  # slow to load: whoever predicts with a model that is there needs none of it

    lines, dt = study.lines, study.dt
    u, y = (np.stack([np.fft.rfft(getattr(e, n), axis=0) for e in experiments], axis=-1) for n in ("u", "y"))
    g = response(u, y)
    scale = np.abs(g[lines]).max(axis=(0, 2))[:, None]
    impulses = _impulses(g / scale, lines, len(experiments[0].u))
    s = np.asarray(2j * np.pi * study.frequencies[lines], dtype=np.complex128)
    u, y = u[lines].mT, y[lines].mT / scale[:, 0]
    best: list[tuple[float, Array, Complex, float]] = []
    blocks = min(_BLOCKS, impulses.shape[2] // 4)
    for order in _ORDERS:
        if order > blocks:
            break
        system, _ = control.eigensys_realization(impulses, order, m=blocks, n=blocks, dt=dt)
        poles = _oscillations(np.asarray(system.poles(), dtype=np.complex128), dt, s)
        if not poles.size:
            continue
        delays = _DELAYS if not best else np.array([min(best, key=lambda fit: fit[0])[3]])
        fits = [(*_residues(poles, float(delay) * dt, s, u, y), poles, float(delay)) for delay in delays]
        best.append(min(fits, key=lambda fit: fit[0]))
    if not best:
        raise InputRefused(
            f"no oscillation between {study.frequencies[lines[0]]:.4g} and {study.frequencies[lines[-1]]:.4g} Hz: "
            f"there are no modes to be found in these recordings"
        )
    least = min(cost for cost, *_ in best)
    _, residues, poles, delay = next(fit for fit in best if fit[0] <= _ENOUGH * least)
    size = np.linalg.norm(residues, axis=(1, 2)) / (-poles.real / np.abs(poles))
    kept = size > _MATTERS * size.max()
    b = np.array([np.linalg.svd(r)[2][0] for r in residues[kept]])
    omega = np.asarray(np.abs(poles[kept]), dtype=np.float64)
    return omega, -poles.real[kept] / omega, b, delay


def _impulses(g: Complex, lines: NDArray[np.int64], size: int) -> Array:
    """Return (O, P, N) impulse responses in the excited band, whose upper edge is rounded off against ringing."""
    edge, top = max(3, lines.size // 40), lines[-1]
    weight = np.zeros(len(g))
    weight[: top + 1] = 1.0
    weight[top - edge + 1 : top + 1] = 0.5 * (1.0 + np.cos(np.pi * np.arange(1, edge + 1) / (edge + 1)))
    filled = g.copy()
    filled[: lines[0]] = g[lines[0]].real
    return np.fft.irfft(filled * weight[:, None, None], size, axis=0).transpose(1, 2, 0)


def _oscillations(poles: Complex, dt: float, s: Complex) -> Complex:
    """Return the poles of modes in the band, in continuous time, in ascending order."""
    continuous = np.log(poles[np.abs(poles) > 0.0]) / dt
    damping = -continuous.real / np.maximum(np.abs(continuous), 1e-300)
    inside = (continuous.imag > s[0].imag) & (continuous.imag < s[-1].imag)
    modes = continuous[inside & (damping > 0.0) & (damping < _DAMPED)]
    return modes[np.argsort(modes.imag)]


def _residues(poles: Complex, delay: float, s: Complex, u: Complex, y: Complex) -> tuple[float, Array]:
    """Return the cost and the real residues (M, O, P) of poles behind a delay, beside a direct term, from spectra u
    (F, R, P) and y (F, R, O) of R experiments: lines on which inputs are hard to tell apart count less."""
    h = np.abs(poles) ** 2 / ((s[:, None] - poles) * (s[:, None] - poles.conj()))
    basis = np.concatenate([h, np.ones((s.size, 1))], axis=1) * np.exp(-s * delay)[:, None]
    columns = (basis[:, None, :, None] * u[:, :, None, :]).reshape(s.size * u.shape[1], -1)
    target = y.reshape(columns.shape[0], -1)
    normal, right = (columns.conj().T @ columns).real, (columns.conj().T @ target).real
    solution = np.linalg.lstsq(normal, right, rcond=1e-13)[0]
    cost = float((np.abs(columns @ solution - target) ** 2).sum())
    return cost, np.asarray(solution.reshape(poles.size + 1, u.shape[2], -1)[:-1].transpose(0, 2, 1), dtype=np.float64)
