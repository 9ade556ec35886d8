"""Models on disk: a setup as one readable json file, every field of the type that its plain dataclass declares."""

from __future__ import annotations

import json
import math
import os
import typing
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import MISSING, asdict, fields, replace
from functools import partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar

import torch
from torch import nn

from phnn.chain import AMPLIFIERS, SENSORS, SOURCES, BlockKind
from phnn.errors import InputRefused, PhnnError
from phnn.intake import LIMITS, load_json, named_file
from phnn.integrate.program import compile_network
from phnn.laws.wide import form_of, has_kernel, is_passive_by_form
from phnn.network.bounded import LARGEST_WEIGHT, check_weights
from phnn.network.elements import Coupling, Network, check_laws
from phnn.nn import (
    ConvexEnergyMLP,
    LearnedCoupling,
    LearnedDissipation,
    LearnedEnergy,
    LearnedRatio,
    MonotoneMLP,
    SectorMLP,
)
from phnn.parameters import Parameter
from phnn.recordings.manifest import shown as brief
from phnn.results import Place, claim, printable
from phnn.setup import Block, Own, Setup, Source

T = TypeVar("T")
# The elements of a network, by the field that holds them, and those of which a file has no field where there are none.
_ELEMENTS: dict[str, Any] = {
    name: typing.get_args(hint)[0]
    for name, hint in typing.get_type_hints(Network).items()
    if typing.get_origin(hint) is tuple
}
_OPTIONAL = ("multi_ports", "shared_energies")
SCHEMA = "phnn.model/1"
_REMEDY = "give model/ or base/ of a result"
FILE = "model.json"
# The folders of the final and of the base model within that of a result.
FINAL, BASE = "model", "base"


