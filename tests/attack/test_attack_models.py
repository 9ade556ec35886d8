"""Hostile models, networks and checkpoints: whoever loads one gets one that is passive, or one message."""

from __future__ import annotations

import copy
import io
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from attack_tools import Attack, often, put, quick, zipped
from hypothesis import given
from hypothesis import strategies as st

from phnn.errors import InputRefused
from phnn.learn import trainer
from phnn.models.actuator import hrc
from phnn.models.store import FILE, load, save
from phnn.network import PortHamiltonianSystem, Resistor, Storage
from phnn.nn import ConvexEnergyMLP, MonotoneMLP, SectorMLP
from phnn.parameters import Parameter
from phnn.setup import Block, Setup


def learned() -> Setup:
    """A model with every kind of learned law, a block before it and one behind it."""
    base = hrc(1)
    network = base.extend(
        storages=(Storage("w", ConvexEnergyMLP(1e-6, 1.0, 2)),),
        resistors=(
            Resistor("l_1", SectorMLP(1.0, 1.0, 2), {"p": 1.0}),
            Resistor("l_2", MonotoneMLP(1.0, 1.0, 2), {"w": 1.0}),
        ),
    )
    setup = Setup(network, name="learned")
    setup = setup.with_block("amplifier", Block("lowpass", ("tau",)), (Parameter("tau", 1e-4, "s", positive=True),))
    return setup.with_block("sensor", Block("drift", ("r",)), (Parameter("r", 0.0, "m/s"),))


def content_of(setup: Setup, folder: Path) -> dict[str, Any]:
    save(setup, folder)
    return json.loads((folder / FILE).read_text())


NAN, INFINITE = float("nan"), float("inf")
# Where something is put into a model, and what: none of these is passive, or none is a model.
WRONG: dict[str, list[Any]] = {
    "parameters.b.value": [-1.0, 0, NAN, 10**400],
    "parameters.b.positive": [1],
    "parameters.b.typical": [0],
    "parameters.b.name": ["m"],
    "parameters.b.mood": [1],
    "parameters.b": [3],
    "parameters": [[1], {}, {f"p{i}": 1.0 for i in range(50000)}],
    "name": [None, "\x1b[31m"],
    "storages.0.name": ["\x00", "p", "", ["Q"]],
    "storages.0.law": [3, "eval", "dead_zone"],
    "resistors.0.parameters": [["rho_1"], ["b"] * 9, 3, ["x", "y"]],
    "resistors.0.on": [{"x": 1.0}, ["Q_1"]],
    "couplings.0.ratio": [[1], "zeal", INFINITE],
    "ports": [[]],
    "ports.0.law": ["x"],
    "output": ["x", ["q"]],
    "substeps": [0, 10**9],
    "drift_terms": [10**9],
    "lines": [[NAN], [-50.0], [50.0] * 10**4, "50"],
    "amplifier": [[{"kind": k, "parameters": p}] for k, p in (
        ("eval", []), ("lowpass", []), ("lowpass", ["zeal"]), ("drift", ["b"]))],
    "sensor": [[3]],
    "sources": [[{"kind": "tone", "port": port, "parameters": ["b", "b", "b"]}] for port in ("voltage", "x")],
    "memories": [[{"name": "z", "law": "eval"}]],
    "modulations": [[{"ratio": "x", "by": "q", "law": "affine"}]],
    "schema": ["phnn.model/2", ["phnn.model/1"]],
    "storages": [[{"name": f"s{i}", "law": "capacitor", "parameters": ["m"]} for i in range(20000)]],
    "resistors": [None],
}  # fmt: skip
LEARNED: dict[str, list[Any]] = {
    "units": [10**9, -1, 3, "2"], "kind": ["active", ["convex"]], "state": [None, {}], "state.scale": [-1.0, 0.0, NAN],
    "state.gains": [[1e9, 1e9], [NAN, 1.0], [1.0], [[1.0], [1.0, 2.0]], "abc", [10**400, 1.0], [[[[[[1.0]]]]]]],
}  # fmt: skip
SIGNED = {"damping": "conductance", "monotone": "flow", "convex": "typical"}


