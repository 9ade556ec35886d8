"""A folder of simulated recordings: what the sensor reports, one csv for each recording, and their manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from omegaconf import OmegaConf

from phnn.errors import InputRefused
from studies.generator.actuator import Array
from studies.generator.conditions import ANCHOR
from studies.generator.excitation import Excitation
from studies.generator.noise import Noise

# What puts the content of a file on a disk. Whoever asks for recordings brings it: the package is not known here.
Writer = Callable[[Path, bytes], object]
MANIFEST = "recordings.yaml"
_ZERO = 5e-6  # m, largest displacement zero of a recording


def refuse_strangers(folder: Path, plan: Sequence[Excitation]) -> None:
    """A second run may replace what the first one wrote; any other file would end up among the recordings.

    Raises:
        InputRefused: the folder is a file, or holds files of others.
    """
    if folder.exists() and not folder.is_dir():
        raise InputRefused(f"{folder}: is a file; name a folder")
    own = {MANIFEST, *(f"{excitation.name}.csv" for excitation in plan)}
    strangers = sorted(path.name for path in folder.iterdir() if path.name not in own) if folder.exists() else []
    if strangers:
        raise InputRefused(f"{folder}: holds {strangers[0]}, which the demonstration did not write; name a new folder")


def measured(q: Array, noise: float, quantisation: float, rng: np.random.Generator) -> Array:
    """What a sensor with white noise reports, see ``reported``."""
    return reported(q, Noise(noise, quantisation), rng)


def reported(q: Array, noise: Noise, rng: np.random.Generator) -> Array:
    """What the sensor reports: its zero, its noise, and its least step."""
    y = q + rng.uniform(-_ZERO, _ZERO) + noise.drawn(q.size, rng)
    rounded: Array = np.round(y / noise.step) * noise.step
    return rounded


def write_recording(path: Path, excitation: Excitation, y: Array, write: Writer = Path.write_bytes) -> None:
    """One csv with times, voltages and the displacements ``y``, (samples,), m."""
    t = excitation.t
    table = {
        "time_s": t,
        "voltage_V": excitation.voltage(t),
        # The least step is a whole number of nanometres: more decimals would only be rounding errors.
        "displacement_um": np.round(y * 1e6, 3),
    }
    write(path, pd.DataFrame(table).to_csv(index=False).encode())


def write_manifest(
    path: Path,
    mass: float,
    plan: Sequence[Excitation],
    uses: Mapping[str, str] | None = None,
    spread: float = ANCHOR,
    hysterons: int = 2,
    write: Writer = Path.write_bytes,
) -> None:
    """What a person would say of the recordings: their starts, and the weighed mass.

    Args:
        mass: as weighed, kg.
        uses: by recording name, "identification" or "confirmation"; nothing is said where it is left out.
        spread: standard deviation of the weighing over the mass.
        hysterons: as a person would state them.
        write: puts it on the disk.
    """
    recordings = []
    for excitation in plan:
        entry: dict[str, object] = {
            "file": f"{excitation.name}.csv",
            "name": excitation.name,
            "start": {"state": "rest", "input_before": 0.0},
        }
        if excitation.held:
            entry["input"] = "zero_order"
        if uses is not None:
            entry["use"] = uses[excitation.name]
        recordings.append(entry)
    manifest = {
        "setup": {"model": "piezo_actuator", "hysterons": hysterons},
        "known": {"m": {"value": mass, "std": float(f"{spread * mass:.3g}")}},
        "voltage": "command",
        "recordings": recordings,
    }
    write(path, OmegaConf.to_yaml(OmegaConf.create(manifest)).encode())
