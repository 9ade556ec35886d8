"""The next recording for ``diagnosis.json``, and its waveform as a file that a generator can play."""

from __future__ import annotations

from typing import Any

import pandas as pd

from phnn.check import check
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.proposal import NextExperiment
from phnn.diagnose.verdict import NONE, UNKNOWN
from phnn.report.formatting import listing, words
from phnn.results import Place
from phnn.setup import Setup

WAVEFORM = "next_experiment.csv"
# Recordings that are asked for at a time.
_LACKS = 3


def next_experiment(proposal: NextExperiment | None) -> dict[str, Any] | None:
    """Describe the proposed recording: words, stretches of its input, separation by each recording of the menu."""
    if proposal is None:
        return None
    e = proposal.experiment
    return {
        "recording": proposal.experiment.words,
        "separates": list(proposal.separates),
        "why": proposal.why,
        "separation": proposal.separation,
        "needed": proposal.needed,
        "menu": dict(proposal.menu),
        "aim": proposal.aim,
        "groups": [list(g) for g in proposal.groups],
        "kind": e.kind,
        "duration_s": e.duration,
        "sample_rate_hz": e.rate,
        "input": e.interpolation,
        "stretches": [
            {
                "start_s": s.start,
                "end_s": s.end,
                "level": s.level,
                "lines": [{"amplitude": a, "frequency_Hz": f, "phase_rad": phase} for a, f, phase in s.lines],
            }
            for s in e.stretches
        ],
    }


def no_proposal(diagnosis: Diagnosis) -> str:
    """Say why no recording is proposed, which experiment would decide in principle, and what was not recorded."""
    if diagnosis.proposal is not None or diagnosis.verdict == NONE:
        return ""
    tied = next((c for c in diagnosis.claims if c.alike), None)
    places = not diagnosis.claims and diagnosis.location is not None and diagnosis.location.tied
    if tied is None and not places:
        return _further(diagnosis) if diagnosis.verdict == UNKNOWN else ""
    members = () if tied is None else (tied.effect, *tied.alike)
    if members:
        start = (
            f"No recording is proposed for what is tied: on none of the menu do the refitted models of "
            f"{listing(words(e.name) for e in members)} differ once their parameters adapt, or none of it can be "
            "simulated."
        )
    else:
        start = (
            "No recording is proposed for what is tied: it takes two refitted models to compute where they differ, and "
            "the places that are tied have not two that fit better than the base model."
        )
    told = [f"For {words(e.name)}: {e.separation}" for e in members[:2]]
    lacks = _lacks(diagnosis)
    also = f"These recordings also lack: {'; '.join(lacks)}." if lacks else ""
    return " ".join(x for x in (start, *told, also) if x)


def _further(diagnosis: Diagnosis) -> str:
    """Say what to record if nothing is tied and no name is proven."""
    lacks = _lacks(diagnosis)
    if not lacks:
        return ""
    return (
        "No two models are left between which a recording could be computed to decide, and yet no name is proven. "
        f"Recordings that these lack would narrow it down: {'; '.join(lacks)}."
    )


def _lacks(diagnosis: Diagnosis) -> list[str]:
    """List the recordings whose absence `phnn check` reports."""
    return [a.record for a in check(diagnosis.campaign).abilities if not a.able][:_LACKS]


def write_waveform(proposal: NextExperiment | None, setup: Setup, unit: str, place: Place) -> None:
    """Time and input of the proposed recording, where there is one; ``unit`` is that of the recorded inputs."""
    if proposal is None:
        return
    port = setup.network.ports[0]
    table = pd.DataFrame({"time_s": proposal.experiment.t, f"{port.name}_{unit}": proposal.experiment.u})
    place.write(table.to_csv(index=False, float_format="%.9g").encode())