def numbered(cases: dict[str, list[Any]]) -> list[tuple[str, int]]:
    """Place and number of every value."""
    return [(where, i) for where, values in cases.items() for i in range(len(values))]


def put_in(content: Any, where: str | tuple[str | int, ...], value: Any) -> Any:
    *way, last = where.split(".") if isinstance(where, str) else where
    at = changed = copy.deepcopy(content)
    for step in way:
        at = at[int(step) if isinstance(at, list) else step]
    at[last] = value
    return changed


def predicted(attack: Attack, good: Path, content: Any) -> Any:
    (good.parent / "model").mkdir(exist_ok=True)
    text = content if isinstance(content, str | bytes) else json.dumps(content)
    put(good.parent / "model" / FILE, text)
    # 1 is the right status of a model that is passive and cannot be simulated.
    outcome = attack(good, "predict", model=good.parent / "model", statuses=(0, 1, 2))
    if outcome.status == 0:
        assert np.isfinite(np.loadtxt(good.parent / "out" / "a.csv", delimiter=",", skiprows=1)).all()
    return outcome


@pytest.fixture
def model(tmp_path: Path) -> dict[str, Any]:
    return content_of(Setup(hrc(1)), tmp_path / "model")


@pytest.mark.parametrize(("where", "i"), numbered(WRONG))
def test_a_wrong_model_is_refused_by_name(
    where: str, i: int, attack: Attack, good: Path, model: dict[str, Any]
) -> None:
    outcome = predicted(attack, good, put_in(model, where, WRONG[where][i]))
    assert outcome.refused
    assert FILE in outcome.err


@pytest.mark.parametrize(
    "flags", [{"positive": False}, {"fixed": True}, {"lower": -1e9}, {"positive": False, "fixed": True}]
)
@pytest.mark.parametrize("name", ["b", "m", "k", "C_1", "rho_1", "d_1"])
def test_no_flag_makes_a_negative_value_good(
    name: str, flags: dict[str, Any], attack: Attack, good: Path, model: dict[str, Any]
) -> None:
    was = model["parameters"][name]
    model["parameters"][name] = was | flags | {"value": -abs(was["value"]), "lower": -1e9}
    outcome = predicted(attack, good, model)
    assert outcome.refused
    assert name in outcome.err


@pytest.mark.parametrize("law", quick(["damping"], "convex", "monotone"))
@pytest.mark.parametrize(("where", "i"), [*numbered(LEARNED), ("", 0)])
def test_a_wrong_learned_law_is_refused(
    law: str, where: str, i: int, attack: Attack, good: Path, tmp_path: Path
) -> None:
    content = content_of(learned(), tmp_path / "model")
    where, value = (where, LEARNED[where][i]) if where else (f"state.{SIGNED[law]}", -1.0)
    elements = [e for key in ("storages", "resistors") for e in content[key] if isinstance(e["law"], dict)]
    element = next(e for e in elements if e["law"]["kind"] == law)
    element["law"] = put_in(element["law"], where, value)
    assert predicted(attack, good, content).refused


TEXTS: list[str | bytes] = [
    "", "3", "[" * 100_000, "[" * 900 + "]" * 900, '{"a":' * 5000 + "1" + "}" * 5000,
    '{"schema": "phnn.model/1", "schema": "phnn.model/1"}', b'{"schema": "\xff"}', '{"schema": NaN}',
    b" " * (16 * 2**20 + 1), '{"schema": "' + "x" * 10**6 + '"}', json.dumps({f"k{i}": i for i in range(50_000)}),
    "1" * 100_000, '{"schema": 1e99999}', '{"schema": "phnn.model/1"}',
]  # fmt: skip


