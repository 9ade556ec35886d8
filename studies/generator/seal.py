"""What a case leaves: a folder of simulated recordings with their manifest, and the sealed answer.

The answer is written before the diagnosis and opened after it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import OmegaConf

from phnn.errors import InputRefused
from studies.generator.cases import ANCHOR
from studies.generator.noise import Noise, Rng
from studies.generator.plans import Array, Excitation

# What puts the content of a file on a disk. Whoever asks for recordings brings it: the package is not known here.
Writer = Callable[[Path, bytes], object]
MANIFEST = "recordings.yaml"
_ZERO = 5e-6  # m, largest displacement zero of a recording


def refuse_strangers(folder: Path, plan: Sequence[Excitation]) -> None:
    """Refuse a folder with other files than those of the plan: they would end up among the recordings.

    Raises:
        InputRefused: the folder is a file, or holds files of others.
    """
    if folder.exists() and not folder.is_dir():
        raise InputRefused(f"{folder}: is a file; name a folder")
    own = {MANIFEST, *(f"{excitation.name}.csv" for excitation in plan)}
    strangers = sorted(path.name for path in folder.iterdir() if path.name not in own) if folder.exists() else []
    if strangers:
        raise InputRefused(f"{folder}: holds {strangers[0]}, which the demonstration did not write; name a new folder")


def reported(q: Array, noise: Noise, rng: Rng) -> Array:
    """Return what the sensor reports: its zero, its noise, and its least step."""
    y = q + rng.uniform(-_ZERO, _ZERO) + noise.drawn(q.size, rng)
    rounded: Array = np.round(y / noise.step) * noise.step
    return rounded


def write_recording(path: Path, excitation: Excitation, y: Array, write: Writer = Path.write_bytes) -> None:
    """Write one csv with times, voltages and the displacements ``y``, (samples,), m."""
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
    """Write what a person would say of the recordings: their starts, and the weighed mass.

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


def write_folder(
    folder: Path,
    mass: float,
    plan: Sequence[Excitation],
    reports: Sequence[Array],
    uses: Mapping[str, str] | None = None,
    spread: float = ANCHOR,
    hysterons: int = 2,
    write: Writer = Path.write_bytes,
) -> None:
    """Write the recordings and their manifest into a folder, which is made if need be.

    Args:
        reports: of the sensor, (samples,) each, m; see `write_manifest` for the others.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for excitation, y in zip(plan, reports, strict=True):
        write_recording(folder / f"{excitation.name}.csv", excitation, y, write)
    write_manifest(folder / MANIFEST, mass, plan, uses, spread, hysterons, write)


@dataclass(frozen=True)
class Sealed:
    """What was concealed.

    Attributes:
        effect: canonical name, or "none".
        parameters: of the effect, SI.
        base: parameters of the actuator, SI: the ten of Table 1, or those of another number of hysterons or of
            another hysteresis.
        strength_over_noise: root mean square of what the effect changes beyond a refit of the base model, over the
            standard deviation of the noise.
        noise: standard deviation of the added noise, m.
        quantisation: least step of the displacement, m.
        seed: everything was drawn from it.
        plan: name of the set of recordings.
        effects: all that was concealed: canonical names, or names that no catalogue has; empty for nothing.
        stratum: which kind of case, one of `studies.generator.STRATA`.
        form: the form of the law: "canonical", the name of another form, or "unlisted".
        location: canonical location of each effect.
        withheld: names of the catalogue that the diagnosis must do without.
        levels: of each effect alone, as ``strength_over_noise``.
        delta: noncentrality of all that was concealed: norm of what it changes beyond a refit of the base model and of
            each recording's zero, in units of the (whitened) noise, rounding included. Where the effect's direction
            is known, a test of false-alarm rate a finds it with probability Φ(δ − z_a), and no test does better.
        deltas: of each effect alone.
        apart: of each effect, the noncentrality of what the other one's direction cannot take over either.
        colour: coefficient of the first-order noise, 0 for white noise.
        redrawn: rejected shapes: no strength of theirs reached the level wanted.
        noise_family: of the noise, where one was asked for; empty otherwise, and then the other three are not stated.
        noise_amount: see `studies.generator.noise.Noise`.
        noise_total: root mean square of all noise over all recordings, rounding included, m.
        noise_rms: the same of each recording.
        background: parameters of the small mismatch that acts beside what was concealed, SI; background_effects: its
            canonical names; background_level: root mean square that it leaves beyond a refit, over the noise.
        hysterons, stated_hysterons: of the actuator, and as the manifest states them, where that was asked for.
        stated_mass: as the manifest states it, kg, where it was drawn with its error.
        base_family: hysteresis of the actuator where it is not one of hysterons, see `studies.generator.cases`.
        noise_unrecorded: share of a random force or of jitter in the noise's power, as it came out.
    """

    effect: str
    parameters: Mapping[str, float]
    base: Mapping[str, float]
    strength_over_noise: float
    noise: float
    quantisation: float
    seed: int
    plan: str
    effects: tuple[str, ...] = ()
    stratum: str = "same"
    form: str = "canonical"
    location: tuple[str, ...] = ()
    withheld: tuple[str, ...] = ()
    levels: tuple[float, ...] = ()
    delta: float = 0.0
    deltas: tuple[float, ...] = ()
    apart: tuple[float, ...] = ()
    colour: float = 0.0
    redrawn: int = 0
    noise_family: str = ""
    noise_amount: float = 0.0
    noise_total: float = 0.0
    noise_rms: Mapping[str, float] = field(default_factory=dict)
    noise_unrecorded: float = 0.0
    background: Mapping[str, float] = field(default_factory=dict)
    background_effects: tuple[str, ...] = ()
    background_level: float = 0.0
    hysterons: int = 0
    stated_hysterons: int = 0
    stated_mass: float = 0.0
    base_family: str = ""


# Stated only where they differ from their defaults: a seal without them has the bytes that it always had.
_ON_REQUEST = (
    *("noise_family", "noise_amount", "noise_total", "noise_rms", "noise_unrecorded"),
    *("background", "background_effects", "background_level", "hysterons", "stated_hysterons", "stated_mass"),
    "base_family",
)


def write_seal(sealed: Sealed, path: Path, write: Writer = Path.write_bytes) -> str:
    """Write the answer as json; it must lie outside the folder that is diagnosed.

    Args:
        write: puts it on the disk.

    Returns:
        The SHA-256 of the file, in hexadecimal: printed now, it proves later that the answer was not changed.
    """
    content = {n: v for n, v in asdict(sealed).items() if v or n not in _ON_REQUEST}
    data = (json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, data)
    return hashlib.sha256(data).hexdigest()


def open_seal(path: Path) -> Sealed:
    """Read the answer back.

    Raises:
        InputRefused: the file is absent or is no sealed answer.
    """
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise InputRefused(f"{path}: cannot be read ({error.strerror}): give the file that write_seal wrote") from error
    except ValueError as error:
        raise InputRefused(f"{path}: is not json ({error}): give the file that write_seal wrote") from error
    names = [f.name for f in fields(Sealed)]
    needed = [f.name for f in fields(Sealed) if f.default is MISSING and f.default_factory is MISSING]
    if not isinstance(content, dict) or not set(needed) <= set(content) <= set(names):
        raise InputRefused(f"{path}: is no sealed answer, which has {', '.join(sorted(needed))}")
    values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in content.items()}
    return Sealed(**values)
