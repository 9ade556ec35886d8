"""Hostile models and checkpoints: whoever loads one gets one that is passive, or one message."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from attack_tools import Attack, often, put, rows, zipped
from attacks import violations
from hypothesis import given
from hypothesis import strategies as st
from subjects import NetworkSubject

from phnn.errors import InputRefused
from phnn.learn import trainer
from phnn.models.actuator import hrc
from phnn.models.store import FILE, load, save
from phnn.network import Resistor, Storage
from phnn.nn import ConvexEnergyMLP, MonotoneMLP, SectorMLP
from phnn.parameters import Parameter
from phnn.setup import Block, Setup

NAN, INFINITE, MANY = float("nan"), float("inf"), 10**400
UNFINITE, UNDEFINED, TEXT = "no finite number", "is not defined", "no printable text"
LAWLESS = "no law called"
MANY_STORAGES = [{"name": f"s{i}", "law": "capacitor", "parameters": ["m"]} for i in range(20000)]
TONE = {"kind": "tone", "parameters": ["b", "b", "b"]}
# By where something is put into a model: the words of the refusal, and what is put there. None of these is passive, or
# none is a model.
WRONG: dict[str, dict[str, list[Any]]] = {
    "parameters.b": {"no object": [3]}, "parameters.b.name": {"calls itself 'm'": ["m"]},
    "parameters.b.value": {"outside its bounds": [-1.0, 0], UNFINITE: [NAN, MANY]},
    "parameters.b.positive": {"neither true nor false": [1]}, "parameters.b.mood": {"has no field 'mood'": [1]},
    "parameters.b.typical": {"its typical change is 0": [0]},
    "parameters": {"no object": [[1]], UNDEFINED: [{}], "at most 1024": [{f"p{i}": 1.0 for i in range(50000)}]},
    "name": {TEXT: [None, "\x1b[31m"]}, "storages": {"at most 256": [MANY_STORAGES]},
    "storages.0.name": {TEXT: ["\x00", ["Q"]], "rename one": ["p"], "0 characters": [""]},
    "storages.0.law": {"no learned law": [3], LAWLESS: ["eval", "dead_zone"]}, "ports.0.law": {LAWLESS: ["x"]},
    "resistors.0.parameters": {
        "takes 2 parameters": [["rho_1"], ["b"] * 9], "no list": [3], UNDEFINED: [["x", "y"]]},
    "resistors.0.on": {"refers to the storage 'x'": [{"x": 1.0}], "no object": [["Q_1"]]},
    "couplings.0.ratio": {UNFINITE: [[1], INFINITE], UNDEFINED: ["zeal"]}, "sensor": {"no object": [[3]]},
    "ports": {"no port": [[]]}, "output": {"refers to the storage 'x'": ["x"], TEXT: [["q"]]},
    "substeps": {"no whole number from 1": [0, 10**9]}, "drift_terms": {"no whole number from 0": [10**9]},
    "lines": {UNFINITE: [[NAN]], "not positive": [[-50.0]], "at most 64": [[50.0] * 10**4], "no list": ["50"]},
    "amplifier": {
        "unknown amplifier": [[{"kind": "eval", "parameters": []}], [{"kind": "drift", "parameters": ["b"]}]],
        "takes 1 parameters": [[{"kind": "lowpass", "parameters": []}]],
        "no parameter zeal": [[{"kind": "lowpass", "parameters": ["zeal"]}]],
    },
    "sources": {"no port after the first": [[TONE | {"port": port}] for port in ("voltage", "x")]},
    "memories": {LAWLESS: [[{"name": "z", "law": "eval"}]]}, "schema": {"is no phnn.model/1 file": [["phnn.model/1"]]},
    "modulations": {UNDEFINED: [[{"ratio": "x", "by": "q", "law": "affine"}]]},
}  # fmt: skip
# What is wrong in any of the learned laws of the model below, and a factor of each that has to be positive.
LEARNED: dict[str, dict[str, list[Any]]] = {
    "units": {"no whole number from 1": [10**9, -1, "2"], "do not fit": [3]},
    "state": {"no object": [None], "do not fit": [{}]},
    "kind": {"no learned law of the kind": ["active", ["convex"]]}, "state.scale": {UNFINITE: [NAN]},
    "state.gains": {
        FILE: [[1e9, 1e9]], UNFINITE: [[NAN, 1.0], [MANY, 1.0]], "do not fit": [[1.0], [[[[[[1.0]]]]]]],
        "no array of numbers": [[[1.0], [1.0, 2.0]], "abc"]},
}  # fmt: skip
# Learned laws of that model, and a factor of each that has to be positive.
LAWS = {"resistors.-2.law": "conductance", "resistors.-1.law": "flow", "storages.2.law": "typical"}
for law, factor in LAWS.items():
    WRONG |= {f"{law}.{where}": dict(some) for where, some in LEARNED.items()}
    WRONG |= {f"{law}.state.{factor}": {"must be positive": [-1.0]}}
    WRONG[f"{law}.state.scale"]["must be positive"] = [-1.0, 0.0]
# No flag makes a negative value good.
FREE, FIXED = {"lower": -1e9, "positive": False}, {"lower": -1e9, "fixed": True}
FLAGS = [{"lower": -1e9}, FREE, FIXED, FREE | FIXED]
for name in ("b", "m", "k", "C_1", "rho_1", "d_1"):
    WRONG.setdefault(f"parameters.{name}", {})[f"parameter {name} = -"] = FLAGS
# What is no model as a whole; a part that is absent or nothing is damaged in tests/models/test_store.py.
NO_MODEL: dict[str, list[str | bytes]] = {
    "not json": ["", b'{"schema": "\xff"}', '{"schema": NaN}', "1" * 100_000, '{"schema": 1e99999}'],
    "stands twice": ['{"schema": "phnn.model/1", "schema": "phnn.model/1"}'],
    "levels deep": ["[" * 100_000, "[" * 900 + "]" * 900, '{"a":' * 5000 + "1" + "}" * 5000],
    "is no phnn.model/1": ['{"schema": "' + "x" * 10**6 + '"}', json.dumps({f"k{i}": i for i in range(9999)})],
    "at most 16.8 MB": [b" " * (16 * 2**20 + 1)],
}  # fmt: skip
CASES = [(where, words, v) for where, some in WRONG.items() for words, values in some.items() for v in values]


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a model with every kind of learned law, a block before it and one behind it."""
    storages = (Storage("w", ConvexEnergyMLP(1e-6, 1.0, 2)),)
    first, second = SectorMLP(1.0, 1.0, 2), MonotoneMLP(1.0, 1.0, 2)
    resistors = (Resistor("l_1", first, {"p": 1.0}), Resistor("l_2", second, {"w": 1.0}))
    setup = Setup(hrc(1).extend(storages=storages, resistors=resistors), name="learned")
    setup = setup.with_block("amplifier", Block("lowpass", ("tau",)), (Parameter("tau", 1e-4, "s", positive=True),))
    setup = setup.with_block("sensor", Block("drift", ("r",)), (Parameter("r", 0.0, "m/s"),))
    save(setup, folder := tmp_path_factory.mktemp("learned"))
    return json.loads((folder / FILE).read_text())


