"""The next recording for ``diagnosis.json``, and its waveform as a file that a generator can play."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from phnn.diagnose.propose import NextExperiment
from phnn.report.files import write_atomic
from phnn.setup import Setup

WAVEFORM = "next_experiment.csv"


def next_experiment(proposal: NextExperiment | None) -> dict[str, Any] | None:
    """What is proposed: in words, as the stretches of its input, and how well each recording of the menu separates."""
    if proposal is None:
        return None
    e = proposal.experiment
    return {
        "recording": proposal.recording,
        "separates": list(proposal.separates),
        "why": proposal.why,
        "separation": proposal.separation,
        "needed": proposal.needed,
        "menu": dict(proposal.menu),
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


def write_waveform(proposal: NextExperiment | None, setup: Setup, path: Path) -> None:
    """Time and input of the proposed recording; a file of an earlier proposal goes where there is none now."""
    if proposal is None:
        path.unlink(missing_ok=True)
        return
    port = setup.network.ports[0]
    table = pd.DataFrame({"time_s": proposal.experiment.t, f"{port.name}_{port.unit}": proposal.experiment.u})
    write_atomic(path, table.to_csv(index=False, float_format="%.9g").encode())
