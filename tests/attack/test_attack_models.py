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
from attack_tools import Attack, often, put, zipped
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
POSITIVE, UNDEFINED, TEXT = "must be positive", "is not defined", "no printable text"
# Where something is put into a model (nowhere: in its place), the words of the refusal, and what is put there: none
# of these is passive, or none is a model.
WRONG: list[tuple[Any, ...]] = [
    ("parameters.b.value", "outside its bounds", -1.0, 0), ("parameters.b.value", "no finite number", NAN),
    ("parameters.b.value", "no finite number", MANY), ("parameters.b.positive", "neither true nor false", 1),
    ("parameters.b.typical", "its typical change is 0", 0), ("parameters.b.name", "calls itself 'm'", "m"),
    ("parameters.b.mood", "has no field 'mood'", 1), ("parameters.b", "no object", 3), ("parameters", "no object", [1]),
    ("parameters", UNDEFINED, {}), ("parameters", "at most 1024", {f"p{i}": 1.0 for i in range(50000)}),
    ("name", TEXT, None, "\x1b[31m"), ("storages.0.name", TEXT, "\x00", ["Q"]),
    ("storages.0.name", "rename one", "p"), ("storages.0.name", "0 characters", ""),
    ("storages.0.law", "no learned law", 3), ("storages.0.law", "no law called", "eval", "dead_zone"),
    ("resistors.0.parameters", "takes 2 parameters", ["rho_1"], ["b"] * 9), ("resistors.0.parameters", "no list", 3),
    ("resistors.0.parameters", UNDEFINED, ["x", "y"]), ("resistors.0.on", "refers to the storage 'x'", {"x": 1.0}),
    ("resistors.0.on", "no object", ["Q_1"]), ("couplings.0.ratio", "no finite number", [1]),
    ("couplings.0.ratio", UNDEFINED, "zeal"), ("couplings.0.ratio", "no finite number", INFINITE),
    ("ports", "no port", []), ("ports.0.law", "no law called", "x"), ("output", "refers to the storage 'x'", "x"),
    ("output", TEXT, ["q"]), ("substeps", "no whole number from 1", 0, 10**9),
    ("drift_terms", "no whole number from 0", 10**9), ("lines", "no finite number", [NAN]),
    ("lines", "not positive", [-50.0]), ("lines", "at most 64", [50.0] * 10**4), ("lines", "no list", "50"),
    ("amplifier", "unknown amplifier", [{"kind": "eval", "parameters": []}], [{"kind": "drift", "parameters": ["b"]}]),
    ("amplifier", "takes 1 parameters", [{"kind": "lowpass", "parameters": []}]),
    ("amplifier", "no parameter zeal", [{"kind": "lowpass", "parameters": ["zeal"]}]), ("sensor", "no object", [3]),
    *(("sources", "no port after the first", [{"kind": "tone", "port": port, "parameters": ["b", "b", "b"]}])
      for port in ("voltage", "x")),
    ("memories", "no law called", [{"name": "z", "law": "eval"}]),
    ("modulations", UNDEFINED, [{"ratio": "x", "by": "q", "law": "affine"}]),
    ("schema", "is no phnn.model/1 file", "phnn.model/2", ["phnn.model/1"]), ("resistors", "no list", None),
    ("storages", "at most 256", [{"name": f"s{i}", "law": "capacitor", "parameters": ["m"]} for i in range(20000)]),
    # No flag makes a negative value good.
    *((f"parameters.{name}", f"parameter {name} = -", lambda was, flags=flags: was | flags | {"value": -was["value"]})
      for name in ("b", "m", "k", "C_1", "rho_1", "d_1") for flags in (
        {"lower": -1e9, "positive": False}, {"lower": -1e9, "fixed": True}, {"lower": -1e9},
        {"lower": -1e9, "positive": False, "fixed": True})),
    ("", "not json", "", b'{"schema": "\xff"}', '{"schema": NaN}', "1" * 100_000, '{"schema": 1e99999}'),
    ("", "stands twice", '{"schema": "phnn.model/1", "schema": "phnn.model/1"}'),
    ("", "levels deep", "[" * 100_000, "[" * 900 + "]" * 900, '{"a":' * 5000 + "1" + "}" * 5000),
    ("", "is no phnn.model/1", "3", '{"schema": "' + "x" * 10**6 + '"}', json.dumps({f"k{i}": i for i in range(9999)})),
    ("", "at most 16.8 MB", b" " * (16 * 2**20 + 1)), ("", "no 'storages'", '{"schema": "phnn.model/1"}'),
]  # fmt: skip
# Learned laws of the model below, a factor that has to be positive, and what is wrong in any of them.
LAWS = {"resistors.-2.law": "conductance", "resistors.-1.law": "flow", "storages.2.law": "typical"}
LEARNED: list[tuple[Any, ...]] = [
    ("units", "no whole number from 1", 10**9, -1, "2"), ("units", "do not fit", 3), ("state", "no object", None),
    ("kind", "no learned law of the kind", "active", ["convex"]), ("state", "do not fit", {}),
    ("state.scale", POSITIVE, -1.0, 0.0), ("state.scale", "no finite number", NAN),
    ("state.gains", FILE, [1e9, 1e9]), ("state.gains", "no finite number", [NAN, 1.0]),
    ("state.gains", "do not fit", [1.0], [[[[[[1.0]]]]]]), ("state.gains", "no finite number", [MANY, 1.0]),
    ("state.gains", "no array of numbers", [[1.0], [1.0, 2.0]], "abc"),
]  # fmt: skip
WRONG += [(f"{law}.{where}", *others) for law in LAWS for where, *others in LEARNED]
WRONG += [(f"{law}.state.{factor}", POSITIVE, -1.0) for law, factor in LAWS.items()]


