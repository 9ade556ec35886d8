"""A diagnosis as values, as a report shows it; `phnn.report.reading` reads them from ``diagnosis.json``."""

from __future__ import annotations

from dataclasses import dataclass

VERDICTS = ("named", "equivalent", "unknown", "none")


@dataclass(frozen=True)
class Score:
    """How well one model follows one recording."""

    fit_percent: float | None = None
    rmse: float | None = None
    residual_over_noise: float | None = None

    @property
    def empty(self) -> bool:
        """Nothing is known."""
        return self.fit_percent is None and self.rmse is None and self.residual_over_noise is None


@dataclass(frozen=True)
class FitRow:
    """One recording before and after."""

    name: str
    held_out: bool
    before: Score
    after: Score


@dataclass(frozen=True)
class MissingParameter:
    """A parameter of what is missing."""

    name: str
    value: float | None
    std: float | None
    unit: str
    interval_95: tuple[float, float] | None = None


@dataclass(frozen=True)
class HeldOut:
    """Residual over noise on held-out recordings without and with an element; no p-value where they are too short."""

    before: float | None
    after: float | None
    p_value: float | None


@dataclass(frozen=True)
class Missing:
    """One entry of ``missing``."""

    effect: str
    location: str
    equivalent_to: tuple[str, ...]
    p_value: float | None
    statement: str
    equation: str
    passive: bool | None
    parameters: tuple[MissingParameter, ...]
    status: str = ""
    nearest: str = ""
    held_out: HeldOut | None = None
    probability: float | None = None


@dataclass(frozen=True)
class Location:
    """Where the mismatch is."""

    name: str
    detail: str
    tied: tuple[str, ...]
    scores: tuple[tuple[str, float | None], ...]  # best first, those without a score last
    recordings: tuple[tuple[str, float | None], ...]  # name, residual over noise; worst first
    frequencies_hz: tuple[float, ...]
    times_s: tuple[float, ...]


@dataclass(frozen=True)
class Immaterial:
    """What is significant and too small to matter."""

    candidate: str
    rms: float | None
    share_of_noise: float | None


@dataclass(frozen=True)
class Remainder:
    """Describe the remainder."""

    verdict: str
    residual_over_noise: float | None
    p_value: float | None
    location: str
    immaterial: Immaterial | None = None


@dataclass(frozen=True)
class NextExperiment:
    """The recording to make next."""

    recording: str
    why: str
    needed: float | None = None  # separation from which two models are told apart, in noise units
    menu: tuple[tuple[str, float | None], ...] = ()  # smallest separation by recording of the menu, largest first
    groups: tuple[tuple[str, ...], ...] = ()  # what it separates, by tie or by element
    aim: str = "separate"  # or "measure": separations are factors by which standard errors shrink


@dataclass(frozen=True)
class NoiseRow:
    """What the noise of one recording is."""

    name: str
    rms: float | None
    source: str
    colour: str
    notes: tuple[str, ...]
    found: bool = True  # False where the recording shows no noise: nothing can be held against its floor


@dataclass(frozen=True)
class Lost:
    """A part that failed, and how often.

    Attributes:
        part: what was to be done; candidate: the effect that was refitted, if one was; why: the error in words.
    """

    part: str
    candidate: str
    why: str
    times: int = 1


@dataclass(frozen=True)
class Ending:
    """How the search ended.

    Attributes:
        why: ``nothing left``, ``evaluations``, ``seconds``, ``interrupted`` or ``failure``; budget: seconds that there
            were; evaluations: of the whole plan of recordings that were used.
        not_tried: moves that were given up or not begun; failed: models that were no candidates.
    """

    why: str = "nothing left"
    budget: float | None = None
    not_tried: tuple[str, ...] = ()
    failed: tuple[Lost, ...] = ()
    evaluations: float | None = None


@dataclass(frozen=True)
class Document:
    """A diagnosis as a reader needs it."""

    verdict: str
    statistic: float | None
    p_value: float | None
    candidate: str
    missing: tuple[Missing, ...]
    remainder: Remainder | None
    location: Location | None
    noise_floor: tuple[tuple[str, float | None], ...]
    numerical_error_sigma: float | None
    fits: tuple[FitRow, ...]  # held-out recordings first
    next_experiment: NextExperiment | None
    versions: tuple[tuple[str, str], ...]
    seed: str
    seconds: float | None
    input_unit: str
    output_unit: str
    immaterial: Immaterial | None = None
    noise: tuple[NoiseRow, ...] = ()
    ended: Ending = Ending()
    warnings: tuple[Lost, ...] = ()
    probability: tuple[tuple[str, float | None], ...] = ()  # by effect, largest first; of ``none`` too

    @property
    def has_after(self) -> bool:
        """Some recording was scored with a final model."""
        return any(not row.after.empty for row in self.fits)

    def noise_of(self, name: str) -> NoiseRow | None:
        """What the noise of a recording is."""
        return next((row for row in self.noise if row.name == name), None)

    def fit(self, name: str) -> FitRow | None:
        """The row of a recording."""
        return next((row for row in self.fits if row.name == name), None)
