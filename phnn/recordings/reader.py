"""From a folder, or from objects in memory, to a campaign."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from phnn.errors import InputRefused
from phnn.recordings import checks
from phnn.recordings.array_files import read_axes
from phnn.recordings.draft import Draft, drafts_of
from phnn.recordings.folder import READERS, Files
from phnn.recordings.manifest import Entry, Manifest, load_manifest, manifest_of
from phnn.recordings.memory import described, given
from phnn.recordings.partition import candidate_of, divide, whole_parts
from phnn.recordings.recording import IN_MEMORY, Campaign, Recording, is_actuator
from phnn.recordings.table import Table, beside
from phnn.results import printable
from phnn.signals.first_order import correlation_of, density
from phnn.signals.noise import SILENT, WHITE, NoiseFloor

# Fewest recordings whose spectra are pooled; how far their coefficients may lie from the median.
_FEWEST, _AGREES = 3, 0.12
# Factor within which deviations are of one size: a spectrum that ringing or a tail reaches gives many times the noise.
_ONE_SIZE = 1.5
# Level at which recordings of one kind are proven to differ in their noise.
DIFFERENT = 0.01


def pooled(floors: Sequence[NoiseFloor], kinds: Sequence[Hashable] | None = None) -> list[NoiseFloor]:
    """The floors of recordings, those seen in a part of the spectrum only brought to a common word.

    Args:
        kinds: of each recording; recordings of one kind are taken to share a sensor. All are of one kind if left out.
    """
    common = _of_one_word(floors)
    names = kinds if kinds is not None else [None] * len(common)
    groups: dict[Hashable, list[int]] = {}
    for i, (floor, name) in enumerate(zip(common, names, strict=True)):
        # Others keep what they were given: by repetition, by rest, or by agreement.
        if floor.interval is not None and floor.found and floor.coefficient is None:
            groups.setdefault(name, []).append(i)
    for group in groups.values():
        for i, floor in zip(group, _sharing([common[i] for i in group]), strict=True):
            common[i] = floor
    return common


def _sharing(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """The floors of one kind: one for those that are not proven different.

    One spectrum hardly tells coloured noise from what the signal leaves there. Where others of the kind do not agree on
    it the smaller floor stands, with an interval that holds both.
    """
    shared = alike([f.value for f in floors], [f.interval or (0.0, 0.0) for f in floors])
    if len(floors) == 1:
        return list(floors)
    if shared is None:
        return [f.smaller or f for f in floors]

    def of(k: int, floor: NoiseFloor) -> NoiseFloor:
        if k not in shared.members:
            return floor.smaller or floor
        source = f"{floor.source}, shared by {len(shared.members)} recordings that do not differ in it"
        return replace(floor, value=shared.value, source=source, interval=shared.interval, smaller=None)

    return [of(k, floor) for k, floor in enumerate(floors)]


class Shared(NamedTuple):
    """A deviation that some recordings share, its 95 % interval, and their numbers."""

    value: float
    interval: tuple[float, float]
    members: tuple[int, ...]


def alike(values: Sequence[float], intervals: Sequence[tuple[float, float]]) -> Shared | None:
    """The deviation that estimates share unless they are proven different; None where no two agree.

    Under equal deviations ``Q = Σ (ln σ_i − m)²/s_i²`` is χ² with one degree of freedom less than estimates, where
    ``s_i`` is a quarter of the width of ``ln`` of an interval and ``m`` the weighted mean. Where Q exceeds its quantile
    the estimate that lies farthest off leaves, and the others are asked again at the same level.
    """
    logs = np.log(np.maximum(values, 1e-300))
    bounds = np.log(np.maximum(np.asarray(intervals, dtype=float), 1e-300))
    errors = np.maximum((bounds[:, 1] - bounds[:, 0]) / (2.0 * norm.isf(0.025)), 1e-6)
    members = list(range(len(logs)))
    while len(members) > 1:
        weight = 1.0 / errors[members] ** 2
        mean = float(weight @ logs[members] / weight.sum())
        away = weight * (logs[members] - mean) ** 2
        if away.sum() <= chi2.isf(DIFFERENT, len(members) - 1):
            half = norm.isf(0.025) / np.sqrt(weight.sum())
            interval = float(np.exp(mean - half)), float(np.exp(mean + half))
            return Shared(float(np.exp(mean)), interval, tuple(members))
        del members[int(away.argmax())]
    return None


def _of_one_word(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """Floors seen in a part of the spectrum only, where several agree on white or on first-order noise.

    One spectrum hardly tells coloured noise from what the signal leaves there; several that agree do. Where at least
    half of them show first-order noise of about the same coefficient, all get their median; where few do, those get
    the median of the white ones. Only deviations of one size count. One that is larger, and not trusted (it has no
    interval), is what the signal leaves. A smaller one may come from the highest frequencies alone, taken as white:
    where the first-order noise of the others has about that deviation there, it is this noise. Any other keeps its own
    word.
    """
    every = [f for f in floors if f.coefficient is not None]
    size = float(np.median([f.value for f in every])) if every else 0.0
    partial = [f for f in every if size / _ONE_SIZE <= f.value <= size * _ONE_SIZE]
    coloured = [f for f in partial if f.coefficient]
    if len(partial) < _FEWEST or 2 * len(partial) < len(every):
        return list(floors)
    if 2 * len(coloured) >= len(partial):
        middle = float(np.median([f.coefficient or 0.0 for f in coloured]))
        agreeing = [f for f in coloured if abs((f.coefficient or 0.0) - middle) <= _AGREES]
        if 2 * len(agreeing) < len(partial):
            return list(floors)
        note, correlation = f"first-order noise of coefficient {middle:.2g}", correlation_of(middle)
        highest = float(np.sqrt(density(middle, np.array(-1.0))))
    else:
        agreeing = [f for f in partial if not f.coefficient]
        note, correlation, highest = "white noise", WHITE, 1.0
    value = float(np.median([f.value for f in agreeing]))
    source = f"the spectra of {len(agreeing)} recordings that agree on {note}"
    agreed = (*partial, *(f for f in every if _seen_at_the_highest(f, highest * value)))
    told = [f for f in every if f not in agreed and (f.value < size or f.interval is not None)]
    alone = {id(f) for f in (*told, *(agreeing if correlation is WHITE else ()))}
    common = NoiseFloor(value, source, correlation, 0.0)
    return [f if f.coefficient is None or id(f) in alone else common for f in floors]


def _seen_at_the_highest(floor: NoiseFloor, expected: float) -> bool:
    """Whether a floor from the highest frequencies, taken as white, has about the deviation that a noise has there."""
    as_white = not floor.coefficient and floor.interval is None and SILENT not in floor.source
    return as_white and expected / _ONE_SIZE <= floor.value <= expected * _ONE_SIZE


# A manifest of an object in memory: its second argument.
_SAID = "recordings.yaml"
# A moving mass of an actuator beyond this is doubted where no unit was stated [kg].
_HEAVY = 0.1


def read(
    folder: str | Path | Any,
    manifest: str | Path | Mapping[str, Any] | None = None,
    *,
    need_output: bool = True,
    allow_outside: bool = False,
) -> Campaign:
    """Read, check and understand a folder of recordings, or recordings in memory.

        campaign = phnn.read("recordings/")
        from_frames = phnn.read({"loops": frame, "sweep": other}, {"setup": {"model": "linear"}})

    Args:
        folder: holds one file per recording, and ``recordings.yaml`` where something is to be said about them. Or a
            pandas DataFrame, an xarray Dataset or DataArray, an ``Input_output_data`` of nonlinear_benchmarks or its
            tuple (train, test), a mapping from column names to arrays; a list of these, or a mapping from names.
        manifest: a ``recordings.yaml`` that lies elsewhere, or a mapping of its content.
        need_output: refuse recordings without an output. Otherwise (to predict) such recordings have ``y`` NaN
            and ``noise`` NaN, and no recording is set aside: every one is a confirmation part as a whole.
        allow_outside: files may lead out of the folder: by their paths, by links, by external parts of HDF5 files.

    Raises:
        InputRefused: with one message naming file, column, row, value, cause and remedy.
    """
    if not isinstance(folder, str | Path):
        return _from_memory(folder, manifest, need_output)
    home = Path(folder)
    checks.folder_exists(home)
    if isinstance(manifest, Mapping):
        said = manifest_of(manifest, "the manifest given", (home,), allow_outside)
    else:
        said = load_manifest(home, Path(manifest) if manifest is not None else None, allow_outside)
    checks.no_results(home)
    files = Files(home, said, allow_outside)
    entries, left = files.entries()
    tables = ((entry, _table(files, entry)) for entry in entries)
    return _campaign(tables, said, need_output, home, left)


def campaign_of(recorded: Campaign | str | Path | Any, *, need_output: bool = True) -> Campaign:
    """A campaign as it is; a folder, and what else `read` takes, is read."""
    return recorded if isinstance(recorded, Campaign) else read(recorded, need_output=need_output)


def _from_memory(data: Any, manifest: str | Path | Mapping[str, Any] | None, need_output: bool) -> Campaign:
    here = (Path(),)
    try:
        if isinstance(manifest, str | Path):
            said = load_manifest(here[0], Path(manifest), outside=True)
        else:
            said = manifest_of(manifest, "the manifest given", here, outside=True)
        tables, left = described(given(data, said), said)
        found = _campaign(tables, said, need_output, Path(IN_MEMORY), left)
    except InputRefused as error:
        if _SAID not in str(error):
            raise
        raise InputRefused(
            f"{error} (of recordings in memory the second argument of phnn.read says what recordings.yaml says: a "
            f"path, or a mapping)"
        ) from error
    return replace(found, in_memory=True)


def _campaign(
    tables: Iterable[tuple[Entry, Table]], said: Manifest, need_output: bool, home: Path, left: list[str]
) -> Campaign:
    """The campaign of tables, each with what is said about it; they are asked for one after another.

    Args:
        home: where they come from; left: what else is there, in words.
    """
    drafts: list[Draft] = []
    for entry, table in tables:
        drafts += drafts_of(entry, table, said, need_output, home)
        checks.not_too_many(len(drafts), sum(d.recording.t.size for d in drafts), home)
    checks.unique_names((d.recording.name, d.recording.source) for d in drafts)
    candidates = [candidate_of(d.recording, d.excitation, d.use) for d in drafts]
    whole = {c.name: whole_parts(c, True) for c in candidates}
    parts, new, notes = divide(candidates) if need_output else (whole, False, ())
    recordings = tuple(
        replace(
            d.recording, parts=parts[d.recording.name], noise=f.value, noise_source=f.source,
            noise_correlation=f.correlation, noise_found=f.found, noise_interval=f.interval,
        )
        for d, f in zip(drafts, pooled([d.floor for d in drafts], [_kind(d.recording) for d in drafts]), strict=True)
    )  # fmt: skip
    notes = (_extent(recordings), *_columns(drafts), *(note for d in drafts for note in d.notes), *notes)
    notes += _heavy(said)
    if left:
        notes = (*notes, f"Left alone, no recordings: {', '.join(left)}.")
    held = frozenset(d.recording.name for d in drafts if d.use == "confirmation")
    return Campaign(recordings, said.setup, said.known, said.voltage, notes, new, printable(str(home)), held)


def _table(files: Files, entry: Entry) -> Table:
    """The columns of all files of a recording."""
    sources = [files.source(file) for file in entry.files]
    return beside([read_axes(s, entry.axes) if entry.axes else READERS[s.suffix](s) for s in sources])


def _kind(recording: Recording) -> tuple[str, str, float]:
    """Recordings of one output at one rate are taken to have one sensor and one amplifier."""
    return recording.measures, recording.units.output, float(f"{recording.dt:.9g}")


def _extent(recordings: tuple[Recording, ...]) -> str:
    """How much was recorded, and at which rates."""
    seconds = sum(r.t.size * r.dt for r in recordings)
    rates = sorted({float(f"{1 / r.dt:.6g}") for r in recordings})
    said = f"at {rates[0]:g} Hz"
    if len(rates) > 1:
        said = f"at {len(rates)} different rates, each kept, {rates[0]:g} to {rates[-1]:g} Hz"
    samples = sum(r.t.size for r in recordings)
    many = "s" if len(recordings) > 1 else ""
    return f"Read {len(recordings)} recording{many}: {samples} samples, {seconds:.4g} s, {said}."


def _heavy(said: Manifest) -> tuple[str, ...]:
    """A doubt where the mass of an actuator, stated without a unit, would be unusually large."""
    mass = said.known.get("m")
    if not is_actuator(said.setup) or mass is None or mass.unit or mass.value < _HEAVY:
        return ()
    return (f"known: m = {mass.value:g} kg is much for a moving mass of an actuator; if it is in g, add unit: g.",)


def _columns(drafts: list[Draft]) -> tuple[str, ...]:
    """Which columns serve as what, said once for all recordings that share it."""
    names: dict[str, list[str]] = {}
    for draft in drafts:
        names.setdefault(draft.columns, []).append(draft.recording.name)
    if len(names) == 1:
        return (f"Understood as {next(iter(names))}.",)
    return tuple(f"{', '.join(who)}: understood as {columns}." for columns, who in names.items())
