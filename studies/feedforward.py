"""Tracking study: the inverse of an identified model drives another actuator along a reference.

The actuator of the paper is identified from noisy recordings. Three commands follow from them: ``V = q/G`` with the
static gain ``G`` of the slowest recording, the inverse of a linear model, and the inverse of the identified model. They
drive other plants, through a converter that holds each sample:

* actuators whose parameters are drawn about the estimates with the covariance of the identification, and
* the paper's own parameters, in the differential equations of `studies.generator`, which LSODA solves.

The tracking error of the full inverse is compared with what noise and parameter errors must leave,

    σ_allowed² = σ_noise² + mean_t (J C Jᵀ),

where ``J`` are the derivatives of the output by the parameters along the command and ``C`` is their covariance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.identification.base import Progress, quiet
from phnn.identification.identified import Identified, identify
from phnn.identification.plan import Options
from phnn.inverse import Inverse
from phnn.models.actuator import hrc
from phnn.recordings import read
from phnn.recordings.recording import Campaign, Recording, unrecorded
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, RC, new_figure, png, quiet_grid
from phnn.report.formatting import markdown_table
from phnn.results import claim
from phnn.setup import Setup
from phnn.trajectory import simulate
from studies.generator.plans import Excitation, Piece
from studies.generator.world import TABLE
from studies.generator.world import simulate as simulate_equations
from studies.recordings import Conditions, write_recordings
from studies.results import write_results

Array = NDArray[np.float64]

# Sampling rate of the converter by the frequency of the reference [Hz].
RATES = {1.0: 2_000.0, 25.0: 10_000.0, 100.0: 20_000.0}
# The reference: amplitude [m], periods that are scored, and periods before them in which the motion begins.
AMPLITUDE, PERIODS, LEAD_IN = 110e-6, 2, 1
# The plants take smaller steps than the model.
_FINER = 8
COMMANDS = ("none", "linear", "full")
RESULTS = ("recordings", "feedforward.md", "feedforward.csv", "feedforward.png")
_COLOURS = dict(zip(COMMANDS, (BEFORE, CATEGORIES[1], AFTER), strict=True))
_TITLES = {"none": "V = q/G", "linear": "linear inverse", "full": "inverse of the identified model"}
# Starts of the nonlinear stage of the identification; more take longer.
_STARTS = 1
_FAST, _MICRO = 100.0, 1e-6


@dataclass(frozen=True)
class Commands:
    """Attributes:
    scored: the samples that count; voltages: (N,) commands [V] by name.
    full: the inverse of the identified model, with time and reference.
    """

    scored: slice
    voltages: Mapping[str, Array]
    full: Inverse


@dataclass(frozen=True)
class Row:
    """Tracking errors at one frequency, root mean square [m].

    Attributes:
        frequency: of the reference [Hz].
        drawn: by command, over all drawn plants, with sensor noise; ``clean``: of the full inverse without noise.
        equations: by command, of the paper's parameters in the independent equations, with sensor noise.
        nominal: of the full inverse where the plant is the model, without noise.
        parameters: what parameter errors must leave, from the covariance.
        allowed: that and the sensor noise together.
    """

    frequency: float
    drawn: Mapping[str, float]
    equations: Mapping[str, float]
    nominal: float
    parameters: float
    allowed: float

    @property
    def ratio(self) -> float:
        """Error of the full inverse over what noise and parameter errors allow."""
        return self.drawn["full"] / self.allowed


@dataclass(frozen=True)
class Models:
    """Attributes:
    full: identified actuator with hysterons; linear: identified without.
    static_gain: [m/V], slope of the slowest recording.
    """

    full: Identified
    linear: Identified
    static_gain: float


def identified(campaign: Campaign, options: Options) -> Models:
    """Identify what the commands are made from."""
    slowest = max(campaign.recordings, key=lambda r: r.dt * r.t.size if r.period else 0.0)
    u = slowest.u - slowest.u.mean()
    gain = float(u @ (slowest.y - slowest.y.mean()) / (u @ u))
    return Models(identify(hrc(2), campaign, options), identify(hrc(0), campaign, options), gain)


def commands(models: Models, frequency: float) -> Commands:
    """Return the three commands for a sine."""
    dt = 1.0 / RATES[frequency]
    t = dt * np.arange(round(PERIODS / frequency / dt) + 1)
    wave = AMPLITUDE * np.sin(2.0 * np.pi * frequency * t)
    full, linear = (
        m.model.inverse(t, wave, hold="zero_order", lead_in=LEAD_IN / frequency) for m in (models.full, models.linear)
    )
    voltages = {"none": full.reference / models.static_gain, "linear": linear.voltage, "full": full.voltage}
    return Commands(slice(full.t.size - t.size, full.t.size), voltages, full)


def row(models: Models, frequency: float, noise: float, draws: int, rng: np.random.Generator) -> Row:
    """Drive all plants at one frequency.

    Args:
        noise: standard deviation of the sensor's white noise [m].
        draws: how many plants are drawn.
    """
    given = commands(models, frequency)

    def noisy(y: Array) -> float:
        return error(given, y + noise * rng.standard_normal(given.full.t.size))

    errors: dict[str, list[float]] = {name: [] for name in (*COMMANDS, "clean")}
    for plant in drawn_plants(models.full, draws, rng):
        outputs = {name: output(plant, given, name) for name in COMMANDS}
        for name, y in outputs.items():
            errors[name].append(noisy(y) ** 2)
        errors["clean"].append(error(given, outputs["full"]) ** 2)
    equations = {name: noisy(by_equations(given, name)) for name in COMMANDS}
    spread, drawn = parameter_spread(models.full, given), {n: float(np.sqrt(np.mean(e))) for n, e in errors.items()}
    nominal = error(given, output(models.full.fit.setup, given, "full"))
    return Row(frequency, drawn, equations, nominal, spread, float(np.hypot(spread, noise)))


def error(found: Commands, y: Array) -> float:
    """Return the root mean square of a tracking error (N,) over the scored samples [m]."""
    return float(np.sqrt(np.mean((y - found.full.reference)[found.scored] ** 2)))


def output(plant: Setup, found: Commands, name: str) -> Array:
    """Return the displacement (N,) of a plant under a command that a converter holds [m]."""
    return np.asarray(simulate(plant, _held(found, name), _FINER).y)


def _held(found: Commands, name: str) -> Recording:
    t, before = found.full.t, found.full.voltage_before
    return unrecorded(name, t - t[0], found.voltages[name], "zero_order", before)


def by_equations(found: Commands, name: str) -> Array:
    """Return the same of the paper's actuator, by the equations and the solver of `studies.generator`."""
    dt = float(found.full.t[1] - found.full.t[0])
    pieces = tuple(Piece(n * dt, (n + 1) * dt, level=float(v)) for n, v in enumerate(found.voltages[name]))
    return simulate_equations(TABLE, Excitation(name, pieces, dt, found.full.t.size, held=True))


