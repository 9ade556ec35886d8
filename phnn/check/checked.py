"""Everything that is to be said about a campaign's recordings, in words and as data."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phnn.check.abilities import Ability, abilities
from phnn.check.consistency import contaminated
from phnn.check.finding import Finding
from phnn.check.mains import mains
from phnn.check.noise import stated_noise
from phnn.check.quality import drift, limits, quantisation
from phnn.check.timing import lead
from phnn.recordings.describe import describe
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Campaign
from phnn.signals.noise_statement import NoiseStatement

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
        found = [(name, f) for name, some in self.findings.items() for f in some]
        lines += ["Noticed:", *(f"  {f.severity:8}{name}: {f.text}" for name, f in found), ""] if found else []
        lines += [
            "Noise:",
            *(f"  {name}: {s.colour}" + "".join(f"; {n}" for n in s.notes) for name, s in self.noise.items()),
            "",
        ]
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


def check(campaign: Campaign) -> Checked:
    """All checks on all recordings that have an output."""
    recorded = [r for r in campaign.recordings if np.isfinite(r.y).all()]
    excitations = {r: excitation_of(r.drive, r.dt) for r in campaign.recordings}
    among = contaminated(recorded, excitations)
    findings: dict[str, list[Finding]] = {r.name: [] for r in campaign.recordings}
    for r in recorded:
        findings[r.name] = [*(f for one in _CHECKS for f in one(r, excitations[r])), *among[r.name]]
    noise = {r.name: stated_noise(r, excitations[r]) for r in recorded}
    return Checked(campaign, findings, abilities(campaign, excitations), noise)
