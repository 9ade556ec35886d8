"""Hostile manifests and networks: values of every kind under every key, structures that multiply, what others run."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from attack_tools import NETWORK, Attack, each, often, put, rows
from hypothesis import given
from hypothesis import strategies as st

KEYS = (
    "setup", "known", "voltage", "columns", "variables", "sample_rate_hz", "start", "periodic", "input",
    "segments", "ports", "outputs", "axes", "recordings",
)  # fmt: skip
EACH = ("name", "slice", "use", *KEYS[3:13])
VALUES = [
    "null", "''", "nonsense", "x" * 5000, "0", "-1", "9" * 18, "9" * 400, ".inf", "-.inf", ".nan", "1e308", "1e-320",
    "true", "[]", "[1, 2, 3]", "[[[[1]]]]", "{}", "{a: 1}", "{1: 2, 3: 4}", "{null: 1}", "{a: {b: {c: {d: 1}}}}",
    "'${oc.env:HOME}'", "${oc.env:HOME,none}", "'${voltage}'", '"\\e[31mred\\e[0m"', '"a\\0b"', '"\\u202egnp.exe"',
    "../../../../etc/passwd", "/etc/passwd", "/dev/zero", "!!python/object/apply:os.system ['true']",
    "!!binary aGFsbG8=", "!!set {a, b}", "2001-12-14t21:59:43.10-05:00", "190:20:30", "0o17", "1_000",
]  # fmt: skip
PATHS = (
    "../outside.csv", "/etc/passwd", "../../../../../../etc/passwd", "sub/../../outside.csv", "./../outside.csv",
    "/dev/zero", "/proc/self/environ", "..", ".", "/", "~/x.csv", "a.csv/../../outside.csv", "nowhere/../a.csv",
    "x" * 300 + ".csv", "y/" * 3000 + "a.csv", "\\\\server\\share.csv", "file:///etc/passwd",
    "http://example.org/a.csv",
)  # fmt: skip


def bomb(levels: int, last: str, frame: str, alias: str) -> str:
    """Return aliases of aliases: nine to the power of ``levels`` values when written out."""
    several = [frame % ", ".join(alias.format(i=i, j=j) for j in range(9)) for i in range(levels)]
    lines = [f"a{i}: &a{i} {value}" for i, value in enumerate([last, *several])]
    return "\n".join([*lines, f"recordings: *a{levels}"])


# A list, a mapping, and one that is merged of others: the value at the end, and what stands for those below.
BOMBS = (("x", "[%s]", "*a{i}"), ("{k: 1}", "{%s}", "k{j}: *a{i}"), ("{k: 1}", "{<<: [%s]}", "*a{i}"))
MODELS = ("{}", "{model: linear}", "{model: bouc_wen}", "{hysterons: 0}")
ANCHORS = (
    *("{k: -1.0}", "{k: 0}", "{m: -1e-3}", "{m: .nan}", "{k: {value: 1, std: -1}}", "{k: {std: 1}}", "{k: 1e300}"),
    *("{nobody: 1}", "{'': 1}", "{C_1: -1}", "{C_9: 1}", "{alpha: -0.04}", "{b: 1e-320}", "{k: {value: {a: 1}}}"),
    *("{d_1: 0}", "{k: {value: 1, std: .inf}}", '{"\\e[31m": 1}', "[k, 1]", "{k: true}"),
)
# Manifests by the words of the refusal; none where they are read.
MANIFESTS: dict[str, list[str | bytes]] = {
    "": ["\ufeffvoltage: command", "#\n" * 200_000],
    "not readable as yaml": [
        " \n\t\n", "{[}", "voltage: *nobody", b"voltage: \xff\xfe\x80", "voltage: command".encode("utf-16"),
        b"voltage: \x07\x1b[2J", b"a: \xed\xa0\x80",
    ],
    "expected keys and values": ["3", "- a\n- b"],
    "a second document begins": ["voltage: command\n---\nvoltage: command"],
    "is given twice": ["voltage: command\nvoltage: command"],
    "more than 32 levels deep": [
        "setup: &a {model: *a}", "recordings: &r [*r]", "recordings: " + "[" * 5000,
        "recordings: " + "[" * 900 + "]" * 900, "setup: " + "{a: " * 2000 + "1" + "}" * 2000,
        "\n".join(" " * i + "a:" for i in range(600)),
    ],
    "unknown key": [
        "a: &a {model: hrc}\nsetup: {<<: *a}", "".join(f"k{i}: {i}\n" for i in range(20000)),
        "? " + "k" * 500_000 + "\n: 1", "".join(f"k{i}: &a{i} {i}\n" for i in range(5000)),
        *(bomb(2, *form) for form in BOMBS),
    ],
    "no mapping": ["setup: {<<: 3}"], "as a key": ["? [a, b]\n: 1"], "is not accepted": ["!include /etc/passwd"],
    "may have at most": ["#" * (2**20 + 1)], "20000 recordings": ["recordings: [" + "a.csv, " * 20_000 + "]"],
    "is not known": ["voltage: '" + "x" * 900_000 + "'", "voltage: >\n" + "  x\n" * 100_000],
    "aliases written out": [bomb(levels, *form) for levels in (9, 30) for form in BOMBS],
    "nothing is put in for": [
        "recordings: [{file: a.csv, name: '${oc.env:PHNN_SECRET}'}]", "voltage: ${oc.env:PHNN_SECRET}",
        "known: {'${oc.env:PHNN_SECRET}': 1}", "setup: {network: '${oc.env:PHNN_SECRET}.yaml'}",
    ],
    "known: ": [f"setup: {model}\nknown: {anchor}\n" for anchor in ANCHORS for model in MODELS],
    "recordings.yaml: setup: ": [f"setup: {form % path}" for form in ("{network: '%s'}", "'%s'") for path in PATHS],
    "phnn: ": [
        *(f"recordings: [{{file: {form % path}}}]" for form in ("'%s'", "[a.csv, '%s']") for path in PATHS),
        "recordings: [{file: away/outside.csv}]", "files: /etc/passwd",
        "axes: [time]\nrecordings: [{file: [a.csv, ../outside.csv]}]", "recordings: [{file: '${oc.env:HOME}/x.csv'}]",
        "recordings: [{file: !!python/object/apply:open [../outside.csv]}]",
    ],
}  # fmt: skip


@pytest.mark.parametrize(("words", "text"), rows(MANIFESTS))
def test_check_refuses_a_hostile_manifest_as_identify_does(
    words: str, text: str | bytes, attack: Attack, good: Path
) -> None:
    (good / "away").symlink_to("..")
    put(good / "recordings.yaml", text)
    checked = attack(good, words=words)
    assert not words or attack(good, "identify").err == checked.err


@pytest.mark.parametrize("entry", [
    *(f"{key}: VALUE\n" for key in KEYS), "recordings: [{file: VALUE}]\n",
    *(f"recordings: [{{file: a.csv, {key}: VALUE}}]\n" for key in EACH),
])  # fmt: skip
def test_any_value_under_any_key(entry: str, attack: Attack, good: Path) -> None:
    def one(value: str) -> None:
        put(good / "recordings.yaml", entry.replace("VALUE", value))
        attack(good)

    each(VALUES, one)


SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-(10**19), 10**19), st.floats(), st.text(max_size=8), st.sampled_from(KEYS),
    st.sampled_from(("a.csv", "voltage_V", "rest", "m", "s", "time", "command", "hrc", "cubic", "confirmation")),
)  # fmt: skip
INNER = ["model", "hysterons", "network", "column", "unit", "scale", "value", "std", "state", "input_before", "file"]
NAMES = st.sampled_from([*KEYS, *EACH, *INNER, "displacement"]) | st.text(max_size=5)
TREES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(NAMES, inner, max_size=4))


@often(30)
@given(content=st.dictionaries(st.sampled_from(KEYS), TREES, max_size=3))
def test_manifests_at_random(content: dict[str, object], attack: Attack, good: Path) -> None:
    put(good / "recordings.yaml", yaml.safe_dump(content, allow_unicode=True))
    attack(good)


MANIFEST = """setup: {model: piezo_actuator, hysterons: 1}
known: {k: {value: 2.4e4, std: 10}}
columns: {voltage: {column: voltage_V, unit: V}}
start: {state: rest, input_before: 0.0}
recordings:
  - {file: a.csv, name: b, slice: [0, 110], use: identification, input: cubic}
