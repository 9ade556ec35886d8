"""The next recording: the one of a menu on which rival models differ most, whatever their parameters.

The menu stays within the input, the displacement and nearly the rate that are in use already.

Models ``a`` and ``b`` compete for one tie or one element. On a new recording, if ``a`` is right, ``b`` fails to explain

    min over δ of  ‖Δ − S δ‖² + ‖J δ‖²,    Δ = (y_a − y_b)/σ without the zero of the recording

to first order: ``S`` are the sensitivities of ``b`` on the new recording and ``J`` those on the recordings at hand, so
that its parameters, base and effect, move only within what these allow. This is the expected difference of the sums of
squares of a joint refit; its root is the separation in noise units. The smaller of both directions counts.

Where an element has no rival, a recording is asked for the element's own numbers ``e``: with the covariances
``P = (JᵀJ)⁻¹`` and ``P' = (JᵀJ + SᵀS)⁻¹`` without and with it, their standard errors shrink by

    (det P_ee / det P'_ee)^{1/2m}

in the geometric mean over the ``m`` numbers, all other coordinates free. A repetition of all recordings at hand gives
√2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.diagnose.linearised import LinearisedFit, tie
from phnn.errors import PhnnError
from phnn.identification.fit import Fit, variables_from
from phnn.identification.problem import Problem, Variables, without_nuisances
from phnn.identification.staged import stated_only
from phnn.network.roles import linearised_at_rest
from phnn.parameters import quantity
from phnn.recordings.recording import Part, Recording, Start, Units
from phnn.setup import Own, Setup
from phnn.trajectory import is_displacement, simulate

Array = NDArray[np.float64]

_SUBSTEPS = 2
# Coordinates do not move further than this, a factor of twenty: beyond, a sensitivity at one place says nothing.
_FAR = 3.0
# Separations below this are nothing.
_NOTHING = 1e-3
# By this factor a repetition of all recordings at hand shrinks standard errors.
_REPEATED = math.sqrt(2.0)
# A recording is not asked for more often.
_OFTEN = 100
# Most samples of a recording, samples of the fastest period, and how much higher than in use the rate may be.
_SAMPLES, _PER_PERIOD, _FASTER = 20_000, 20, 2.0
# Share of the resonance and periods of a sine near it; lines and periods of a multisine; amplitudes of a sweep and
# periods of each.
_BELOW_RESONANCE, _RING = 0.9, 200
_LINES, _REPEATS = 10, 4
_STEPS, _PERIODS_A_STEP = 5, 4


@dataclass(frozen=True)
class Stretch:
    """``u(t) = level + Σ A sin(2π f (t − start) + φ)`` for ``start ≤ t < end`` [s]; lines are ``(A, f [Hz], φ)``."""

    start: float
    end: float
    level: float = 0.0
    lines: tuple[tuple[float, float, float], ...] = ()

    def input(self, t: Array) -> Array:
        """Return the input at some times within the stretch, shape as ``t``."""
        waves = [a * np.sin(2.0 * np.pi * f * (t - self.start) + phase) for a, f, phase in self.lines]
        return np.asarray(self.level + sum(waves, np.zeros_like(t)))


@dataclass(frozen=True)
class Experiment:
    """A recording to be made, from rest at zero input.

    Attributes:
        kind: its name on the menu.
        settings: of the generator beside duration and rate.
        stretches: of the input, one after the other from 0 s on.
        rate: samples per second.
        units: of input and output.
        interpolation: of the input between the samples.
    """

    kind: str
    settings: str
    stretches: tuple[Stretch, ...]
    rate: float
    units: Units
    interpolation: str = "cubic"

    @property
    def duration(self) -> float:
        """Its length [s]."""
        return self.stretches[-1].end

    @property
    def words(self) -> str:
        """Return all that is needed to make it."""
        return f"{self.kind}: {self.settings}; {quantity(self.duration, 's')} in all, {self.rate:.6g} samples/s"

    @property
    def t(self) -> Array:
        """Return (N,) sampling times [s]."""
        return np.arange(math.floor(self.duration * self.rate + 1e-6), dtype=np.float64) / self.rate

    @property
    def u(self) -> Array:
        """Return (N,) input."""
        t = self.t
        u = np.empty_like(t)
        for stretch in self.stretches:
            # A sample on a border belongs to the later stretch, whatever the rounding of its time.
            rows = t >= stretch.start - 1e-9 / self.rate
            u[rows] = stretch.input(t[rows])
        return u

    def recording(self, noise: float) -> Recording:
        """Return it as a recording without an output; white noise of standard deviation ``noise`` is expected."""
        t, name = self.t, f"menu: {self.kind}"
        part = Part(name, 0, t.size, "identification")
        return Recording(
            name, t, self.u, np.zeros_like(t), Start("rest", 0.0), self.interpolation, (part,), noise, "assumed",
            np.array([1.0]), None, {}, "", self.units,
        )  # fmt: skip


def menu(linearised: LinearisedFit) -> tuple[Experiment, ...]:
    """Return recordings that a laboratory can make: they differ in time, frequency, amplitude and offset."""
    scales, recording = linearised.scales, linearised.plan.recordings[0]
    rate, volts = partial(_rate, linearised), partial(quantity, unit=recording.units.input)
    v, slow, middle = map(_three, (scales.voltage, 0.2 * scales.slowest, math.sqrt(scales.slowest * scales.fastest)))
    each = _PERIODS_A_STEP / middle
    rising = [_three(scales.voltage * (i + 1) / _STEPS) for i in range(_STEPS)]
    settings = f"{_PERIODS_A_STEP} periods of {middle:g} Hz at each of the amplitudes {', '.join(map(volts, rising))}"
    sweep = tuple(Stretch(i * each, (i + 1) * each, lines=((a, middle, 0.0),)) for i, a in enumerate(rising))
    smooth = (
        _sine(linearised, "slow sine", v, slow, 3, rate(3.0 / slow)),
        _near_resonance(linearised),
        Experiment("amplitude sweep", settings, sweep, rate(_STEPS * each), recording.units),
        _multisine(linearised),
    )
    if is_displacement(linearised.fit.setup, recording):
        # No rig moves at once from one place to another.
        return smooth
    long = _three(max(3.0 * scales.duration, 5.0))
    held = min(rate(1.6 * long), 2_000.0)
    up, off, end = (round(x * held) / held for x in (0.1 * long, 1.1 * long, 1.6 * long))
    before, on, after = (quantity(x, "s") for x in (up, off - up, end - off))
    settings = f"0 for {before}, a step to {volts(v)} held for {on}, back to 0 for {after}"
    hold = (Stretch(0.0, up), Stretch(up, off, v), Stretch(off, end))
    # About half the largest input, even and odd effects no longer look alike.
    level, amplitude = _three(0.6 * scales.voltage), _three(0.4 * scales.voltage)
    offset = _sine(linearised, "offset sine", amplitude, middle, 10, rate(10.0 / middle), level)
    return (Experiment("hold", settings, hold, held, recording.units, "zero_order"), *smooth, offset)


def resonance(setup: Setup) -> float | None:
    """Return the lowest resonance [Hz] of the network about rest, ``Im λ/2π`` linearised; None without one."""
    if setup.network.senses:
        # What is held by an imposed motion does not ring.
        return None
    values = np.linalg.eigvals(linearised_at_rest(setup.network)[0])
    ringing = values.imag[values.imag > 1e-6 * np.abs(values).max()]
    return float(ringing.min()) / (2.0 * math.pi) if ringing.size else None


def _rate(linearised: LinearisedFit, duration: float, faster: float = 1.0) -> float:
    """Return the highest rate in use, times ``faster``, or what leaves few enough samples; rounded to 1, 2, 5, 10, …"""
    used = max(1.0 / r.dt for r in linearised.plan.recordings)
    most = min(faster * used, _SAMPLES / duration) * (1.0 + 1e-9)
    decade = 10.0 ** math.floor(math.log10(most))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most)


def _three(value: float) -> float:
    """Return three digits, so that the words are exact."""
    return float(f"{value:.3g}")


def _sine(
    linearised: LinearisedFit, kind: str, amplitude: float, frequency: float, periods: int, rate: float,
    level: float = 0.0,
) -> Experiment:  # fmt: skip
    """Return whole periods of a sine about a level."""
    units = linearised.plan.recordings[0].units
    about = f" about {quantity(level, units.input)}, with a step to it" if level else ""
    settings = f"{periods} periods of {frequency:.6g} Hz at {quantity(amplitude, units.input)} amplitude{about}"
    stretch = Stretch(0.0, periods / frequency, level, ((amplitude, frequency, 0.0),))
    return Experiment(kind, settings, (stretch,), rate, units)


def _near_resonance(linearised: LinearisedFit) -> Experiment:
    """Return a sine just below the resonance, or as near to it as the rate allows; no displacement beyond that in
    use."""
    scales, setup = linearised.scales, linearised.fit.setup
    at = resonance(setup)
    wanted = _BELOW_RESONANCE * at if at is not None else 2.0 * scales.fastest
    rate = _rate(linearised, _RING / wanted)
    if rate < _PER_PERIOD * wanted:
        rate = _rate(linearised, _RING / wanted, _FASTER)
    # Whole samples a period: noise is then seen in differences of periods, with nothing to interpolate.
    frequency = rate / max(round(rate / wanted), _PER_PERIOD)
    kind = "near-resonance sine" if at is not None and frequency >= 0.5 * at else "fast sine"
    full = _sine(linearised, kind, _three(scales.voltage), frequency, _RING, rate)
    peak = float(np.abs(simulate(setup, full.recording(scales.noise), _SUBSTEPS).y).max())
    amplitude = _three(scales.voltage * min(1.0, scales.sensed / peak))
    return _sine(linearised, kind, amplitude, frequency, _RING, rate)


def _multisine(linearised: LinearisedFit) -> Experiment:
    """Return harmonics of one frequency, spaced evenly on a logarithmic scale, with Schroeder's phases (1970)."""
    scales = linearised.scales
    first = _three(max(0.5 * scales.slowest, 0.02 * scales.fastest))
    rate = _rate(linearised, _REPEATS / first)
    last = min(2.0 * scales.fastest, rate / _PER_PERIOD, 0.5 * (resonance(linearised.fit.setup) or np.inf))
    orders = np.unique(np.round(np.geomspace(1.0, max(last / first, 1.0), _LINES)))
    phases = -np.pi * np.arange(orders.size) * np.arange(1, orders.size + 1) / orders.size
    unit = Stretch(0.0, 1.0 / first, lines=tuple((1.0, f, p) for f, p in zip(first * orders, phases, strict=True)))
    fine = np.linspace(0.0, unit.end, 20_001)
    wave = unit.input(fine)
    # It begins where the wave crosses zero, so that there is no step from rest.
    begin = fine[int(np.argmin(np.abs(wave)))]
    amplitude = _three(0.995 * scales.voltage / float(np.abs(wave).max()))
    turned = np.angle(np.exp(1j * (phases + 2.0 * np.pi * first * orders * begin)))
    lines = tuple((amplitude, f, p) for f, p in zip((first * orders).tolist(), turned.tolist(), strict=True))
    units, stretch = linearised.plan.recordings[0].units, Stretch(0.0, _REPEATS / first, lines=lines)
    settings = (
        f"{_REPEATS} periods of {quantity(unit.end, 's')} with lines of {quantity(amplitude, units.input)} each at "
        f"{', '.join(f'{f:g}' for _, f, _ in lines)} Hz, phases {', '.join(f'{p:.2f}' for _, _, p in lines)} rad"
    )
    return Experiment("multisine", settings, (stretch,), rate, units)


