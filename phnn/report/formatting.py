"""Numbers as a person reads them: significant digits, errors that match, powers of ten, one unit per column."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from phnn.parameters import prefixed

DASH = "–"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# The tails of residuals are not those of a normal deviate: smaller p-values are shown as smaller than this.
_FLOOR = 2.0001e-5


def finite(value: object) -> float | None:
    """Return the value as a finite float, ``None`` where it is missing, not a number or infinite."""
    if value is None or isinstance(value, bool):
        return None
    try:
        number_ = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
    return number_ if math.isfinite(number_) else None


def power_of_ten(exponent: int) -> str:
    """Return ``10⁻⁵``."""
    return "10" + str(exponent).translate(_SUPERSCRIPT)


def _exponent(value: float, digits: int = 3) -> int:
    """Return the decimal exponent after rounding to ``digits``: 9.999 has 1."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])


def _fixed(value: float, decimals: int) -> str:
    decimals = max(decimals, 0)
    text = f"{value:.{decimals}f}"
    return text.replace("-", "−") if float(text) else f"{0.0:.{decimals}f}"


def number(value: float | None, digits: int = 3, lowest: int = -3, highest: int = 4) -> str:
    """Return ``digits`` significant digits, with a power of ten outside 0.001 … 99999 or other decades."""
    value = finite(value)
    if value is None:
        return DASH
    if value == 0.0:
        return "0"
    exponent = _exponent(value, digits)
    if lowest <= exponent <= highest:
        return _fixed(round(value, digits - 1 - exponent), digits - 1 - exponent)
    mantissa = f"{value:.{digits - 1}e}".partition("e")[0].replace("-", "−")
    return f"{mantissa} × {power_of_ten(exponent)}"


def plain(value: float | None, digits: int = 3) -> str:
    """Write ``digits`` significant digits without an exponent, for columns of one unit; extreme values keep one."""
    return number(value, digits, lowest=-6, highest=8)


def with_error(value: float | None, std: float | None) -> str:
    """Return ``0.310 ± 0.020``: the error with two digits, the value to the same place.

    Where the error is missing the value stands with three digits.
    """
    value, std = finite(value), finite(std)
    if value is None:
        return DASH
    if std is None or std <= 0.0:
        return number(value)
    scale = max(abs(value), std)
    exponent = _exponent(scale, 2)
    if abs(exponent) > 290:  # 10**exponent is no longer exact
        return f"{number(value)} ± {number(std, 2)}"
    shift = 0 if -4 < exponent < 5 else exponent
    unit = 10.0**shift
    rounded_std = float(f"{std / unit:.1e}")
    decimals = 1 - _exponent(rounded_std, 2)
    if decimals > 9:
        return f"{number(value, 6)} ± {number(std, 2)}"
    text = f"{_fixed(value / unit, decimals)} ± {_fixed(rounded_std, decimals)}"
    return text if shift == 0 else f"({text}) × {power_of_ten(shift)}"


def interval(ends: tuple[float, float] | None) -> str:
    """Write ``0.27 … 0.35``, with as many digits as tell the ends apart to two; a dash where there is no interval."""
    low, high = (finite(end) for end in ends) if ends is not None else (None, None)
    if low is None or high is None:
        return DASH
    width, size = high - low, max(abs(low), abs(high))
    digits = min(max(2, 2 + _exponent(size) - _exponent(width)), 9) if width > 0.0 and size > 0.0 else 3
    return f"{number(low, digits)} … {number(high, digits)}"


def p_value(value: float | None) -> str:
    """Return ``p = 0.04``, ``p = 3 × 10⁻⁵``; below it ``p < 2 × 10⁻⁵``, for smaller tails are not to be believed."""
    value = finite(value)
    if value is None:
        return "p not computed"
    return f"p {'=' if value > _FLOOR else '<'} {number(max(value, _FLOOR), 1)}"


def likelihood(value: float | None) -> str:
    """Return a probability as a person reads it: ``97 %``, ``> 99 %``."""
    value = finite(value)
    if value is None:
        return DASH
    return "> 99 %" if value >= 0.995 else "< 1 %" if value < 0.005 else f"{100.0 * value:.0f} %"


def percent(value: float | None, decimals: int = 1) -> str:
    """Return a percentage without its sign."""
    value = finite(value)
    return DASH if value is None else _fixed(value, decimals)


def ratio(value: float | None) -> str:
    """Return a residual over noise: ``1.01``, ``12.4``, ``350``."""
    value = finite(value)
    return DASH if value is None else _fixed(value, 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0)


def short(value: float | None) -> str:
    """Return the at most four digits and no trailing zeros, for lists of times and frequencies."""
    value = finite(value)
    return DASH if value is None else f"{value:.4g}".replace("-", "−")


def words(name: str | None) -> str:
    """Return a canonical name as words: ``charge_leakage`` → ``charge leakage``; people keep their capitals."""
    return (name or "").replace("_", " ").replace("bouc wen", "Bouc–Wen").replace("coulomb", "Coulomb")


def listing(names: Iterable[str], last: str = "and") -> str:
    """Return ``a, b and c``."""
    items = list(names)
    return "".join(items) if len(items) < 2 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def markdown_table(head: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table in markdown; a bar within a cell becomes a slash."""
    rule = ["---"] * len(head)
    return [f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in [head, rule, *body]]


@dataclass(frozen=True)
class Unit:
    """A display unit: ``shown = value_in_SI / scale``."""

    scale: float
    name: str

    def show(self, value: float | None) -> str:
        """Write the value in this unit, without its name; one decimal where it has a prefix, so that columns align."""
        value = finite(value)
        if value is None:
            return DASH
        shown = value / self.scale
        return _fixed(shown, 1) if self.scale != 1.0 and abs(shown) >= 1.0 else plain(shown)


def display_unit(largest: float | None, unit: str) -> Unit:
    """Return the unit in which a column up to ``largest`` reads well: its largest number is 3 to 3000."""
    return Unit(*prefixed((finite(largest) or 0.0) / 3.0, unit))
