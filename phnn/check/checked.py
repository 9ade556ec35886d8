"""Everything that is to be said about a campaign's recordings, in words and as data."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phnn.check.abilities import Ability, abilities
from phnn.check.consistency import contaminated
from phnn.check.finding import WARNING, Finding
from phnn.check.gain import odd_units
from phnn.check.mains import mains
from phnn.check.noise import stated_noise
from phnn.check.quality import drift, limits, quantisation
from phnn.check.timing import lead
from phnn.recordings.describe import describe
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Campaign
from phnn.signals.noise_statement import NoiseStatement

_NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?: [nµmkM]?(?:m|V|s|N|A|Hz|rad)\b)?")
# Names in a line before only their number is said; check.json has all.
_LISTED = 3
_CHECKS = (quantisation, limits, drift, mains, lead)


@dataclass(frozen=True)
class Checked:
    """Attributes:
    campaign: what was read.
    findings: by recording, in the order of the campaign; abilities: of all together.
    noise: what the noise of each recording is that has an output.
    """

    campaign: Campaign
    findings: dict[str, list[Finding]]
    abilities: list[Ability]
    noise: dict[str, NoiseStatement]

    def text(self) -> str:
        """What `phnn check` prints."""
        lines = [describe(self.campaign), ""]
        if found := [(name, f) for name, some in self.findings.items() for f in some]:
            lines += ["Noticed:", *_noticed(found), ""]
        lines += ["Noise:", *_colours(self.noise), ""]
        for head, able in (("These recordings can show:", True), ("They cannot show, for which to record:", False)):
            some = [a for a in self.abilities if a.able is able]
            if some:
                lines += [head, *(f"  {a.shows}" + ("" if able else f"\n      {a.record}") for a in some), ""]
        return "\n".join(lines).rstrip()

    def document(self) -> dict[str, Any]:
        """The same as plain data, SI."""
        return {
            "schema": "phnn.check/1",
            "recordings": {
                r.name: {
                    "source": r.source, "sample_rate_hz": 1.0 / r.dt, "samples": int(r.t.size),
                    "noise_floor": r.noise if np.isfinite(r.noise) and r.noise_found else None,
                    "noise_interval_95": list(r.noise_interval) if r.noise_interval else None,
                    "noise": self.noise[r.name].document() if r.name in self.noise else None,
                    "start": r.start.state, "period_s": r.period,
                    "findings": [asdict(f) for f in self.findings[r.name]],
                }
                for r in self.campaign.recordings
            },
            "abilities": [asdict(a) for a in self.abilities],
            "notes": list(self.campaign.notes),
        }  # fmt: skip


def _noticed(found: Iterable[tuple[str, Finding]]) -> Iterator[str]:
    """Lines of findings; notes that differ in numbers alone share the line of the first."""
    return _grouped("similar", (
        ((name, f.text) if f.severity == WARNING else _NUMBER.sub("#", f.text), name, f"{f.severity:8}{name}: {f.text}")
        for name, f in found
    ))  # fmt: skip


def _colours(statements: Mapping[str, NoiseStatement]) -> Iterator[str]:
    """Lines of noise statements; recordings of which the same is said share one."""
    said = ((name, "; ".join((s.colour, *s.notes))) for name, s in statements.items())
    return _grouped("the same", ((text, name, f"{name}: {text}") for name, text in said))


def _grouped(how: str, told: Iterable[tuple[Hashable, str, str]]) -> Iterator[str]:
    """One line for each key, the first; ``told``: key, name of the recording and line."""
    groups: dict[Hashable, tuple[str, list[str]]] = {}
    for key, name, line in told:
        groups.setdefault(key, (line, []))[1].append(name)
    for line, (_, *others) in groups.values():
        yield f"  {line}{_others(how, others)}"


def _others(how: str, names: Sequence[str]) -> str:
    if not names:
        return ""
    return f" ({how} in {', '.join(names) if len(names) <= _LISTED else f'{len(names)} others'})"


def check(campaign: Campaign) -> Checked:
    """All checks on all recordings that have an output."""
    recorded = [r for r in campaign.recordings if np.isfinite(r.y).all()]
    excitations = {r: excitation_of(r.drive, r.dt) for r in campaign.recordings}
    among = contaminated(recorded, excitations)
    units = odd_units(campaign)
    findings: dict[str, list[Finding]] = {r.name: [] for r in campaign.recordings}
    for r in recorded:
        findings[r.name] = [*(f for one in _CHECKS for f in one(r, excitations[r])), *among[r.name], *units[r.name]]
    noise = {r.name: stated_noise(r, excitations[r]) for r in recorded}
    return Checked(campaign, findings, abilities(campaign, excitations), noise)
