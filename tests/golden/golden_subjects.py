"""What is simulated and scored: setups of every law, block, effect and model, and campaigns with a concealed effect."""

from __future__ import annotations

# Everything that a refactoring may move is imported here and nowhere else in this folder.
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phnn
from phnn.chain import AMPLIFIERS, SENSORS, SOURCES
from phnn.configuration import config_folder
from phnn.criteria import Criteria
from phnn.derivatives import output_derivatives
from phnn.diagnose.linearised import prepare
from phnn.diagnose.locations import Location, locate
from phnn.diagnose.screen import Candidate, Screen
from phnn.effects import Scales, catalogue, effect, in_all_forms
from phnn.effects.formulas import formulas
from phnn.effects.learned import learned_elements
from phnn.effects.places import attached
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.models.actuator import bouc_wen
from phnn.models.network_file import load_network
from phnn.network import Coupling, Modulation, ModulatorState, Network, Port, Resistor, Storage
from phnn.parameters import Parameter, as_table
from phnn.recordings.recording import Campaign, Recording
from phnn.setup import Block, Setup, Source
from phnn.trajectory import simulate

Array = NDArray[np.float64]

NETWORKS = Path(__file__).resolve().parents[2] / "configs" / "network"
STEPS = 200

# --- Simulated setups -------------------------------------------------------------------------------------------------

# Values of the parameters of every block, for an actuator at 75 V, 0.1 mm and 20 ms, or a source at its second port.
BLOCKS: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "amplifier": {
        "lowpass": (3e-4,), "second_order_lowpass": (2e-4, 0.6), "saturation": (52.5,), "soft_saturation": (60.0, 3.0),
        "bouc_wen": (0.0087, 0.006, 0.014, 40.0), "slipping": (20.0, 40.0, 1.4, 0.3, 0.2),
        "delay": (1.37e-4,), "slew_limit": (3e4,), "offset": (1.5,), "play": (6.0,), "fading": (0.6, 5e-3),
        "gain": (1.3,), "knee": (0.3, 20.0), "dead_band": (0.7, 4.5), "rate": (),
    },
    "sensor": {
        "drift": (3e-4,), "lag": (2e-4,), "rate": (), "polynomial": (900.0, -2e6), "rectification": (),
        "zero": (3e-6,), "play": (4e-6,), "knee": (0.3, 4e-5), "cubic": (0.1, -0.08, 7e-5), "clock": (0.02, 0.02),
        "drifting_gain": (0.1, -0.05, 0.03, 0.02), "wave": (0.4, -0.3, 3e-5),
    },
    "source": {"tone": (0.4, -0.3, 130.0)},
}  # fmt: skip
ACTUATOR_SCALES = Scales(
    voltage=75.0, displacement=1.2e-4, velocity=0.1, stiffness=24579.0, transducer=0.046, slowest=20.0,
    fastest=150.0, duration=0.02, noise=5e-8, peaks=(430.0,),
)  # fmt: skip
TANK_SCALES = Scales(
    voltage=1e-4, displacement=1.4e-3, velocity=2e-4, stiffness=1.0, transducer=1.0, slowest=0.02, fastest=0.05,
    duration=100.0, noise=1e-6,
)  # fmt: skip
# By how much the strength of the first point of an effect's grid is multiplied, so that the effect shows.
_VISIBLE = 50.0


def actuator(hysterons: int = 2) -> Setup:
    """Return the actuator of the paper."""
    return Setup(phnn.models.hrc(hysterons=hysterons))


def network(name: str) -> Setup:
    """Return a network that the project describes in a file."""
    return Setup(load_network(NETWORKS / f"{name}.yaml"), name=name)


def sine(dt: float, amplitude: float, frequency: float, level: float = 0.0) -> tuple[Array, Array]:
    """Return time [s] and input of `STEPS` steps: a sine that grows from 40 % to all of its amplitude in the middle."""
    t = np.arange(STEPS + 1) * dt
    grown = np.where(t < 0.5 * t[-1], 0.4, 1.0)
    return t, level + amplitude * grown * np.sin(2.0 * np.pi * frequency * t)