def changed(content: Any, way: tuple[str | int, ...], value: Any) -> Any:
    """Return a model with something else in one place; an object takes over what is given of it."""
    at = result = copy.deepcopy(content)
    for step in way[:-1]:
        at = at[int(step) if isinstance(at, list) else step]
    at[way[-1]] = at[way[-1]] | value | {"value": -at[way[-1]]["value"]} if value in FLAGS else value
    return result


def predicted(attack: Attack, content: Any, words: str | None = None) -> str:
    """Predict with this model, whose predictions are finite; return what was said."""
    (attack.root / "model").mkdir(exist_ok=True)
    put(attack.root / "model" / FILE, content if isinstance(content, str | bytes) else json.dumps(content))
    # 1 is the right status of a model that is passive and cannot be simulated.
    outcome = attack("predict", words=words, statuses=() if words else (1,))
    if outcome.status == 0:
        assert np.isfinite(np.loadtxt(attack.root / "out" / "a.csv", delimiter=",", skiprows=1)).all()
    return outcome.err


@pytest.mark.parametrize(("where", "words", "value"), CASES)
def test_a_wrong_model_is_refused_by_name(where: str, words: str, value: Any, attack: Attack, learned: Any) -> None:
    assert FILE in predicted(attack, changed(learned, tuple(where.split(".")), value), words)


