"""Hostile manifests and networks: values of every kind under every key, structures that multiply, what others run."""

from __future__ import annotations

import pytest
import yaml
from attack_tools import NETWORK, Attack, often, put, rows
from hypothesis import given
from hypothesis import strategies as st

OF_ONE = (
    "columns", "variables", "sample_rate_hz", "start", "periodic", "input", "segments", "ports", "outputs", "axes",
)  # fmt: skip
KEYS = ("setup", "known", "voltage", *OF_ONE, "recordings")
EACH = ("name", "slice", "use", *OF_ONE)
VALUES = [
    "null", "''", "nonsense", "x" * 5000, "0", "-1", "9" * 18, "9" * 400, ".inf", "-.inf", ".nan", "1e308", "1e-320",
    "true", "[]", "[1, 2, 3]", "[[[[1]]]]", "{}", "{a: 1}", "{1: 2, 3: 4}", "{null: 1}", "{a: {b: {c: {d: 1}}}}",
    "'${oc.env:HOME}'", "${oc.env:HOME,none}", "'${voltage}'", '"\\e[31mred\\e[0m"', '"a\\0b"', '"\\u202egnp.exe"',
    "../../../../etc/passwd", "/etc/passwd", "/dev/zero", "!!python/object/apply:os.system ['true']",
    "!!binary aGFsbG8=", "!!set {a, b}", "2001-12-14t21:59:43.10-05:00", "190:20:30", "0o17", "1_000",
]  # fmt: skip
PATHS = (
    "../outside.csv", "/etc/passwd", "sub/../../outside.csv", "/dev/zero", "/proc/self/environ", "..", ".", "/",
    "~/x.csv", "a.csv/../../outside.csv", "x" * 300 + ".csv", "y/" * 3000 + "a.csv", "http://example.org/a.csv",
)  # fmt: skip


def bomb(levels: int, last: str, frame: str, alias: str) -> str:
    """Return aliases of aliases: nine to the power of ``levels`` values when written out."""
    several = [frame % ", ".join(alias.format(i=i, j=j) for j in range(9)) for i in range(levels)]
    lines = [f"a{i}: &a{i} {value}" for i, value in enumerate([last, *several])]
    return "\n".join([*lines, f"recordings: *a{levels}"])


# A list, a mapping, and one that is merged of others: the value at the end, and what stands for those below.
BOMBS = (("x", "[%s]", "*a{i}"), ("{k: 1}", "{%s}", "k{j}: *a{i}"), ("{k: 1}", "{<<: [%s]}", "*a{i}"))
ANCHORS = (
    "{k: -1.0}", "{k: 0}", "{m: .nan}", "{k: {value: 1, std: -1}}", "{k: {std: 1}}", "{nobody: 1}", "{'': 1}",
    "{C_1: -1}", "{k: {value: {a: 1}}}", "{k: {value: 1, std: .inf}}", '{"\\e[31m": 1}', "[k, 1]",
)  # fmt: skip
# Manifests by the words of the refusal; none where they are read.
MANIFESTS: dict[str, list[str | bytes]] = {
    "": ["\ufeffvoltage: command", "#\n" * 200_000],
    "not readable as yaml": [
        " \n\t\n", "{[}", "voltage: *nobody", b"voltage: \xff\xfe\x80", b"voltage: \x07\x1b[2J"],
    "expected keys and values": ["3", "- a\n- b"], "a second document begins": ["voltage: command\n---\na: 1"],
    "is given twice": ["voltage: command\nvoltage: command"],
    "more than 32 levels deep": [
        "setup: &a {model: *a}", "recordings: " + "[" * 5000, "\n".join(" " * i + "a:" for i in range(600))],
    "unknown key": [
        "a: &a {model: hrc}\nsetup: {<<: *a}", "".join(f"k{i}: &a{i} {i}\n" for i in range(20000)),
        "? " + "k" * 500_000 + "\n: 1", *(bomb(2, *form) for form in BOMBS),
    ],
    "no mapping": ["setup: {<<: 3}"], "as a key": ["? [a, b]\n: 1"], "is not accepted": ["!include /etc/passwd"],
    "may have at most": ["#" * (2**20 + 1)], "20000 recordings": ["recordings: [" + "a.csv, " * 20_000 + "]"],
    "is not known": ["voltage: '" + "x" * 900_000 + "'", "voltage: >\n" + "  x\n" * 100_000],
    "aliases written out": [bomb(levels, *form) for levels in (9, 30) for form in BOMBS],
    "nothing is put in for": [
        "recordings: [{file: a.csv, name: '${oc.env:PHNN_SECRET}'}]", "known: {'${oc.env:PHNN_SECRET}': 1}"],
    "known: ": [f"setup: {model}\nknown: {anchor}\n" for anchor in ANCHORS for model in ("{}", "{model: linear}")],
    "recordings.yaml: setup: ": [f"setup: {form % path}" for form in ("{network: '%s'}", "'%s'") for path in PATHS],
    "phnn: ": [
        *(f"recordings: [{{file: {form % path}}}]" for form in ("'%s'", "[a.csv, '%s']") for path in PATHS),
        "recordings: [{file: away/outside.csv}]", "files: /etc/passwd",
        "axes: [time]\nrecordings: [{file: [a.csv, ../outside.csv]}]", "recordings: [{file: '${oc.env:HOME}/x.csv'}]",
        "recordings: [{file: !!python/object/apply:open [../outside.csv]}]",
    ],
}  # fmt: skip


