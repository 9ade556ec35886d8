"""The optimisers as methods of one epoch each, with all of their state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import kernel, sweep
from phnn.integrate.compilable import can_compile
from phnn.integrate.differentiable import Steps, first_order, march, sensitivities
from phnn.integrate.program import Program, compile_network
from phnn.learn.objective import Objective
from phnn.learn.settings import Settings, instantiate
from phnn.learn.solvers import NetworkPlant, Window, discrete_gradient, near, remember, together

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

    Laws without a kernel are integrated and differentiated in torch, see `InTorch`.

    Raises:
        InputRefused: the plant is no network, its solver has no sensitivities, or recordings are cut into windows.
    """

    def __init__(self, objective: Objective) -> None:
        plant = objective.plant
        whole = objective.solver is discrete_gradient and not any(w.continues for w in objective.windows)
        if not isinstance(plant, NetworkPlant) or not whole:
            raise InputRefused(
                "gauss_newton is for networks on whole recordings with solver=discrete_gradient: set gauss_newton=0 "
                "and lbfgs=100, or window=0"
            )
        self.in_torch = None if can_compile(plant.system.network) else InTorch(objective)
        laws = list(plant.system.laws.values())
        separate = len(set(map(id, laws))) == len(laws) and all(p.requires_grad for p in plant.system.parameters())
        if self.in_torch is None and not separate:
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
            step = torch.from_numpy(-np.linalg.solve(normal + self.damping * np.diag(scale), slope))
            if self._cost(before, step) < cost:
                self.damping = max(self.damping * _EASED, 1e-10)
                return cost
            self.damping *= _RAISED
        _move(self.objective, before)
        self.damping = _DAMPING
        return cost

    @torch.no_grad()
    def _cost(self, before: Tensor, step: Tensor) -> float:
        """The loss after a step; infinite where the model cannot be simulated there."""
        try:
            if self.in_torch is not None:
                return self.in_torch.cost(before, step)
            _move(self.objective, before + step)
            return float(self.objective())
        except SolverFailed:
            return float("inf")

    def linearised(self) -> tuple[Array, Array]:
        """(N,) residual over noise and (N, K) its derivatives by all that is trained."""
        o = self.objective
        o.solved += 1
        if self.in_torch is not None:
            return self.in_torch.linearised()
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


class InTorch:
    """Residual, derivatives and trial steps of an objective whose network is solved in torch."""

    def __init__(self, objective: Objective) -> None:
        plant = objective.plant
        assert isinstance(plant, NetworkPlant)
        self.objective, self.plant, self.steps = objective, plant, Steps(plant.system)
        self.row = plant.system.state_names.index(plant.system.network.output)
        self.trained = {n: p for n, p in self.steps.named_parameters() if p.requires_grad}
        # Of equal lengths: no step is wasted.
        sizes = [len(w.h) for w in objective.windows]
        self.groups = [[k for k, s in enumerate(sizes) if s == size] for size in dict.fromkeys(sizes)]
        self.driven = [together(plant, [objective.windows[k] for k in members]) for members in self.groups]
        self.states: list[Tensor] = []

    @torch.no_grad()
    def _solved(self, guesses: Sequence[Tensor | None], alone: bool) -> list[Tensor]:
        """(N+1, B, n) states of the windows of every group."""
        x0, system = self.objective.initial(), self.plant.system
        given = zip(self.groups, self.driven, guesses, strict=True)
        return [march(system, x0[m], u, h.unsqueeze(-1), near=g, alone=alone) for m, (u, h), g in given]

    def _outputs(self, states: Sequence[Tensor]) -> list[Tensor]:
        found: list[Tensor] = [states[0]] * len(self.objective.windows)
        for members, x in zip(self.groups, states, strict=True):
            for b, k in enumerate(members):
                found[k] = x[self.objective.windows[k].nodes, b, self.row]
        return found

    def linearised(self) -> tuple[Array, Array]:
        """(N,) residual over noise and (N, K) its derivatives by all that is trained."""
        o, windows = self.objective, [[self.objective.windows[k] for k in m] for m in self.groups]
        self.states = self._solved([near(self.plant, w) for w in windows], alone=False)
        sizes = [p.numel() for p in self.trained.values()]
        places = dict(zip(map(id, self.trained.values()), np.cumsum([0, *sizes]), strict=False))
        order = np.concatenate([places[id(p)] + np.arange(p.numel()) for p in self.plant.trained()])
        rows: list[Array] = [np.zeros(0)] * len(o.windows)
        for members, (u, h), x, own in zip(self.groups, self.driven, self.states, windows, strict=True):
            remember(self.plant, own, x)
            nodes = [w.nodes for w in own]
            try:
                found = sensitivities(self.steps, x, u, h.unsqueeze(-1), nodes, self.row)
            except RuntimeError as error:
                raise InputRefused(f"gauss_newton cannot follow a law ({error}): take lbfgs") from error
            for k, w, by in zip(members, own, found, strict=True):
                of_start = np.zeros((len(w.nodes), o.offsets.numel()))
                if not w.known:
                    first = o.unknown.index(k) * x.shape[-1]
                    of_start[:, first : first + x.shape[-1]] = by[:, -x.shape[-1] :] * self.plant.scale
                both = np.concatenate([by[:, : -x.shape[-1]].numpy()[:, order], of_start], axis=1)
                inside = both[o.masks[w.recording].numpy()]
                rows[k] = -(inside - inside.mean(0)) / o.recordings[w.recording].noise
        return o.residuals(self._outputs(self.states)).detach().numpy(), np.concatenate(rows)

    @torch.no_grad()
    def cost(self, before: Tensor, step: Tensor) -> float:
        """The loss after a step (K,), which is taken; simulated from where the derivatives lead.

        Raises:
            SolverFailed: that did not converge.
        """
        _move(self.objective, before)
        x0, named, first = self.objective.initial(), {id(p): n for n, p in self.trained.items()}, 0
        moved = {}
        for p in self.plant.trained():
            moved[named[id(p)]] = step[first : first + p.numel()].reshape(p.shape)
            first += p.numel()
        _move(self.objective, before + step)
        start = self.objective.initial() - x0
        _move(self.objective, before)
        given = zip(self.groups, self.driven, self.states, strict=True)
        guesses = [x + first_order(self.steps, x, u, h.unsqueeze(-1), moved, start[m]) for m, (u, h), x in given]
        _move(self.objective, before + step)
        states = self._solved(guesses, alone=True)
        for members, x in zip(self.groups, states, strict=True):
            remember(self.plant, [self.objective.windows[k] for k in members], x)
        return float(self.objective.residuals(self._outputs(states)).square().mean())


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
    return Stepwise(objective, settings, factor)


