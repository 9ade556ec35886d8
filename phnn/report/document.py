"""A diagnosis as values, as a report shows it; `read_document` reads them from ``diagnosis.json``.

A field is read from the entry of its name, as its type says. Where the entry is absent, null or of another kind, the
field has its default.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from phnn.errors import InputRefused
from phnn.report.formatting import Unit, display_unit, finite

T = TypeVar("T")
Number = float | None
Numbers = tuple[float, ...]
Texts = tuple[str, ...]
# Numbers by name, the largest first, those without a number last.
Ranked = tuple[tuple[str, float | None], ...]

VERDICTS = ("named", "equivalent", "unknown", "none")


@dataclass(frozen=True)
class Score:
    """How well one model follows one recording."""

    fit_percent: Number = None
    rmse: Number = None
    residual_over_noise: Number = None

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

    name: str = ""
    value: Number = None
    std: Number = None
    unit: str = ""
    interval_95: tuple[float, float] | None = None

    @property
    def shown_unit(self) -> str:
        """Its unit, empty for a plain number."""
        return "" if self.unit == "1" else self.unit


@dataclass(frozen=True)
class HeldOut:
    """Residual over noise on held-out recordings without and with an element; no p-value where they are too short."""

    before: Number = None
    after: Number = None
    p_value: Number = None


@dataclass(frozen=True)
class Missing:
    """One entry of ``missing``."""

    effect: str = "unknown"
    location: str = ""
    equivalent_to: Texts = ()
    p_value: Number = None
    statement: str = ""
    equation: str = ""
    passive: bool | None = None
    parameters: tuple[MissingParameter, ...] = ()
    status: str = ""
    nearest: str = ""
    held_out: HeldOut | None = None
    probability: Number = None


@dataclass(frozen=True)
class Location:
    """Where the mismatch is; of the recordings it has the residual over noise."""

    name: str = ""
    detail: str = ""
    tied: Texts = ()
    scores: Ranked = ()
    recordings: Ranked = ()
    frequencies_Hz: Numbers = ()
    times_s: Numbers = ()


@dataclass(frozen=True)
class Immaterial:
    """What is significant and too small to matter."""

    candidate: str = ""
    rms: Number = None
    share_of_noise: Number = None


@dataclass(frozen=True)
class Remainder:
    """Describe the remainder."""

    verdict: str = ""
    residual_over_noise: Number = None
    p_value: Number = None
    location: str = ""
    immaterial: Immaterial | None = None


@dataclass(frozen=True)
class NextExperiment:
    """The recording to make next.

    Attributes:
        needed: separation from which two models are told apart, in noise units.
        menu: smallest separation by recording of the menu; groups: what it separates, by tie or by element.
        aim: ``separate``, or ``measure``: separations are factors by which standard errors shrink.
    """

    recording: str = ""
    why: str = ""
    needed: Number = None
    menu: Ranked = ()
    groups: tuple[Texts, ...] = ()
    aim: str = "separate"


@dataclass(frozen=True)
class NoiseRow:
    """What the noise of one recording is; not found where it shows none: nothing can be held against its floor."""

    name: str = ""
    rms: Number = None
    source: str = ""
    colour: str = ""
    notes: Texts = ()
    found: bool = True


@dataclass(frozen=True)
class Lost:
    """A part that failed, and how often.

    Attributes:
        part: what was to be done; candidate: the effect that was refitted, if one was.
        error, message: type and text of the exception.
    """

    part: str = ""
    candidate: str = ""
    error: str = ""
    message: str = ""
    times: int = 1


@dataclass(frozen=True)
class Ending:
    """How the search ended.

    Attributes:
        why: ``nothing left``, ``evaluations``, ``seconds``, ``interrupted`` or ``failure``; budget: seconds that there
            were; evaluations: simulations of 300,000 steps that were used.
        not_tried: moves that were given up or not begun; failed: models that were no candidates.
    """

    why: str = "nothing left"
    budget: Number = None
    not_tried: Texts = ()
    failed: tuple[Lost, ...] = ()
    evaluations: Number = None


@dataclass(frozen=True)
class Document:
    """A diagnosis as a reader needs it; statistic, p-value, candidate and what is immaterial are those of its test."""

    verdict: str
    noise_floor: tuple[tuple[str, float | None], ...]
    fits: tuple[FitRow, ...]  # held-out recordings first
    versions: tuple[tuple[str, str], ...]
    input_unit: str
    output_unit: str
    statistic: Number = None
    p_value: Number = None
    candidate: str = ""
    immaterial: Immaterial | None = None
    missing: tuple[Missing, ...] = ()
    remainder: Remainder | None = None
    location: Location | None = None
    numerical_error_sigma: Number = None
    next_experiment: NextExperiment | None = None
    seed: str = ""
    seconds: Number = None
    noise: tuple[NoiseRow, ...] = ()
    ended: Ending = Ending()
    warnings: tuple[Lost, ...] = ()
    probability: Ranked = ()  # by effect, of ``none`` too

    @property
    def has_after(self) -> bool:
        """Some recording was scored with a final model."""
        return any(not row.after.empty for row in self.fits)

    def noise_of(self, name: str) -> NoiseRow | None:
        """What the noise of a recording is."""
        return next((row for row in self.noise if row.name == name), None)

    @property
    def rmse_unit(self) -> Unit:
        """One unit for all root mean squares: that of the largest, yet small ones keep digits."""
        values = [s.rmse for row in self.fits for s in (row.before, row.after) if s.rmse is not None]
        return display_unit(max(values, default=None), self.output_unit)

    def fit(self, name: str) -> FitRow | None:
        """The row of a recording."""
        return next((row for row in self.fits if row.name == name), None)

    def without_floor(self, name: str) -> bool:
        """Whether no noise floor was found for a recording or a part of one, such as ``loops[confirmation]``."""
        return any(not row.found and (name == row.name or name.startswith(f"{row.name}[")) for row in self.noise)


def read_document(document: Mapping[str, Any]) -> Document:
    """The document as values; nothing is compared with a noise floor that was not found.

    An optional entry ``units: {input: V, output: m}`` names the units of the channels.

    Raises:
        InputRefused: the verdict is not one of the four.
    """
    verdict = document.get("verdict")
    if verdict not in VERDICTS:
        raise InputRefused(f"diagnosis.json: verdict is {verdict!r}: it must be one of {', '.join(VERDICTS)}")
    units = _mapping(document.get("units"))
    found = _read(
        Document,
        {**document, **_mapping(document.get("test"))},
        noise_floor=tuple((str(n), finite(v)) for n, v in _mapping(document.get("noise_floor")).items()),
        fits=_fits(_mapping(document.get("fit"))),
        versions=tuple((str(n), str(v)) for n, v in _mapping(document.get("versions")).items()),
        input_unit=str(units.get("input") or "V"),
        output_unit=str(units.get("output") or "m"),
    )
    where, left = found.location, found.remainder
    if where is not None:
        recordings = {n: None if found.without_floor(n) else v for n, v in where.recordings}
        where = replace(where, recordings=_ranked(recordings))
    if left is not None and not all(row.found for row in found.noise):
        left = replace(left, residual_over_noise=None)
    fits = tuple(_without_ratios(row) if found.without_floor(row.name) else row for row in found.fits)
    return replace(found, location=where, remainder=left, fits=fits)


def lost_parts(value: Any) -> tuple[Lost, ...]:
    """Parts that failed."""
    return _value(tuple[Lost, ...], value) or ()


def _fits(entry: Mapping[str, Any]) -> tuple[FitRow, ...]:
    before, after = _mapping(entry.get("before")), _mapping(entry.get("after"))
    held_out = set(_texts(entry.get("held_out")))
    names = dict.fromkeys([*before, *after])
    rows = [FitRow(n, n in held_out, _read(Score, before.get(n)), _read(Score, after.get(n))) for n in names]
    return tuple(sorted(rows, key=lambda row: not row.held_out))


def _without_ratios(row: FitRow) -> FitRow:
    before, after = (replace(score, residual_over_noise=None) for score in (row.before, row.after))
    return replace(row, before=before, after=after)


def _read(kind: type[T], entry: Any, **further: Any) -> T:
    """Return an entry as a dataclass; ``further`` are fields that it does not have itself."""
    given, kinds = _mapping(entry), get_type_hints(kind)
    found = {name: _value(kinds[name], given.get(name)) for name in kinds if name not in further}
    return kind(**{name: value for name, value in found.items() if value is not None}, **further)


def _value(kind: Any, value: Any) -> Any:
    """Return an entry as a type says; None where it is of another kind. Entries of a mapping are rows with names."""
    if value is None or kind in _READERS:
        return None if value is None else _READERS[kind](value)
    if get_origin(kind) is not tuple:
        inner = next(iter(get_args(kind)), kind)
        return _read(inner, value) if isinstance(value, Mapping) else None
    inner = get_args(kind)[0]
    if isinstance(value, Mapping):
        return tuple(_read(inner, item, name=str(name)) for name, item in value.items())
    return tuple(_read(inner, item) for item in value) if _is_list(value) else None


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _texts(value: Any) -> Texts:
    if isinstance(value, str):
        return (value,)
    return tuple(str(item) for item in value if item is not None) if _is_list(value) else ()


def _numbers(value: Any) -> Numbers:
    return tuple(number for item in value if (number := finite(item)) is not None) if _is_list(value) else ()


def _interval(value: Any) -> tuple[float, float] | None:
    ends = _numbers(value)
    return (ends[0], ends[1]) if len(ends) == 2 else None


def _ranked(value: Any) -> Ranked:
    """Return numbers by name; an entry of a recording holds its residual over noise."""
    numbers = {
        str(n): finite(v.get("residual_over_noise") if isinstance(v, Mapping) else v)
        for n, v in _mapping(value).items()
    }
    return tuple(sorted(numbers.items(), key=lambda item: (item[1] is None, -(item[1] or 0.0))))


_READERS: dict[Any, Callable[[Any], Any]] = {
    str: str,
    int: lambda value: int(finite(value) or 1),
    bool: lambda value: value if isinstance(value, bool) else None,
    bool | None: lambda value: value if isinstance(value, bool) else None,
    Number: finite,
    Numbers: _numbers,
    Texts: _texts,
    tuple[Texts, ...]: lambda value: tuple(map(_texts, value)) if _is_list(value) else (),
    tuple[float, float] | None: _interval,
    Ranked: _ranked,
}