@pytest.mark.parametrize(("words", "text"), rows(MANIFESTS))
def test_check_refuses_a_hostile_manifest_as_identify_does(words: str, text: str | bytes, attack: Attack) -> None:
    (attack.data / "away").symlink_to("..")
    checked = attack(said=text, words=words)
    assert not words or attack("identify").err == checked.err


ENTRIES = [
    *(f"{key}: VALUE\n" for key in KEYS), "recordings: [{file: VALUE}]\n",
    *(f"recordings: [{{file: a.csv, {key}: VALUE}}]\n" for key in EACH),
]  # fmt: skip


@pytest.mark.parametrize("entry", ENTRIES)
def test_any_value_under_any_key(entry: str, attack: Attack) -> None:
    for value in VALUES:
        attack(said=entry.replace("VALUE", value))


SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-(10**19), 10**19), st.floats(), st.text(max_size=8), st.sampled_from(KEYS),
    st.sampled_from(("a.csv", "voltage_V", "rest", "m", "s", "time", "command", "hrc", "cubic", "confirmation")),
)  # fmt: skip
INNER = ["model", "hysterons", "network", "column", "unit", "scale", "value", "std", "state", "input_before", "file"]
NAMES = st.sampled_from([*KEYS, *EACH, *INNER, "displacement"]) | st.text(max_size=5)
TREES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(NAMES, inner, max_size=4))


@often(30)
@given(content=st.dictionaries(st.sampled_from(KEYS), TREES, max_size=3))
def test_manifests_at_random(content: dict[str, object], attack: Attack) -> None:
    attack(said=yaml.safe_dump(content, allow_unicode=True))


MANIFEST = """setup: {model: piezo_actuator, hysterons: 1}
known: {k: {value: 2.4e4, std: 10}}
columns: {voltage: {column: voltage_V, unit: V}}
start: {state: rest, input_before: 0.0}
recordings: [{file: a.csv, name: b, slice: [0, 110], use: identification, input: cubic}]
"""


@often(30)
@given(at=st.integers(0, len(MANIFEST)), cut=st.integers(0, 12), piece=st.text(max_size=6))
def test_manifests_with_a_damaged_place(at: int, cut: int, piece: str, attack: Attack) -> None:
    attack(said=MANIFEST[:at] + piece + MANIFEST[at + cut :])


