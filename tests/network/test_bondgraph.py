"""Networks from bond graphs: the paper's actuator, random linear graphs, merged storages, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from bondgraphs import as_yaml, network_response, random_graph, response, solvable_graph
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.configuration import config_folder
from phnn.errors import InputRefused, StructureViolated
from phnn.models.actuator import hrc
from phnn.models.network_file import load_graph, load_network
from phnn.network import ModulatorState, PortHamiltonianSystem
from phnn.network.bondgraph import TF, Bond, BondGraph, C, I, R, Se, Sf
from phnn.network.bondgraph.description import Element, Link, _units
from phnn.parameters import Parameter, as_table, constant, positive
from phnn.recordings.units import same_kind

FOLDER = config_folder() / "network"
seeds = st.integers(0, 2**31 - 1)
SPRING, MASS = C("q", "a", "spring", ("k",)), I("p", "a", "capacitor", ("m",))
K, M, B = positive("k", 8.0, "N/m"), positive("m", 2.0, "kg"), positive("b", 0.5, "N s/m")


def graph(
    junctions: dict[str, int],
    elements: list[Element],
    bonds: list[Link] | None = None,
    output: str = "q",
    **other: object,
) -> BondGraph:
    """A graph whose parameters are all 0.7, those given in ``other`` excepted."""
    names = {n for e in elements for n in e.parameters}
    names |= {b.ratio.removeprefix("1/") for b in bonds or [] if not isinstance(b, Bond) and isinstance(b.ratio, str)}
    table = as_table(positive(n, float(other.get(n, 0.7)), "1") for n in sorted(names))  # type: ignore[arg-type]
    return BondGraph(junctions, tuple(elements), tuple(bonds or []), table, output, bool(other.get("merge", True)))


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_the_actuator_of_figure_5_is_that_of_proposition_1(seed: int) -> None:
    derived, hysterons = load_graph(FOLDER / "hrc.yaml").derive(), 2
    wanted, found = PortHamiltonianSystem(hrc(hysterons)), PortHamiltonianSystem(derived.network)
    assert found.state_names == wanted.state_names
    random = np.random.default_rng(seed)
    x = torch.from_numpy(random.normal(size=(5, hysterons + 2)) * 10.0 ** random.uniform(-9, 0, (5, 1)))
    assert torch.equal(found.structure(x), wanted.structure(x))
    assert torch.equal(found.incidences(x)[1], wanted.incidences(x)[1])
    torch.testing.assert_close(found.dissipation(x), wanted.dissipation(x), rtol=1e-15, atol=0.0)
    torch.testing.assert_close(found.energy(x), wanted.energy(x), rtol=1e-14, atol=0.0)
    (merge,) = derived.merges
    assert (merge.kept, merge.gone, merge.ratio, merge.parameter) == ("q", "Q_C", "alpha", "k")
    assert "k stands for k + alpha^2/C" in merge.statement
    assert set(derived.network.parameters) == set(hrc(hysterons).parameters)


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_random_linear_graphs_respond_as_their_elements_do(seed: int) -> None:
    drawn = solvable_graph(seed)
    network = replace(drawn, merge=False).network()
    merged = drawn.derive()
    # The state of a storage that took up one with derivative causality is the total: there only answers are compared.
    own = not any(m.kept == drawn.output and m.statement.count("e(") for m in merged.merges)
    for s in (0.7 + 0.3j, 2.0j + 0.1):
        state, answer = response(drawn, s)
        for each in (network, merged.network):
            found = network_response(each, s)
            if each.ports[0].law == "linear":
                np.testing.assert_allclose(found[1], answer, rtol=1e-9, atol=1e-12)
            if own:
                np.testing.assert_allclose(found[0], state, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("flow", "file"), [("m/s", "hrc"), ("A", "hrlc")], ids=["mechanical", "electrical"])
def test_power_and_energy_variables_are_those_of_table_a4(flow: str, file: str) -> None:
    coil = load_graph(FOLDER / f"{file}.yaml")
    effort, displacement, momentum = _units(flow)
    assert same_kind(f"{effort} {flow}", "W")
    assert same_kind(f"{flow} s", displacement) and same_kind(f"{effort} s", momentum)
    # Momentum is the integral of an effort, displacement that of a flow.
    stores = [e for e in coil.elements if isinstance(e, C | I) and (e.unit in ("C", "V s")) == (flow == "A")]
    assert {type(e) for e in stores} == {C, I}
    assert all(same_kind(f"{effort if isinstance(e, I) else flow} s", e.unit) for e in stores)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_general_relations_are_those_of_table_a5(seed: int) -> None:
    # Se, I and R at a 1-junction, a transformer to a 0-junction with C and R; no law but the ratio's is linear.
    drawn = graph(
        {"one": 1, "zero": 0},
        [
            C("q", "zero", "cubic_spring", ("k", "kappa", "q0")),
            R("leak", "zero", "dead_zone", ("rho", "d")),
            I("p", "one", "cubic_spring", ("l", "lambda", "p0")),
            R("drag", "one", "quadratic_drag", ("c",), "resistance"),
            Se("source", "one"),
        ],
        [TF("one", "zero", "g")],
        kappa=0.3,
    )
    values, random = {n: p.value for n, p in drawn.parameters.items()}, np.random.default_rng(seed)
    k, kappa, q0, rho, d, c, g = (values[n] for n in ("k", "kappa", "q0", "rho", "d", "c", "g"))
    q, p, u = random.normal(size=3)
    # C store: q = Φ_C(e); I store: p = Φ_I(f), both by their inverses.
    e, f = k * q * (1.0 + kappa * (q / q0) ** 2), values["l"] * p * (1.0 + values["lambda"] * (p / values["p0"]) ** 2)
    # Transformer: f_1 g = f_2, e_1 = g e_2. 0-junction: flows add up to zero; 1-junction: efforts do.
    charging = g * f - rho * np.sign(e) * max(abs(e) - d / 2, 0.0)
    pushing = u - c * abs(f) * f - g * e
    network = drawn.network()
    system, x = PortHamiltonianSystem(network), torch.tensor([q, p], dtype=torch.float64)
    drive = torch.tensor([u], dtype=torch.float64)
    assert network.state_names == ("q", "p")
    np.testing.assert_allclose(system.vector_field(x, drive).detach(), [charging, pushing], rtol=1e-12, atol=1e-12)
    # The flow of the source is that of the 1-junction, and so of the I store.
    np.testing.assert_allclose(system.port_outputs(x, drive).detach(), [f], rtol=1e-13)


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_refusals_are_refusals(seed: int) -> None:
    try:
        network = random_graph(seed).network()
    except StructureViolated as error:
        # The cause, a colon, the remedy.
        assert ": " in str(error)
    else:
        assert torch.isfinite(
            PortHamiltonianSystem(network).structure(torch.ones(len(network.storages))).detach()
        ).all()


def test_masses_on_one_shaft_become_one() -> None:
    masses = [I("p", "a", "capacitor", ("m_1",)), I("p_2", "b", "capacitor", ("m_2",))]
    two = graph({"a": 1, "b": 1}, [SPRING, *masses, Se("force", "b")], [TF("a", "b", "r")], m_1=2.0, m_2=5.0, r=0.4)
    derived = two.derive()
    assert derived.network.state_names == ("q", "p")
    assert derived.network.parameters["m_1"].value == pytest.approx(2.0 + 0.4**2 * 5.0, rel=1e-15)
    assert "m_1 stands for m_1 + r^2*m_2" in derived.merges[0].statement


def test_a_parameter_that_others_use_keeps_its_meaning() -> None:
    springs: list[Element] = [C(n, "a", "spring", ("k",)) for n in ("q", "q_2", "q_3")]
    network = graph({"a": 1}, [*springs, MASS, Se("force", "a")], k=2.0, m=1.0).network()
    assert network.storages[0].parameters == ("k_q",)
    assert network.parameters["k_q"].value == 6.0
    assert "k" not in network.parameters


def test_only_linear_storages_side_by_side_become_one() -> None:
    bent, springs = C("q", "a", "cubic_spring", ("k", "kappa", "q0")), [C("y", "a", "spring", ("k_1",))]
    elements: list[Element] = [bent, *springs, C("z", "b", "spring", ("k_2",)), MASS, Se("force", "a", "N")]
    derived = graph({"a": 1, "b": 1}, elements, [TF("a", "b", 2.0)], k_1=3.0, k_2=0.5, m=1.0).derive()
    assert derived.network.state_names == ("q", "y", "p")
    assert derived.network.parameters["k_1"].value == 3.0 + 2.0**2 * 0.5


def test_linear_resistors_turn_and_others_do_not() -> None:
    def damped(law: str, parameters: tuple[str, ...], direction: str) -> BondGraph:
        return graph({"a": 1}, [SPRING, MASS, R("r", "a", law, parameters, direction)])

    derived = damped("linear", ("g",), "conductance").derive()
    assert derived.inverted == ("r",)
    x = torch.tensor([0.0, 2.0], dtype=torch.float64)
    system = PortHamiltonianSystem(derived.network)
    flow = system.branch_flows(system.branch_efforts(system.efforts(x), x), x)
    # The force of a conductance 0.7 at the velocity 2/0.7.
    torch.testing.assert_close(flow, torch.tensor([2.0 / 0.7 / 0.7], dtype=torch.float64))
    assert derived.network.parameters["one"].fixed
    # A parameter of that name keeps its own value.
    assert damped("linear", ("one",), "conductance").network().parameters["one_"].value == 1.0
    assert damped("linear", ("b",), "resistance").derive().inverted == ()
    assert damped("dead_zone", ("rho", "d"), "resistance").network().resistors[0].on == {"p": 1.0}
    with pytest.raises(StructureViolated, match=r"r has the law f = φ\(e\), but its flow is imposed by p.*resistance"):
        damped("dead_zone", ("rho", "d"), "conductance").network()


REFUSED: dict[str, tuple[dict[str, int], list[Element], list[Link], str]] = {
    "source fixes effort": (
        {"a": 0}, [C("q", "a", "spring", ("k",)), Se("V", "a")], [],
        "the source V fixes the effort of the storage q: put a small storage of the other kind",
    ),
    "source fixes flow": (
        {"a": 1}, [SPRING, MASS, Sf("v", "a")], [], "the source v fixes the flow of the storage p",
    ),
    "two sources": (
        {"a": 0}, [I("q", "a", "capacitor", ("m",)), Se("V", "a"), Se("W", "a")], [],
        "the sources V, W contradict each other: ",
    ),
    "sources through a transformer": (
        {"a": 0, "b": 0}, [I("q", "a", "capacitor", ("m",)), Se("V", "a"), Se("W", "b")], [TF("a", "b", "r")],
        "the sources V, W contradict each other",
    ),
    "effort feeds flow": (
        {"a": 1, "b": 1}, [SPRING, MASS, Se("V", "b"), Sf("i", "b")], [], "the sources V, i feed each other",
    ),
    "driven resistor": (
        {"a": 1}, [C("q", "a", "capacitor", ("C",)), R("r", "a", "dead_zone", ("rho", "d")), Se("V", "a")], [],
        "the source V drives the resistor r directly",
    ),
    "series resistors": (
        {"a": 1, "b": 0}, [C("q", "b", "capacitor", ("C",)), R("r_1", "a", "linear", ("g",)),
                           R("r_2", "a", "linear", ("h",))], [Bond("b", "a")],
        "algebraic loop among the resistors r_1, r_2: combine them in one law, or put a small storage",
    ),
    "one resistor of the loop cannot turn": (
        {"a": 1, "b": 0}, [C("q", "b", "capacitor", ("C",)), R("r_1", "a", "dead_zone", ("g", "d")),
                           R("r_2", "a", "linear", ("h",))], [Bond("b", "a")],
        "algebraic loop among the resistors r_1, r_2",
    ),
    "nonlinear derivative causality": (
        {"a": 0}, [C("q", "a", "spring", ("k",)), C("z", "a", "cubic_spring", ("k", "c", "s"))], [],
        "fix each other's effort, and the law of z is not linear: put a resistor",
    ),
    "three velocities": (
        {"a": 1, "b": 1, "c": 1, "n": 0},
        [I("q", "a", "capacitor", ("m",)), I("y", "b", "capacitor", ("m",)), I("z", "c", "capacitor", ("m",))],
        [Bond("a", "n"), Bond("b", "n"), Bond("n", "c")], "together fix the flow of the storage q",
    ),
    "nothing acts on the resistor": (
        {"a": 1, "b": 1}, [SPRING, MASS, R("r", "b", "dead_zone", ("g", "d"), "resistance")], [],
        "no storage acts on the resistor r",
    ),
    "transformers in parallel": (
        {"a": 0, "b": 0}, [C("q", "a", "spring", ("k",))], [TF("a", "b", 1.0), TF("a", "b", 2.0)],
        "the junctions fix at zero the effort of the storage q: put a resistor",
    ),
    "source on nothing": (
        {"a": 1, "b": 0}, [SPRING, MASS, Se("V", "b")], [], "no storage takes what the source V gives: join",
    ),
    "source against nothing": (
        {"a": 1, "b": 1}, [SPRING, MASS, Se("V", "b")], [], "no storage takes what the source V gives",
    ),
    "reads what is gone": (
        {"a": 1}, [SPRING, C("z", "a", "spring", ("k",)), MASS,
                   R("r", "a", "following_dead_zone", ("g", "d", "x", "y"), "resistance", "z")], [],
        "r reads the storage z, which is merged into q: let it read q, or set merge to false",
    ),
    "ratios of both signs": (
        {"a": 1, "b": 1, "c": 1, "d": 1, "n": 0, "n_b": 1},
        [MASS, I("q", "b", "capacitor", ("m",)), R("r", "c", "coulomb", ("g", "h"), "resistance"), Se("V", "a")],
        [TF("a", "d", "s"), Bond("d", "n"), TF("n_b", "b", "1/t"), Bond("n", "n_b"), Bond("n", "c")],
        "the ratio -t arises at the resistor r, where a minus has no place",
    ),
    "product of ratios": (
        {"a": 1, "b": 1, "c": 0}, [MASS, C("q", "c", "capacitor", ("C",))], [TF("a", "b", "r"), TF("b", "c", "s")],
        r"the ratio -?r\*s arises between the storages p and q: introduce a parameter",
    ),
    "inverse of a ratio": (
        {"a": 1, "c": 0}, [MASS, C("q", "c", "capacitor", ("C",))], [TF("c", "a", "r")],
        "the ratio -?1/r arises between the storages p and q: introduce a parameter",
    ),
    "minus at a source": (
        {"a": 1, "b": 1}, [SPRING, MASS, Se("V", "b", "V", -1)], [TF("a", "b", "r")],
        "the ratio -r arises at the source V, where a minus has no place: turn its sign",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_conflicts_are_refused_with_names_and_remedy(case: str) -> None:
    junctions, elements, bonds, message = REFUSED[case]
    with pytest.raises(StructureViolated, match=message):
        graph(junctions, elements, bonds).network()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"junctions": {"mass": 2}}, "junction mass is 2: write 0"),
        ({"elements": (SPRING,)}, "q hangs on the junction 'a', which is not defined; there are mass"),
        ({"output": "z"}, "the output is the storage 'z', which is not defined; there are q, p"),
        ({"parameters": as_table([K, M])}, "uses the parameter 'b'"),
        ({"parameters": as_table([K, M, B, constant("c", 1.0, "1")])}, "nothing uses the parameter c"),
        ({"bonds": (Bond("mass", "mass"),)}, "joins mass with itself"),
        ({"bonds": (TF("mass", "wall", 0.0),)}, "'wall', which is not defined"),
    ],
    ids=str,
)
def test_a_description_that_refers_to_nothing_is_refused(change: dict[str, object], message: str) -> None:
    good = BondGraph(
        {"mass": 1},
        (
            C("q", "mass", "spring", ("k",), "m"),
            I("p", "mass", "capacitor", ("m",), "kg m/s"),
            R("damper", "mass", "linear", ("b",), "resistance"),
            Se("force", "mass", "N"),
        ),
        parameters=as_table([K, M, B]),
    )
    assert good.network().state_names == ("q", "p")
    with pytest.raises(StructureViolated, match=message):
        replace(good, **change)  # type: ignore[arg-type]


def test_small_mistakes_are_refused() -> None:
    for element, message in (
        (R("r", "a", "linear", ("b",), "forward"), "r has the direction 'forward': write conductance"),
        (Se("V", "a", "V", 0), "the source V has the sign 0: write 1 or -1"),
        (C("p", "a", "spring", ("k",)), "two elements are called p"),
        (R("r", "a", "linear", ("b",), reads="z"), "r reads the storage 'z'"),
    ):
        with pytest.raises(StructureViolated, match=message):
            graph({"a": 1}, [SPRING, MASS, element])
    with pytest.raises(StructureViolated, match="has ratio 0"):
        graph({"a": 1, "b": 1}, [SPRING, MASS], [TF("a", "b", 0.0)])


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


def test_memories_survive_yaml(tmp_path: Path) -> None:
    graph = load_graph(FOLDER / "thermal_hrc.yaml")
    memory = ModulatorState("field", "exceeding", ("tau", "V_c"), ("voltage",), "1")
    more = {n: Parameter(n, v) for n, v in {"tau": 3.0, "V_c": 50.0}.items()}
    graph = replace(graph, memories=(*graph.memories, memory), parameters={**graph.parameters, **more})
    (tmp_path / "written.yaml").write_text(as_yaml(graph), encoding="utf-8")
    assert load_graph(tmp_path / "written.yaml") == graph


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