def recording(t: Array, u: Array, unit: str = "V", **entry: Any) -> Recording:
    """Return a recording without an output, as `phnn.read` makes it.

    Args:
        unit: SI unit of the input.
        entry: what its entry in a manifest says.
    """
    entry = {"file": "made", "columns": {"input": {"column": "u", "unit": unit}}, **entry}
    manifest = {"setup": {"model": "linear"}, "recordings": [entry]}
    return phnn.read({"made": {"time_s": t, "u": u}}, manifest, need_output=False).recordings[0]


ACTUATOR_DRIVE = sine(5e-5, 75.0, 150.0)
TANK_DRIVE = (np.arange(STEPS + 1) * 0.5, 5e-5 * (1.0 - np.cos(2 * np.pi * 0.04 * np.arange(STEPS + 1) * 0.5)))
RIG_DRIVE = sine(1e-3, 5e-3, 4.0)
JUNCTION_DRIVE = sine(0.05, 1.5, 0.31)


def responses(setup: Setup, driven: Recording, substeps: int = 1) -> dict[str, Array]:
    """Return the simulated output (N,) and its derivatives (N,) by every free parameter, by name."""
    trajectory = simulate(setup, driven, substeps)
    names = [n for n in setup.parameters if n in setup.free]
    columns = output_derivatives(trajectory, names)
    return {"output": trajectory.y} | {f"by {n}": columns[:, i] for i, n in enumerate(names)}


def _values(prefix: str, example: tuple[float, ...]) -> tuple[tuple[str, ...], list[Parameter]]:
    names = tuple(f"{prefix}_{i}" for i in range(len(example)))
    return names, [Parameter(n, v) for n, v in zip(names, example, strict=True)]


def junction(kind: str, law: Any) -> Setup:
    """Return an oscillator in which one element has a law, with the example values of the law's registration."""
    names, values = _values("law", law.example)
    parameters = [Parameter("m", 1.0), Parameter("k", 2.0), Parameter("b", 0.3), Parameter("alpha", 0.8), *values]
    storages = [Storage("q", "spring", ("k",)), Storage("p", "capacitor", ("m",))]
    resistors = [Resistor("damper", "linear", {"p": 1.0}, ("b",))]
    couplings, ports = [Coupling("q", "p")], [Port("u", {"p": "alpha"})]
    modulations: tuple[Modulation, ...] = ()
    memories: tuple[ModulatorState, ...] = ()
    if kind == "storage":
        storages.insert(1, Storage("x", law.name, names))
        couplings.append(Coupling("x", "p"))
    if kind in ("resistor", "resistor of a storage"):
        at = {"p": 1.0} if kind == "resistor" else {"x": 1.0}
        resistors.append(Resistor("r", law.name, at, names, "q"))
    if kind == "resistor of a storage":
        parameters.append(Parameter("C", 0.7))
        storages.insert(1, Storage("x", "capacitor", ("C",)))
        couplings.append(Coupling("x", "p", "alpha"))
    if kind == "port":
        ports = [Port("u", {"p": "alpha"}, law.name, names)]
    if kind == "factor":
        modulations = (Modulation("alpha", "q", law.name, names),)
    if kind == "memory":
        parameters.append(Parameter("kappa", 0.2))
        parameters.append(Parameter("scale", 1.0))
        memories = (ModulatorState("z", law.name, names, () if law.heats else ("u",)),)
        modulations = (Modulation("alpha", "z", "affine", ("kappa", "scale")),)
    return Setup(
        Network(
            tuple(storages), tuple(resistors), tuple(couplings), tuple(ports), as_table(parameters), "q", modulations,
            memories,
        )
    )  # fmt: skip