@dataclass(frozen=True, eq=False)
class Rival:
    """A model with what the recordings at hand know of its parameters.

    Attributes:
        name: canonical name of what it has beyond the others.
        fit: around which it is linear.
        variables: everything that the recordings leave open, also what they do not identify: its K coordinates.
        known: (M, K) rows ``J`` with ``‖J δ‖²`` the rise of their sum of squares when its coordinates move by ``δ``.
        coordinates: which of the K belong to the element in question.
    """

    name: str
    fit: Fit
    variables: Variables
    known: Array
    coordinates: tuple[int, ...]


@dataclass(frozen=True)
class Question:
    """Models of which a recording shall tell the right one.

    Attributes:
        models: the first is the present model; a question with one model asks how large its element's numbers are.
        element: canonical name of the element without a name; empty for a class of effects.
    """

    models: tuple[Rival, ...]
    element: str = ""


def refitted_rival(name: str, fitted: Fit, parameters: tuple[str, ...] = ()) -> Rival:
    """Return a fit as a rival; what no statement holds may move, but no coordinate beyond `_FAR`.

    Args:
        name: of the element; parameters: of it.
        fitted: the fit with the element in its place.
    """
    held = [n for n in fitted.held if n not in stated_only(fitted.held)]
    variables = variables_from(fitted.setup, fitted.plan, (*fitted.variables.names, *held), fitted)
    # (N, K) derivatives of the weighted residual.
    slopes = fitted.jacobian
    if held:
        slopes = Problem(fitted.setup, fitted.plan.coarse(), variables).jacobian(variables.start(fitted.setup))
    known = np.concatenate([np.linalg.qr(slopes, mode="r"), np.eye(slopes.shape[1]) / _FAR])
    return Rival(name, fitted, variables, known, tuple(i for i, n in enumerate(variables.names) if n in parameters))


