"""The sealed answer of a demonstration: written before the diagnosis, opened after it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused
from studies.generator.folder import Writer


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
        base_family: hysteresis of the actuator where it is not one of hysterons, see `studies.generator.other_base`.
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