def _laws() -> Iterator[tuple[str, Setup]]:
    tables: Mapping[str, Mapping[str, Any]] = {
        "storage": STORAGE_LAWS, "resistor": RESISTOR_LAWS, "port": PORT_LAWS, "factor": FACTOR_LAWS,
        "memory": MEMORY_LAWS,
    }  # fmt: skip
    for kind, laws in tables.items():
        for name, law in laws.items():
            yield f"{kind} {name}", junction(kind, law)
            if kind == "resistor" and law.thresholds is not None:
                yield f"resistor of a storage {name}", junction("resistor of a storage", law)


def with_block(stage: str, kind: str) -> Setup:
    """Return the actuator with one block of the chain."""
    names, parameters = _values(stage, BLOCKS[stage][kind])
    if stage == "source":
        return actuator(1).with_source(Source(kind, "force", names), tuple(parameters))
    return actuator(1).with_block(stage, Block(kind, names), tuple(parameters))


def _blocks() -> Iterator[tuple[str, Setup]]:
    for stage, kinds in (("amplifier", AMPLIFIERS), ("sensor", SENSORS), ("source", SOURCES)):
        for kind in kinds:
            assert kind in BLOCKS[stage], f"state values of the {stage} block {kind} in BLOCKS"
            yield f"{stage} {kind}", with_block(stage, kind)


def _effects() -> Iterator[tuple[str, Setup, tuple[tuple[Array, Array], str]]]:
    """Every effect, in all forms, with the setup to which it is added, what drives that, and the unit."""
    rig = replace(TANK_SCALES, displacement=5e-3, velocity=0.1, stiffness=1e4, effort=1e3)
    homes = (
        (actuator(), ACTUATOR_SCALES, (ACTUATOR_DRIVE, "V")),
        (network("tanks"), TANK_SCALES, (TANK_DRIVE, "m³/s")),
        (network("friction_rig"), rig, (RIG_DRIVE, "m")),
    )
    tables = {"effect": catalogue(), "learned": learned_elements(), "formula": formulas()}
    for table, members in tables.items():
        for member in members.values():
            for i, form in enumerate(in_all_forms([member])):
                setup, scales, driven = next(h for h in homes if form.can_be_added_to(h[0]))
                point = form.scaled(form.grid(scales)[0], _VISIBLE)
                name = f"{table} {form.name}" + (f", form {i + 1}" if i else "")
                yield name, form.add_to(setup, point), driven
    # At the second motion of a network with other names.
    for form in attached(effect("cubic_stiffness"), network("two_masses")):
        masses = replace(ACTUATOR_SCALES, voltage=1.0, displacement=2e-3, velocity=0.1, stiffness=800.0)
        yield (
            f"effect {form.name} of two masses",
            form.add_to(network("two_masses"), form.grid(masses)[0]),
            (sine(2e-3, 1.0, 7.0), "N"),
        )


def _models() -> Iterator[tuple[str, Setup]]:
    yield from ((f"actuator, {n} hysterons", actuator(n)) for n in (0, 1, 2, 3))
    yield "bouc_wen", bouc_wen()
    yield "thermal actuator", Setup(load_network(config_folder() / "network/thermal_hrc.yaml"))
    yield "hrcl", Setup(load_network(config_folder() / "network/hrcl.yaml"))
    yield "hrlc", Setup(load_network(config_folder() / "network/hrlc.yaml"))
    yield "hrlc, transducer", Setup(load_network(config_folder() / "network/hrlc_transducer.yaml"))
    yield "actuator of a beam", Setup(load_network(Path(__file__).with_name("beam.yaml")))


def _starts() -> Iterator[tuple[str, Recording, int]]:
    """Recordings of the actuator that begin, are sampled or are reconstructed in other ways, and sub-steps."""
    t, u = ACTUATOR_DRIVE
    whole = 60.0 * np.sin(2 * np.pi * 200.0 * t)
    steps = 40.0 * (np.floor(t / 2.5e-3 + 1e-6) % 2)
    yield "rest at an input before", recording(t, u + 20.0, start={"state": "rest", "input_before": 20.0}), 1
    yield "steady cycle", recording(t, whole, start="periodic", periodic=True), 1
    yield "steady cycle, band-limited", recording(t, whole, start="periodic", periodic=True, input="band_limited"), 2
    yield "linear input", recording(t, u, input="linear"), 2
    yield "held input", recording(t, steps, input="zero_order"), 3
    yield "sensor with lag", recording(t, u, sensor={"lag": "0.2 ms", "rectified": True}), 1


