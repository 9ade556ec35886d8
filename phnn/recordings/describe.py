"""A campaign in words: what `phnn check` prints."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phnn.parameters import quantity
from phnn.recordings.excitation import Excitation, excitation_of
from phnn.recordings.reader import campaign_of
from phnn.recordings.recording import Campaign, Recording


def describe(campaign: Campaign | str | Path) -> str:
    """Describe a campaign, or a folder of recordings, in words: ``print(phnn.describe("recordings/"))``.

    Per recording: rate, length, ranges, start, excitation, noise floor and its source, use; what all share comes first,
    the notes last."""
    campaign = campaign_of(campaign)
    count = len(campaign.recordings)
    volts = all(r.units.input == "V" for r in campaign.recordings)
    drive, place = ("voltage", "measured at the terminals") if volts else ("input", "measured where it enters")
    setup = ", ".join(f"{key} {value}" for key, value in campaign.setup.items())
    lines = [
        f"{campaign.folder}: {count} recording{'s' if count != 1 else ''}; {setup}; "
        f"the {drive} is {'the command' if campaign.voltage == 'command' else place}",
        "",
    ]
    every = [facts(r) for r in campaign.recordings]
    common = [fact for fact in every[0] if len(every) > 1 and all(fact in known for known in every)]
    if common:
        lines += ["all recordings", *_listed(common), ""]
    for recording, known in zip(campaign.recordings, every, strict=True):
        own = [fact for fact in known if fact not in common]
        lines += [f"{recording.name} ({recording.source})", *_listed(own), ""]
    if campaign.known:
        anchors = (f"{name} = {a.value:g} ± {a.std:g} {a.unit}".rstrip() for name, a in campaign.known.items())
        lines += [f"known, in SI units: {', '.join(anchors)}", ""]
    lines.append("Understood:")
    lines += [f"  {note}" for note in campaign.notes]
    return "\n".join(lines)


def _listed(known: list[tuple[str, str]]) -> list[str]:
    return [f"  {label:14}{value}" for label, value in known]


def _within(r: Recording) -> str:
    """The interval of a noise floor in words; empty where none is known."""
    if r.noise_interval is None:
        return ""
    low, high = (quantity(x, r.units.output) for x in r.noise_interval)
    return f" ({low} to {high})"


def facts(r: Recording) -> list[tuple[str, str]]:
    """What was understood of a recording: label and words."""
    excitation = excitation_of(r.drive, r.dt)
    span = " to ".join(quantity(v, r.units.input, 4) for v in (r.u.min(), r.u.max()))
    found = [
        ("sampled", f"{1 / r.dt:.6g} Hz, {r.t.size} samples, {r.t.size * r.dt:.4g} s"),
        ("input", f"{span}; {_words(excitation)}; {r.interpolation} between samples"),
    ]
    if r.further:
        found.append(("driven too at", ", ".join(r.further)))
    if np.isfinite(r.y).all():
        unit = r.units.output
        colour = "" if r.noise_correlation.size == 1 else f", correlated over {r.noise_correlation.size} samples"
        found += [
            ("output", " to ".join(quantity(v, unit, 4) for v in (r.y.min(), r.y.max()))),
            (
                "noise floor",
                f"{quantity(r.noise, unit)}{_within(r)} from {r.noise_source}{colour}"
                if r.noise_found
                else r.noise_source,
            ),
        ]
    if (known := r.sensor.words(r.y)) and np.isfinite(r.y).all():
        found.append(("sensor", known))
    if r.gain == "unknown":
        found.append(("gain", "of the input unknown, one factor is estimated"))
    if r.offset == "shared":
        found.append(("zero", "shared with other recordings"))
    at_rest = f"rest, input {r.start.input_before:g} before"
    found.append(("start", at_rest if r.start.state == "rest" else r.start.state))
    if r.channels:
        found.append(("also", ", ".join(r.channels)))
    return [*found, ("use", _uses(r))]


def _words(e: Excitation) -> str:
    if e.kind == "sine":
        return f"sine of {e.low_Hz:.4g} Hz, amplitude {e.amplitude:.4g}, {e.cycles:.3g} periods"
    if e.kind == "periodic":
        return f"periodic, {e.low_Hz:.4g} Hz with content to {e.high_Hz:.4g} Hz, {e.cycles:.3g} periods"
    if e.kind == "chirp":
        return f"sweep between {e.low_Hz:.3g} and {e.high_Hz:.3g} Hz, amplitude {e.amplitude:.4g}"
    if e.kind == "broadband":
        return f"broadband, {e.low_Hz:.3g} to {e.high_Hz:.3g} Hz"
    return {"steps": "steps and holds", "constant": "constant"}[e.kind]


def _uses(r: Recording) -> str:
    said = []
    for part in r.parts:
        whole = part.first == 0 and part.last == r.t.size
        place = "" if whole else f" {part.first * r.dt:.4g} to {part.last * r.dt:.4g} s"
        use = "start, not scored" if part.use == "nuisance" else part.use
        said.append(use + place)
    return "; ".join(said)