@pytest.mark.parametrize(("words", "content"), rows(NO_MODEL))
def test_what_is_no_model_is_refused_by_name(words: str, content: str | bytes, attack: Attack) -> None:
    assert FILE in predicted(attack, content, words)


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.floats(), st.text(max_size=4), st.just([]), st.just({}),
    st.lists(st.sampled_from(["q", "p", "b", 1.0]), max_size=3),
    st.sampled_from(["q", "p", "Q_1", "b", "m", "alpha", "capacitor", "linear", "dead_zone", "voltage", "V"]),
    st.sampled_from([1e-300, 1e300, -1e9]),
)  # fmt: skip


def places(content: Any, at: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Return the ways to everything in a model."""
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [p for key, value in items for p in ((*at, key), *places(value, (*at, key)))]


def check_passive(folder: Path) -> None:
    """Assert that what is loaded takes energy up, wherever it is."""
    found = violations(NetworkSubject(load(folder)[0].network), 64)
    assert not (found.dissipation or found.skew or found.energy), found


@often(60)
@given(data=st.data())
def test_models_with_something_at_random(data: st.DataObject, attack: Attack, learned: Any) -> None:
    predicted(attack, changed(learned, data.draw(st.sampled_from(places(learned))), data.draw(VALUES)))
    with contextlib.suppress(InputRefused):
        check_passive(attack.root / "model")


def test_what_was_saved_is_loaded_and_passive(attack: Attack, learned: Any) -> None:
    predicted(attack, learned, words="")
    check_passive(attack.root / "model")


class _Runs:
    def __reduce__(self) -> Any:
        return (eval, ("__import__('pathlib').Path('ran').write_text('')",))


def _saved(content: Any) -> bytes:
    torch.save(content, file := io.BytesIO())
    return file.getvalue()


STATE = {
    "schema": "phnn.checkpoint/1", "random": torch.get_rng_state(), "settings": {}, "progress": {}, "present": [],
    "method": None,
}  # fmt: skip
VERSION, PICKLE = ("archive/version", b"3"), pickle.dumps(_Runs())
# By the words of the refusal.
CHECKPOINTS: dict[str, list[bytes]] = {
    "cannot be read": [
        b"", bytes(4096), PICKLE, zipped(), _saved(STATE | {"x": np.zeros(3)}), _saved(STATE)[:-800],
        zipped(("archive/data.pkl", PICKLE), VERSION), zipped(("archive/data.pkl", b"\x80\x02}"), VERSION),
    ],
    "is no phnn.checkpoint/1": [_saved([1, 2]), _saved(STATE | {"schema": "x"})],
    "holds no 'random'": [_saved({"schema": STATE["schema"]})],
    "its state of the random generator": [
        _saved(STATE | {"random": wrong}) for wrong in (3, torch.zeros(0), torch.zeros(5056))],
}  # fmt: skip


@pytest.mark.parametrize(("words", "content"), rows(CHECKPOINTS))
def test_a_checkpoint_that_is_none_is_refused_and_never_run(words: str, content: bytes, attack: Attack) -> None:
    put(attack.data / trainer.FILE, content)
    with pytest.raises(InputRefused, match=f"{words}.*delete it to begin anew"):
        trainer.load(attack.data / trainer.FILE)
    assert not list(attack.root.rglob("ran"))
