"""Everything of an identification that can be refused before it begins, and the hysteresis that an actuator needs.

Where the user leaves the hysteresis to the recordings, models with one and two hysterons, with the best of the other
forms, and with more hysterons are fitted to some of the identification recordings; the others choose (`LeftOut`).

The gain of one element on recordings that took no part in finding it is compared sample by sample: with the residuals
``e₀`` and ``e₁`` without and with it, in units of the noise, ``d = e₀² − e₁²`` is summed over blocks of time, and a
one-sided t-test asks whether its mean is positive (Ibragimov & Müller 2010). Blocks are eight correlation lengths of
``e₁``, the larger one of ``1 + 2 Σ ρ_k`` over the lags before ``ρ`` first vanishes (slow noise, drift) and
``1 + 2 Σ ρ_k²`` over the lags up to N/64 (noise that rings; Bayley & Hammersley 1946).

The mean of each part is taken away before the test, as the error of the displacement zero is common to all blocks.
K fitted lines and drifts take ``K/N`` of the power of noise; the residual is scaled by ``√(N/(N − K))``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from phnn.errors import InputRefused, PhnnError, StructureViolated
from phnn.identification.evaluate import Evaluation, evaluate
from phnn.identification.fit import Fit
from phnn.identification.plan import Plan
from phnn.identification.problem import own_size
from phnn.identification.staged import (
    check_known,
    fit_identified,
    held_by_statement,
    identify_actuator,
    identify_form,
    stated_only,
)
from phnn.identification.starting_points import mechanical_points
from phnn.integrate.program import compile_network
from phnn.models.actuator import bouc_wen, hrc
from phnn.models.network_file import load_network, ready
from phnn.parameters import positive, signed
from phnn.recordings.manifest import READY
from phnn.recordings.partition import candidate_of, divide
from phnn.recordings.recording import Anchor, Campaign, Recording, is_actuator
from phnn.results import printable
from phnn.setup import NOTHING, Block, Own, Setup
from phnn.trajectory import check_names, simulate

Array = NDArray[np.float64]

# Correlation lengths in a block; fewest samples in one, for sums of squares to be nearly normal; into how many of the
# longest lags whose squared correlation counts a part is divided.
_LENGTHS, _FEWEST_SAMPLES, _LAGS = 8, 20, 64
# Change of the mean square, as a share of it, that is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Gain:
    """Attributes:
    before, after: residual over noise, root mean square over the scored parts, without and with the element.
    rms: root mean square of what the element explains there, ``√(before² − after²)`` in the output's unit; negative
        where the error rises.
    falls: one-sided p-value that the error falls; None where there are too few nearly independent blocks of time.
    """

    before: float
    after: float
    rms: float
    falls: float | None

    @property
    def takes(self) -> float:
        """Return the mean square [noise²] that the element takes; negative where the error rises."""
        return self.before**2 - self.after**2


def gain(
    before: Evaluation,
    after: Evaluation,
    recordings: Sequence[Recording],
    use: str,
    fewest_blocks: int,
    nuisances: tuple[Own, Own] = (NOTHING, NOTHING),
) -> Gain | None:
    """Compare two models on the parts of one use; every part counts as much as any other.

    Args:
        before, after: outputs without and with the element.
        use: of the parts, such as ``"confirmation"``.
        fewest_blocks: with fewer blocks there is no p-value.
        nuisances: what recordings add of their own to the outputs before and after.

    Returns:
        None where no part has that use.
    """
    squares: list[tuple[float, float, float]] = []
    sums: list[Array] = []
    for recording in recordings:
        for part in (p for p in recording.parts if p.use == use):
            rows = slice(part.first, part.last)
            e0, e1 = (
                (recording.y - m.outputs[recording.name])[rows] / recording.noise * _fair(recording, added)
                for m, added in zip((before, after), nuisances, strict=True)
            )
            squares.append((float(np.mean(e0**2)), float(np.mean(e1**2)), recording.noise))
            sums.append(_block_sums(e0 - e0.mean(), e1 - e1.mean()) / e0.size)
    if not squares:
        return None
    had, has, noise = (np.array(column) for column in zip(*squares, strict=True))
    changes = np.concatenate(sums)
    # A difference of rounding is none.
    changes = np.where(np.abs(changes) > _ROUNDING * (had + has).mean(), changes, 0.0)
    taken = float(np.mean((had - has) * noise**2))
    rms = math.copysign(math.sqrt(abs(taken)), taken)
    return Gain(math.sqrt(had.mean()), math.sqrt(has.mean()), rms, _p_value(changes, fewest_blocks))


def _fair(recording: Recording, nuisances: Own) -> float:
    """Return the factor on a residual beside what was fitted to its own samples, for noise to keep its size."""
    size = recording.t.size
    return math.sqrt(size / max(size - own_size(recording, nuisances), 1))


def _block_sums(before: Array, after: Array) -> Array:
    """Return (B,) sums of ``e₀² − e₁²`` over blocks of equal length, at least one."""
    length = max(_LENGTHS * correlation_length(after), _FEWEST_SAMPLES)
    count = max(1, int(before.size // length))
    return np.array([block.sum() for block in np.array_split(before**2 - after**2, count)])


def correlation_length(residual: Array) -> float:
    """Return the correlation length of a residual (N,) without mean, in samples; at least 1."""
    size = residual.size
    covariance = np.fft.irfft(np.abs(np.fft.rfft(residual, 2 * size)) ** 2)[:size]
    if not covariance[0] > 0.0:
        return 1.0
    rho = covariance[1:] / covariance[0]
    positive = rho[: int(np.argmax(np.append(rho, -1.0) <= 0.0))]
    return 1.0 + 2.0 * max(float(positive.sum()), float(np.sum(rho[: size // _LAGS] ** 2)))


def _p_value(values: Array, fewest: int) -> float | None:
    """Return the one-sided p-value of Student's test that the mean is positive."""
    if values.size < fewest:
        return None
    spread = float(np.std(values, ddof=1)) / math.sqrt(values.size)
    if spread == 0.0:
        return 0.5 if not values.mean() else 0.0 if values.mean() > 0.0 else 1.0
    return float(student.sf(float(values.mean()) / spread, values.size - 1))