@dataclass(frozen=True)
class NextExperiment:
    """A recording to make.

    Attributes:
        experiment: what to record.
        aim: ``separate`` or ``measure``.
        groups: models that it tells from another one, by question, by the name of what each has beyond the others; all
            where it tells none apart, and none where it measures.
        why: a sentence with the figures.
        separation: the smallest between models that it tells apart, in noise units over the whole recording; where it
            measures, the factor by which the standard errors of an element's numbers shrink.
        needed: the separation from which two models are told apart; where it measures, the factor that a repetition of
            all recordings at hand would give.
        menu: the smallest separation between any two, or that factor, by recording of the menu.
    """

    experiment: Experiment
    aim: str
    groups: tuple[tuple[str, ...], ...]
    why: str
    separation: float
    needed: float
    menu: Mapping[str, float]

    @property
    def separates(self) -> tuple[str, ...]:
        """Return the names in all groups."""
        return tuple(dict.fromkeys(n for group in self.groups for n in group))


def propose(questions: Sequence[Question], linearised: LinearisedFit) -> NextExperiment | None:
    """Return the experiment of the menu that tells most pairs of rivals apart; of several, the clearest. Without rivals
    it is the one on which the standard errors of the first element's numbers shrink most.

    None where nothing is asked, or no experiment moves the rivals apart or shrinks an error.

    Args:
        questions: pairs are made within each of them.
        linearised: of the base model, for the menu and the noise.
    """
    several = [q for q in questions if len(q.models) > 1]
    asked = several or questions[:1]
    if not asked:
        return None
    needed = math.sqrt(max(tie(q.models[0].fit) for q in asked)) if several else _REPEATED
    able = []
    for experiment in menu(linearised):
        with suppress(PhnnError):
            able.append((experiment, foreseen(asked, experiment.recording(linearised.scales.noise))))
    if not able:
        return None

    def merit(figures: Sequence[Array]) -> tuple[int, float]:
        each = np.concatenate(figures)
        sufficient = each[each >= needed]
        return sufficient.size, float(sufficient.min() if sufficient.size else each.min())

    experiment, figures = max(able, key=lambda item: merit(item[1]))
    pair_count, separation = merit(figures)
    if np.concatenate(figures).max() < _NOTHING + (0.0 if several else 1.0):
        return None
    groups = [_told_apart(q, apart, needed if pair_count else 0.0) for q, apart in zip(several, figures, strict=False)]
    return NextExperiment(
        experiment=experiment,
        aim="separate" if several else "measure",
        groups=tuple(g for g in groups if g),
        why=_why_it_separates(several, figures, needed) if several else _why_it_measures(asked[0], separation),
        separation=separation,
        needed=needed,
        menu={e.kind: float(np.concatenate(f).min()) for e, f in able},
    )


