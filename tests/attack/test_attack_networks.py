"""Hostile networks: `phnn check` refuses a file, or makes of it a network that identify can begin with."""

from __future__ import annotations

from pathlib import Path

import pytest
from attack_tools import Attack, often, put
from hypothesis import given
from hypothesis import strategies as st

GOOD = """junctions: {mass: 1}
elements:
  q:      {type: C, junction: mass, law: spring, parameters: [k], unit: m}
  p:      {type: I, junction: mass, law: capacitor, parameters: [m], unit: kg m/s}
  damper: {type: R, junction: mass, law: linear, parameters: [b], direction: resistance}
  force:  {type: Se, junction: mass, unit: V}
bonds: []
parameters:
  k: {value: 8.0, unit: N/m, positive: true}
  m: {value: 2.0, unit: kg, positive: true}
  b: {value: 0.5, unit: N s/m, positive: true}
output: q
"""
K, M, B = "k: {value: 8.0, unit: N/m, positive: true}", "m: {value: 2.0, unit: kg, positive: true}", "b: {value: 0.5,"
# Nine to the power of seven values, written out.
ALIASES = "\n".join(["a0: &a0 x", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 8))])
# What is replaced by what: none of these is a network.
BROKEN: dict[str, list[str]] = {
    K: ["k: {value: -8.0, unit: N/m}"],
    M: [
        "m: {value: -2.0}", "m: {value: 0}", "m: -2.0", "m: {value: .nan}", "m: {value: .inf}", "m: {value: 1e-320}",
        "m: {value: 1e308}", "m: {value: " + "9" * 400 + "}", "m: {value: 2, lower: 3}",
        "m: {value: 2, lower: 3, upper: 1}", "m: {value: 2, typical: 0}", "m: {value: 2, typical: -1}",
        "m: {value: heavy}", "m: {value: [2]}", "m: {value: true}", "m: {unit: kg}", "m: {worth: 2}", "m: null",
        "m: {value: 2, fixed: perhaps}",
    ],
    B: ["b: {value: -0.5, lower: -1, upper: 1} #", "b: {value: -0.5,", "idle: {value: 1}\n  b: {value: 0.5,"],
    "junctions: {mass: 1}": ["junctions: {}"],
    "mass: 1}": ["mass: 2}", "mass: true}", "mass: 0}"],
    "{mass: 1}": ["[mass]"],
    "elements:": ["elements: {}\nabout:"],
    "  force:  {type: Se, junction: mass, unit: V}\n": [""],
    "type: Se": ["type: Sf"],
    "unit: V}": ["unit: V, sign: 2}", "unit: V, sign: .nan}", "unit: V, sign: [1]}"],
    "type: C": ["type: X", "type: [C]"],
    "law: spring": ["law: sprung", "law: coulomb", "law: {a: 1}", 'law: "\\e[31m"'],
    "[k]": ["[k, m]", "[]", "[zeal]", "[3]"],
    "C, junction: mass": ["C, junction: wall", "C, junction: [mass]"],
    "C, junction: mass,": ["C,"],
    "output: q": [
        "output: z", "output: damper", "output: [q]", "", "output: q\nwings: 2", "output: " + "q" * 500,
        "output: !!python/name:os.system", "output: q\n" + ALIASES,
    ],
    "bonds: []": [
        "bonds: [{from: mass, to: mass}]", "bonds: [{from: mass, to: x}]", "bonds: [3]", "bonds: 3",
        "bonds: [{type: TF, from: mass, to: mass, ratio: 0}]",
        "bonds: [{type: TF, from: mass, to: mass, ratio: .inf}]", "bonds: []\nmodulations: {alpha: {by: q}}",
        "bonds: []\nmemories: {z: {law: thermal, of: [nobody], parameters: [k, m, b, k]}}",
        "bonds: []\nmemories: [3]", "bonds: []\nmerge: 3",
    ],
    "direction: resistance": ["reads: nobody", "direction: up"],
    "unit: kg": ["unit: '${oc.env:HOME}'"],
    "  p: ": ["  q: "],
}  # fmt: skip