@pytest.mark.parametrize("text", range(len(TEXTS)))
def test_a_text_that_is_no_model(text: int, attack: Attack, good: Path) -> None:
    assert predicted(attack, good, TEXTS[text]).refused


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.floats(), st.text(max_size=4), st.just([]), st.just({}),
    st.lists(st.sampled_from(["q", "p", "b", 1.0]), max_size=3),
    st.sampled_from(["q", "p", "Q_1", "b", "m", "alpha", "capacitor", "linear", "dead_zone", "voltage", "V"]),
    st.sampled_from([1e-300, 1e300, -1e9]),
)  # fmt: skip


def places(content: Any, at: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [p for key, value in items for p in ((*at, key), *places(value, (*at, key)))]


@often(40)
@given(data=st.data())
def test_models_with_something_at_random(
    data: st.DataObject, attack: Attack, good: Path, model: dict[str, Any]
) -> None:
    where, value = data.draw(st.sampled_from(places(model))), data.draw(VALUES)
    predicted(attack, good, put_in(model, where, value))
    try:
        setup, _ = load(good.parent / "model")
    except InputRefused:
        return
    passive(setup)


def passive(setup: Setup) -> None:
    """What was loaded takes energy up, wherever it is."""
    system = PortHamiltonianSystem(setup.network)
    scale = torch.tensor([1e-6] * len(setup.network.state_names), dtype=torch.float64)
    x = scale * torch.randn((64, scale.numel()), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    with torch.no_grad():
        d, h = system.dissipation(x), system.energy(x)
        j = system.structure(x)
        least = torch.linalg.eigvalsh(0.5 * (d + d.mT))[:, 0]
    size = d.abs().amax()
    assert bool((least >= -1e-9 * size).all())
    assert bool((j + j.mT == 0.0).all())
    assert bool((h >= 0.0).all())


def test_what_was_saved_is_loaded_and_passive(tmp_path: Path, attack: Attack, good: Path) -> None:
    save(learned(), tmp_path / "model")
    assert attack(good, "predict", model=tmp_path / "model").status == 0
    setup, _ = load(tmp_path / "model")
    passive(setup)


class _Runs:
    def __reduce__(self) -> Any:
        return (eval, ("__import__('pathlib').Path('ran').write_text('')",))


def _saved(content: Any) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


STATE = {"schema": "phnn.checkpoint/1", "random": torch.get_rng_state()}
CHECKPOINTS = {
    "empty": b"", "a text": b"checkpoint", "zeros": bytes(4096), "a list": _saved([1, 2]),
    "no schema": _saved({"random": 1}), "another schema": _saved({**STATE, "schema": "x"}),
    "no random state": _saved({"schema": STATE["schema"]}),
    "a random state that is none": _saved({**STATE, "random": 3}),
    "an empty one": _saved({**STATE, "random": torch.zeros(0)}),
    "of another type": _saved({**STATE, "random": torch.zeros(5056)}), "no keys": _saved(STATE),
    "a pickle": pickle.dumps(_Runs()),
    "a pickle in a zip": zipped({"archive/data.pkl": pickle.dumps(_Runs()), "archive/version": b"3"}),
    "an empty zip": zipped({}), "a zip bomb": zipped({"archive/data.pkl": b"\x80\x02}", "archive/version": b"3"}),
    "a tensor that is not there": _saved(STATE)[:-800], "a numpy array": _saved({**STATE, "x": np.zeros(3)}),
}  # fmt: skip


@pytest.mark.parametrize("case", CHECKPOINTS)
def test_a_checkpoint_that_is_none_is_refused_and_never_run(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    put(tmp_path / trainer.FILE, CHECKPOINTS[case])
    with pytest.raises(InputRefused, match="delete it to begin anew"):
        trainer.load(tmp_path / trainer.FILE, ("settings", "progress"))
    assert [p.name for p in tmp_path.iterdir()] == [trainer.FILE]


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
        "m: {value: .nan}", "m: {value: 1e-320}", "m: {value: 1e308}", "m: {value: " + "9" * 400 + "}",
        "m: {value: 2, lower: 3}", "m: {value: 2, typical: 0}", "m: {unit: kg}", "m: {worth: 2}", "m: null",
    ],
    B: ["b: {value: -0.5, lower: -1, upper: 1} #", "b: {value: -0.5,", "idle: {value: 1}\n  b: {value: 0.5,"],
    "junctions: {mass: 1}": ["junctions: {}"],
    "mass: 1}": ["mass: 2}"],
    "{mass: 1}": ["[mass]"],
    "elements:": ["elements: {}\nabout:"],
    "  force:  {type: Se, junction: mass, unit: V}\n": [""],
    "type: Se": ["type: Sf"],
    "unit: V}": ["unit: V, sign: 2}"],
    "type: C": ["type: X"],
    "law: spring": ['law: "\\e[31m"'],
    "[k]": ["[zeal]"],
    "C, junction: mass,": ["C,"],
    "output: q": [
        "output: [q]", "", "output: q\nwings: 2", "output: " + "q" * 500,
        "output: !!python/name:os.system", "output: q\n" + ALIASES,
    ],
    "bonds: []": [
        "bonds: [{from: mass, to: x}]", "bonds: [3]", "bonds: 3",
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


UNFIT = (
    "ports: {nobody: {column: voltage_V, unit: V}}", "outputs: {nobody: {column: displacement_m, unit: m}}",
    "ports: {force: {column: voltage_V, unit: V}}", "known: {m: 0}", "known: {zeal: 1}", "known: {k: .nan}",
    'ports: {"\\e[1m": {column: voltage_V, unit: V}}', "outputs: {p: {column: nobody, unit: m}}",
    "recordings: [{file: a.csv, use: confirmation}]",
)  # fmt: skip


@pytest.mark.parametrize(("old", "new", "said"), [
    *((old, new, "") for old, some in BROKEN.items() for new in some), *((GOOD, GOOD, said) for said in UNFIT),
])  # fmt: skip
def test_check_refuses_a_broken_network_and_what_does_not_fit_one_as_identify_does(
    old: str, new: str, said: str, attack: Attack, good: Path
) -> None:
    assert old in GOOD
    described(good, GOOD.replace(old, new, 1), said)
    checked = attack(good)
    assert checked.refused
    assert attack(good, "identify").err == checked.err


def test_check_lets_a_good_network_pass(attack: Attack, good: Path) -> None:
    described(good, GOOD)
    assert attack(good).status == 0


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


@pytest.mark.parametrize(("count", "bonds"), [(2, True), (60, True), (257, True), (257, False), (5000, True)])
def test_networks_of_any_size_end(count: int, bonds: bool, attack: Attack, good: Path) -> None:
    described(good, chain(count, bonds))
    attack(good)


VALUES_NETWORKS = st.sampled_from([
    "0", "1", "-1", "1e-200", "1e200", ".nan", "true", "null", "[]", "{}", "q", "mass", "k", "''", "[k]", "{a: 1}",
    "1e-9", "'1/k'", "linear", "capacitor", "spring", "C", "Se", '"\\0"',
])  # fmt: skip
PLACES = [i for i, c in enumerate(GOOD) if c in " {}[],:\n"]


@often(30)
@given(at=st.sampled_from(PLACES), cut=st.integers(0, 9), piece=VALUES_NETWORKS)
def test_networks_with_a_damaged_place(at: int, cut: int, piece: str, attack: Attack, good: Path) -> None:
    described(good, GOOD[:at] + f" {piece} " + GOOD[at + cut :])
    attack(good)


@pytest.mark.slow
@often(150)
@given(at=st.sampled_from(PLACES), cut=st.integers(0, 9), piece=VALUES_NETWORKS)
def test_identify_refuses_nothing_that_check_lets_pass(
    at: int, cut: int, piece: str, attack: Attack, good: Path
) -> None:
    described(good, GOOD[:at] + f" {piece} " + GOOD[at + cut :])
    if attack(good).status == 0:
        # Values far from the recordings may make a fit fail; that is no fault of the file.
        assert attack(good, "identify", more=("starts=1",), statuses=(0, 1)).status != 2