# They are chosen like the held-out ones, inside the span of the rest; of a single recording it is the last third. A
# model is grown on the rest and held against them. The held-out recordings of the campaign are not touched.

# Inside this module and its evaluations, the left-out samples serve as "confirmation" samples do.
_CHOOSES = "confirmation"


@dataclass(frozen=True)
class LeftOut:
    """Identification recordings in two sets.

    Attributes:
        growth: models are fitted to these.
        chosen: all of them, the left-out samples marked.
        fewest_blocks: with fewer nearly independent blocks of time a gain has no p-value.
    """

    growth: Plan
    chosen: Plan
    fewest_blocks: int

    def scores(self, fitted: Fit) -> Evaluation:
        """Return a model's outputs on all of them."""
        return evaluate(fitted.setup, self.chosen, fitted.initial_states)

    def gain(self, before: tuple[Fit, Evaluation], after: tuple[Fit, Evaluation]) -> Gain:
        """Return what one model gains over another on the left-out samples."""
        nuisances = (before[0].setup.own, after[0].setup.own)
        gained = gain(before[1], after[1], self.chosen.recordings, _CHOOSES, self.fewest_blocks, nuisances)
        assert gained is not None
        return gained

    def over_noise(self, scores: Evaluation) -> float:
        """Return the residual over noise on the left-out samples."""
        return scores.over_noise(_CHOOSES)


def leave_out(plan: Plan, fewest_blocks: int) -> LeftOut:
    """Divide the identification recordings of a plan."""
    whole = [_identified(r) for r in plan.recordings]
    parts, _, _ = divide([candidate_of(r, r.excitation) for r in whole])
    divided = tuple(replace(r, parts=parts[r.name]) for r in whole)
    growth = tuple(r for r in divided if r.mask("identification").any())
    return LeftOut(replace(plan, recordings=growth), replace(plan, recordings=divided), fewest_blocks)


def _identified(recording: Recording) -> Recording:
    """Return a recording up to the end of its identification samples."""
    last = max(p.last for p in recording.parts if p.use == "identification")
    return recording if last == recording.t.size else recording.only(slice(0, last))


MOST_HYSTERONS = 4
# Where none is better than the next, and where the recordings cannot be divided.
DEFAULT_HYSTERONS = 2
# A further hysteron has to take this share of the excess over the noise, and with such a p-value: three parameters
# more, chosen among few models. Too few independent blocks of time for a p-value leave the default.
_SHARE, _LEVEL, _FEWEST_BLOCKS = 0.05, 0.00135, 8
# Chance does not take this share of the mean square: few large errors leave a test without power.
_LARGER = 0.5
# Residual over noise at which nothing further is tried.
_NOISE = 1.1