def drawn_plants(found: Identified, draws: int, rng: np.random.Generator) -> list[Setup]:
    """Draw actuators whose parameters scatter about the estimates as these scatter about the truth."""
    names, covariance = found.fit.joint_covariance()
    known = [found.fit.setup.parameters[n] for n in names]
    # In the coordinates of the estimation, in which a positive parameter stays positive.
    slopes = np.array([p.slope(p.value) for p in known])
    chosen = rng.multivariate_normal(np.zeros(slopes.size), covariance / np.outer(slopes, slopes), draws, method="eigh")
    moved = (
        [p.from_coordinate(p.to_coordinate(p.value) + float(z)) for p, z in zip(known, d, strict=True)] for d in chosen
    )
    return [found.fit.setup.with_values(dict(zip(names, values, strict=True))) for values in moved]


def parameter_spread(found: Identified, given: Commands) -> float:
    """Return what parameter errors leave of the tracking error to first order, root mean square [m]."""
    names, covariance = found.fit.joint_covariance()
    trajectory = simulate(found.fit.setup, _held(given, "full"), _FINER)
    jacobian = output_derivatives(trajectory, names)[given.scored]
    return float(np.sqrt(np.mean(np.einsum("nk,kl,nl->n", jacobian, covariance, jacobian))))


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return the rows in nanometres, for a page."""
    lines = []
    for r in rows:
        sizes = (*(r.drawn[n] for n in COMMANDS), r.drawn["clean"], r.nominal, r.parameters, r.allowed)
        nm = [f"{1e9 * v:.4g}" if v > 1e-8 else f"{1e9 * v:.3g}" for v in sizes]
        own = [f"{1e9 * r.equations[n]:.4g}" for n in COMMANDS]
        lines.append([f"{r.frequency:g} Hz", *nm, f"{r.ratio:.3f}", f"{r.drawn['none'] / r.drawn['full']:.0f}", *own])
    return lines


HEADS = (
    "reference", "none", "linear", "full", "full, no noise", "full, no noise, plant = model", "parameters", "allowed",
    "full / allowed", "none / full", "none, LSODA", "linear, LSODA", "full, LSODA",
)  # fmt: skip


def run_feedforward(out: Path, seed: int, draws: int, noise_um: float, progress: Progress = quiet) -> str:
    """Make recordings, identify, drive plants; writes `RESULTS` and returns the table as text.

    Args:
        seed: of the recordings, the plants and the noise; draws: plants at each frequency.
        noise_um: standard deviation of the sensor's noise [µm].

    Raises:
        InputRefused: a folder that holds files of others, or a noise that is not positive.
    """
    conditions, rng = Conditions(noise_um=noise_um, seed=seed), np.random.default_rng(seed)
    with claim(out, "feedforward", (), RESULTS) as place:
        progress("make recordings")
        folder = (place / "recordings").own_folder()
        write_recordings(folder, conditions)
        progress("identify with and without hysterons")
        models = identified(read(folder), Options(seed=seed, starts=_STARTS))
        rows = []
        for frequency in RATES:
            progress(f"drive plants at {frequency:g} Hz")
            rows.append(row(models, frequency, noise_um * 1e-6, draws, rng))
        cells = table(rows)
        text = "\n".join(["Tracking errors, root mean square [nm]", "", *markdown_table(HEADS, cells), ""])
        with rc_context(RC):
            (place / "feedforward.png").write(png(_drawn(models, commands(models, _FAST))))
        columns = pd.DataFrame(cells, columns=HEADS).to_csv(index=False)
        write_results(place, {"feedforward.csv": columns, "feedforward.md": text})
    return text


def _drawn(models: Models, found: Commands) -> Figure:
    """Commands and tracking errors at the highest frequency, the plant being the identified model."""
    figure = new_figure(9.6, 5.4)
    voltages, errors = figure.subplots(2, 1, sharex=True)
    for name in COMMANDS:
        missed = output(models.full.fit.setup, found, name) - found.full.reference
        voltages.step(found.full.t, found.voltages[name], color=_COLOURS[name], label=_TITLES[name], where="post", lw=1)
        errors.plot(found.full.t, missed / _MICRO, color=_COLOURS[name], linewidth=1.0)
    voltages.set_ylabel("command (V)")
    errors.set(xlabel="time (s)", ylabel="tracking error (µm)")
    figure.legend(*voltages.get_legend_handles_labels(), loc="outside upper right", ncols=len(COMMANDS))
    for axes in (voltages, errors):
        quiet_grid(axes)
    return figure