def foreseen(questions: Sequence[Question], recording: Recording) -> list[Array]:
    """Return the separations of all pairs of models of each question on a recording that does not exist yet; of one
    model alone, the factor by which the standard errors of its own numbers shrink when it joins those at hand.

    Raises:
        SolverFailed: a model cannot be simulated there.
    """
    # Outputs (N,) and their derivatives (N, K) of each fit, which may stand in several questions.
    made: dict[int, tuple[Array, Array]] = {}
    for model in {id(m.fit): m for q in questions for m in q.models}.values():
        trajectory = simulate(model.fit.setup, recording, _SUBSTEPS)
        raw = output_derivatives(trajectory, model.variables.names)
        made[id(model.fit)] = trajectory.y, model.variables.columns(model.fit.setup, recording, raw)
    mask, figures = recording.mask("identification"), []
    for models in (q.models for q in questions):
        each = [m.fit.setup.own for m in models]
        nuisances = Own(tuple(dict.fromkeys(f for o in each for f in o.lines)), max(o.drift_terms for o in each))
        outputs, moved = zip(
            *([without_nuisances(x, mask, recording, nuisances) / recording.noise for x in made[id(m.fit)]]
              for m in models), strict=True,
        )  # fmt: skip
        if len(models) == 1:
            figures.append(np.array([shrinkage(moved[0], models[0].known, models[0].coordinates)]))
            continue
        pairs = combinations(range(len(models)), 2)
        apart = [min(left(outputs[a] - outputs[b], moved[i], models[i].known) for i in (a, b)) for a, b in pairs]
        figures.append(np.array(apart))
    return figures