def hysteresis_needed(
    plan: Plan, known: Mapping[str, Anchor], starts: int, seed: int, progress: Callable[[str], None]
) -> tuple[int | str, Fit | None]:
    """Return the number of hysterons, at most `MOST_HYSTERONS`, or the form of hysteresis, beyond which recordings that
    were left out are predicted no better; and its fit to the others, None where none could be made.

    Args:
        plan: identification recordings.
        known: anchors; one of hysteron ``i`` asks for ``i`` hysterons at least, and for no other form.
        starts, seed: of every fit.
        progress: told what is tried.
    """
    stated = max((int(n.rpartition("_")[2]) for n in known if n.startswith(("C_", "rho_", "d_"))), default=0)
    held = leave_out(plan, _FEWEST_BLOCKS)
    best: tuple[Fit, Evaluation] | None = None
    chosen: int | str = max(stated, DEFAULT_HYSTERONS)
    counts = list(range(max(stated, 1), max(stated, MOST_HYSTERONS) + 1))
    untried: list[int | None] = [*counts[:DEFAULT_HYSTERONS], *([] if stated else [None]), *counts[DEFAULT_HYSTERONS:]]
    while untried:
        count = untried.pop(0)
        progress("which hysteresis: try " + ("other forms" if count is None else f"{count} hysterons"))
        tried: int | str
        try:
            if count is not None:
                tried, fitted = count, identify_actuator(held.growth, known, count, starts, seed)
            elif best is not None:
                tried, fitted = identify_form(held.growth, known, best[0])
            else:
                continue
        except PhnnError:
            continue
        further = fitted, held.scores(fitted)
        if best is None or _better(held, best, further, tried):
            best, chosen = further, tried
            if held.over_noise(further[1]) <= _NOISE:
                break
        elif count is not None:
            # One more is no better: no further ones are tried.
            untried = [n for n in untried if n is None]
    return chosen, None if best is None else best[0]


def _better(held: LeftOut, before: tuple[Fit, Evaluation], after: tuple[Fit, Evaluation], tried: int | str) -> bool:
    """Return whether what was left out is predicted clearly better with one more hysteron, or with another form.

    Recordings too short for a test decide nothing: there the default stays, if it predicts no worse.
    """
    gained = held.gain(before, after)
    taken, excess = gained.takes, max(gained.before**2 - 1.0, 0.0)
    if gained.falls is None:
        return isinstance(tried, int) and tried <= DEFAULT_HYSTERONS and taken >= 0.0
    return taken > _LARGER * gained.before**2 or (taken > _SHARE * excess and gained.falls < _LEVEL)


def identification_plan(campaign: Campaign, workers: int) -> Plan:
    """Return the recordings with identification samples.

    Raises:
        InputRefused: there are none.
    """
    chosen = tuple(r for r in campaign.recordings if r.mask("identification").any())
    if not chosen:
        raise InputRefused("no recording is for identification: set `use: identification` for some in recordings.yaml")
    return Plan(chosen, {}, workers, {n: a.std for n, a in campaign.known.items()})


@dataclass(frozen=True)
class Prepared:
    """What a fit begins with, once nothing in the manifest can be refused any more.

    Attributes:
        plan: the recordings with identification samples.
        model: by name; ``network`` where a file describes it.
        hysterons: of an actuator, or the form of another hysteresis; None where the recordings are to say.
        described: the network of that file.
    """

    plan: Plan
    model: str
    hysterons: int | str | None
    described: Setup | None = None


def prepare(campaign: Campaign, workers: int = 1) -> Prepared:
    """Return everything of an identification that can be refused before it begins.

    Raises:
        InputRefused: no recording to identify from, a network that cannot be built or simulated, ports or outputs that
            it does not have, anchors of parameters that the model does not have or that cannot have the value, several
            inputs for a model of one.
    """
    plan = identification_plan(campaign, workers)
    is_shared(campaign.recordings)
    if "network" in campaign.setup or is_ready(campaign):
        return Prepared(plan, "network", 0, _described(campaign))
    _refuse_for_an_actuator(campaign.recordings)
    model = str(campaign.setup.get("model", "piezo_actuator"))
    stated = campaign.setup.get("hysterons") if model in ("piezo_actuator", "hrc") else 0
    hysterons = None if stated in (None, "auto") else stated
    most = hysterons if isinstance(hysterons, int) else MOST_HYSTERONS if hysterons is None else 0
    parameters = bouc_wen().parameters if model == "bouc_wen" else hrc(most).parameters
    check_known(campaign.known, parameters)
    held_by_statement(campaign.known)
    mechanical_points(plan, {n: a.value for n, a in campaign.known.items()})
    return Prepared(plan, model, hysterons)


def is_ready(campaign: Campaign) -> bool:
    """Return whether the manifest names a ready model, whose values mean nothing yet."""
    return campaign.setup.get("model") in READY and not is_actuator(campaign.setup) and "network" not in campaign.setup


def _described(campaign: Campaign) -> Setup:
    """Return the network of the manifest, a file or a setup, with its anchors."""
    units, model = campaign.recordings[0].units[:2], campaign.setup.get("model", "")
    given = campaign.setup.get("network") or Setup(ready(model, units=units), name=model)
    path = Path(given.name if isinstance(given, Setup) else str(given))
    setup = given if isinstance(given, Setup) else Setup(load_network(path), name=printable(path.stem))
    check_names(setup.network, campaign.recordings)
    check_known(campaign.known, setup.parameters)
    try:
        setup = setup.with_values({n: a.value for n, a in campaign.known.items()})
        compile_network(setup.network)
    except StructureViolated as error:
        raise InputRefused(f"{printable(path.name)}: {error}") from error
    if not setup.network.ports:
        raise InputRefused(f"{printable(path.name)}: no source for the recorded input: add an element of type Se or Sf")
    return with_unknown_gain(setup, campaign.recordings)


