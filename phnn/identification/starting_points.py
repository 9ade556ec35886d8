"""Starting points of an actuator's identification, from the recordings alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phnn.effects import Effect, Scales
from phnn.effects.hysteresis import BOUC_WEN_HYSTERESIS, DISTRIBUTED_HYSTERESIS
from phnn.errors import InputRefused, PhnnError
from phnn.identification.plan import Plan
from phnn.identification.problem import without_nuisances
from phnn.models.actuator import hrc
from phnn.network.elements import Network
from phnn.network.roles import linearised_at_rest
from phnn.recordings.checks import turned
from phnn.recordings.recording import Recording, dominant_frequency
from phnn.recordings.units import powers
from phnn.setup import Setup
from phnn.trajectory import simulate

Array = NDArray[np.float64]

DEFAULT_MASS = 1.0e-3
RESONANCES_HZ = (200.0, 800.0, 3000.0)
# Shortest and longest time of a network, in samples and as a share of a recording; the logarithm of the ratio of
# neighbouring ones; how many starting points are fitted.
_SHORTEST, _LONGEST, _STRIDE, _POINTS = 1.0, 0.5, 0.4, 3
# Share of the fastest rate of a network below which a rate is zero; lower bound over upper one where both say nothing.
_STILL, _WIDE = 1e-9, 1e-11
# Bins of the input over which an output is averaged; share of its way that leads down where it falls throughout.
_GAIN_BINS, _DOWNHILL = 12, 0.8
# Forms of hysteresis that may take the place of hysterons in a base model, and their strength over that of their grids.
FORMS: dict[str, Effect] = {
    "bouc_wen": BOUC_WEN_HYSTERESIS.forms[0],
    "duhem": BOUC_WEN_HYSTERESIS,
    "distributed": DISTRIBUTED_HYSTERESIS,
}
OF_GRID = 300.0
# Parameters of an actuator without hysterons.
MECHANICAL = ("m", "k", "b", "alpha")


def mechanical_points(plan: Plan, anchored: Mapping[str, float]) -> list[Setup]:
    """Return the mass–spring–dampers with the static gain of the recordings, one for each of several resonances.

    Hysterons start from these and not from a fit of them: a linear model takes hysteresis for a lag and loses its mass.
    """
    gain = static_gain(plan.recordings)
    mass = anchored.get("m", DEFAULT_MASS)
    points = []
    for resonance in RESONANCES_HZ:
        omega = 2.0 * np.pi * resonance
        k = anchored.get("k", anchored["alpha"] / gain if "alpha" in anchored else mass * omega**2)
        values = {"m": anchored.get("m", k / omega**2), "k": k, "b": 0.6 * k / omega, "alpha": gain * k} | {
            n: v for n, v in anchored.items() if n in MECHANICAL
        }
        points.append(linear_part(values))
    return points


def linear_part(values: Mapping[str, float]) -> Setup:
    """Return the mass–spring–damper of an actuator, without hysterons, from values of which others are passed over."""
    return Setup(hrc(0, {n: values[n] for n in MECHANICAL}), name="linear")


def static_gain(recordings: Sequence[Recording]) -> float:
    """Return the displacement per volt from the recording with the largest output.

    Raises:
        InputRefused: no input moves, or the output falls, all the way, where the input rises.
    """
    driven = [r for r in recordings if _input_range(r) > 0.0]
    if not driven:
        raise InputRefused(f"{recordings[0].source}: the input stands still in all recordings: nothing tells the gain")
    chosen = max(driven, key=lambda r: float(np.ptp(r.y)))
    span = _input_range(chosen)
    if not chosen.sensor.rectified and falls_throughout(chosen.u, chosen.y):
        alone = any(not falls_throughout(r.u, r.y) for r in driven)
        remedy = "give one of them `scale: -1` under columns in recordings.yaml"
        raise InputRefused(
            f"{chosen.source}: the output falls where the input rises: {turned(chosen.source) if alone else remedy}"
        )
    return float(np.ptp(chosen.y) / span)


def falls_throughout(u: Array, y: Array) -> bool:
    """Return whether an output (N,) falls with the input (N,) over its whole range, and not only on a part of it.

    Means of the output over bins of the input take both branches of a loop together. They fall if nearly all their way
    leads down: a loop that is widened or lags behind does so, a butterfly, which falls and rises again, does not.
    """
    if np.ptp(u) == 0.0:
        return False
    place = np.minimum(((u - u.min()) / np.ptp(u) * _GAIN_BINS).astype(int), _GAIN_BINS - 1)
    count = np.bincount(place, minlength=_GAIN_BINS)
    means = np.bincount(place, y, _GAIN_BINS)[count > 0] / count[count > 0]
    way = np.diff(means)
    return bool(way.sum() < -_DOWNHILL * np.abs(way).sum())


def _input_range(recording: Recording) -> float:
    """Return the range of the input, what was before the first sample included."""
    return float(np.ptp(np.append(recording.u, recording.input_before)))


def with_hysterons(
    linear: Setup,
    anchored: Mapping[str, float],
    shares: Sequence[float],
    rates: Sequence[float],
    widths: Sequence[float],
) -> Setup:
    """Return the hysterons added to a linear setup: ``α²/C_i = share·k``, relaxation rate ``ϱ_i⁻¹/C_i``, dead zone.

    Stiffness gives up what the hysterons take while they stick, so that the small-signal gain stays.
    """
    v = linear.values()
    total = v["k"]
    k = total / (1.0 + 0.5 * sum(shares))
    values = {"m": v["m"], "k": k, "b": v["b"], "alpha": v["alpha"]}
    for i, (share, rate, width) in enumerate(zip(shares, rates, widths, strict=True), start=1):
        c = v["alpha"] ** 2 / (share * k)
        values |= {f"C_{i}": c, f"rho_{i}": rate * c, f"d_{i}": width}
    network = hrc(len(shares), values | {n: a for n, a in anchored.items() if n in values})
    return Setup(network, name="phs")


def random_starts(
    linear: Setup, plan: Plan, hysterons: int, anchored: Mapping[str, float], count: int, seed: int
) -> list[Setup]:
    """Starting points spread over shares, relaxation rates and dead zones; the first is the typical actuator."""
    rng = np.random.default_rng(seed)
    drive = drive_amplitude(plan.recordings)
    omega = 2.0 * np.pi * middle_frequency(plan.recordings)
    points = []
    for number in range(count):
        spread = 0.0 if number == 0 else 1.0
        shares = 0.15 * np.exp(0.5 * spread * rng.standard_normal(hysterons))
        fast = np.where(np.arange(hysterons) % 2 == 0, 30.0, 1.0)
        rates = omega * fast * np.exp(1.2 * spread * rng.standard_normal(hysterons))
        widths = drive * 0.2 / (1.0 + 0.7 * np.arange(hysterons)) * np.exp(spread * rng.standard_normal(hysterons))
        points.append(with_hysterons(linear, anchored, shares.tolist(), rates.tolist(), widths.tolist()))
    return points


def with_form(linear: Setup, plan: Plan, form: str) -> list[Setup]:
    """Return the starting points of another hysteresis in the place of hysterons, named after it, one for each point of
    its effect's grid."""
    moved = 0.5 * max(float(np.ptp(r.y)) for r in plan.recordings)
    fastest = max((dominant_frequency(r) for r in plan.recordings), default=1.0)
    scales = Scales(
        drive_amplitude(plan.recordings), moved, moved * fastest, linear.values()["k"], linear.values()["alpha"],
        fastest, fastest, max(float(r.t[-1] - r.t[0]) for r in plan.recordings), 0.0,
    )  # fmt: skip
    points = [FORMS[form].scaled(p, OF_GRID) for p in FORMS[form].grid(scales)]
    return [replace(FORMS[form].add_to(linear, p), name=form) for p in points]


