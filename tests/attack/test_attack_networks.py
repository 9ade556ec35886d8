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
# What is replaced by what: none of these is a network.
BROKEN = {
    "a negative stiffness": (K, "k: {value: -8.0, unit: N/m}"),
    "a negative mass": (M, "m: {value: -2.0}"),
    "no mass": (M, "m: {value: 0}"),
    "a negative damping": (B, "b: {value: -0.5, lower: -1, upper: 1} #"),
    "negative and positive": (B, "b: {value: -0.5,"),
    "a bare negative number": (M, "m: -2.0"),
    "NaN": (M, "m: {value: .nan}"),
    "infinite": (M, "m: {value: .inf}"),
    "too small": (M, "m: {value: 1e-320}"),
    "too large": (M, "m: {value: 1e308}"),
    "400 digits": (M, "m: {value: " + "9" * 400 + "}"),
    "outside its bounds": (M, "m: {value: 2, lower: 3}"),
    "bounds turned round": (M, "m: {value: 2, lower: 3, upper: 1}"),
    "a typical change of zero": (M, "m: {value: 2, typical: 0}"),
    "a negative one": (M, "m: {value: 2, typical: -1}"),
    "a text as a value": (M, "m: {value: heavy}"),
    "a list as a value": (M, "m: {value: [2]}"),
    "a flag as a value": (M, "m: {value: true}"),
    "no value": (M, "m: {unit: kg}"),
    "an unknown key": (M, "m: {worth: 2}"),
    "nothing as a parameter": (M, "m: null"),
    "fixed is no flag": (M, "m: {value: 2, fixed: perhaps}"),
    "an unused parameter": ("output: q", "output: q #"),
    "no junctions": ("junctions: {mass: 1}", "junctions: {}"),
    "a junction of kind 2": ("mass: 1}", "mass: 2}"),
    "of kind true": ("mass: 1}", "mass: true}"),
    "of kind 0": ("mass: 1}", "mass: 0}"),
    "a list of junctions": ("{mass: 1}", "[mass]"),
    "no elements": ("elements:", "elements: {}\nabout:"),
    "no source": ("  force:  {type: Se, junction: mass, unit: V}\n", ""),
    "a source of flow": ("type: Se", "type: Sf"),
    "a sign of 2": ("unit: V}", "unit: V, sign: 2}"),
    "a sign of NaN": ("unit: V}", "unit: V, sign: .nan}"),
    "a list as a sign": ("unit: V}", "unit: V, sign: [1]}"),
    "an unknown type": ("type: C", "type: X"),
    "a list as a type": ("type: C", "type: [C]"),
    "an unknown law": ("law: spring", "law: sprung"),
    "a law of another element": ("law: spring", "law: coulomb"),
    "a mapping as a law": ("law: spring", "law: {a: 1}"),
    "too many parameters": ("[k]", "[k, m]"),
    "none": ("[k]", "[]"),
    "an unknown one": ("[k]", "[zeal]"),
    "a number as a parameter": ("[k]", "[3]"),
    "an unknown junction": ("C, junction: mass", "C, junction: wall"),
    "a list as a junction": ("C, junction: mass", "C, junction: [mass]"),
    "no junction": ("C, junction: mass,", "C,"),
    "an unknown output": ("output: q", "output: z"),
    "an output that is none": ("output: q", "output: damper"),
    "a list as an output": ("output: q", "output: [q]"),
    "no output": ("output: q", ""),
    "a bond to itself": ("bonds: []", "bonds: [{from: mass, to: mass}]"),
    "a bond to nowhere": ("bonds: []", "bonds: [{from: mass, to: x}]"),
    "a number as a bond": ("bonds: []", "bonds: [3]"),
    "no list of bonds": ("bonds: []", "bonds: 3"),
    "a ratio of zero": ("bonds: []", "bonds: [{type: TF, from: mass, to: mass, ratio: 0}]"),
    "an infinite ratio": ("bonds: []", "bonds: [{type: TF, from: mass, to: mass, ratio: .inf}]"),
    "a modulation of nothing": ("bonds: []", "bonds: []\nmodulations: {alpha: {by: q}}"),
    "a memory of nothing": (
        "bonds: []",
        "bonds: []\nmemories: {z: {law: thermal, of: [nobody], parameters: [k, m, b, k]}}",
    ),
    "no mapping of memories": ("bonds: []", "bonds: []\nmemories: [3]"),
    "merge is no flag": ("bonds: []", "bonds: []\nmerge: 3"),
    "reads nothing": ("direction: resistance", "reads: nobody"),
    "an unknown direction": ("direction: resistance", "direction: up"),
    "an unknown key at the top": ("output: q", "output: q\nwings: 2"),
    "the environment": ("unit: kg", "unit: '${oc.env:HOME}'"),
    "an escape code": ("law: spring", 'law: "\\e[31m"'),
    "a long name": ("output: q", "output: " + "q" * 500),
    "a python object": ("output: q", "output: !!python/name:os.system"),
    "a name twice": ("  p: ", "  q: "),
    "an alias bomb": (
        "output: q",
        "output: q\na: &a [x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\n"
        "c: &c [*b,*b,*b,*b,*b,*b,*b,*b,*b]\nd: &d [*c,*c,*c,*c,*c,*c,*c,*c,*c]\n"
        "e: &e [*d,*d,*d,*d,*d,*d,*d,*d,*d]\nf: [*e,*e,*e,*e,*e,*e,*e,*e,*e]",
    ),
}
BROKEN["an unused parameter"] = (B, "idle: {value: 1}\n  b: {value: 0.5,")


def described(folder: Path, text: str, more: str = "") -> None:
    put(folder / "net.yaml", text)
    put(folder / "recordings.yaml", "setup: {network: net.yaml}\n" + more)


@pytest.mark.parametrize("case", BROKEN)
def test_check_refuses_a_broken_network(case: str, attack: Attack, good: Path) -> None:
    old, new = BROKEN[case]
    assert old in GOOD
    described(good, GOOD.replace(old, new, 1))
    checked = attack(good)
    assert checked.refused, case
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


VALUES = st.sampled_from(
    (
        "0",
        "1",
        "-1",
        "1e-200",
        "1e200",
        ".nan",
        "true",
        "null",
        "[]",
        "{}",
        "q",
        "mass",
        "k",
        "''",
        "[k]",
        "{a: 1}",
        "1e-9",
        "'1/k'",
        "linear",
        "capacitor",
        "spring",
        "C",
        "Se",
        '"\\0"',
    )
)
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
