"""The optimisers as methods of one epoch each, with all of their state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import kernel, sweep
from phnn.integrate.compilable import can_compile
from phnn.integrate.program import Program, compile_network
from phnn.learn.objective import Objective
from phnn.learn.plant import NetworkPlant
from phnn.learn.settings import Settings, instantiate
from phnn.learn.solvers import discrete_gradient
from phnn.learn.windows import Window

#     (JᵀJ + λ diag JᵀJ) δ = −Jᵀ r,     r = (y − ŷ − zero)/σ
#
# The compiled integration has exact sensitivities by every parameter and every weight of a learned law. A Jacobian of a
# hundred columns costs a few gradients, and some tens of steps replace thousands of a first-order method.
#
# References: Levenberg 1944, Marquardt 1963.
Array = NDArray[np.float64]

_DAMPING, _EASED, _RAISED, _MOST = 1e-2, 0.3, 4.0, 1e8
# Weights that the recordings do not see at all must not move at all.
_FLOOR = 1e-3


class GaussNewton:
    """One damped step an epoch; what is kept between them is the damping alone.

    Raises:
        InputRefused: the plant is no network, its solver not the compiled one, or recordings are cut into windows.
    """

    def __init__(self, objective: Objective) -> None:
        plant = objective.plant
        whole = objective.solver is discrete_gradient and not any(w.continues for w in objective.windows)
        if not isinstance(plant, NetworkPlant) or not can_compile(plant.system.network) or not whole:
            raise InputRefused(
                "gauss_newton is for networks on whole recordings with solver=discrete_gradient: set gauss_newton=0 "
                "and lbfgs=100, or window=0"
            )
        laws = list(plant.system.laws.values())
        if len(set(map(id, laws))) < len(laws) or not all(p.requires_grad for p in plant.system.parameters()):
            raise InputRefused("gauss_newton moves all weights of laws, each of its own: take lbfgs")
        self.objective, self.plant, self.damping = objective, plant, _DAMPING

    def state_dict(self) -> dict[str, Any]:
        """What the next step depends on beside the parameters."""
        return {"damping": self.damping}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.damping = float(state["damping"])

    def __call__(self, epoch: int) -> float:
        """One step; the loss before it.

        Raises:
            SolverFailed: the present model cannot be simulated.
        """
        residual, jacobian = self.linearised()
        n = residual.size
        cost = float(residual @ residual) / n
        normal, slope = jacobian.T @ jacobian, jacobian.T @ residual
        scale = np.maximum(np.diag(normal), _FLOOR * np.diag(normal).max())
        before = _flat(self.objective)
        while self.damping < _MOST:
            step = -np.linalg.solve(normal + self.damping * np.diag(scale), slope)
            _move(self.objective, before + torch.from_numpy(step))
            if self._cost() < cost:
                self.damping = max(self.damping * _EASED, 1e-10)
                return cost
            self.damping *= _RAISED
        _move(self.objective, before)
        self.damping = _DAMPING
        return cost

    @torch.no_grad()
    def _cost(self) -> float:
        try:
            return float(self.objective())
        except SolverFailed:
            return float("inf")

    def linearised(self) -> tuple[Array, Array]:
        """(N,) residual over noise and (N, K) its derivatives by all that is trained."""
        o = self.objective
        o.solved += 1
        columns = sum(p.numel() for p in o.trained())
        chain = self._chain()
        x0 = o.initial().detach()
        outputs, rows = [], []
        for k, w in enumerate(o.windows):
            y, derivatives = self._window(w, x0[k].numpy(), chain, columns, o.unknown.index(k) if not w.known else -1)
            mask, noise = o.masks[w.recording].numpy(), o.recordings[w.recording].noise
            outputs.append(torch.from_numpy(y))
            rows.append(-(derivatives[mask] - derivatives[mask].mean(0)) / noise)
        return o.residuals(outputs).detach().numpy(), np.concatenate(rows)

    def _chain(self) -> Array:
        """(M, K') derivative of the active entries of theta by coordinates and raw weights."""
        plant = self.plant
        blocks = [torch.diag(torch.tensor(plant.slopes(), dtype=torch.float64))] if plant.names else []
        blocks += [weight_derivatives(law) for law in plant.system.laws.values()]
        return torch.block_diag(*blocks).numpy()

    def _window(self, window: Window, x0: Array, chain: Array, columns: int, estimated: int) -> tuple[Array, Array]:
        """(S,) output and (S, K) its derivatives."""
        network = self.plant.network
        program = with_weights(compile_network(network), self.plant)
        theta = program.theta(network)
        u, h = self.plant.inputs(window.mean).numpy(), window.h.numpy()
        states, efforts = np.empty((h.size + 1, x0.size)), np.empty((h.size, x0.size))
        done = kernel.march(program, theta, x0, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(f"no solution of the step at t = {h[:done].sum():.6g} s: lower the rate of learning")
        places = _places(program, self.plant)
        initial = np.arange(x0.size if estimated >= 0 else 0, dtype=np.int64)
        march = sweep.Integrated(program, theta, states, efforts, u, h)
        by, start = sweep.by_parameters(places, h.size), np.zeros((x0.size, places.size))
        found = sweep.sensitivities(march, by, start, initial, window.nodes.numpy())
        out = np.zeros((found.shape[0], columns))
        out[:, : chain.shape[1]] = found[:, : places.size] @ chain
        if estimated >= 0:
            first = chain.shape[1] + estimated * x0.size
            out[:, first : first + x0.size] = found[:, places.size :] * self.plant.scale.numpy()
        return states[window.nodes.numpy(), program.output], out


def with_weights(program: Program, plant: NetworkPlant) -> Program:
    """The program with the weights of neural laws among the inputs of the equations they stand in.

    The adjoint leaves them to the torch module; a forward sweep by weights needs them in its pattern.
    """
    base = len(program.states) + len(program.junctions)
    leaves = [set(inputs) for inputs in program.sparsity.leaves]
    others = {row: set(inputs) for row, inputs in program.sparsity.others.items()}
    for (kind, element), places in _weight_places(program, plant).items():
        owner = _owner(plant, kind, element)
        weights = {base + p for p in places}
        # What belongs to a junction may stand in any equation.
        mine = [leaves[program.leaves.index(owner)]] if owner in program.leaves else [*leaves, *others.values()]
        for inputs in mine:
            inputs |= weights
    sparsity = program.sparsity._replace(
        leaves=tuple(map(frozenset, leaves)), others={row: frozenset(inputs) for row, inputs in others.items()}
    )
    return replace(program, sparsity=sparsity)


def _weight_places(program: Program, plant: NetworkPlant) -> dict[tuple[str, str], range]:
    """Places in theta of the weights of every learned law."""
    first = len(program.names) + len(program.constants)
    found = {}
    for kind, element in program.modules:
        size = plant.system.laws[f"{kind}_{element}"].weights().numel()  # type: ignore[operator]
        found[kind, element] = range(first, first + size)
        first += size
    return found


def _owner(plant: NetworkPlant, kind: str, element: str) -> str:
    """The storage in whose equation a learned law stands, empty for a resistor between several."""
    if kind == "storage":
        return element
    (resistor,) = (r for r in plant.system.network.resistors if r.name == element)
    return next(iter(resistor.on)) if len(resistor.on) == 1 else ""


def _places(program: Program, plant: NetworkPlant) -> NDArray[np.int64]:
    """Active places in theta, in the order in which the plant lists what is trained."""
    of_law = {f"{kind}_{element}": list(p) for (kind, element), p in _weight_places(program, plant).items()}
    places = [program.names.index(n) for n in plant.names]
    return np.array(places + [p for key in plant.system.laws for p in of_law[key]], dtype=np.int64)


def weight_derivatives(law: nn.Module) -> Tensor:
    """(W, K) derivatives of the physical weights of a learned law by its own."""
    raw = list(law.parameters())
    weights: Tensor = law.weights()  # type: ignore[operator]
    rows = []
    for weight in weights:
        found = torch.autograd.grad(weight, raw, retain_graph=True, allow_unused=True)
        pairs = zip(found, raw, strict=True)
        rows.append(torch.cat([torch.zeros_like(p).reshape(-1) if g is None else g.reshape(-1) for g, p in pairs]))
    return torch.stack(rows)


@torch.no_grad()
def _flat(objective: Objective) -> Tensor:
    return torch.cat([p.reshape(-1) for p in objective.trained()]).clone()


@torch.no_grad()
def _move(objective: Objective, vector: Tensor) -> None:
    first = 0
    for p in objective.trained():
        p.copy_(vector[first : first + p.numel()].reshape(p.shape))
        first += p.numel()


METHODS = ("adam", "lbfgs", "gauss_newton")

_LEAST_RATE = 0.01
_HISTORY = 30
# A trial of a line search that cannot be simulated counts as this many times the loss at its start.
_BAD = 1e3


class Method(Protocol):
    """One epoch at a time."""

    def __call__(self, epoch: int) -> float:
        """Take one epoch of the method; the loss before it."""

    def state_dict(self) -> dict[str, Any]:
        """All that the next epoch depends on beside the parameters."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""


def method_of(name: str, objective: Objective, settings: Settings, factor: float) -> Method:
    """A method by its name; ``factor`` lowers the rate of learning after failures."""
    if name == "gauss_newton":
        return GaussNewton(objective)
    if name == "lbfgs":
        return QuasiNewton(objective, settings.lbfgs_iterations)
    if settings.optimiser is not None:
        return OfOwn(objective, settings, factor)
    return Adam(objective, settings.rate * factor, settings.adam)


def with_gradients(objective: Objective) -> Tensor:
    """() the loss, gradients left in ``.grad`` of all that is trained.

    Raises:
        SolverFailed: the model could not be simulated, or loss or gradient are not finite.
    """
    objective.zero_grad()
    loss = objective()
    loss.backward()
    gradients = [p.grad for p in objective.trained() if p.grad is not None]
    if not bool(torch.isfinite(loss)) or not all(bool(torch.isfinite(g).all()) for g in gradients):
        value = float(loss.detach())
        raise SolverFailed(f"the loss is {value:g} or its gradient not finite: lower the rate of learning")
    return loss.detach()


class Adam:
    """Adam along a cosine from the full rate to a hundredth of it (Kingma & Ba 2015; Loshchilov & Hutter 2017)."""

    def __init__(self, objective: Objective, rate: float, epochs: int) -> None:
        self.objective, self.rate, self.epochs = objective, rate, epochs
        self.optimiser = torch.optim.Adam(objective.trained(), lr=rate)

    def now(self, epoch: int) -> float:
        """The rate of an epoch."""
        share = 0.5 * (1.0 + math.cos(math.pi * epoch / self.epochs))
        return self.rate * (_LEAST_RATE + (1.0 - _LEAST_RATE) * share)

    def __call__(self, epoch: int) -> float:
        """One step."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.now(epoch)
        loss = with_gradients(self.objective)
        self.optimiser.step()
        return float(loss)

    def state_dict(self) -> dict[str, Any]:
        """Moments and step counts."""
        return self.optimiser.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.optimiser.load_state_dict(dict(state))


class OfOwn:
    """An optimiser of the user's choice, with a scheduler if there is one; a step an epoch."""

    def __init__(self, objective: Objective, settings: Settings, factor: float) -> None:
        self.objective = objective
        self.optimiser: torch.optim.Optimizer = _made(settings.optimiser, "params", objective.trained())
        for group in self.optimiser.param_groups:
            group["lr"] = factor * group["lr"]
        given = settings.scheduler
        self.scheduler: Any = None if given is None else _made(given, "optimizer", self.optimiser)

    def __call__(self, epoch: int) -> float:
        """One step."""
        loss = with_gradients(self.objective)
        self.optimiser.step()
        if self.scheduler is not None:
            self.scheduler.step()
        return float(loss)

    def state_dict(self) -> dict[str, Any]:
        """The state of both."""
        later = None if self.scheduler is None else self.scheduler.state_dict()
        return {"optimiser": self.optimiser.state_dict(), "scheduler": later}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.optimiser.load_state_dict(dict(state["optimiser"]))
        if self.scheduler is not None:
            self.scheduler.load_state_dict(dict(state["scheduler"]))


def _made(given: Any, name: str, argument: Any) -> Any:
    """What a function makes of its argument, or a mapping with ``_target_`` of an argument of this name."""
    try:
        return given(argument) if callable(given) else instantiate({**given, "_partial_": True})(**{name: argument})
    except (TypeError, ValueError, KeyError) as error:
        raise InputRefused(f"the {'optimiser' if name == 'params' else 'scheduler'} cannot be made: {error}") from error


class QuasiNewton:
    """Several iterations of L-BFGS with a strong Wolfe line search (Liu & Nocedal 1989)."""

    def __init__(self, objective: Objective, iterations: int) -> None:
        self.objective = objective
        self.optimiser = torch.optim.LBFGS(
            objective.trained(), max_iter=iterations, history_size=_HISTORY, line_search_fn="strong_wolfe"
        )

    def __call__(self, epoch: int) -> float:
        """Iterations up to the limit."""
        first: list[float] = []

        def closure() -> Tensor:
            try:
                loss = with_gradients(self.objective)
            except SolverFailed:
                if not first:
                    raise
                for p in self.objective.trained():
                    p.grad = torch.zeros_like(p)
                return torch.tensor(_BAD * first[0], dtype=torch.float64)
            first.append(float(loss))
            return loss

        step: Callable[[Callable[[], Tensor]], Any] = self.optimiser.step
        step(closure)
        return first[0]

    def state_dict(self) -> dict[str, Any]:
        """History of gradients and steps."""
        return self.optimiser.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.optimiser.load_state_dict(dict(state))
