"""Translation of laws from their sources: the same values in C and Python, or a refusal that names the construct."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported import COMPILER, FLAGS, needs_compiler

from phnn.errors import InputRefused
from phnn.exporting.c import c_header, c_source
from phnn.exporting.laws import Sources
from phnn.exporting.program import Program, function
from phnn.exporting.write import matlab, python
from phnn.laws.namespace import where

NEGATIVE = -2.0
TRUTH = True
TABLE = (1.0, 2.0)


def negated(x: Any, y: Any) -> Any:
    return where(~(x > y), x, +y)


def chained(x: Any, y: Any) -> Any:
    return where(-1.0 < x < y <= 1.0, 1.0, 0.0)  # type: ignore[operator]


def swapped(x: Any, y: Any) -> Any:
    x, y = y, x
    return x - 2.0 * y


def conditional(x: Any, y: Any) -> Any:
    return x if x > y else 3.0 * y


def below(x: Any, y: Any) -> Any:
    return y - NEGATIVE - -NEGATIVE * x


def divided(x: Any, y: Any) -> Any:
    return 1 / 2 * x + y


def signs(x: Any, y: Any) -> Any:
    return np.sign(x) + 3.0 * np.sign(y - y)


def either(x: Any, y: Any) -> Any:
    return where((x > 0.0) & ~(y > 0.0) | (x < -0.5), x, y)


LAWS = [negated, chained, swapped, conditional, below, divided, signs, either]
POINTS = [(x, y) for x in (-0.75, -0.25, 0.0, 0.5) for y in (-0.5, 0.0, 0.5, 1.5)]


def helper(x: Any, k: Any = 2.0) -> Any:
    return k * x


def named(x: Any, y: Any) -> Any:
    return helper(x, k=y)


def short(x: Any, y: Any) -> Any:
    return helper(x) + y


def remainder(x: Any, y: Any) -> Any:
    return x % y


def inverted_bits(x: Any, y: Any) -> Any:
    return x ^ y


def tabled(x: Any, y: Any) -> Any:
    return x * TABLE[1] + y


def truthful(x: Any, y: Any) -> Any:
    return where(TRUTH, x, y)


def infinite(x: Any, y: Any) -> Any:
    return np.minimum(x, np.inf) + y


def starred(*x: Any) -> Any:
    return x


def twice(x: Any, y: Any) -> Any:
    a = b = x
    return a + b + y


def ranged(x: Any, y: Any) -> Any:
    for _i in range(2, 5):
        x = x + y
    return x


def of_numbers(x: Any, y: Any) -> Any:
    return (x + 1.0) or y


def largest(x: Any, y: Any) -> Any:
    return max(x, y, 0.0)


REFUSED = [
    named, short, remainder, inverted_bits, tabled, truthful, infinite, starred, twice, ranged, of_numbers, largest,
]  # fmt: skip


def program_of(laws: list[Callable[..., Any]]) -> Program:
    """A program that only has an output, the values of laws at its input; begun and advanced by nothing."""
    p = Program("law", "law", 1.0, 1, "linear", (("u", "1"),), ("y", "1"))
    p.state("x", "a state")
    sources = Sources(p.functions)
    names = [sources.name_of(law, "law of a test") for law in laws]
    nothing = ["s.x = 0.0", "return 1.0"]
    for name, arguments in (("init", ("u",)), ("substep", ("a", "b", "c")), ("step", ("u",))):
        p.functions[name] = function(name, arguments, nothing if name != "init" else nothing[:1], p.functions)
    calls = " + ".join(f"{name}(s.x, s.x)" for name in names)
    p.functions["output"] = function("output", (), [f"return {calls}"], p.functions)
    return p


@pytest.mark.parametrize("law", LAWS, ids=lambda f: f.__name__)
def test_a_law_has_its_values_in_python(law: Callable[..., Any]) -> None:
    scope: dict = {}
    exec(python(program_of([law])), scope)
    for x, y in POINTS:
        assert scope[law.__name__](x, y) == float(law(np.float64(x), np.float64(y))), (x, y)


@needs_compiler
def test_laws_have_their_values_in_c(tmp_path: Path) -> None:
    program = program_of(LAWS)
    (tmp_path / "law.h").write_text(c_header(program), "utf-8")
    wrapped = [f"double at_{f.__name__}(double, double);" for f in LAWS]
    wrapped += [f"double at_{f.__name__}(double x, double y) {{ return law_{f.__name__}(x, y); }}" for f in LAWS]
    (tmp_path / "law.c").write_text(c_source(program) + "\n".join(wrapped), "utf-8")
    assert COMPILER is not None
    library = tmp_path / "law.so"
    command = [COMPILER, *FLAGS, "-shared", "-fPIC", str(tmp_path / "law.c"), "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    loaded = ctypes.CDLL(str(library))
    for law in LAWS:
        found = getattr(loaded, f"at_{law.__name__}")
        found.argtypes, found.restype = [ctypes.c_double] * 2, ctypes.c_double
        for x, y in POINTS:
            assert found(x, y) == float(law(np.float64(x), np.float64(y))), (law.__name__, x, y)


def test_matlab_has_no_operator_of_python() -> None:
    text = matlab(program_of(LAWS))["law_step.m"]
    assert "--" not in text
    assert "where(~(x > y), x, y)" in text
    assert "-1.0 < x && x < y && y <= 1.0" in text


@pytest.mark.parametrize("law", REFUSED, ids=lambda f: f.__name__)
def test_what_has_no_translation_is_refused_by_name(law: Callable[..., Any]) -> None:
    with pytest.raises(InputRefused, match="law of a test: cannot be exported"):
        program_of([law])