def save(setup: Setup, folder: Path | Place, substeps: int = 1, inputs: tuple[float, float] | None = None) -> None:
    """Write a setup into a folder, whole or not at all.

    Args:
        folder: of the model alone, or a place in a folder that is claimed.
        substeps: sub-steps a sample interval that kept the numerical error below the noise.
        inputs: least and largest input of the recordings that it was identified from, SI.

    Raises:
        PhnnError: a law is a torch module other than those of `phnn.nn.one_ports`, which this format does not hold.
    """
    network = setup.network
    content = {
        "schema": SCHEMA,
        "name": setup.name,
        "substeps": substeps,
        **({"identified_inputs": list(inputs)} if inputs else {}),
        **{
            key: [_element(e) for e in of] for key in _ELEMENTS if (of := getattr(network, key)) or key not in _OPTIONAL
        },
        "output": network.output,
        **({"senses": network.senses} if network.senses else {}),
        **{key: [asdict(b) for b in getattr(setup, key)] for key in ("amplifier", "sensor", "sources")},
        "lines": list(setup.own.lines),
        "drift_terms": setup.own.drift_terms,
        "parameters": {n: _plain(p) for n, p in network.parameters.items()},
        "block_parameters": {n: _plain(p) for n, p in (setup.block_parameters or {}).items()},
    }
    data = (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    with nullcontext(folder) if isinstance(folder, Place) else claim(folder, "save", (), (FILE,)) as place:
        (place / FILE).write(data)


def load(folder: Path) -> tuple[Setup, int]:
    """Read a setup and its sub-steps from a folder that `save` wrote.

    What is returned is passive: every parameter lies in the domain of its law, whatever the file says of it.

    Raises:
        InputRefused: the file is absent, too large, no json, or not a model of this package; names what is wrong.
    """
    return setup_from(*stored(folder))[:2]


def setup_from(content: Mapping[str, Any], shown: str) -> tuple[Setup, int, tuple[float, float] | None]:
    """Return what `save` was given from a file's content, as `load`; ``shown`` is the file's name for messages."""
    if content.get("schema") != SCHEMA:
        raise InputRefused(f"{shown}: is no {SCHEMA} file: give model/ or base/ of a result of this version")
    try:
        setup = _setup(content)
        check_laws(setup.network)
        # Of laws that torch alone evaluates there is no program.
        if all(has_kernel(one.element.law) for one in setup.network.with_laws()):
            compile_network(setup.network)
        _check_chain(setup)
        return setup, a_count(content["substeps"], "substeps", 1, LIMITS.substeps), _inputs(content)
    except (KeyError, ValueError, PhnnError) as error:
        kind = f"no {error}" if isinstance(error, KeyError) else printable(str(error))
        raise InputRefused(f"{shown}: is damaged ({kind}): write the model again") from error


def _inputs(content: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the least and largest input that a file's content states, SI; None where it states none."""
    if "identified_inputs" not in content:
        return None
    low, high = (a_number(v, "identified_inputs") for v in a_list(content["identified_inputs"], "identified_inputs", 2))
    if low > high:
        raise ValueError(f"identified_inputs {low:g} to {high:g} is no range")
    return low, high


def stored(folder: Path, outside: bool = False) -> tuple[Mapping[str, Any], str]:
    """Read the plain content of a stored model of any kind, and the name of its file for messages.

    Args:
        folder: of the model, or its file, or the folder of a diagnosis or identification, whose last model is taken;
            outside: the file in the folder may be a link that leads out of it.

    Raises:
        InputRefused: the file is absent, too large, or no json object.
    """
    path = folder / FILE if os.path.isdir(folder) else folder
    within = [at for name in (FINAL, BASE) if os.path.exists(at := folder / name / FILE)]
    if path != folder and not os.path.exists(path) and within:
        path, folder = within[0], within[0].parent
    source = named_file(path, (folder,) if path != folder else (), "", f"the model cannot be read, {_REMEDY}", outside)
    content, shown = load_json(source, LIMITS.model_bytes, "a model", _REMEDY), printable(str(path))
    if not isinstance(content, dict):
        raise InputRefused(f"{shown}: is no {SCHEMA} file: give model/ or base/ of a result of this version")
    return content, shown


def _check_chain(setup: Setup) -> None:
    """Refuse blocks and sources of unknown kinds, with other parameters, or with values out of their domains."""
    ports = [p.name for p in setup.network.ports]
    if not ports:
        raise ValueError("the network has no port for the recorded input")
    stages: tuple[tuple[str, Mapping[str, BlockKind], Sequence[Block | Source]], ...] = (
        ("amplifier", AMPLIFIERS, setup.amplifier),
        ("sensor", SENSORS, setup.sensor),
        ("source", SOURCES, setup.sources),
    )
    for stage, kinds, blocks in stages:
        for block in blocks:
            if block.kind not in kinds:
                raise ValueError(f"unknown {stage} {brief(block.kind)}; there are {', '.join(kinds)}")
            domains = kinds[block.kind].domains
            if len(block.parameters) != len(domains):
                raise ValueError(f"{stage} {block.kind} takes {len(domains)} parameters, not {len(block.parameters)}")
            for name, domain in zip(block.parameters, domains, strict=True):
                if name not in setup.parameters:
                    raise ValueError(f"no parameter {name} of {stage} {block.kind}")
                setup.parameters[name].within(domain, f"{stage} {block.kind}")
    for source in setup.sources:
        if source.port not in ports[1:]:
            raise ValueError(f"source {source.kind} acts on the port {source.port}, which is no port after the first")


def _setup(content: Mapping[str, Any]) -> Setup:
    # Files of earlier versions have no modulations, modulator states, sources and nuisances.
    former: dict[str, Any] = {**{key: [] for key in ("modulations", "memories", *_OPTIONAL)}, **content}
    elements: dict[str, Any] = {key: _all(former[key], key, kind) for key, kind in _ELEMENTS.items()}
    network = Network(
        **elements,
        parameters=_parameters(content, "parameters"),
        output=a_name(content["output"], "output"),
        senses=a_name(content["senses"], "senses") if "senses" in content else "",
    )
    lines = a_list(content.get("lines", []), "lines", LIMITS.lines)
    frequencies = tuple(a_number(f, "a line") for f in lines)
    if any(f <= 0.0 for f in frequencies):
        raise ValueError("a line has a frequency that is not positive")
    # Files of earlier versions have the number under another name.
    drift = "drift_terms" if "drift_terms" in content else "courses"
    return Setup(
        network=network,
        amplifier=_all(content["amplifier"], "amplifier", Block),
        sensor=_all(content["sensor"], "sensor", Block),
        block_parameters=_parameters(content, "block_parameters"),
        name=a_text(content["name"], "name"),
        sources=_all(content.get("sources", []), "sources", Source),
        own=Own(frequencies, a_count(content.get(drift, 0), drift, 0, LIMITS.lines)),
    )


def _all(items: Any, key: str, kind: type[T]) -> tuple[T, ...]:
    """Return the elements or blocks of a list, laws by their names or made of the weights of a learned one."""
    made = []
    for i, item in enumerate(a_list(items, key)):
        given = an_object(item, f"{key}[{i}]")
        law = {"law": from_json(given["law"])} if "law" in given else {}
        made.append(of_fields(kind, {**given, **law}, f"{key}[{i}]"))
    return tuple(made)


def _parameters(content: Mapping[str, Any], key: str) -> dict[str, Parameter]:
    given = an_object(content[key], key)
    if len(given) > 4 * LIMITS.elements:
        raise ValueError(f"{len(given)} {key}, at most {4 * LIMITS.elements} are accepted")
    table = {a_name(n, key): _parameter(p, f"the parameter {brief(n)}") for n, p in given.items()}
    for name, parameter in table.items():
        if parameter.name != name:
            raise ValueError(f"the parameter {brief(name)} calls itself {brief(parameter.name)}")
    return table


def _element(element: Any) -> dict[str, Any]:
    """Return an element as json, its law by name or, where it is learned, by its weights."""
    if isinstance(element, Coupling):
        return asdict(element)
    return asdict(replace(element, law="")) | {"law": as_json(element.law)}


def _plain(parameter: Parameter) -> dict[str, Any]:
    # JSON has no infinity: an absent bound is null.
    return {k: None if isinstance(v, float) and math.isinf(v) else v for k, v in asdict(parameter).items()}


def _parameter(content: Any, where: str) -> Parameter:
    # An absent bound is infinite.
    given = {n: v for n, v in an_object(content, where).items() if v is not None or n not in ("lower", "upper")}
    return of_fields(Parameter, given, where)


# Scales are buffers and come with the weights: the ones given here only make room for them.
_KINDS: dict[str, Callable[[int], nn.Module]] = {
    "damping": lambda width: SectorMLP(1.0, 1.0, width),
    "symmetric_damping": lambda width: SectorMLP(1.0, 1.0, width, symmetric=True),
    "monotone": lambda width: MonotoneMLP(1.0, 1.0, width),
    "convex": lambda width: ConvexEnergyMLP(1.0, 1.0, width),
}
# Laws of several variables, made of the counts that they keep.
_TOGETHER: dict[str, type[Any]] = {
    law.__name__: law for law in (LearnedDissipation, LearnedCoupling, LearnedEnergy, LearnedRatio)
}


def is_storable(network: Network) -> bool:
    """Return whether all laws of a network have a form on disk."""
    return all(isinstance(one.element.law, str) or _kind_of(one.element.law) for one in network.with_laws())


def _kind_of(law: nn.Module) -> str:
    """Return the kind under which a torch module stands on disk; empty where it has no form there."""
    name = type(law).__name__ if is_passive_by_form(law) else ""
    return name if name in _TOGETHER else form_of(law) if form_of(law) in _KINDS else ""


def as_json(law: Any) -> Any:
    """Return the name of a law, or the content of a learned one.

    Raises:
        PhnnError: a torch module of another kind.
    """
    if isinstance(law, str):
        return law
    kind = _kind_of(law)
    if not kind:
        raise PhnnError(f"a {type(law).__name__} as a law has no form on disk: keep its state_dict with torch.save")
    size = {"counts": law.counts} if kind in _TOGETHER else {"units": law.units}
    return {"kind": kind, **size, "state": {n: v.tolist() for n, v in law.state_dict().items()}}


def from_json(content: Any) -> Any:
    """Return what `as_json` was given.

    Raises:
        ValueError: an unknown kind, weights that do not fit it, or values with which the law would not be passive.
    """
    if isinstance(content, str):
        return content
    if not isinstance(content, Mapping) or content.get("kind") not in [*_KINDS, *_TOGETHER]:
        raise ValueError(f"no learned law of the kind {brief(content)}")
    law: Any
    if content["kind"] in _KINDS:
        law = _KINDS[content["kind"]](a_count(content.get("units"), "units of a learned law", 1, LIMITS.units))
    else:
        known, counts = _TOGETHER[content["kind"]], an_object(content.get("counts"), "counts of a learned law")
        if sorted(counts) != sorted(known.COUNTS):
            raise ValueError(f"counts of a learned law are {brief(counts)}: {', '.join(known.COUNTS)} are needed")
        # Matrices grow with the square of the variables.
        most = {"width": LIMITS.units, "ports": 64, "states": 64, "reads": 64}
        law = known(**{n: a_count(v, n, 0, most[n]) for n, v in counts.items()})
    given = an_object(content.get("state"), "state of a learned law")
    state = {n: a_tensor(v, f"{brief(n)} of a learned law") for n, v in given.items()}
    try:
        law.load_state_dict(state)
        check_weights(law, "of a learned law ", LARGEST_WEIGHT)
    except RuntimeError as error:
        raise ValueError(f"weights of a learned law do not fit: {str(error).splitlines()[-1].strip()}") from error
    for name, buffer in law.named_buffers():
        # A negative conductance would deliver power.
        if not bool(((buffer > 0.0) & torch.isfinite(buffer)).all()):
            raise ValueError(f"{name} of a learned law must be positive")
    return law


def a_tensor(value: Any, where: str) -> torch.Tensor:
    """Return the numbers in lists of equal lengths. Raises ValueError for other values, or if one is not finite."""
    try:
        tensor = torch.tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise ValueError(f"{where} is {brief(value)}, no array of numbers") from error
    if not bool(torch.isfinite(tensor).all()):
        raise ValueError(f"{where} is not finite")
    return tensor


# The one text that is no name, and may be empty.
_PROSE = "description"


def of_fields(cls: type[T], content: Any, where: str) -> T:
    """Return a dataclass from an object of json.

    Args:
        cls: its fields are texts, numbers, truth values, lists of texts, or objects of ratios; fields called ``law`` of
            type ``Any`` are passed on.
        content: a value by the name of each field; those with a default may be absent.
        where: the element, for the message.

    Raises:
        ValueError: an unknown or missing field, or a value of another type.
    """
    given = an_object(content, where)
    hints, known = typing.get_type_hints(cls), {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for name in given:
        if name not in known:
            raise ValueError(f"{where} has no field {brief(name)}; there are {', '.join(known)}")
    for name, f in known.items():
        if name not in given and f.default is MISSING and f.default_factory is MISSING:
            raise ValueError(f"{where} has no {name}")
    readers = {n: a_text if n == _PROSE else partial(_typed, hint=hints[n]) for n in given}
    return cls(**{name: readers[name](value, where=f"{name} of {where}") for name, value in given.items()})


def an_object(content: Any, where: str) -> Mapping[str, Any]:
    """Read an object of json. Raises ValueError otherwise."""
    if not isinstance(content, Mapping):
        raise ValueError(f"{where} is {brief(content)}, no object")
    return content


def a_list(content: Any, where: str, most: int = LIMITS.elements) -> list[Any]:
    """Return a list of json of at most ``most`` entries. Raises ValueError otherwise, or if it is longer."""
    if not isinstance(content, list):
        raise ValueError(f"{where} is {brief(content)}, no list")
    if len(content) > most:
        raise ValueError(f"{where} has {len(content)} entries, at most {most} are accepted")
    return content


def a_text(value: Any, where: str) -> str:
    """Return a printable text. Raises ValueError otherwise, or if it is too long."""
    if not isinstance(value, str) or printable(value) != value:
        raise ValueError(f"{where} is {brief(value)}, no printable text")
    return value


def a_name(value: Any, where: str) -> str:
    """Return a printable text that is not empty and no longer than a name. Raises ValueError otherwise."""
    if not 0 < len(a_text(value, where)) <= LIMITS.name_characters:
        raise ValueError(f"{where} has {len(value)} characters: 1 to {LIMITS.name_characters} are accepted")
    return str(value)


def a_number(value: Any, where: str) -> float:
    """Read a finite number. Raises ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where} is {brief(value)}, no finite number")
    return float(value)


def a_count(value: Any, where: str, least: int, most: int) -> int:
    """Read a whole number from ``least`` to ``most``. Raises ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{where} = {brief(value)} is no whole number from {least} to {most}")
    return value


def _typed(value: Any, hint: Any, where: str) -> Any:
    """Return a value of the type that a field declares; a union is ``str | other``. Raises ValueError otherwise."""
    kind, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if kind is tuple:
        return tuple(_typed(v, parts[0], where) for v in a_list(value, where))
    if kind is Mapping:
        return {a_name(n, where): _typed(v, parts[1], where) for n, v in an_object(value, where).items()}
    if kind is UnionType:
        if value is None and parts[1] is NoneType:
            return None
        return _typed(value, str if isinstance(value, str) or parts[1] is NoneType else parts[1], where)
    if hint is not bool:
        return a_name(value, where) if hint is str else a_number(value, where)
    if not isinstance(value, bool):
        raise ValueError(f"{where} is {brief(value)}, neither true nor false")
    return value