def scaled_points(setup: Setup, plan: Plan, anchored: Mapping[str, float]) -> list[Setup]:
    """Return starting points of a network, the best first: its values in units that suit the recordings.

    In other units of mass, length, time, current and temperature its values are other numbers of the same model: the
    input gives one condition on these units, the output another. The times of the network are tried from a few samples
    to half a recording, each with the gain that fits best. Fixed parameters keep their values.
    """
    time_scale = _time_scale(setup.network)
    span = max(float(r.t[-1] - r.t[0]) for r in plan.recordings) / time_scale
    step = min(r.dt for r in plan.recordings) / time_scale
    first = plan.recordings[0].units
    drive = drive_amplitude(plan.recordings)
    sizes = {first.output: 0.5 * max(float(np.ptp(r.y)) for r in plan.recordings)}
    sizes |= {first.input: drive} if drive else {}
    points = []
    held = {n: p.value for n, p in setup.network.parameters.items() if p.fixed} | dict(anchored)
    for time in np.geomspace(_SHORTEST * step, _LONGEST * span, max(int(np.log(span / step) / _STRIDE), 4)):
        point = _in_units(setup, sizes, float(time), held)
        try:
            gain, cost = _with_best_gain(point, plan)
            moved = _in_units(setup, sizes | {first.output: sizes[first.output] * gain}, float(time), held)
            points.append((cost, moved))
        except PhnnError:
            continue
    # Where nothing drives, a simulation from rest shows nothing: every time is as good a start as any.
    return [point for _, point in sorted(points, key=lambda pair: pair[0])[: _POINTS if drive else None]]


