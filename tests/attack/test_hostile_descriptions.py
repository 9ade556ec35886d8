"""Hostile manifests, networks and models: what is loaded is what was meant, and passive, or refused in one message."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from attack_tools import MODEL, NETWORK, REFUSED, TABLE, Attack, Outcome, each, put
from attacks import violations
from damaged_files import made
from hypothesis import strategies as st
from subjects import NetworkSubject

from phnn.models.store import FILE, load
from phnn.recordings.manifest import _EACH, TOP_KEYS

# Common to all recordings, of one of them, and of one without a time.
ENTRIES = [
    *(f"{key}: %s" for key in TOP_KEYS),
    *(f"recordings: [{{{'' if key == 'file' else 'file: a.csv, '}{key}: %s}}]" for key in _EACH),
    "recordings: [{file: b.npy, columns: {voltage: {column: 0}, displacement: {column: 1}}, sample_rate_hz: %s}]",
]
VALUES = [
    "null", "''", "nonsense", "x" * 5000, "0", "-1", "9" * 18, "9" * 400, ".inf", "-.inf", ".nan", "1e308", "1e-320",
    "true", "[]", "[1, 2, 3]", "[[[[1]]]]", "{}", "{a: 1}", "{1: 2, 3: 4}", "{null: 1}", "{a: {b: {c: {d: 1}}}}",
    "'${oc.env:HOME}'", "${oc.env:HOME,none}", "'${voltage}'", '"\\e[31mred\\e[0m"', '"a\\0b"', '"\\u202egnp.exe"',
    "../../../../etc/passwd", "/etc/passwd", "/dev/zero", "!!python/object/apply:os.system ['true']",
    "!!binary aGFsbG8=", "!!set {a, b}", "2001-12-14t21:59:43.10-05:00", "190:20:30", "0o17", "1_000",
    "1e-150", "1e150", "1", "60", "119", "{model: linear}", "[0, 1]", "periodic", "zero_order",
    "{voltage: {column: 1, scale: 1e150}}", "{voltage: {column: 1, scale: 1e-150}}",
    "{displacement: {column: 2, scale: -1}}", "{state: rest, input_before: 1e150}",
]  # fmt: skip


@pytest.mark.parametrize("entry", ENTRIES)
def test_any_value_under_any_key(entry: str, attack: Attack) -> None:
    put(attack.data / "b.npy", made(np.save, TABLE[:, 1:]))
    for value in VALUES:
        attack(said=f"{entry % value}\n")


def bomb(levels: int, last: str, frame: str, alias: str) -> str:
    """Return aliases of aliases: nine to the power of ``levels`` values when written out."""
    several = [frame % ", ".join(alias.format(i=i, j=j) for j in range(9)) for i in range(levels)]
    lines = [f"a{i}: &a{i} {value}" for i, value in enumerate([last, *several])]
    return "\n".join([*lines, f"recordings: *a{levels}"])


def chain(count: int, bonds: bool = True) -> str:
    """Return a network of so many masses and springs in a row."""
    law, numbers = {"law": "capacitor", "parameters": ["c"]}, range(count)
    elements = {f"e{i}": {"type": "IC"[i % 2], "junction": f"j{i}"} | law for i in numbers}
    return json.dumps({
        "junctions": {f"j{i}": 1 - i % 2 for i in numbers}, "parameters": {"c": {"value": 1.0, "positive": True}},
        "elements": elements | {"u": {"type": "Se", "junction": "j0", "unit": "V"}}, "output": "e1",
        "bonds": [{"from": f"j{i - 1}", "to": f"j{i}"} for i in numbers[1:] if bonds],
    })  # fmt: skip


# A list, a mapping, and one that is merged of others: the value at the end, and what stands for those below.
BOMBS = (("x", "[%s]", "*a{i}"), ("{k: 1}", "{%s}", "k{j}: *a{i}"), ("{k: 1}", "{<<: [%s]}", "*a{i}"))
PATHS = (
    "../outside.csv", "/etc/passwd", "sub/../../outside.csv", "/dev/zero", "/proc/self/environ", "..", ".", "/",
    "~/x.csv", "a.csv/../../outside.csv", "x" * 300 + ".csv", "y/" * 3000 + "a.csv", "http://example.org/a.csv",
)  # fmt: skip
ANCHORS = (
    "{k: -1.0}", "{k: 0}", "{m: .nan}", "{k: {value: 1, std: -1}}", "{k: {std: 1}}", "{nobody: 1}", "{'': 1}",
    "{C_1: -1}", "{k: {value: {a: 1}}}", "{k: {value: 1, std: .inf}}", '{"\\e[31m": 1}', "[k, 1]",
)  # fmt: skip
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
        "? " + "k" * 500_000 + "\n: 1", *(bomb(2, *form) for form in BOMBS)],
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
        "recordings: [{file: !!python/object/apply:open [../outside.csv]}]"],
}  # fmt: skip
K, M, B, OUT = "8.0, unit: N/m, positive: true", "m: {value: 2.0,", "b: {value: 0.5,", "output: q"
# What of a network is replaced, and by what; what a manifest says beside it. Other words that a network is refused with
# are those of tests/network/test_bondgraph.py.
NETWORKS: dict[str, list[tuple[str, ...]]] = {
    "": [("", ""), (NETWORK, chain(2)), (NETWORK, chain(60))],
    "at most 256": [(NETWORK, chain(257)), (NETWORK, chain(257, bonds=False)), (NETWORK, chain(2000))],
    "must be zero or positive": [(K, "-8.0, unit: N/m")], "400 digits": [(M, "m: {value: " + "9" * 400 + ",")],
    "is not a finite number": [(M, "m: {value: .nan,"), ("", "", "known: {k: .nan}"),
        ("", "bonds: [{type: TF, from: mass, to: mass, ratio: .inf}]\n")],
    "its typical change is 0": [(M, "m: {value: 2, typical: 0,")],
    "no source": [("  force: {type: Se, junction: mass, unit: V}\n", "")],
    "nothing uses the parameter idle": [(B, "idle: {value: 1}\n  b: {value: 0.5,")],
    "the junction 'mass', which is not defined": [("{mass: 1}", "{}")], "is given twice": [("  p: ", "  q: ")],
    "expected keys and values": [("{mass: 1}", "[mass]"), ("", "memories: [3]\n")],
    "is no name": [(OUT, "output: [q]")], "aliases written out": [("", bomb(7, *BOMBS[0]) + "\n")],
    "nothing is put in for": [("kg m/s", "'${oc.env:HOME}'")], "is not known": [("law: spring", 'law: "\\e[31m"')],
    "a name of 500 characters": [(OUT, "output: " + "q" * 500)], "no parameter zeal": [("", "", "known: {zeal: 1}")],
    "is not accepted": [(OUT, "output: !!python/name:os.system")], "must be positive": [("", "", "known: {m: 0}")],
    "the network has no": [("", "", 'ports: {"\\e[1m": {column: voltage_V, unit: V}}')],
    "the network has no 'nobody'": [("", "", "outputs: {nobody: {column: displacement_m, unit: m}}")],
    "'force' is the name of a quantity": [("", "", "ports: {force: {column: voltage_V, unit: V}}")],
    "no column is called 'nobody'": [("", "", "outputs: {p: {column: nobody, unit: m}}")],
    "every recording has use: confirmation": [("", "", "recordings: [{file: a.csv, use: confirmation}]")],
}  # fmt: skip


@each(MANIFESTS, NETWORKS)
def test_check_refuses_a_description_as_identify_does(words: str, name: int, content: Any, attack: Attack) -> None:
    (attack.data / "away").symlink_to("..")
    if isinstance(content, tuple):
        put(attack.data / "net.yaml", NETWORK.replace(*content[:2], 1))
        content = "\n".join(["setup: {network: net.yaml}", *content[2:]])
    checked = attack(said=content, words=words)
    assert not words or attack("identify").err == checked.err


FLAGS: list[dict[str, bool]] = [{}, {"positive": False}, {"fixed": True}, {"positive": False, "fixed": True}]
EMPTY, DRIFT = {"kind": "lowpass", "parameters": []}, {"kind": "drift", "parameters": ["b"]}
NAN, MANY, FIRST, LAW, B_VALUE = float("nan"), 10**400, "storages.0.", "resistors.0.", "parameters.b.value"
# Where something is put into the model, and what. None of these is passive, or none is a model.
MODELS: dict[str, list[tuple[str, Any]]] = {
    "": [("name", "other")],
    "no object": [("parameters.b", 3), ("parameters", [1]), (LAW + "on", ["Q_1"]), ("sensor", [3])],
    "outside its bounds": [(B_VALUE, -1.0), (B_VALUE, 0)], "calls itself 'm'": [("parameters.b.name", "m")],
    "no finite number": [
        (B_VALUE, NAN), (B_VALUE, MANY), ("lines", [NAN]), *(("couplings.0.ratio", v) for v in ([1], float("inf")))],
    "neither true nor false": [("parameters.b.positive", 1)], "has no field 'mood'": [("parameters.b.mood", 1)],
    "its typical change is 0": [("parameters.b.typical", 0)], "no list": [(LAW + "parameters", 3), ("lines", "50")],
    "is not defined": [("parameters", {}), (LAW + "parameters", ["x", "y"]), ("couplings.0.ratio", "zeal"),
        ("modulations", [{"ratio": "x", "by": "q", "law": "affine"}])],
    "at most 1024": [("parameters", {f"p{i}": 1.0 for i in range(50000)})],
    "at most 256": [("storages", [{"name": f"s{i}", "law": "capacitor", "parameters": ["m"]} for i in range(20000)])],
    "no printable text": [
        ("name", None), ("name", "\x1b[31m"), (FIRST + "name", "\x00"), (FIRST + "name", ["Q"]), ("output", ["q"])],
    "rename one": [(FIRST + "name", "p")], "0 characters": [(FIRST + "name", "")], "no port": [("ports", [])],
    "no law called": [(FIRST + "law", "eval"), (FIRST + "law", "dead_zone"), ("ports.0.law", "x"),
        ("memories", [{"name": "z", "law": "eval"}])],
    "takes 2 parameters": [(LAW + "parameters", ["rho_1"]), (LAW + "parameters", ["b"] * 9)],
    "refers to the storage 'x'": [(LAW + "on", {"x": 1.0}), ("output", "x")], "no learned law": [(FIRST + "law", 3)],
    "no whole number from 1": [("substeps", 0), ("substeps", 10**9)], "not positive": [("lines", [-50.0])],
    "no whole number from 0": [("drift_terms", 10**9)], "at most 64": [("lines", [50.0] * 10**4)],
    "unknown amplifier": [("amplifier", [EMPTY | {"kind": "eval"}]), ("amplifier", [DRIFT])],
    "takes 1 parameters": [("amplifier", [EMPTY])], "no parameter y": [("amplifier", [EMPTY | {"parameters": ["y"]}])],
    "no port after the first": [
        ("sources", [{"kind": "tone", "parameters": ["b"] * 3, "port": port}]) for port in ("voltage", "x")],
    "is no phnn.model/1": [("schema", ["phnn.model/1"]), ("", '{"schema": "' + "x" * 10**6 + '"}'),
        ("", json.dumps({f"k{i}": i for i in range(9999)}))],
    # What is no model as a whole; a part that is absent or nothing is damaged in tests/models/test_store.py.
    "not json": [
        ("", text) for text in ("", b'{"schema": "\xff"}', '{"schema": NaN}', "1" * 100_000, '{"schema": 1e99999}')],
    "stands twice": [("", '{"schema": "phnn.model/1", "schema": "phnn.model/1"}')],
    "levels deep": [("", text) for text in ("[" * 100_000, "[" * 900 + "]" * 900, '{"a":' * 5000 + "1" + "}" * 5000)],
    "at most 16.8 MB": [("", b" " * (16 * 2**20 + 1))],
    # No flag makes a negative value good.
    **{f"parameter {name} = -": [(f"parameters.{name}", {"lower": -1e9, "value": -1.0} | flags) for flags in FLAGS]
       for name in ("b", "m", "k", "C_1", "rho_1", "d_1")},
}  # fmt: skip
# What is wrong in any of the learned laws.
LEARNED: dict[str, list[tuple[str, Any]]] = {
    "no whole number from 1": [("units", units) for units in (10**9, -1, "2")], "no object": [("state", None)],
    "do not fit": [("units", 3), ("state", {}), ("state.gains", [1.0]), ("state.gains", [[[[[[1.0]]]]]])],
    "no learned law of the kind": [("kind", "active"), ("kind", ["convex"])],
    "no finite number": [("state.scale", NAN), ("state.gains", [NAN, 1.0]), ("state.gains", [MANY, 1.0])],
    "no array of numbers": [("state.gains", [[1.0], [1.0, 2.0]]), ("state.gains", "abc")],
    "must be positive": [("state.scale", -1.0), ("state.scale", 0.0)], FILE: [("state.gains", [1e9, 1e9])],
}  # fmt: skip
# Learned laws of the model, and a factor of each that has to be positive.
for law, factor in (("resistors.-2", "conductance"), ("resistors.-1", "flow"), ("storages.2", "typical")):
    for words, some in (*LEARNED.items(), ("must be positive", [(f"state.{factor}", -1.0)])):
        MODELS.setdefault(words, []).extend((f"{law}.law.{where}", value) for where, value in some)


def changed(way: tuple[str | int, ...], value: Any) -> Any:
    """Return the model with something else in one place; an object with a bound changes a parameter, not all of it."""
    at = result = copy.deepcopy(MODEL)
    for step in way[:-1]:
        at = at[int(step) if isinstance(at, list) else step]
    at[way[-1]] = at[way[-1]] | value if isinstance(value, dict) and "lower" in value else value
    return result


def predicted(attack: Attack, content: Any, words: str | None = None) -> tuple[Outcome, object]:
    """Predict with a model; return what came of it, and what of the answer is not finite or not passive."""
    (attack.root / "model").mkdir(exist_ok=True)
    put(attack.root / "model" / FILE, content if isinstance(content, str | bytes) else json.dumps(content))
    outcome = attack.run("predict", words=words)
    if outcome.status == REFUSED:
        return outcome, FILE not in outcome.err and "the file is not named"
    table = attack.root / "out" / "a.csv"
    if outcome.status == 0 and not np.isfinite(np.loadtxt(table, delimiter=",", skiprows=1)).all():
        return outcome, "not finite"
    found = violations(NetworkSubject(load(attack.root / "model")[0].network), 64)
    return outcome, (found.dissipation or found.skew or found.energy) and found


@each(MODELS)
def test_a_hostile_model(words: str, name: int, content: tuple[str, Any], attack: Attack) -> None:
    where, value = content
    outcome, wrong = predicted(attack, changed(tuple(where.split(".")), value) if where else value, words)
    assert not any(outcome.faults.values()) and not wrong, (outcome, wrong)


MANIFEST = """setup: {model: piezo_actuator, hysterons: 1}
known: {k: {value: 2.4e4, std: 10}}
columns: {voltage: {column: voltage_V, unit: V}}
start: {state: rest, input_before: 0.0}
recordings: [{file: a.csv, name: b, slice: [0, 110], use: identification, input: cubic}]
"""
WORDS = sorted({*TOP_KEYS, *_EACH, *re.findall(r"[\w.]+", NETWORK + MANIFEST + json.dumps(MODEL))})
SCALARS = st.sampled_from(WORDS) | st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
NAMES = st.sampled_from(WORDS) | st.text(max_size=5)
TREES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(NAMES, inner, max_size=4))
PIECES = st.text(max_size=6) | st.sampled_from([f" {value} " for value in VALUES]) | TREES.map(json.dumps)
NUMBERS = (st.floats(1e-9, 1e9) | st.floats() | st.integers(0, 9)).map(str)
# Places of a text, and what is put there: a number, a word, a list, a mapping, between two letters, some letters.
PLACES = {r"(?<![\w.])-?\d[\d.e+-]*": NUMBERS} | dict.fromkeys(
    (r'"[^"]*"|[\w.+-]+', r"\[[^\[\]]*\]", r"\{[^{}]*\}", "", "(?s).{1,12}"), PIECES)  # fmt: skip
WHOLE = {
    "models": st.just(json.dumps(MODEL)), "networks": st.just(NETWORK),
    "manifests": st.just(MANIFEST) | st.dictionaries(st.sampled_from(TOP_KEYS), TREES, max_size=3).map(json.dumps),
}  # fmt: skip


@pytest.mark.parametrize("kind", WHOLE)
@pytest.mark.parametrize("most", [60, pytest.param(2200, marks=pytest.mark.slow)])
def test_descriptions_with_a_damaged_place(kind: str, most: int, attack: Attack) -> None:
    def mutant(draw: Callable[..., Any]) -> tuple[Outcome, object]:
        text = draw(WHOLE[kind])
        place = draw(st.sampled_from([place for place in PLACES if re.search(place, text)]))
        first, last = draw(st.sampled_from([found.span() for found in re.finditer(place, text)]))
        text = text[:first] + draw(PLACES[place]) + text[last:]
        if kind == "models":
            return predicted(attack, text)
        if kind == "manifests":
            return attack.run(said=text), ""
        put(attack.data / "net.yaml", text)
        outcome = attack.run(said="setup: {network: net.yaml}\n")
        # Identify refuses nothing that check lets pass.
        later = attack.run("identify", "starts=1") if outcome.status == 0 else outcome
        refused = later.status == REFUSED != outcome.status
        return later if any(later.faults.values()) else outcome, refused and f"check reads it: {later.err}"

    attack.count(most, kind, mutant)