def _refuse_for_an_actuator(recordings: Sequence[Recording]) -> None:
    """Refuse what the stages of an actuator's identification cannot begin from.

    Raises:
        InputRefused: an unknown gain, for the transducer's ratio is one already; several inputs or outputs; a sensor of
            the velocity.
    """
    unknown = [r.source for r in recordings if r.gain == "unknown"]
    if unknown:
        raise InputRefused(
            f"{unknown[0]}: gain: unknown: this model's transducer ratio takes up any factor of the input already, "
            f"leave `gain` out; electrical values then hold for the recorded numbers as volts"
        )
    single(recordings, "this model has one input and one output")
    if rates := [r for r in recordings if r.sensor.derivative]:
        kinds = ("a velocity (`sensor: {derivative: true}`)", "an acceleration (`sensor: {second_derivative: true}`)")
        raise InputRefused(
            f"{rates[0].source}: its sensor measures {kinds[rates[0].sensor.derivative - 1]}, but this model is "
            f"identified from displacements: describe the actuator as a network, setup: {{network: FILE.yaml}}"
        )


def single(recordings: Sequence[Recording], why: str, further: bool = False) -> None:
    """Refuse recordings of several outputs, and those of several inputs unless ``further`` ones are allowed.

    Raises:
        InputRefused: names one.
    """
    several = [r.source for r in recordings if r.measures or (r.further and not further)]
    if several:
        what, one = ("outputs (", "") if further else ("inputs or outputs (`ports`, ", "one input and ")
        raise InputRefused(
            f"{several[0]}: several {what}`outputs` in recordings.yaml), but {why}: describe the system as a network "
            f"and use phnn check, identify and predict, or give {one}one output"
        )


# Parameters for what recordings share and nobody knows: the zero of the output, the gain of the input.
ZERO, GAIN = "y_0", "gamma_u"


def own_zeros(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Return the recordings, each with a zero of its own."""
    return tuple(replace(r, offset="own") for r in recordings)


def is_shared(recordings: Sequence[Recording]) -> bool:
    """Return whether recordings share the zero of their output.

    Raises:
        InputRefused: some do and some do not.
    """
    shared = [r for r in recordings if r.offset == "shared"]
    if shared and len(shared) < len(recordings):
        other = next(r for r in recordings if r.offset != "shared")
        raise InputRefused(
            f"{other.source}: {other.name} has a zero of its own, {shared[0].name} shares one: say `offset: shared` "
            f"for all recordings in recordings.yaml, or for none"
        )
    return bool(shared)


def with_shared_zero(first: Fit, plan: Plan) -> Fit:
    """Return a fit with own zeros continued with one zero for all recordings of a plan.

    Args:
        first: with own zeros; plan: the same recordings, which share theirs.
    """

    def error(recording: Recording) -> float:
        y = simulate(first.setup, recording, first.plan.steps_of(recording), initial=first.initial(recording.name)).y
        counted = recording.mask("identification") & (recording.sensor.at_limit(recording.y) == 0)
        return float(np.mean((recording.y - y)[counted])) if counted.any() else 0.0

    start, reach = float(np.mean(plan.each(error))), max(float(np.abs(r.y).max()) for r in plan.recordings)
    unit = plan.recordings[0].units.output
    parameter = signed(ZERO, start, unit, 10.0 * reach, reach, "zero of the output, common to all recordings")
    setup = first.setup.with_block("sensor", Block("zero", (ZERO,)), (parameter,))
    plan, held = replace(plan, substeps=first.plan.substeps), stated_only(first.held)
    return fit_identified(setup, plan, held, origin=first, keep=(ZERO,))


def with_unknown_gain(setup: Setup, recordings: Sequence[Recording]) -> Setup:
    """Return the setup behind a drive of unknown gain, where the recordings say so.

    Raises:
        InputRefused: some have a known gain and some do not.
    """
    unknown = [r for r in recordings if r.gain == "unknown"]
    if not unknown:
        return setup
    if len(unknown) < len(recordings):
        other = next(r for r in recordings if r.gain == "known")
        raise InputRefused(
            f"{other.source}: the gain of {other.name} is known, that of {unknown[0].name} is not: give both the same "
            f"in recordings.yaml"
        )
    return setup.with_block("amplifier", Block("gain", (GAIN,)), (positive(GAIN, 1.0, "1", "gain of the input", 1e9),))