def left(difference: Array, moved: Array, known: Array) -> float:
    """Return ``√min ‖Δ − S δ‖² + ‖J δ‖²`` over ``δ``.

    Args:
        difference: (N,) ``Δ``; moved: (N, K) ``S``; known: (M, K) ``J``.
    """
    design = np.concatenate([moved, known])
    wanted = np.concatenate([difference, np.zeros(known.shape[0])])
    basis = np.linalg.qr(design)[0]
    return float(np.linalg.norm(wanted - basis @ (basis.T @ wanted)))


def shrinkage(moved: Array, known: Array, coordinates: Sequence[int]) -> float:
    """Return ``(det P_ee / det P'_ee)^{1/2m}``, as the module says.

    Args:
        moved: (N, K) ``S``; known: (M, K) ``J``; coordinates: which ``m`` of the K are ``e``.
    """
    sizes = []
    for rows in (known, np.concatenate([known, moved])):
        root = np.linalg.inv(np.linalg.qr(rows, mode="r"))[list(coordinates)]
        sizes.append(np.linalg.slogdet(root @ root.T)[1])
    return math.exp((sizes[0] - sizes[1]) / (2.0 * len(coordinates)))


def _told_apart(question: Question, apart: Array, least: float) -> tuple[str, ...]:
    """Return the names of the models that are told from another one by a separation of at least ``least``."""
    pairs = zip(combinations(question.models, 2), apart, strict=True)
    names = {m.name for pair, s in pairs if s >= least for m in pair}
    return tuple(dict.fromkeys(m.name for m in question.models if m.name in names))


def _why_it_separates(questions: Sequence[Question], apart: Sequence[Array], needed: float) -> str:
    """Return which models compete, how far the recording moves them apart, and which it does not tell apart."""
    competing, pairs = "", []
    for question, separations in zip(questions, apart, strict=True):
        names = [_words(m.name) for m in question.models]
        pairs += [(f"{a} and {b}", s) for (a, b), s in zip(combinations(names, 2), separations, strict=True)]
        if question.element:
            others = " or ".join(filter(None, [", ".join(names[1:-1]), names[-1]]))
            competing += (
                f"The element {_words(question.element)} has no proven name: in its place {others} explains these "
                "recordings nearly as well. "
            )
    separated = [pair for pair in pairs if pair[1] >= needed]
    pair, s = min(separated or pairs, key=lambda item: item[1])
    least = " least: by" if len(separated) > 1 else " by"
    again = math.ceil((needed / s) ** 2) if s > 0.0 and not separated else 0
    often = f": make it {again} times" if 0 < again < _OFTEN else ""
    rest = [name for name, value in pairs if separated and value < needed]
    but = f" It does not tell apart {'; '.join(rest)}." if rest else ""
    return (
        f"{competing}With their parameters refitted as far as the recordings at hand allow, the models of {pair} "
        f"differ there{least} {_two(s)} × noise over the whole recording; {_two(needed)} are needed to tell two "
        f"models apart{often}.{but}"
    )


def _why_it_measures(question: Question, times: float) -> str:
    """Return that an element has no rival, and by which factor the standard errors of its numbers shrink."""
    small = " only" if times < _REPEATED else ""
    return (
        f"Nothing else that was tried explains these recordings nearly as well as the element "
        f"{_words(question.element)}. No two models are left to be told apart, so this recording measures the element "
        f"itself: beside the recordings at hand it makes the standard errors of its numbers smaller by a factor "
        f"of{small} {_two(times)} (geometric mean). To repeat all recordings at hand would give {_two(_REPEATED)}."
    )


def _words(name: str) -> str:
    return name.replace("_", " ")


def _two(value: float) -> str:
    """Return two digits, and no exponent."""
    return f"{float(f'{value:.2g}'):.10g}"