def simulations() -> dict[str, Callable[[], dict[str, Array]]]:
    """Return the responses of every setup, by name, to be computed when they are asked for."""
    cases: dict[str, Callable[[], dict[str, Array]]] = {}

    def add(name: str, setup: Setup, driven: tuple[Array, Array], unit: str = "V") -> None:
        cases[name] = lambda: responses(setup, recording(*driven, unit))

    for name, setup in _laws():
        add(name, setup, JUNCTION_DRIVE)
    for name, setup in (*_blocks(), *_models()):
        add(name, setup, ACTUATOR_DRIVE)
    for name, setup, (drive, unit) in _effects():
        add(name, setup, drive, unit)
    add("imposed motion", network("friction_rig"), RIG_DRIVE, "m")
    add("imposed velocity", network("friction_rig"), sine(1e-3, 0.1, 4.0), "m/s")
    for name, driven, substeps in _starts():
        cases[name] = lambda d=driven, s=substeps: responses(actuator(), d, s)  # type: ignore[misc]
    return cases


def laws_blocks_and_effects() -> set[str]:
    """Return the beginnings of the names that `simulations` must have: one for every member of a registry."""
    named = {"storage": STORAGE_LAWS, "resistor": RESISTOR_LAWS, "port": PORT_LAWS, "factor": FACTOR_LAWS,
             "memory": MEMORY_LAWS, "amplifier": AMPLIFIERS, "sensor": SENSORS, "source": SOURCES,
             "effect": catalogue(), "learned": learned_elements(), "formula": formulas()}  # fmt: skip
    return {f"{kind} {name}" for kind, table in named.items() for name in table}


# --- Campaigns with a concealed effect, and their stored fits ---------------------------------------------------------

# Noise of the displacement [m], the seed of its draws, and the most evaluations of a fit that is stored.
_NOISE, _SEED, _EVALUATIONS = 5e-8, 20, 60


@dataclass(frozen=True)
class Concealed:
    """A base model and what its recordings conceal.

    Attributes:
        base: the model that is fitted, with the true values.
        effect: name of the effect or formula that is added to it, empty for nothing.
        values: of the effect's parameters [SI].
        drives: time [s] and input of the recordings by name; the name of one that is held out begins with ``held``.
        unit: of the input.
        held: parameters that are not estimated.
        noise: of the output [m].
    """

    base: Setup
    effect: str
    values: Mapping[str, float]
    drives: Mapping[str, tuple[Array, Array]]
    unit: str = "V"
    held: tuple[str, ...] = ()
    noise: float = _NOISE


def _multisine(dt: float, samples: int, amplitude: float, frequencies: Sequence[float]) -> tuple[Array, Array]:
    """Return time [s] and an input of several lines that begins at zero."""
    t = np.arange(samples) * dt
    lines = [np.sin(2.0 * np.pi * f * t + k**2) for k, f in enumerate(frequencies)]
    wave = np.sum(lines, axis=0) * np.minimum(t / (0.1 * t[-1]), 1.0)
    return t, amplitude * wave / np.abs(wave).max()


def _actuator_drives() -> dict[str, tuple[Array, Array]]:
    return {
        "slow": _multisine(5e-4, 400, 75.0, (10.0,)),
        "fast": _multisine(5e-5, 400, 60.0, (100.0, 230.0)),
        "small": _multisine(1e-4, 400, 30.0, (40.0, 130.0)),
        "held": _multisine(1e-4, 400, 70.0, (25.0, 180.0)),
    }