def _content(setup: Setup, folder: Path) -> Any:
    save(setup, folder)
    return json.loads((folder / FILE).read_text())


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a model without learned laws."""
    return _content(Setup(hrc(1)), tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a model with every kind of learned law, a block before it and one behind it."""
    network = hrc(1)
    network = network.extend(
        storages=(Storage("w", ConvexEnergyMLP(1e-6, 1.0, 2)),),
        resistors=(
            Resistor("l_1", SectorMLP(1.0, 1.0, 2), {"p": 1.0}),
            Resistor("l_2", MonotoneMLP(1.0, 1.0, 2), {"w": 1.0}),
        ),
    )
    setup = Setup(network, name="learned")
    setup = setup.with_block("amplifier", Block("lowpass", ("tau",)), (Parameter("tau", 1e-4, "s", positive=True),))
    setup = setup.with_block("sensor", Block("drift", ("r",)), (Parameter("r", 0.0, "m/s"),))
    return _content(setup, tmp_path_factory.mktemp("learned"))


def changed(content: Any, where: str | tuple[str | int, ...], value: Any) -> Any:
    """Return a model with something else in one place."""
    *way, last = where.split(".") if isinstance(where, str) else where
    at = result = copy.deepcopy(content)
    for step in way:
        at = at[int(step) if isinstance(at, list) else step]
    at[last] = value(at[last]) if callable(value) else value
    return result


def predicted(attack: Attack, good: Path, content: Any, words: str | None = None) -> str:
    """Predict with this model, whose predictions are finite; return what was said."""
    (good.parent / "model").mkdir(exist_ok=True)
    put(good.parent / "model" / FILE, content if isinstance(content, str | bytes) else json.dumps(content))
    # 1 is the right status of a model that is passive and cannot be simulated.
    outcome = attack(good, "predict", words=words, statuses=() if words else (1,))
    if outcome.status == 0:
        assert np.isfinite(np.loadtxt(good.parent / "out" / "a.csv", delimiter=",", skiprows=1)).all()
    return outcome.err


@pytest.mark.parametrize(("where", "words", "value"), [(w, words, v) for w, words, *values in WRONG for v in values])
def test_a_wrong_model_is_refused_by_name(
    where: str, words: str, value: Any, attack: Attack, good: Path, learned: Any
) -> None:
    assert FILE in predicted(attack, good, changed(learned, where, value) if where else value, words)


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


@often(40)
@given(data=st.data())
def test_models_with_something_at_random(data: st.DataObject, attack: Attack, good: Path, plain: Any) -> None:
    predicted(attack, good, changed(plain, data.draw(st.sampled_from(places(plain))), data.draw(VALUES)))
    with contextlib.suppress(InputRefused):
        check_passive(good.parent / "model")


def test_what_was_saved_is_loaded_and_passive(attack: Attack, good: Path, learned: Any) -> None:
    predicted(attack, good, learned, words="")
    check_passive(good.parent / "model")


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
    "no schema": _saved({"random": 1}), "another schema": _saved(STATE | {"schema": "x"}),
    "no random state": _saved({"schema": STATE["schema"]}), "no keys": _saved(STATE),
    "a random state that is none": _saved(STATE | {"random": 3}), "a pickle": pickle.dumps(_Runs()),
    "an empty one": _saved(STATE | {"random": torch.zeros(0)}),
    "of another type": _saved(STATE | {"random": torch.zeros(5056)}),
    "a pickle in a zip": zipped([("archive/data.pkl", pickle.dumps(_Runs())), ("archive/version", b"3")]),
    "an empty zip": zipped([]), "no content": zipped([("archive/data.pkl", b"\x80\x02}"), ("archive/version", b"3")]),
    "a tensor that is not there": _saved(STATE)[:-800], "a numpy array": _saved(STATE | {"x": np.zeros(3)}),
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
