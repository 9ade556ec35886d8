"""A diagnosis as values, as a report shows it; `phnn.report.document` reads them from ``diagnosis.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from phnn.errors import InputRefused
from phnn.report.formatting import finite

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


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _texts(value: Any) -> tuple[str, ...]:
    if isinstance(value, str):
        return (value,)
    return tuple(str(item) for item in value if item is not None) if isinstance(value, Sequence) else ()


def _numbers(value: Any) -> tuple[float, ...]:
    items = value if isinstance(value, Sequence) and not isinstance(value, str) else ()
    return tuple(number for item in items if (number := finite(item)) is not None)


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _score(value: Any, floorless: bool) -> Score:
    entry = _mapping(value)
    over_noise = None if floorless else finite(entry.get("residual_over_noise"))
    return Score(finite(entry.get("fit_percent")), finite(entry.get("rmse")), over_noise)


def _fits(value: Any, noise: Sequence[NoiseRow]) -> tuple[FitRow, ...]:
    entry = _mapping(value)
    before, after = _mapping(entry.get("before")), _mapping(entry.get("after"))
    held_out = set(_texts(entry.get("held_out")))
    names = list(dict.fromkeys([*before, *after]))
    bare = {n: _without_floor(noise, n) for n in names}
    rows = [FitRow(n, n in held_out, _score(before.get(n), bare[n]), _score(after.get(n), bare[n])) for n in names]
    return tuple(sorted(rows, key=lambda row: not row.held_out))


def _parameter(name: str, value: Any) -> MissingParameter:
    if not isinstance(value, Mapping):
        return MissingParameter(name, finite(value), None, "")
    unit = _text(value.get("unit"))
    ends = [finite(end) for end in value.get("interval_95") or ()]
    known = (ends[0], ends[1]) if len(ends) == 2 and ends[0] is not None and ends[1] is not None else None
    shown = "" if unit == "1" else unit
    return MissingParameter(name, finite(value.get("value")), finite(value.get("std")), shown, known)


def _missing(value: Any) -> Missing:
    entry = _mapping(value)
    passive = entry.get("passive")
    return Missing(
        effect=_text(entry.get("effect")) or "unknown",
        location=_text(entry.get("location")),
        equivalent_to=_texts(entry.get("equivalent_to")),
        p_value=finite(entry.get("p_value")),
        statement=_text(entry.get("statement")),
        equation=_text(entry.get("equation")),
        passive=passive if isinstance(passive, bool) else None,
        parameters=tuple(_parameter(name, item) for name, item in _mapping(entry.get("parameters")).items()),
        status=_text(entry.get("status")),
        nearest=_text(entry.get("nearest")),
        held_out=_held_out(entry.get("held_out")),
        probability=finite(entry.get("probability")),
    )


def _held_out(value: Any) -> HeldOut | None:
    if not isinstance(value, Mapping):
        return None
    return HeldOut(finite(value.get("before")), finite(value.get("after")), finite(value.get("p_value")))


def _noise(value: Any) -> tuple[NoiseRow, ...]:
    return tuple(
        NoiseRow(
            str(n), finite(e.get("rms")), _text(e.get("source")), _text(e.get("colour")), _texts(e.get("notes")),
            e.get("found") is not False,
        )
        for n, item in _mapping(value).items()
        if (e := _mapping(item))
    )  # fmt: skip


def _without_floor(noise: Sequence[NoiseRow], name: str) -> bool:
    """Whether no noise floor was found for a recording or a part of one, such as ``loops[confirmation]``."""
    return any(not row.found and (name == row.name or name.startswith(f"{row.name}[")) for row in noise)


def _descending(items: Mapping[str, float | None]) -> tuple[tuple[str, float | None], ...]:
    return tuple(sorted(items.items(), key=lambda item: (item[1] is None, -(item[1] or 0.0))))


def _location(value: Any, noise: Sequence[NoiseRow]) -> Location | None:
    if not isinstance(value, Mapping):
        return None
    recordings = {
        str(name): None if _without_floor(noise, str(name)) else finite(_mapping(item).get("residual_over_noise"))
        for name, item in _mapping(value.get("recordings")).items()
    }
    scores = {str(name): finite(item) for name, item in _mapping(value.get("scores")).items()}
    return Location(
        name=_text(value.get("name")),
        detail=_text(value.get("detail")),
        tied=_texts(value.get("tied")),
        scores=_descending(scores),
        recordings=_descending(recordings),
        frequencies_hz=_numbers(value.get("frequencies_Hz")),
        times_s=_numbers(value.get("times_s")),
    )


def _remainder(value: Any, floorless: bool) -> Remainder | None:
    if not isinstance(value, Mapping):
        return None
    return Remainder(
        _text(value.get("verdict")),
        None if floorless else finite(value.get("residual_over_noise")),
        finite(value.get("p_value")),
        _text(value.get("location")),
        _immaterial(value.get("immaterial")),
    )


def _immaterial(value: Any) -> Immaterial | None:
    if not isinstance(value, Mapping):
        return None
    return Immaterial(_text(value.get("candidate")), finite(value.get("rms")), finite(value.get("share_of_noise")))


def _next_experiment(value: Any) -> NextExperiment | None:
    if not isinstance(value, Mapping):
        return None
    groups = value.get("groups")
    return NextExperiment(
        recording=_text(value.get("recording")),
        why=_text(value.get("why")),
        needed=finite(value.get("needed")),
        menu=_descending({str(n): finite(s) for n, s in _mapping(value.get("menu")).items()}),
        groups=tuple(map(_texts, groups)) if isinstance(groups, Sequence) else (),
        aim=_text(value.get("aim")) or "separate",
    )


def lost_parts(value: Any) -> tuple[Lost, ...]:
    """Parts that failed."""
    entries = [_mapping(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else []
    return tuple(
        Lost(
            _text(e.get("part")),
            _text(e.get("candidate")),
            f"{_text(e.get('error'))}: {_text(e.get('message'))}",
            int(finite(e.get("times")) or 1),
        )
        for e in entries
    )


def _ended(value: Any) -> Ending:
    entry = _mapping(value)
    why, budget = _text(entry.get("why")), finite(entry.get("budget"))
    lost, evaluations = lost_parts(entry.get("failed")), finite(entry.get("evaluations"))
    return Ending(why or "nothing left", budget, _texts(entry.get("not_tried")), lost, evaluations)


def read_document(document: Mapping[str, Any]) -> Document:
    """The document as values.

    An optional entry ``units: {input: V, output: m}`` names the units of the channels.

    Raises:
        InputRefused: the verdict is not one of the four.
    """
    verdict = document.get("verdict")
    if verdict not in VERDICTS:
        raise InputRefused(f"diagnosis.json: verdict is {verdict!r}: it must be one of {', '.join(VERDICTS)}")
    test, units = _mapping(document.get("test")), _mapping(document.get("units"))
    seed, missing, noise = document.get("seed"), document.get("missing"), _noise(document.get("noise"))
    return Document(
        verdict=str(verdict),
        statistic=finite(test.get("statistic")),
        p_value=finite(test.get("p_value")),
        candidate=_text(test.get("candidate")),
        missing=tuple(_missing(item) for item in missing) if isinstance(missing, Sequence) else (),
        remainder=_remainder(document.get("remainder"), any(not row.found for row in noise)),
        location=_location(document.get("location"), noise),
        noise_floor=tuple((str(n), finite(v)) for n, v in _mapping(document.get("noise_floor")).items()),
        numerical_error_sigma=finite(document.get("numerical_error_sigma")),
        fits=_fits(document.get("fit"), noise),
        next_experiment=_next_experiment(document.get("next_experiment")),
        versions=tuple((str(n), _text(v)) for n, v in _mapping(document.get("versions")).items()),
        seed=_text(seed),
        seconds=finite(document.get("seconds")),
        input_unit=_text(units.get("input")) or "V",
        output_unit=_text(units.get("output")) or "m",
        immaterial=_immaterial(test.get("immaterial")),
        noise=noise,
        ended=_ended(document.get("ended")),
        warnings=lost_parts(document.get("warnings")),
        probability=_descending({str(n): finite(p) for n, p in _mapping(document.get("probability")).items()}),
    )
