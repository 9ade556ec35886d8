"""Hostile models and checkpoints: whoever loads one gets one that is passive, or one message."""

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
from attack_tools import Attack, often, put, zipped
from hypothesis import given
from hypothesis import strategies as st

from phnn.errors import InputRefused
from phnn.laws.neural import DampingMLP, EnergyMLP, MonotoneMLP
from phnn.learn import checkpoint
from phnn.models.actuator import hrc
from phnn.models.store import FILE, load, save
from phnn.network import PortHamiltonianSystem, Resistor, Storage
from phnn.parameters import Parameter
from phnn.setup import Block, Setup


def learned() -> Setup:
    """A model with every kind of learned law, a block before it and one behind it."""
    base = hrc(1)
    network = base.extend(
        storages=(Storage("w", EnergyMLP(1e-6, 1.0, 2)),),
        resistors=(
            Resistor("l_1", DampingMLP(1.0, 1.0, 2), {"p": 1.0}),
            Resistor("l_2", MonotoneMLP(1.0, 1.0, 2), {"w": 1.0}),
        ),
    )
    setup = Setup(network, name="learned")
    setup = setup.with_block("amplifier", Block("lowpass", ("tau",)), (Parameter("tau", 1e-4, "s", positive=True),))
    return setup.with_block("sensor", Block("drift", ("r",)), (Parameter("r", 0.0, "m/s"),))


def content_of(setup: Setup, folder: Path) -> dict[str, Any]:
    save(setup, folder)
    return json.loads((folder / FILE).read_text())


BASE = "base"
# Where something is put into a model, and what: none of these is passive, or none is a model.
WRONG: dict[str, tuple[tuple[str | int, ...], Any]] = {
    "a negative damping": (("parameters", "b", "value"), -1.0),
    "a negative mass": (("parameters", "m", "value"), -1e-3),
    "no mass": (("parameters", "m", "value"), 0),
    "a negative stiffness": (("parameters", "k", "value"), -1.0),
    "a negative slope": (("parameters", "rho_1", "value"), -1.0),
    "NaN": (("parameters", "b", "value"), float("nan")),
    "infinite": (("parameters", "b", "value"), float("inf")),
    "a text": (("parameters", "b", "value"), "b"),
    "400 digits": (("parameters", "b", "value"), 10**400),
    "a flag": (("parameters", "b", "value"), True),
    "a flag that is none": (("parameters", "b", "positive"), 1),
    "bounds as texts": (("parameters", "b", "lower"), "0"),
    "a typical change of zero": (("parameters", "b", "typical"), 0),
    "another name": (("parameters", "b", "name"), "m"),
    "an unknown field": (("parameters", "b", "mood"), 1),
    "a parameter that is none": (("parameters", "b"), 3),
    "parameters in a list": (("parameters",), [1]),
    "no parameters": (("parameters",), {}),
    "no name": (("name",), None),
    "a name with an escape code": (("name",), "\x1b[31m"),
    "a name of a storage": (("storages", 0, "name"), "\x00"),
    "two of one name": (("storages", 0, "name"), "p"),
    "an empty name": (("storages", 0, "name"), ""),
    "a list as a name": (("storages", 0, "name"), ["Q"]),
    "a law that is none": (("storages", 0, "law"), 3),
    "an unknown law": (("storages", 0, "law"), "eval"),
    "a law of another kind": (("storages", 0, "law"), "dead_zone"),
    "too few parameters": (("resistors", 0, "parameters"), ["rho_1"]),
    "too many": (("resistors", 0, "parameters"), ["b"] * 9),
    "parameters that are none": (("resistors", 0, "parameters"), 3),
    "an unknown one": (("resistors", 0, "parameters"), ["x", "y"]),
    "a ratio of NaN": (("resistors", 0, "on", "Q_1"), float("nan")),
    "on nothing": (("resistors", 0, "on"), {"x": 1.0}),
    "on a list": (("resistors", 0, "on"), ["Q_1"]),
    "a ratio that is a list": (("couplings", 0, "ratio"), [1]),
    "an unknown ratio": (("couplings", 0, "ratio"), "zeal"),
    "an infinite ratio": (("couplings", 0, "ratio"), float("inf")),
    "coupled to nothing": (("couplings", 0, "of"), "x"),
    "no ports": (("ports",), []),
    "a port law": (("ports", 0, "law"), "x"),
    "an unknown output": (("output",), "x"),
    "an output that is a list": (("output",), ["q"]),
    "no substeps": (("substeps",), 0),
    "negative substeps": (("substeps",), -3),
    "many substeps": (("substeps",), 10**9),
    "half a substep": (("substeps",), 1.5),
    "substeps as a text": (("substeps",), "1"),
    "a billion drift terms": (("drift_terms",), 10**9),
    "negative drift terms": (("drift_terms",), -1),
    "lines of NaN": (("lines",), [float("nan")]),
    "negative lines": (("lines",), [-50.0]),
    "many lines": (("lines",), [50.0] * 10**4),
    "lines that are none": (("lines",), "50"),
    "an unknown block": (("amplifier",), [{"kind": "eval", "parameters": []}]),
    "a block without parameters": (("amplifier",), [{"kind": "lowpass", "parameters": []}]),
    "with unknown ones": (("amplifier",), [{"kind": "lowpass", "parameters": ["zeal"]}]),
    "a block that is none": (("sensor",), [3]),
    "a sensor among the amplifiers": (("amplifier",), [{"kind": "drift", "parameters": ["b"]}]),
    "a source on the input": (("sources",), [{"kind": "tone", "port": "voltage", "parameters": ["b", "b", "b"]}]),
    "a source on nothing": (("sources",), [{"kind": "tone", "port": "x", "parameters": ["b", "b", "b"]}]),
    "a memory of an unknown law": (("memories",), [{"name": "z", "law": "eval"}]),
    "a modulation of nothing": (("modulations",), [{"ratio": "x", "by": "q", "law": "affine"}]),
    "another schema": (("schema",), "phnn.model/2"),
    "a schema that is a list": (("schema",), ["phnn.model/1"]),
    "many storages": (
        ("storages",),
        [{"name": f"s{i}", "law": "capacitor", "parameters": ["m"]} for i in range(20000)],
    ),
    "many parameters": (("parameters",), {f"p{i}": 1.0 for i in range(50000)}),
    "nothing as resistors": (("resistors",), None),
}
LEARNED: dict[str, tuple[tuple[str | int, ...], Any]] = {
    "a billion units": (("units",), 10**9), "minus one": (("units",), -1), "another number": (("units",), 3),
    "a text": (("units",), "2"), "an unknown kind": (("kind",), "active"),
    "a kind that is a list": (("kind",), ["convex"]), "no state": (("state",), None),
    "a negative scale": (("state", "scale"), -1.0), "no scale": (("state", "scale"), 0.0),
    "a scale of NaN": (("state", "scale"), float("nan")), "a weight beyond use": (("state", "gains"), [1e9, 1e9]),
    "a weight of NaN": (("state", "gains"), [float("nan"), 1.0]),
    "weights of another shape": (("state", "gains"), [1.0]),
    "ragged weights": (("state", "gains"), [[1.0], [1.0, 2.0]]), "a text as weights": (("state", "gains"), "abc"),
    "weights of 400 digits": (("state", "gains"), [10**400, 1.0]),
    "nested weights": (("state", "gains"), [[[[[[1.0]]]]]]),
}  # fmt: skip
SIGNED = {"damping": "conductance", "monotone": "flow", "convex": "typical"}