def described(folder: Path, text: str, more: str = "") -> None:
    put(folder / "net.yaml", text)
    put(folder / "recordings.yaml", "setup: {network: net.yaml}\n" + more)


@pytest.mark.parametrize(("old", "new"), [(old, new) for old, some in BROKEN.items() for new in some])
def test_check_refuses_a_broken_network(old: str, new: str, attack: Attack, good: Path) -> None:
    assert old in GOOD
    described(good, GOOD.replace(old, new, 1))
    checked = attack(good)
    assert checked.refused
    assert attack(good, "identify").err == checked.err


def test_check_lets_a_good_network_pass(attack: Attack, good: Path) -> None:
    described(good, GOOD)
    assert attack(good).status == 0


@pytest.mark.parametrize(
    "said",
    [
        *("ports: {nobody: {column: voltage_V, unit: V}}", "outputs: {nobody: {column: displacement_m, unit: m}}"),
        *("ports: {force: {column: voltage_V, unit: V}}", "known: {k: -8}", "known: {m: 0}", "known: {zeal: 1}"),
        *("known: {b: -0.1}", "known: {k: .nan}", "recordings: [{file: a.csv, use: confirmation}]"),
        *('ports: {"\\e[1m": {column: voltage_V, unit: V}}', "outputs: {p: {column: nobody, unit: m}}"),
    ],
)
def test_check_refuses_what_does_not_fit_the_network(said: str, attack: Attack, good: Path) -> None:
    described(good, GOOD, said)
    checked = attack(good)
    assert checked.refused
    assert attack(good, "identify").err == checked.err


def chain(count: int, bonds: bool = True) -> str:
    """A chain of masses and springs."""
    lines = ["junctions: {" + ", ".join(f"j{i}: {1 - i % 2}" for i in range(count)) + "}", "elements:"]
    lines += [
        f"  e{i}: {{type: {'CI'[1 - i % 2]}, junction: j{i}, law: capacitor, parameters: [c]}}" for i in range(count)
    ]
    lines += ["  u: {type: Se, junction: j0, unit: V}", "parameters: {c: {value: 1.0, positive: true}}", "output: e1"]
    if bonds:
        lines += ["bonds: [" + ", ".join(f"{{from: j{i}, to: j{i + 1}}}" for i in range(count - 1)) + "]"]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("count", [2, 20, 60, 256, 257, 5000])
@pytest.mark.parametrize("bonds", [True, False])
def test_networks_of_any_size_end(count: int, bonds: bool, attack: Attack, good: Path) -> None:
    described(good, chain(count, bonds))
    attack(good)


VALUES = st.sampled_from([
    "0", "1", "-1", "1e-200", "1e200", ".nan", "true", "null", "[]", "{}", "q", "mass", "k", "''", "[k]", "{a: 1}",
    "1e-9", "'1/k'", "linear", "capacitor", "spring", "C", "Se", '"\\0"',
])  # fmt: skip
PLACES = [i for i, c in enumerate(GOOD) if c in " {}[],:\n"]


@often(80)
@given(at=st.sampled_from(PLACES), cut=st.integers(0, 9), piece=VALUES)
def test_networks_with_a_damaged_place(at: int, cut: int, piece: str, attack: Attack, good: Path) -> None:
    described(good, GOOD[:at] + f" {piece} " + GOOD[at + cut :])
    attack(good)


@pytest.mark.slow
@often(150)
@given(at=st.sampled_from(PLACES), cut=st.integers(0, 9), piece=VALUES)
def test_identify_refuses_nothing_that_check_lets_pass(
    at: int, cut: int, piece: str, attack: Attack, good: Path
) -> None:
    described(good, GOOD[:at] + f" {piece} " + GOOD[at + cut :])
    if attack(good).status == 0:
        # Values far from the recordings may make a fit fail; that is no fault of the file.
        assert attack(good, "identify", more=("starts=1",), statuses=(0, 1)).status != 2
