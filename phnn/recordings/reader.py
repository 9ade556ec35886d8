"""From a folder, or from objects in memory, to a campaign."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused
from phnn.recordings import checks
from phnn.recordings.adapters import described, given
from phnn.recordings.array_files import read_axes
from phnn.recordings.draft import Draft, drafts_of
from phnn.recordings.folder import READERS, Files
from phnn.recordings.manifest import Entry, Manifest, load_manifest, manifest_of
from phnn.recordings.partition import candidate_of, divide, whole_parts
from phnn.recordings.recording import IN_MEMORY, Campaign, Part, Recording, is_actuator
from phnn.recordings.table import Table, beside
from phnn.results import printable
from phnn.signals.pooling import pooled

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
    """A campaign as it is; a folder, and what else `read` takes, is read.

    Raises:
        InputRefused: it cannot be read.
    """
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
    parts, new, notes = _divided(drafts, need_output)
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


def _divided(drafts: list[Draft], need_output: bool) -> tuple[Mapping[str, tuple[Part, ...]], bool, tuple[str, ...]]:
    candidates = [candidate_of(d.recording, d.excitation, d.use) for d in drafts]
    if not need_output:
        return {c.name: whole_parts(c, True) for c in candidates}, False, ()
    return divide(candidates)


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
