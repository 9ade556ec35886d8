"""From a folder, or from objects in memory, to a campaign, and a campaign in words."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake import LIMITS, Source, named_file
from phnn.parameters import quantity
from phnn.recordings import checks
from phnn.recordings.array_files import LINES, NoRecording, read_axes, read_json, read_mat, read_npy, read_npz
from phnn.recordings.draft import Draft, drafts_of
from phnn.recordings.excitation import Excitation
from phnn.recordings.library_files import read_hdf5, read_parquet, read_sheet, read_tdms
from phnn.recordings.manifest import Entry, Manifest, load_manifest
from phnn.recordings.memory import Given, given
from phnn.recordings.partition import candidate_of, divide, pooled, whole_parts
from phnn.recordings.recording import IN_MEMORY, Campaign, Recording, is_actuator
from phnn.recordings.table import Table, beside
from phnn.recordings.text_files import looks_like_numbers, read_text
from phnn.recordings.units import parse_name
from phnn.results import printable

READERS: Mapping[str, Callable[[Source], Table]] = {
    **dict.fromkeys((".csv", ".tsv", ".dat", ".txt", ".asc", ".lvm"), read_text), ".mat": read_mat,
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5), ".npy": read_npy, ".npz": read_npz, ".tdms": read_tdms,
    **dict.fromkeys((".json", LINES), read_json), ".xlsx": read_sheet, ".parquet": read_parquet,
}  # fmt: skip


@dataclass(frozen=True)
class Files:
    """The files of a folder, as a manifest describes them."""

    home: Path
    manifest: Manifest
    outside: bool  # files may lie outside

    def source(self, file: str) -> Source:
        """Return a file of a recording. Raises InputRefused as `phnn.intake.named_file`."""
        return named_file(self.home / file, (self.home,), outside=self.outside)

    def table(self, file: str, axes: Sequence[str] = ()) -> Table:
        """Return the columns of a file, of an array with axes where they are given."""
        source = self.source(file)
        return read_axes(source, axes) if axes else read_table(source, self._named())

    def _named(self) -> set[str]:
        """Return the names of columns that the manifest asks for."""
        entries = (self.manifest.common, *(self.manifest.entries or ()))
        columns = (c for e in entries for some in (e.columns, e.ports, e.outputs) for c in some.values())
        return {c.place for c in columns if isinstance(c.place, str)}

    def entries(self) -> tuple[list[Entry], list[str]]:
        """Return the entries to read, and the files left alone, each with its reason where that is not plain."""
        manifest, present = self.manifest, self._present()
        if manifest.path is not None:
            present = [p for p in present if os.path.realpath(p) != os.path.realpath(manifest.path)]
        if manifest.entries is not None:
            where = manifest.path.name if manifest.path is not None else "recordings.yaml"
            paths = [(i, self.home / file) for i, entry in enumerate(manifest.entries) for file in entry.files]
            for i, path in paths:
                if not os.path.lexists(path):
                    name, home = (printable(p)[: LIMITS.name_characters] for p in (path.name, str(path.parent)))
                    cause = f"recordings[{i}]: file {name!r} is not in {home}"
                    raise InputRefused(f"{where}: {cause}: correct its name or remove the entry")
            listed = {os.path.realpath(path) for _, path in paths}
            unlisted = [p for p in present if os.path.realpath(p) not in listed]
            return list(manifest.entries), [_shown(p) + " (not listed)" * self._numbers(p) for p in unlisted]
        chosen, others = [], []
        for path in present:
            reason = self._no_recording(path)
            if reason is None:
                chosen.append(path)
                checks.not_too_many(len(chosen), 0, self.home)
            else:
                others.append(_shown(path) + reason)
        checks.any_recordings(chosen, others, self.home)
        return [replace(manifest.common, files=(path.name,)) for path in chosen], others

    def possible(self) -> tuple[list[Path], list[str]]:
        """Return the files that may be recordings, whatever describes them, and what else lies there, in words."""
        present = self._present()
        chosen = [p for p in present if self._numbers(p)]
        chosen = [p for p in chosen if p.suffix.lower() in READERS] or chosen
        checks.not_too_many(len(chosen), 0, self.home)
        return chosen, [_shown(p) for p in present if p not in chosen]

    def _present(self) -> list[Path]:
        """Return what lies in the folder, without its manifest and hidden files."""
        try:
            names = sorted(self.home.iterdir())
        except OSError as error:
            cause = f"cannot be read ({error.strerror})"
            raise InputRefused(f"folder {printable(str(self.home))}: {cause}: make it readable") from error
        return [p for p in names if not p.name.startswith(".") and p.name != "recordings.yaml"]

    def _numbers(self, path: Path) -> bool:
        """Return whether a file has a known format or, as text, columns of numbers; a csv is meant to have."""
        kind = path.suffix.lower()
        if not os.path.isfile(path) or kind == ".csv" or READERS.get(kind, read_text) is not read_text:
            return os.path.isfile(path)
        try:
            return looks_like_numbers(self.source(path.name))
        except InputRefused:
            return kind in READERS

    def _no_recording(self, path: Path) -> str | None:
        """Return why a file found in the folder is no recording, in words to follow its name; ``None`` if it is one."""
        if not self._numbers(path):
            special = path.suffix.lower() in READERS and not os.path.isfile(path) and not os.path.isdir(path)
            return " (no regular file)" if special else ""
        if path.suffix.lower() not in READERS:
            return " (a table of text: list it in recordings.yaml to use it)"
        stated = {c.place for c in self.manifest.common.columns.values() if c.place is not None}
        kind = path.suffix.lower()
        if kind == ".csv" or (stated and kind != ".json"):
            return None
        try:
            names = self.table(path.name).names
        except NoRecording:
            return " (json without arrays of numbers)"
        # Settings and results in json may lie beside recordings.
        stated = {place for place in stated if isinstance(place, str)}
        described = {parse_name(name)[0] for name in names}
        if (stated and stated <= set(names)) or described & {"voltage", "input", "force"}:
            return None
        return " (numbers that nothing describes: to use it, say in recordings.yaml which columns are what)"


def _shown(path: Path) -> str:
    return printable(path.name) + ("/" if os.path.isdir(path) else "")


def read_table(source: Source, named: Collection[str] = ()) -> Table:
    """Return the columns of a file, of a workbook those of the sheet with the named ones. Raises InputRefused where
    nothing reads files of this ending, and it is no table of text, and as what reads it."""
    if source.suffix == ".xlsx":
        return read_sheet(source, named)
    if source.suffix not in READERS and not looks_like_numbers(source):
        cause = f"unknown format {source.suffix!r}, and no table of numbers in text: accepted are {', '.join(READERS)}"
        raise InputRefused(f"{source.name}: {cause}, and such tables with any ending")
    return READERS.get(source.suffix, read_text)(source)


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
            pandas DataFrame, an xarray Dataset, an ``Input_output_data`` of nonlinear_benchmarks, a
            mapping from column names to arrays; a list of these, or a mapping from names.
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
    stated = load_manifest(home, manifest, allow_outside)
    checks.no_results(home)
    files = Files(home, stated, allow_outside)
    entries, others = files.entries()
    tables = ((entry, beside([files.table(file, entry.axes) for file in entry.files])) for entry in entries)
    return _campaign(tables, stated, need_output, home, others)


def campaign_of(recorded: Campaign | str | Path | Any, *, need_output: bool = True) -> Campaign:
    """Return a campaign as it is; a folder, and what else `read` takes, is read."""
    return recorded if isinstance(recorded, Campaign) else read(recorded, need_output=need_output)


def _from_memory(data: Any, manifest: str | Path | Mapping[str, Any] | None, need_output: bool) -> Campaign:
    try:
        stated = load_manifest(Path(), {} if manifest is None else manifest, outside=True)
        tables, others = given(data, stated)
        campaign = _campaign(tables, stated, need_output, Path(IN_MEMORY), others)
    except InputRefused as error:
        if "recordings.yaml" not in str(error):
            raise
        raise InputRefused(
            f"{error} (of recordings in memory the second argument of phnn.read says what recordings.yaml says: a "
            f"path, or a mapping)"
        ) from error
    return replace(campaign, in_memory=True)


def _campaign(tables: Iterable[Given], stated: Manifest, need_output: bool, home: Path, others: list[str]) -> Campaign:
    """Return the campaign of tables, asked for one after another; ``others`` is what else lies in ``home``."""
    drafts: list[Draft] = []
    for entry, table in tables:
        drafts += drafts_of(entry, table, stated, need_output, home)
        checks.not_too_many(len(drafts), sum(d.recording.t.size for d in drafts), home)
    checks.unique_names((d.recording.name, d.recording.source) for d in drafts)
    candidates = [candidate_of(d.recording, d.excitation, d.use) for d in drafts]
    whole = {c.name: whole_parts(c, True) for c in candidates}
    parts, new, notes = divide(candidates) if need_output else (whole, False, ())
    # Recordings of one output at one rate are taken to have one sensor and one amplifier.
    kinds = [(r.measures, r.units.output, float(f"{r.dt:.9g}")) for r in (d.recording for d in drafts)]
    recordings = tuple(
        replace(
            d.recording, parts=parts[d.recording.name], noise=f.value, noise_source=f.source,
            noise_correlation=f.correlation, noise_found=f.found, noise_interval=f.interval,
        )
        for d, f in zip(drafts, pooled([d.floor for d in drafts], kinds), strict=True)
    )  # fmt: skip
    notes = (_extent(recordings), *_columns(drafts), *(note for d in drafts for note in d.notes), *notes)
    mass = stated.known.get("m")
    if is_actuator(stated.setup) and mass is not None and not mass.unit and mass.value >= _HEAVY:
        doubt = f"known: m = {mass.value:g} kg is much for a moving mass of an actuator; if it is in g, add unit: g."
        notes = (*notes, doubt)
    if others:
        notes = (*notes, f"Left alone: {', '.join(others)}.")
    held = frozenset(d.recording.name for d in drafts if d.use == "confirmation")
    return Campaign(recordings, stated.setup, stated.known, stated.voltage, notes, new, printable(str(home)), held)


def _extent(recordings: tuple[Recording, ...]) -> str:
    """Return how much was recorded, and at which rates."""
    seconds = sum(r.t.size * r.dt for r in recordings)
    rates = sorted({float(f"{1 / r.dt:.6g}") for r in recordings})
    at_rates = f"at {rates[0]:g} Hz"
    if len(rates) > 1:
        at_rates = f"at {len(rates)} different rates, each kept, {rates[0]:g} to {rates[-1]:g} Hz"
    samples = sum(r.t.size for r in recordings)
    many = "s" if len(recordings) > 1 else ""
    return f"Read {len(recordings)} recording{many}: {samples} samples, {seconds:.4g} s, {at_rates}."


def _columns(drafts: list[Draft]) -> tuple[str, ...]:
    """Return which columns serve as what, said once for all recordings that share it."""
    names: dict[str, list[str]] = {}
    for draft in drafts:
        names.setdefault(draft.columns, []).append(draft.recording.name)
    if len(names) == 1:
        return (f"Understood as {next(iter(names))}.",)
    return tuple(f"{', '.join(who)}: understood as {columns}." for columns, who in names.items())


def describe(campaign: Campaign | str | Path) -> str:
    """Describe a campaign, or a folder of recordings, in words: ``print(phnn.describe("recordings/"))``.

    What was understood, then per recording: rate, length, ranges, start, excitation, noise floor and its source, use;
    what all share comes first."""
    campaign = campaign_of(campaign)
    count = len(campaign.recordings)
    volts = all(r.units.input == "V" for r in campaign.recordings)
    drive, place = ("voltage", "measured at the terminals") if volts else ("input", "measured where it enters")
    setup = ", ".join(f"{key} {value}" for key, value in campaign.setup.items())
    place = "the command" if campaign.voltage == "command" else place
    lines = [f"{campaign.folder}: {count} recording{'s' if count != 1 else ''}; {setup}; the {drive} is {place}", ""]
    lines += ["Understood:", *(f"  {note}" for note in campaign.notes), ""]
    every = [facts(r) for r in campaign.recordings]
    common = [fact for fact in every[0] if len(every) > 1 and all(fact in known for known in every)]
    sections = [("all recordings", common)] if common else []
    for recording, known in zip(campaign.recordings, every, strict=True):
        sections.append((f"{recording.name} ({recording.source})", [fact for fact in known if fact not in common]))
    for head, known in sections:
        lines += [head, *(f"  {label:14}{value}" for label, value in known), ""]
    if campaign.known:
        anchors = (f"{name} = {a.value:g} ± {a.std:g} {a.unit}".rstrip() for name, a in campaign.known.items())
        lines += [f"known, in SI units: {', '.join(anchors)}", ""]
    return "\n".join(lines).rstrip()


def facts(r: Recording) -> list[tuple[str, str]]:
    """Return what was understood of a recording: label and words."""
    (u_unit, y_unit), before = r.units, r.start.input_before
    span = " to ".join(quantity(v, u_unit, 4) for v in (r.u.min(), r.u.max()))
    output = noise = sensor = ""
    if np.isfinite(r.y).all():
        output = " to ".join(quantity(v, y_unit, 4) for v in (r.y.min(), r.y.max()))
        noise, sensor = r.noise_source, r.sensor.words(r.y)
        if r.noise_found:
            ends = " to ".join(quantity(x, y_unit) for x in r.noise_interval or ())
            colour = "" if r.noise_correlation.size == 1 else f", correlated over {r.noise_correlation.size} samples"
            noise = f"{quantity(r.noise, y_unit)}{f' ({ends})' if ends else ''} from {noise}{colour}"
    rows = [
        ("sampled", f"{1 / r.dt:.6g} Hz, {r.t.size} samples, {r.t.size * r.dt:.4g} s"),
        ("input", f"{span}; {_words(r.excitation)}; {r.interpolation} between samples"),
        ("driven too at", ", ".join(r.further)),
        ("output", output),
        ("noise floor", noise),
        ("sensor", sensor),
        ("gain", "of the input unknown, one factor is estimated" if r.gain == "unknown" else ""),
        ("zero", "shared with other recordings" if r.offset == "shared" else ""),
        ("start", r.start.state + (f", input {quantity(before, u_unit)} before" if r.start.state == "rest" else "")),
        ("also", ", ".join(r.channels)),
        ("use", _uses(r)),
    ]
    return [(label, words) for label, words in rows if words]


def _words(e: Excitation) -> str:
    return {
        "sine": f"sine of {e.low_Hz:.4g} Hz, amplitude {e.amplitude:.4g}, {e.cycles:.3g} periods",
        "periodic": f"periodic, {e.low_Hz:.4g} Hz with content to {e.high_Hz:.4g} Hz, {e.cycles:.3g} periods",
        "chirp": f"sweep between {e.low_Hz:.3g} and {e.high_Hz:.3g} Hz, amplitude {e.amplitude:.4g}",
        "broadband": f"broadband, {e.low_Hz:.3g} to {e.high_Hz:.3g} Hz",
        "steps": "steps and holds",
        "constant": "constant",
    }[e.kind]


def _uses(r: Recording) -> str:
    uses = []
    for part in r.parts:
        whole = part.first == 0 and part.last == r.t.size
        place = "" if whole else f" {r.t[part.first]:.4g} to {r.t[part.last - 1]:.4g} s"
        use = "start, not scored" if part.use == "nuisance" else part.use
        uses.append(use + place)
    return "; ".join(uses)