@cache
def concealed() -> dict[str, Concealed]:
    """Return the campaigns by name."""
    mass = network("mass_spring_damper").with_values({"m": 0.2, "k": 800.0, "b": 1.5})
    waves = {
        "low": _multisine(4e-3, 400, 1.0, (2.0, 7.3)),
        "resonant": _multisine(4e-3, 400, 0.6, (9.0, 11.0)),
        "small": _multisine(4e-3, 400, 0.3, (3.0, 9.7)),
        "held": _multisine(4e-3, 400, 0.8, (5.0, 10.3)),
    }
    spring = {"kappa_3": 0.015, "q_0": 1e-4}
    return {
        "stiffening actuator": Concealed(
            actuator(), "cubic_stiffness", spring, _actuator_drives(), held=("m", "rho_1")
        ),
        "limited amplifier": Concealed(
            actuator(1), "amplifier_saturation", {"V_max": 72.0}, _actuator_drives(), held=("m", "rho_1")
        ),
        "rubbing mass": Concealed(mass, "coulomb_friction", {"F_c": 0.02, "v_s": 2e-3}, waves, "N", noise=2e-6),
        # No effect of the catalogue, so that a diagnosis has to learn it.
        "kinked amplifier": Concealed(
            actuator(1), "amplifier_knee", {"a_K": 0.15, "U_K": 35.0}, _actuator_drives(), held=("m", "rho_1")
        ),
        "complete actuator": Concealed(actuator(1), "", {}, _actuator_drives(), held=("m", "rho_1")),
    }


def recordings_of(case: Concealed) -> dict[str, dict[str, Array]]:
    """Return the columns of every recording: the true output with white noise and a zero of its own."""
    random = np.random.default_rng(_SEED)
    effects = {**catalogue(), **formulas()}
    true = effects[case.effect].add_to(case.base, case.values) if case.effect else case.base
    found = {}
    for name, (t, u) in case.drives.items():
        y = simulate(true, recording(t, u, case.unit), 4).y
        zero = 3e-6 * random.standard_normal()
        found[name] = {"time_s": t, "u": u, "y": y + zero + case.noise * random.standard_normal(t.size)}
    return found


def manifest_of(case: Concealed, file: str = "{}", setup: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return what a manifest says of a campaign.

    Args:
        file: form of the names of files.
        setup: which model is fitted; a linear actuator where it is left out, for `campaign_of` needs none.
    """
    uses = {name: "confirmation" if name.startswith("held") else "identification" for name in case.drives}
    return {
        "setup": setup or {"model": "linear"},
        "known": {name: case.base.parameters[name].value for name in case.held},
        "columns": {
            "voltage" if case.unit == "V" else "input": {"column": "u", "unit": case.unit},
            "displacement" if case.unit == "V" else "output": {"column": "y", "unit": "m"},
        },
        "recordings": [{"file": file.format(name), "name": name, "use": use} for name, use in uses.items()],
    }


@cache
def campaign_of(name: str) -> Campaign:
    """Return a campaign as it is read."""
    return phnn.read(recordings_of(concealed()[name]), manifest_of(concealed()[name]))


def fitted(name: str, values: Mapping[str, float] | None = None) -> Fit:
    """Return the base model of a campaign at stored values; fitted from the true ones where there are none."""
    case, campaign = concealed()[name], campaign_of(name)
    chosen = tuple(r for r in campaign.recordings if r.mask("identification").any())
    plan = Plan(chosen, {r.name: 2 for r in chosen}, 1)
    names = [n for n in case.base.free if n not in case.held]
    # One evaluation: residual and derivatives where the fit begins.
    most = _EVALUATIONS if values is None else 1
    return fit(case.base.with_values(values or {}), plan, names, max_evaluations=most)


def scores_of(base: Fit) -> tuple[list[Candidate], Location]:
    """Return the scores of the whole catalogue and the learned elements, and the location, of a fitted base model."""
    elements = [*catalogue().values(), *learned_elements().values()]
    possible = [a for e in elements for a in attached(e, base.setup) if a.applies(base.setup)]
    linearised = prepare(base)
    return Screen(linearised, in_all_forms(possible), Criteria())(linearised), locate(linearised)
