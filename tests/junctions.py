"""Random networks with one junction, and their march as a trajectory, for tests of the compiled step."""

from __future__ import annotations

import numpy as np
import torch
from networks import remembering
from torch import Tensor

from phnn.configuration import config_folder
from phnn.integrate import kernel
from phnn.integrate.equations import check, power_balance
from phnn.integrate.program import compile_network
from phnn.integrate.scheme import Scheme
from phnn.laws import PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.models.network_file import load_network
from phnn.network import Coupling, Network, Port, PortHamiltonianSystem, Ratio, Resistor, Storage
from phnn.network.checks import PowerBalance
from phnn.parameters import Parameter, as_table
from phnn.recordings.excitation import driving_of
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate


def warming(values: dict[str, float] | None = None) -> Network:
    """The actuator that warms up, with two hysterons."""
    return load_network(config_folder() / "network" / "thermal_hrc.yaml").with_values(values or {})


def recording(t: np.ndarray, u: np.ndarray, start: Start | None = None, use: str = "", **other: object) -> Recording:
    """A recording, without an output where none is given as ``y``; one part where its use is given."""
    fields = {"name": "made", "y": np.full(t.size, np.nan), "interpolation": "cubic", "noise": 1e-8} | other
    parts = (Part(str(fields["name"]), 0, t.size, use),) if use else ()
    return Recording(t=t, u=u, start=start or Start("rest"), **({"parts": parts} | fields))  # type: ignore[arg-type]


def differences(setup: Setup, run: Recording, name: str, substeps: int = 1) -> np.ndarray:
    """(N,) derivative of the simulated output by a parameter, by central differences."""
    value = setup.parameters[name].value
    ends = [simulate(setup.with_values({name: value * (1.0 + s)}), run, substeps).y for s in (1e-6, -1e-6)]
    return np.asarray((ends[0] - ends[1]) / (2e-6 * value))


def march(network: Network, u: np.ndarray, h: np.ndarray, x0: np.ndarray) -> Trajectory:
    """The compiled march of a network under the mean inputs ``u`` (n, P) and steps ``h`` (n,).

    Fails the test where a step was not solved.
    """
    program = compile_network(network)
    theta = program.theta(network)
    n, count = u.shape[0], len(program.states)
    states, efforts = np.empty((n + 1, count)), np.empty((n, count))
    done = kernel.march(program, theta, x0, u, h, states, efforts)
    assert done == n, f"step {done} of {n} was not solved"
    return trajectory_of(network, u, h, states, efforts)


def trajectory_of(
    network: Network, u: np.ndarray, h: np.ndarray, states: np.ndarray, efforts: np.ndarray
) -> Trajectory:
    """What a march has filled, as a trajectory."""
    program, n = compile_network(network), u.shape[0]
    theta = program.theta(network)
    t = np.concatenate([[0.0], np.cumsum(h)])
    q = states[:, program.output]
    fine = np.repeat(u[:, :1], 3, axis=1)
    nodes = np.arange(n + 1)
    here = recording(t, np.zeros(n + 1))
    return Trajectory(
        Setup(network), here, Scheme.DISCRETE_GRADIENT, program, theta, driving_of(here, 1), h, nodes, 0, 0, 0, None,
        t, q, fine, u, states,
        efforts,
    )  # fmt: skip


def balanced(trajectory: Trajectory, system: PortHamiltonianSystem) -> tuple[PowerBalance, Tensor]:
    """The power balance of steps that solve the equations of a network, and (n,) the energies that meet in each."""
    assert np.isfinite(trajectory.states).all()
    check(trajectory, 1e-10, system)
    balance, held = power_balance(trajectory, system), system.energy(torch.from_numpy(trajectory.states)).detach()
    size = balance.supplied.abs().sum(-1) + balance.dissipated.abs().sum(-1) + held[1:] + held[:-1] + 1e-200
    return balance, size


