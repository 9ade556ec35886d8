"""Models on disk: a setup as one readable json file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused, PhnnError
from phnn.integrate.program import compile_network
from phnn.models.learned import as_json, from_json
from phnn.network.elements import Coupling, Memory, Modulation, Network, Port, Resistor, Storage
from phnn.output import Place, claim
from phnn.parameters import Parameter
from phnn.setup import AMPLIFIERS, SENSORS, SOURCES, Block, Own, Setup, Source

SCHEMA = "phnn.model/1"
FILE = "model.json"


def save(setup: Setup, folder: Path | Place, substeps: int = 1) -> None:
    """Write a setup into a folder, whole or not at all.

    Args:
        folder: of the model alone, or a place in a folder that is claimed.
        substeps: sub-steps a sample interval that kept the numerical error below the noise.

    Raises:
        PhnnError: a law is a torch module other than those of `phnn.laws.neural`, which this format does not hold.
    """
    network = setup.network
    content = {
        "schema": SCHEMA,
        "name": setup.name,
        "substeps": substeps,
        "storages": [_element(s) for s in network.storages],
        "resistors": [_element(r) for r in network.resistors],
        "couplings": [asdict(c) for c in network.couplings],
        "ports": [asdict(p) for p in network.ports],
        "modulations": [asdict(m) for m in network.modulations],
        "memories": [asdict(m) for m in network.memories],
        "output": network.output,
        "amplifier": [asdict(b) for b in setup.amplifier],
        "sensor": [asdict(b) for b in setup.sensor],
        "sources": [asdict(s) for s in setup.sources],
        "lines": list(setup.own.lines),
        "courses": setup.own.courses,
        "parameters": {n: _plain(p) for n, p in network.parameters.items()},
        "block_parameters": {n: _plain(p) for n, p in (setup.block_parameters or {}).items()},
    }
    data = (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    if isinstance(folder, Place):
        (folder / FILE).write(data)
        return
    with claim(folder, "save", (), (FILE,)) as place:
        (place / FILE).write(data)


def load(folder: Path) -> tuple[Setup, int]:
    """Read a setup and its sub-steps from a folder that `save` wrote.

    Raises:
        InputRefused: the file is absent, no json, or not a model of this package.
    """
    path = folder / FILE if folder.is_dir() else folder
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputRefused(f"{path}: cannot be read ({error.strerror}): give model/ or base/ of a result") from error
    except ValueError as error:
        raise InputRefused(f"{path}: is not json ({error}): give model/ or base/ of a result") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputRefused(f"{path}: is no {SCHEMA} file: give model/ or base/ of a result of this version")
    try:
        setup, substeps = _setup(content), int(content["substeps"])
        compile_network(setup.network)
        unknown = [b.kind for b in setup.amplifier if b.kind not in AMPLIFIERS]
        unknown += [b.kind for b in setup.sensor if b.kind not in SENSORS]
        unknown += [s.kind for s in setup.sources if s.kind not in SOURCES]
        if unknown or substeps < 1:
            raise ValueError(f"unknown block {unknown[0]}" if unknown else f"substeps {substeps}")
        chain: tuple[Block | Source, ...] = (*setup.amplifier, *setup.sensor, *setup.sources)
        missing = [n for b in chain for n in b.parameters if n not in setup.parameters]
        missing += [s.port for s in setup.sources if s.port not in [p.name for p in setup.network.ports]]
        if missing:
            raise ValueError(f"no parameter or port {missing[0]}")
        return setup, substeps
    except (KeyError, TypeError, ValueError, AttributeError, PhnnError) as error:
        raise InputRefused(f"{path}: is damaged ({type(error).__name__}: {error}): write the model again") from error


def _setup(content: Mapping[str, Any]) -> Setup:
    network = Network(
        storages=tuple(Storage(**_with_law(s)) for s in content["storages"]),
        resistors=tuple(Resistor(**_with_law(r)) for r in content["resistors"]),
        couplings=tuple(Coupling(**c) for c in content["couplings"]),
        ports=tuple(Port(**_tupled(p)) for p in content["ports"]),
        parameters={n: _parameter(p) for n, p in content["parameters"].items()},
        output=content["output"],
        # Files of earlier versions have none of these, nor sources and own parts.
        modulations=tuple(Modulation(**_tupled(m)) for m in content.get("modulations", ())),
        memories=tuple(Memory(**_tupled(m)) for m in content.get("memories", ())),
    )
    return Setup(
        network=network,
        amplifier=tuple(Block(**_tupled(b)) for b in content["amplifier"]),
        sensor=tuple(Block(**_tupled(b)) for b in content["sensor"]),
        block_parameters={n: _parameter(p) for n, p in content["block_parameters"].items()},
        name=content["name"],
        sources=tuple(Source(**_tupled(s)) for s in content.get("sources", ())),
        own=Own(tuple(float(f) for f in content.get("lines", ())), int(content.get("courses", 0))),
    )


def _tupled(element: Mapping[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in element.items()}


def _element(element: Storage | Resistor) -> dict[str, Any]:
    """An element as json, its law by name or, where it is learned, by its weights."""
    return asdict(replace(element, law="")) | {"law": as_json(element.law)}


def _with_law(element: Mapping[str, Any]) -> dict[str, Any]:
    return _tupled(element) | {"law": from_json(element["law"])}


def _plain(parameter: Parameter) -> dict[str, Any]:
    # JSON has no infinity: an absent bound is null.
    return {k: None if isinstance(v, float) and math.isinf(v) else v for k, v in asdict(parameter).items()}


def _parameter(content: Mapping[str, Any]) -> Parameter:
    values: dict[str, Any] = dict(content)
    for bound, unbounded in (("lower", -math.inf), ("upper", math.inf)):
        if values.get(bound) is None:
            values[bound] = unbounded
    return Parameter(**values)