def with_gradients(objective: Objective) -> Tensor:
    """() the loss, gradients left in ``.grad`` of all that is trained.

    Raises:
        SolverFailed: the model could not be simulated, or loss or gradient are not finite.
    """
    objective.zero_grad()
    loss = objective()
    try:
        loss.backward()
    except AssertionError as error:
        raise SolverFailed(f"the way back failed ({error}): the model is stiff, set solver.adjoint=false") from error
    gradients = [p.grad for p in objective.trained() if p.grad is not None]
    if not bool(torch.isfinite(loss)) or not all(bool(torch.isfinite(g).all()) for g in gradients):
        value = float(loss.detach())
        raise SolverFailed(f"the loss is {value:g} or its gradient not finite: lower the rate of learning")
    return loss.detach()


class Stepwise:
    """A torch optimiser, a step an epoch: Adam along a cosine from the full rate to a hundredth of it (Kingma & Ba
    2015; Loshchilov & Hutter 2017), or one of the user's choice, with a scheduler if there is one."""

    def __init__(self, objective: Objective, settings: Settings, factor: float) -> None:
        self.objective, self.settings, self.rate = objective, settings, settings.rate * factor
        own, trained = settings.optimiser, objective.trained()
        self.optimiser: torch.optim.Optimizer = (
            torch.optim.Adam(trained, lr=self.rate) if own is None else _made(own, "params", trained)
        )
        for group in self.optimiser.param_groups if own is not None else ():
            group["lr"] = factor * group["lr"]
        given = None if own is None else settings.scheduler
        self.scheduler: Any = None if given is None else _made(given, "optimizer", self.optimiser)

    def now(self, epoch: int) -> float:
        """The rate of Adam in an epoch."""
        share = 0.5 * (1.0 + math.cos(math.pi * epoch / self.settings.adam))
        return self.rate * (_LEAST_RATE + (1.0 - _LEAST_RATE) * share)

    def __call__(self, epoch: int) -> float:
        """One step."""
        for group in self.optimiser.param_groups if self.settings.optimiser is None else ():
            group["lr"] = self.now(epoch)
        loss = with_gradients(self.objective)
        self.optimiser.step()
        if self.scheduler is not None:
            self.scheduler.step()
        return float(loss)

    def state_dict(self) -> dict[str, Any]:
        """The state of optimiser and scheduler."""
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