class _Draw:
    """Draws the elements of a network around one junction."""

    def __init__(self, seed: int, stiff: bool) -> None:
        self.random = np.random.default_rng(seed)
        self.stiff = stiff
        self.parameters = [
            Parameter("m", float(10.0 ** self.random.uniform(-3, 1))),
            Parameter("alpha", float(self.random.uniform(0.2, 2.0))),
            Parameter("beta", float(self.random.normal()), fixed=True),
        ]
        self.storages: list[Storage] = []
        self.resistors: list[Resistor] = []
        self.couplings: list[Coupling] = []
        self.lossless: list[str] = []

    def ratio(self) -> Ratio:
        return ("alpha", "beta", 1.0, float(self.random.normal()))[self.random.integers(4)]

    def pick(self, names: list[str]) -> str:
        return names[self.random.integers(len(names))]

    def values(self, element: str, example: tuple[float, ...]) -> tuple[str, ...]:
        names = tuple(f"{element}_{k}" for k in range(len(example)))
        spread = np.exp(0.5 * self.random.normal(size=len(example)))
        self.parameters += [Parameter(n, float(v * s)) for n, v, s in zip(names, example, spread, strict=True)]
        return names

    def modulator(self, law: str) -> str | None:
        wanted = law == "following_dead_zone" or self.random.random() < 0.3
        return self.pick(self.lossless) if wanted else None

    def leaf(self, name: str, dissipative: bool) -> None:
        self.couplings.append(Coupling(name, "p", self.ratio()))
        if not dissipative:
            law = self.pick([n for n, found in STORAGE_LAWS.items() if found.bounded])
            self.storages.append(Storage(name, law, self.values(name, STORAGE_LAWS[law].example)))
            self.lossless.append(name)
            return
        law = self.pick(["capacitor", "spring"])
        self.storages.append(Storage(name, law, self.values(name, STORAGE_LAWS[law].example)))
        law = self.pick([n for n, found in RESISTOR_LAWS.items() if found.thresholds is not None])
        names = self.values(f"r_{name}", RESISTOR_LAWS[law].example)
        if self.stiff:
            # The storage's constant is about one, so this is its rate; of a Maxwell cell it is the time constant.
            rate = float(10.0 ** self.random.uniform(-3.0, 9.0))
            place = 1 if law == "maxwell" else 0
            self.parameters[place - len(names)] = Parameter(names[place], 1.0 / rate if place else rate)
        self.resistors.append(Resistor(f"r_{name}", law, {name: 1.0}, names, self.modulator(law)))
        if self.random.random() < 0.3:
            # Before or after what it lies beside.
            leak = Resistor(f"leak_{name}", "linear", {name: 1.0}, self.values(f"leak_{name}", (0.4,)))
            self.resistors.insert(len(self.resistors) - int(self.random.integers(2)), leak)

    def hindrance(self, name: str) -> None:
        law = self.pick([n for n in RESISTOR_LAWS if n != "plastic"])  # a conductance of 1e9 makes much of rounding
        names = self.values(name, RESISTOR_LAWS[law].example)
        self.resistors.append(Resistor(name, law, {"p": 1.0}, names, self.modulator(law)))

    def port(self, name: str) -> Port:
        law = self.pick(list(PORT_LAWS))
        return Port(name, {"p": self.ratio()}, law, self.values(name, PORT_LAWS[law].example))


def random_junction(seed: int, stiff: bool = True) -> Network:
    """A network that the kernel covers, depending on the seed alone: every registered law, shared ratios.

    Args:
        stiff: time constants of dissipative leaves from 1e-9 s to 1e3 s instead of about 1 s.
    """
    draw = _Draw(seed, stiff)
    draw.leaf("q", dissipative=False)
    for k in range(draw.random.integers(0, 5)):
        draw.leaf(f"x{k}", dissipative=bool(draw.random.random() < 0.6))
    for k in range(draw.random.integers(0, 3)):
        draw.hindrance(f"r{k}")
    ports = tuple(draw.port(f"u{k}") for k in range(draw.random.integers(1, 3)))
    inertia = Storage("p", "capacitor", ("m",))
    # The junction's momentum stands anywhere among the storages.
    place = int(draw.random.integers(0, len(draw.storages) + 1))
    storages = (*draw.storages[:place], inertia, *draw.storages[place:])
    return Network(storages, tuple(draw.resistors), tuple(draw.couplings), ports, as_table(draw.parameters), "q")


def random_march(seed: int, stiff: bool = True, steps: int = 40, memories: bool = False) -> Trajectory:
    """A march of a random junction from a random state under inputs with jumps, its steps of several sizes.

    Args:
        memories: with a temperature and another memory, see `networks.remembering`.
    """
    network = random_junction(seed, stiff)
    network = remembering(network, seed) if memories else network
    random = np.random.default_rng(seed + 1)
    h = 10.0 ** random.uniform(-5.0, -0.5) * random.choice([1.0, 1.0, 0.3], steps)
    u = random.normal(size=(steps, len(network.ports))) * random.choice([0.0, 1.0, 10.0], (steps, 1))
    x0 = random.normal(size=len(network.state_names)) * random.choice([0.0, 1.0])
    return march(network, u, h, x0)
