"""Networks in yaml: what is written is read, what is wrong is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from bondgraphs import random_graph
from graph_text import as_yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.configuration import config_folder
from phnn.errors import InputRefused
from phnn.models.network_file import load_graph, load_network
from phnn.network.bondgraph import BondGraph, C, I, R, Se
from phnn.parameters import Parameter, as_table, constant, positive

FOLDER = config_folder() / "network"


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**31 - 1))
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    path = tmp_path_factory.mktemp("graph") / "graph.yaml"
    graph = replace(random_graph(seed), merge=bool(seed % 2))
    path.write_text(as_yaml(graph, "a: line, with #signs"), encoding="utf-8")
    assert load_graph(path) == graph


def test_names_and_bounds_survive_yaml(tmp_path: Path) -> None:
    graph = BondGraph(
        {"no": 1},
        (
            C("on", "no", "spring", ("off",), "µm"),
            I("p", "no", "capacitor", ("m",), "1"),
            R("dead", "no", "following_dead_zone", ("m", "off", "kappa", "q0"), "resistance", "on"),
            Se("V", "no", "V", -1, "electrostriction", ("kappa",)),
        ),
        parameters=as_table([
            Parameter("off", 3.0, "N/m", -1.0, 1e5, typical=2.0, description="stiff, but: not"),
            positive("m", 1e-30, "kg"),
            Parameter("kappa", -0.1, "1/V", -1.0), constant("q0", 1.0, "m"),
        ]),
        output="on",
    )  # fmt: skip
    (tmp_path / "n.yaml").write_text(as_yaml(graph), encoding="utf-8")
    assert load_graph(tmp_path / "n.yaml") == graph


FAULTS = {
    "mass_spring_damper": [
        ("output: q", "outptu: q", r"unknown key 'outptu' \(did you mean output\?\)"),
        ("output: q", "", "no 'output': a network has junctions"),
        ("junctions: {mass: 1}", "junctions: {mass: one}", "junction mass is 'one': write 0"),
        ("junctions: {mass: 1}", "junctions: 1", "junctions: expected keys and values, found 1"),
        ("type: Se", "type: SE", "elements: force: type: 'SE' is not known: accepted are C, I, R, Se, Sf"),
        ("junction: mass, unit: N", "unit: N", "elements: force: no `junction`"),
        ("junction: mass, unit: N", "on: mass, unit: N", "elements: force: no `junction`"),
        ("law: spring", "law: sprong", "elements: q: law: 'sprong' is not known: accepted are capacitor, spring"),
        ("parameters: [k]", "parameters: [k, m]", "elements: q: parameters: the law spring takes 1, 2 are given"),
        ("direction: resistance", "direction: up", "damper: direction: 'up' is not known"),
        ("direction: resistance", "sign: -1", "elements: damper: unknown key 'sign'"),
        ("value: 8.0", "value: stiff", "parameters: k: value: 'stiff' is not a finite number"),
        ("value: 8.0", "value: -8.0", "parameters: k: value: -8.0 is not a number greater than 0"),
        ("value: 8.0, ", "", "parameters: k: no value"),
        ("value: 8.0", "value: 8.0, lower: 9.0", "parameters: k: .*outside its bounds"),
        ("output: q", "output: q\nbonds: {from: mass}", "bonds: expected a list"),
        ("output: q", "output: q\nbonds: [{from: mass}]", r"bonds\[0\]: no `to`"),
        ("output: q", "output: q\nbonds: [{type: XF, from: mass, to: mass}]", r"bonds\[0\]: type: 'XF' is not known"),
        ("output: q", "output: q\nbonds: [{from: mass, to: mass, ratio: 2}]", r"bonds\[0\]: unknown key 'ratio'"),
        ("output: q", "output: q\nmerge: maybe", "merge: 'maybe' is neither true nor false"),
        ("output: q", "output: [q", "not readable as yaml"),
        ("type: Se", "type: Sf", "the source force fixes the flow of the storage p: put a small storage"),
    ],
    "thermal_hrc": [
        ("law: thermal,", "law: thermic,", r"memories: theta: law: 'thermic' is not known: accepted are thermal"),
        ("[C_T, R_T, T_a, T_ref]", "[C_T, R_T]", "memories: theta: parameters: the law thermal takes 4, 2 are given"),
        ("by: theta", "by: heat", "the ratio alpha reads the storage 'heat', which is not defined"),
        ("by: theta, ", "", "modulations: alpha: no `by`: name the storage or memory"),
        ("reads: theta", "reads: heat", "hysteron_1 reads the storage 'heat'"),
        ("unit: K}\nparam", "of: nobody}\nparam", "memory theta is driven by 'nobody', nothing has this name"),
        ("unit: K}\nparam", "ov: 1}\nparam", "theta: unknown key .ov.: accepted are law, parameters, of"),
        ("  alpha: {by", "  beta: {by", "a modulation is of the ratio 'beta', which is not defined"),
    ],
}


@pytest.mark.parametrize(("file", "old", "new", "message"), [(f, *row) for f, rows in FAULTS.items() for row in rows])
def test_what_is_wrong_is_refused_with_file_key_and_remedy(
    tmp_path: Path, file: str, old: str, new: str, message: str
) -> None:
    good = (FOLDER / f"{file}.yaml").read_text(encoding="utf-8")
    assert old in good
    path = tmp_path / "mine.yaml"
    path.write_text(good.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputRefused, match=f"mine.yaml: .*{message}"):
        load_network(path)


def test_an_absent_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="there is no such file: give the path"):
        load_network(tmp_path / "absent.yaml")
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(InputRefused, match=r"list\.yaml: expected keys and values"):
        load_network(tmp_path / "list.yaml")