BOND, UNFINITE = "bonds: [{type: TF, from: mass, to: mass, ratio: .inf}]", "is not a finite number"
# By what of the network is replaced: the words of the refusal, and by what. Other words that a network is refused with
# are those of tests/network/test_bondgraph.py, test_bondgraph_file.py and tests/models/test_thermal_model.py.
BROKEN: dict[str, dict[str, list[str]]] = {
    "8.0, unit: N/m, positive: true": {"must be zero or positive": ["-8.0, unit: N/m"]},
    "m: {value: 2.0,": {
        UNFINITE: ["m: {value: .nan,"], "400 digits": ["m: {value: " + "9" * 400 + ","],
        "its typical change is 0": ["m: {value: 2, typical: 0,"],
    },
    "b: {value: 0.5,": {"nothing uses the parameter idle": ["idle: {value: 1}\n  b: {value: 0.5,"]},
    "{mass: 1}": {"the junction 'mass', which is not defined": ["{}"], "expected keys and values": ["[mass]"]},
    "  force: {type: Se, junction: mass, unit: V}\n": {"no source": [""]},
    "kg m/s": {"nothing is put in for": ["'${oc.env:HOME}'"]}, "law: spring": {"is not known": ['law: "\\e[31m"']},
    "  p: ": {"is given twice": ["  q: "]},
    "output: q": {
        "is no name": ["output: [q]"], "a name of 500 characters": ["output: " + "q" * 500],
        "is not accepted": ["output: !!python/name:os.system"],
    },
}  # fmt: skip
# The same of what is added to the network, and of what a manifest says that does not fit it.
ADDED = {"aliases written out": [bomb(7, *BOMBS[0])], UNFINITE: [BOND], "expected keys and values": ["memories: [3]"]}
UNFIT = {
    "the network has no": ['ports: {"\\e[1m": {column: voltage_V, unit: V}}'],
    "the network has no 'nobody'": ["outputs: {nobody: {column: displacement_m, unit: m}}"],
    "'force' is the name of a quantity": ["ports: {force: {column: voltage_V, unit: V}}"],
    "must be positive": ["known: {m: 0}"], "no parameter zeal": ["known: {zeal: 1}"], UNFINITE: ["known: {k: .nan}"],
    "no column is called 'nobody'": ["outputs: {p: {column: nobody, unit: m}}"],
    "every recording has use: confirmation": ["recordings: [{file: a.csv, use: confirmation}]"],
}  # fmt: skip
WRONG = [
    *((words, NETWORK.replace(old, new, 1), "") for old, some in BROKEN.items() for words, news in some.items()
      for new in news),
    *((words, NETWORK + more, "") for words, some in ADDED.items() for more in some),
    *((words, NETWORK, said) for words, some in UNFIT.items() for said in some),
]  # fmt: skip


@pytest.mark.parametrize(("words", "network", "said"), WRONG, ids=range(len(WRONG)))
def test_check_refuses_a_broken_network_as_identify_does(words: str, network: str, said: str, attack: Attack) -> None:
    assert said or network != NETWORK
    put(attack.data / "net.yaml", network)
    checked = attack(said="setup: {network: net.yaml}\n" + said, words=words)
    assert attack("identify").err == checked.err


def chain(count: int, bonds: bool = True) -> str:
    """Return a chain of masses and springs."""
    law = "law: capacitor, parameters: [c]"
    joined = [f"{{from: j{i}, to: j{i + 1}}}" for i in range(count - 1)] if bonds else []
    return "\n".join([
        "junctions: {" + ", ".join(f"j{i}: {1 - i % 2}" for i in range(count)) + "}", "elements:",
        *(f"  e{i}: {{type: {'CI'[1 - i % 2]}, junction: j{i}, {law}}}" for i in range(count)),
        "  u: {type: Se, junction: j0, unit: V}", "parameters: {c: {value: 1.0, positive: true}}", "output: e1",
        "bonds: [" + ", ".join(joined) + "]\n",
    ])  # fmt: skip


SIZES = {"": [NETWORK, chain(2), chain(60)], "at most 256": [chain(257), chain(257, bonds=False), chain(2000)]}


@pytest.mark.parametrize(("words", "text"), rows(SIZES))
def test_networks_of_any_size_end(words: str, text: str, attack: Attack) -> None:
    put(attack.data / "net.yaml", text)
    attack(said="setup: {network: net.yaml}\n", words=words)


PIECES = st.sampled_from([
    "0", "1", "-1", "1e-200", "1e200", ".nan", "true", "null", "[]", "{}", "q", "mass", "k", "''", "[k]", "{a: 1}",
    "1e-9", "'1/k'", "linear", "capacitor", "spring", "C", "Se", '"\\0"',
])  # fmt: skip
PLACES = st.sampled_from([i for i, c in enumerate(NETWORK) if c in " {}[],:\n"])
DAMAGED = st.builds(
    lambda at, cut, new: f"{NETWORK[:at]} {new} {NETWORK[at + cut :]}", PLACES, st.integers(0, 9), PIECES
)


@often(30)
@given(network=DAMAGED)
def test_networks_with_a_damaged_place(network: str, attack: Attack) -> None:
    put(attack.data / "net.yaml", network)
    attack(said="setup: {network: net.yaml}\n")


@pytest.mark.slow
@often(150)
@given(network=DAMAGED)
def test_identify_refuses_nothing_that_check_lets_pass(network: str, attack: Attack) -> None:
    put(attack.data / "net.yaml", network)
    if attack(said="setup: {network: net.yaml}\n").status == 0:
        # Values far from the recordings may make a fit fail; that is no fault of the file.
        assert attack("identify", "starts=1", statuses=(0, 1)).status != 2