"""


@often(30)
@given(at=st.integers(0, len(MANIFEST)), cut=st.integers(0, 12), piece=st.text(max_size=6))
def test_manifests_with_a_damaged_place(at: int, cut: int, piece: str, attack: Attack, good: Path) -> None:
    put(good / "recordings.yaml", MANIFEST[:at] + piece + MANIFEST[at + cut :])
    attack(good)


K, M, B = "k: {value: 8.0, unit: N/m, positive: true}", "m: {value: 2.0, unit: kg, positive: true}", "b: {value: 0.5,"
UNFINITE = "is not a finite number"
# What of the network is replaced, the words of the refusal, and by what; nothing where it does not fit the manifest.
BROKEN: list[tuple[str, ...]] = [
    (K, "must be zero or positive", "k: {value: -8.0, unit: N/m}"),
    (M, UNFINITE, "m: {value: .nan}", "m: {value: 1e-320}", "m: {value: 1e308}"), (M, "no value", "m: {unit: kg}"),
    (M, "400 digits", "m: {value: " + "9" * 400 + "}"), (M, "outside its bounds", "m: {value: 2, lower: 3}"),
    (M, "its typical change is 0", "m: {value: 2, typical: 0}"), (M, "unknown key 'worth'", "m: {worth: 2}"),
    (M, "expected keys and values", "m: null"), (B, "greater than 0", "b: {value: -0.5,"),
    (B, "must be zero or positive", "b: {value: -0.5, lower: -1, upper: 1} #"),
    (B, "nothing uses the parameter idle", "idle: {value: 1}\n  b: {value: 0.5,"),
    ("junctions: {mass: 1}", "the junction 'mass', which is not defined", "junctions: {}"),
    ("mass: 1}", "junction mass is 2", "mass: 2}"), ("{mass: 1}", "expected keys and values", "[mass]"),
    ("elements:", "the output is the storage 'q'", "elements: {}\nabout:"),
    ("  force:  {type: Se, junction: mass, unit: V}\n", "no source", ""),
    ("unit: V}", "the sign 2", "unit: V, sign: 2}"), ("kg m/s", "nothing is put in for", "'${oc.env:HOME}'"),
    ("type: Se", "fixes the flow of the storage p", "type: Sf"), ("type: C", "'X' is not known", "type: X"),
    ("law: spring", "is not known", 'law: "\\e[31m"'), ("[k]", "'zeal', which is not defined", "[zeal]"),
    ("C, junction: mass,", "no `junction`", "C,"), ("output: q", "is no name", "output: [q]"),
    ("output: q", "no 'output'", ""), ("output: q", "unknown key 'wings'", "output: q\nwings: 2"),
    ("output: q", "a name of 500 characters", "output: " + "q" * 500),
    ("output: q", "is not accepted", "output: !!python/name:os.system"),
    ("output: q", "aliases written out", "output: q\n" + bomb(7, *BOMBS[0])),
    ("bonds: []", "the junction 'x', which is not defined", "bonds: [{from: mass, to: x}]"),
    ("bonds: []", "expected keys and values", "bonds: [3]", "bonds: []\nmemories: [3]"),
    ("bonds: []", "expected a list", "bonds: 3"),
    ("bonds: []", "joins mass with itself", "bonds: [{type: TF, from: mass, to: mass, ratio: 0}]"),
    ("bonds: []", UNFINITE, "bonds: [{type: TF, from: mass, to: mass, ratio: .inf}]"),
    ("bonds: []", "the law affine takes 2", "bonds: []\nmodulations: {alpha: {by: q}}"),
    ("bonds: []", "neither true nor false", "bonds: []\nmerge: 3"),
    ("bonds: []", "driven by 'nobody'",
     "bonds: []\nmemories: {z: {law: thermal, of: [nobody], parameters: [k, m, b, k]}}"),
    ("direction: resistance", "reads the storage 'nobody'", "reads: nobody"),
    ("direction: resistance", "'up' is not known", "direction: up"), ("  p: ", "is given twice", "  q: "),
    ("", "the network has no 'nobody'", "ports: {nobody: {column: voltage_V, unit: V}}",
     "outputs: {nobody: {column: displacement_m, unit: m}}"),
    ("", "'force' is the name of a quantity", "ports: {force: {column: voltage_V, unit: V}}"),
    ("", "must be positive", "known: {m: 0}"), ("", "no parameter zeal", "known: {zeal: 1}"),
    ("", UNFINITE, "known: {k: .nan}"), ("", "the network has no", 'ports: {"\\e[1m": {column: voltage_V, unit: V}}'),
    ("", "no column is called 'nobody'", "outputs: {p: {column: nobody, unit: m}}"),
    ("", "every recording has use: confirmation", "recordings: [{file: a.csv, use: confirmation}]"),
]  # fmt: skip


def described(folder: Path, text: str, more: str = "") -> None:
    """Write this network, and a manifest that names it."""
    put(folder / "net.yaml", text)
    put(folder / "recordings.yaml", "setup: {network: net.yaml}\n" + more)


@pytest.mark.parametrize(("old", "words", "new"), [(old, words, new) for old, words, *some in BROKEN for new in some])
def test_check_refuses_a_broken_network_as_identify_does(
    old: str, words: str, new: str, attack: Attack, good: Path
) -> None:
    assert old in NETWORK
    described(good, NETWORK.replace(old, new, 1) if old else NETWORK, "" if old else new)
    checked = attack(good, words=words)
    assert attack(good, "identify").err == checked.err


def chain(count: int, bonds: bool = True) -> str:
    """Return a chain of masses and springs."""
    lines = ["junctions: {" + ", ".join(f"j{i}: {1 - i % 2}" for i in range(count)) + "}", "elements:"]
    lines += [
        f"  e{i}: {{type: {'CI'[1 - i % 2]}, junction: j{i}, law: capacitor, parameters: [c]}}" for i in range(count)
    ]
    lines += ["  u: {type: Se, junction: j0, unit: V}", "parameters: {c: {value: 1.0, positive: true}}", "output: e1"]
    if bonds:
        lines += ["bonds: [" + ", ".join(f"{{from: j{i}, to: j{i + 1}}}" for i in range(count - 1)) + "]"]
    return "\n".join(lines) + "\n"


SIZES = {"": [NETWORK, chain(2), chain(60)], "at most 256": [chain(257), chain(257, bonds=False), chain(2000)]}


@pytest.mark.parametrize(("words", "text"), rows(SIZES))
def test_networks_of_any_size_end(words: str, text: str, attack: Attack, good: Path) -> None:
    described(good, text)
    attack(good, words=words)


PIECES = st.sampled_from([
    "0", "1", "-1", "1e-200", "1e200", ".nan", "true", "null", "[]", "{}", "q", "mass", "k", "''", "[k]", "{a: 1}",
    "1e-9", "'1/k'", "linear", "capacitor", "spring", "C", "Se", '"\\0"',
])  # fmt: skip
PLACES = st.sampled_from([i for i, c in enumerate(NETWORK) if c in " {}[],:\n"])


@often(30)
@given(at=PLACES, cut=st.integers(0, 9), piece=PIECES)
def test_networks_with_a_damaged_place(at: int, cut: int, piece: str, attack: Attack, good: Path) -> None:
    described(good, NETWORK[:at] + f" {piece} " + NETWORK[at + cut :])
    attack(good)


@pytest.mark.slow
@often(150)
@given(at=PLACES, cut=st.integers(0, 9), piece=PIECES)
def test_identify_refuses_nothing_that_check_lets_pass(
    at: int, cut: int, piece: str, attack: Attack, good: Path
) -> None:
    described(good, NETWORK[:at] + f" {piece} " + NETWORK[at + cut :])
    if attack(good).status == 0:
        # Values far from the recordings may make a fit fail; that is no fault of the file.
        assert attack(good, "identify", "starts=1", statuses=(0, 1)).status != 2
