"""Units at the boundary: everything inside the package is SI."""

from __future__ import annotations

import difflib
import re

import numpy as np

from phnn.errors import InputRefused

# unit as written -> (SI unit, factor, offset): SI value = factor * number + offset
UNITS: dict[str, tuple[str, float, float]] = {
    "s": ("s", 1.0, 0.0),
    "ms": ("s", 1e-3, 0.0),
    "us": ("s", 1e-6, 0.0),
    "min": ("s", 60.0, 0.0),
    "V": ("V", 1.0, 0.0),
    "mV": ("V", 1e-3, 0.0),
    "kV": ("V", 1e3, 0.0),
    "m": ("m", 1.0, 0.0),
    "mm": ("m", 1e-3, 0.0),
    "um": ("m", 1e-6, 0.0),
    "nm": ("m", 1e-9, 0.0),
    "A": ("A", 1.0, 0.0),
    "mA": ("A", 1e-3, 0.0),
    "uA": ("A", 1e-6, 0.0),
    "nA": ("A", 1e-9, 0.0),
    "C": ("C", 1.0, 0.0),
    "uC": ("C", 1e-6, 0.0),
    "nC": ("C", 1e-9, 0.0),
    "N": ("N", 1.0, 0.0),
    "mN": ("N", 1e-3, 0.0),
    "kN": ("N", 1e3, 0.0),
    "K": ("K", 1.0, 0.0),
    "degC": ("K", 1.0, 273.15),
    "1": ("1", 1.0, 0.0),
}

# quantity -> its SI unit; None: any unit of the table (systems other than the actuator)
QUANTITIES: dict[str, str | None] = {
    "time": "s",
    "voltage": "V",
    "displacement": "m",
    "current": "A",
    "charge": "C",
    "force": "N",
    "temperature": "K",
    "input": None,
    "output": None,
}

# Units in words, as headers of instruments have them.
_WORDS = {"second": "s", "seconds": "s", "sec": "s", "volt": "V", "volts": "V", "micron": "um", "microns": "um"}

_NAME = re.compile(r"^\s*([A-Za-z]+)\s*(?:_(\S+)|[\[(]\s*([^\])]*?)\s*[\])])?\s*$")


def spelled(unit: str) -> str:
    """The table's spelling of a unit: both Unicode micro signs become ``u``, ``°C`` becomes ``degC``, words symbols."""
    bare = unit.strip().replace("\u00b5", "u").replace("\u03bc", "u").replace("\u00b0C", "degC")
    return _WORDS.get(bare.lower(), bare)


def parse_name(header: str) -> tuple[str, str | None] | None:
    """Quantity and unit of a column name such as ``displacement_um`` or ``voltage [V]``.

    Returns:
        ``(quantity, unit)``, unit ``None`` where the name has none; ``None`` where the name is no known quantity.
    """
    match = _NAME.match(header)
    if match is None or match[1].lower() not in QUANTITIES:
        return None
    unit = match[2] or match[3]
    return match[1].lower(), spelled(unit) if unit else None


def accepted(quantity: str) -> str:
    """The units a quantity may have, for messages."""
    si = QUANTITIES[quantity]
    return ", ".join(name for name, (base, _, _) in UNITS.items() if si is None or base == si)


def check_unit(quantity: str, unit: str | None, where: str) -> str:
    """The unit in the table's spelling.

    Raises:
        InputRefused: no unit, a unit that is not in the table, or one of another quantity.
    """
    if unit is None:
        raise InputRefused(
            f"{where}: no unit for the {quantity}, so its numbers are ambiguous: put the unit in the column's name "
            f"({quantity}_{accepted(quantity).split(',')[0]}) or write it in recordings.yaml, "
            f"columns: {{{quantity}: {{unit: ...}}}}; accepted: {accepted(quantity)}"
        )
    name = spelled(unit)
    if name not in UNITS:
        near = difflib.get_close_matches(name, UNITS, n=1, cutoff=0.3)
        alike = [u for u in UNITS if u.lower() == name.lower()] or near
        hint = f" (did you mean {alike[0]}?)" if alike else ""
        raise InputRefused(
            f"{where}: unknown unit {unit!r} for the {quantity}{hint}: accepted are {accepted(quantity)}"
        )
    si = QUANTITIES[quantity]
    if si is not None and UNITS[name][0] != si:
        raise InputRefused(
            f"{where}: the {quantity} cannot be in {unit} (that is a unit of {UNITS[name][0]}): accepted are "
            f"{accepted(quantity)}; a column that is proportional to it takes `scale` and the unit after scaling, "
            f"in recordings.yaml"
        )
    return name


def to_si(values: np.ndarray, unit: str) -> np.ndarray:
    """Numbers in ``unit`` (a key of ``UNITS``) as SI values, same shape."""
    _, factor, offset = UNITS[unit]
    return np.asarray(values, dtype=float) * factor + offset