def _time_scale(network: Network) -> float:
    """Return the geometric mean [s] of a network's own times about rest; 1 where it has none that are finite."""
    if network.senses:
        # The rigid contact of an imposed motion has no time of its own.
        return 1.0
    matrix = linearised_at_rest(network)[0]
    rates = np.abs(np.linalg.eigvals(matrix)) if np.isfinite(matrix).all() else np.zeros(0)
    moving = rates[rates > _STILL * rates.max(initial=0.0)]
    return float(np.exp(-np.log(moving).mean())) if moving.size else 1.0


def _in_units(setup: Setup, sizes: Mapping[str, float], time: float, held: Mapping[str, float]) -> Setup:
    """Return the setup in units in which quantities have given sizes, ``time`` [s] is one, and anchored parameters are
    what they are held at."""
    known = {n: v for n, v in held.items() if n in setup.network.parameters}
    free = ((setup.network.parameters[n], v) for n, v in known.items() if not setup.network.parameters[n].fixed)
    conditions = [*sizes.items(), *((p.unit, v / p.value) for p, v in free if v * p.value > 0.0)]
    bases = sorted({b for unit, _ in conditions for b in powers(unit)} - {"second"})
    rows = np.array([[powers(unit).get(b, 0.0) for b in bases] for unit, _ in conditions])
    wanted = [np.log(size) - powers(unit).get("second", 0.0) * np.log(time) for unit, size in conditions]
    solved = np.linalg.lstsq(rows, np.array(wanted), rcond=None)[0]
    logs = dict(zip(bases, solved.tolist(), strict=True)) | {"second": float(np.log(time))}
    table = {}
    for name, p in setup.network.parameters.items():
        factor = float(np.exp(sum(power * logs.get(base, 0.0) for base, power in powers(p.unit).items())))
        # Bounds that say nothing move with the value; stated ones hold, and with them what a noticeable change is.
        stated = p.lower > _WIDE * p.upper if p.positive else np.isfinite([p.lower, p.upper]).any()
        stretch = 1.0 if stated else factor
        low, high, size = p.lower * stretch, p.upper * stretch, p.typical * stretch
        table[name] = replace(p, value=min(max(p.value * factor, low), high), lower=low, upper=high, typical=size)
    return replace(setup, network=replace(setup.network, parameters=table)).with_values(known)


def _with_best_gain(setup: Setup, plan: Plan) -> tuple[float, float]:
    """Return the factor on a setup's output that fits recordings best, and the weighted squares that it leaves."""
    size, along, whole = 0.0, 0.0, 0.0
    for recording in plan.recordings:
        mask = recording.mask("identification")
        y = simulate(setup, recording, 1).y
        model, seen = (without_nuisances(x, mask, recording) / recording.noise for x in (y, recording.y))
        size, along, whole = size + float(model @ model), along + float(model @ seen), whole + float(seen @ seen)
    if not size > 0.0:
        return 1.0, whole
    return (abs(along) / size or 1.0), whole - max(along, 0.0) ** 2 / size


def drive_amplitude(recordings: Sequence[Recording]) -> float:
    """Return half the largest range of the input."""
    return 0.5 * max(_input_range(r) for r in recordings)


def middle_frequency(recordings: Sequence[Recording]) -> float:
    """Return the geometric mean of the excited frequencies [Hz]."""
    frequencies = [f for r in recordings if (f := dominant_frequency(r)) > 0.0]
    return float(np.exp(np.mean(np.log(frequencies)))) if frequencies else 10.0