def put_in(content: Any, where: tuple[str | int, ...], value: Any) -> Any:
    changed = copy.deepcopy(content)
    at = changed
    for step in where[:-1]:
        at = at[step]
    at[where[-1]] = value
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


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_model_is_refused_by_name(case: str, attack: Attack, good: Path, model: dict[str, Any]) -> None:
    outcome = predicted(attack, good, put_in(model, *WRONG[case]))
    assert outcome.refused, case
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


@pytest.mark.parametrize("law", ["convex", "damping", "monotone"])
@pytest.mark.parametrize("case", [*LEARNED, "a negative magnitude"])
def test_a_wrong_learned_law_is_refused(law: str, case: str, attack: Attack, good: Path, tmp_path: Path) -> None:
    content = content_of(learned(), tmp_path / "model")
    where, value = (("state", SIGNED[law]), -1.0) if case == "a negative magnitude" else LEARNED[case]
    elements = [e for key in ("storages", "resistors") for e in content[key] if isinstance(e["law"], dict)]
    element = next(e for e in elements if e["law"]["kind"] == law)
    element["law"] = put_in(element["law"], where, value)
    assert predicted(attack, good, content).refused


TEXTS = {
    "empty": "", "a number": "3", "a list": "[]", "a text": '"model"', "deep": "[" * 100_000,
    "deep and closed": "[" * 900 + "]" * 900, "deep objects": '{"a":' * 5000 + "1" + "}" * 5000,
    "a key twice": '{"schema": "phnn.model/1", "schema": "phnn.model/1"}', "not UTF-8": b'{"schema": "\xff"}',
    "UTF-16": '{"schema": 1}'.encode("utf-16"), "NUL": b"\0" * 100, "cut": '{"schema": "phnn',
    "NaN": '{"schema": NaN}', "a comment": "// model\n{}", "too large": b" " * (16 * 2**20 + 1),
    "a huge text": '{"schema": "' + "x" * 10**6 + '"}', "many keys": json.dumps({f"k{i}": i for i in range(50_000)}),
    "long digits": "1" * 100_000, "a surrogate": '{"schema": "\\ud800"}', "an exponent": '{"schema": 1e99999}',
    "only a schema": '{"schema": "phnn.model/1"}',
}  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_that_is_no_model(text: str, attack: Attack, good: Path) -> None:
    assert predicted(attack, good, TEXTS[text]).refused


VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.floats(),
    st.text(max_size=4),
    st.just([]),
    st.just({}),
    st.sampled_from(
        ["q", "p", "Q_1", "b", "m", "alpha", "capacitor", "linear", "dead_zone", "voltage", "V", 1e-300, 1e300, -1e9]
    ),
    st.lists(st.sampled_from(["q", "p", "b", 1.0]), max_size=3),
)


def places(content: Any, at: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [p for key, value in items for p in ((*at, key), *places(value, (*at, key)))]


@often(120)
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
    put(tmp_path / checkpoint.FILE, CHECKPOINTS[case])
    with pytest.raises(InputRefused, match="delete it to begin anew"):
        checkpoint.load(tmp_path / checkpoint.FILE, ("settings", "progress"))
    assert [p.name for p in tmp_path.iterdir()] == [checkpoint.FILE]
