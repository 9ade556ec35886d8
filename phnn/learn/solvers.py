"""The trained model, windows of recordings, and the solvers of windows.

The trained model leads from voltage to displacement, with the coordinates in which it is trained.

A window of samples ``[first, last]`` shares its last sample with the first of the next one. Only the displacement is
measured; charges and momentum are hidden. So the state at the beginning of a window is estimated beside the
parameters, except where the recording begins at rest without input, which is the zero state of every model.

A solver is the power-preserving step, compiled or in torch, or torchdiffeq. It takes a plant, windows and their (B, n)
initial states and returns the (S_b, n) states at the samples of each window, differentiable by the plant's parameters
and the initial states.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import torchdiffeq
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate.differentiable import simulated
from phnn.integrate.method import METHOD
from phnn.integrate.scheme import can_compile
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem
from phnn.recordings.recording import Recording
from phnn.signals.reconstruct import Reconstruction, substep_counts


class Plant(nn.Module):
    """A state space model ``ẋ = f(x, u)``, ``y = y(x)`` with a single input.

    Args:
        core: the module that is trained; its weights are the coordinates.
        scale: (n,) typical size of every state.
    """

    core: Any
    scale: Tensor

    def __init__(self, core: nn.Module, scale: Tensor) -> None:
        super().__init__()
        self.core = core
        self.register_buffer("scale", scale)

    def inputs(self, u: Tensor) -> Tensor:  # u: (...) [V]
        """Return (..., P) inputs of all ports."""
        return u.unsqueeze(-1)

    def rate(self, x: Tensor, u: Tensor) -> Tensor:  # x: (..., n), u: (...) [V]
        """Return (..., n) ``ẋ``."""
        return self.core.vector_field(x, self.inputs(u))

    def measured(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (...) displacement [m]."""
        return self.core.measured(x)

    def trained(self) -> list[nn.Parameter]:
        """Return what an optimiser moves."""
        return list(self.core.parameters())


class NetworkPlant(Plant):
    """A network, trained in the coordinates of its parameters (`phnn.network.bounded`) and in learned laws' weights.

    Args:
        given: a network with starting values, or the system that is trained.
        scale: (n,) typical size of every state.

    Attributes:
        near: times and states last found in torch, by the name of a recording: the next iteration begins there.
    """

    def __init__(self, given: Network | PortHamiltonianSystem, scale: Tensor) -> None:
        super().__init__(PortHamiltonianSystem(given) if isinstance(given, Network) else given, scale)
        self.system: PortHamiltonianSystem = self.core
        self.near: dict[str, tuple[Tensor, Tensor]] = {}

    @property
    def network(self) -> Network:
        """Return the network with the present parameter values and laws."""
        return self.system.shown()

    def inputs(self, u: Tensor) -> Tensor:
        """Return (..., P) the voltage at the first port, the others at zero."""
        return torch.cat([u.unsqueeze(-1), u.new_zeros(*u.shape, len(self.system.network.ports) - 1)], dim=-1)

    def measured(self, x: Tensor) -> Tensor:
        """Return (...) state of the measured storage."""
        return x[..., self.system.state_names.index(self.system.network.output)]

    def trained(self) -> list[nn.Parameter]:
        """Return the coordinates of the parameters, then weights of the learned laws."""
        return [p for part in (self.system.free, self.system.laws) for p in part.parameters() if p.requires_grad]


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a recording.

    Attributes:
        recording: its index; name: its name; first: its first sample.
        start: time of the first sample [s].
        fine: (n, 3) input at the start, middle and end of every step [V].
        h: (n,) steps [s].
        nodes: (S,) step index of every sample, the first 0.
        known: begins at the zero state.
        continues: whether the window before it belongs to the same recording.
    """

    recording: int
    name: str
    first: int
    start: float
    fine: Tensor
    h: Tensor
    nodes: Tensor
    known: bool
    continues: bool

    @property
    def times(self) -> Tensor:
        """Return (n+1,) time of the nodes of the steps [s]."""
        return self.start + torch.cat([self.h.new_zeros(1), self.h.cumsum(0)])

    @property
    def mean(self) -> Tensor:
        """Return (n,) mean inputs of the steps, by Simpson's rule."""
        return (self.fine[:, 0] + 4.0 * self.fine[:, 1] + self.fine[:, 2]) / 6.0


def thinned(recording: Recording, stride: int) -> Recording:
    """Return every ``stride``-th sample of a recording, its noise and its parts as they are.

    Raises:
        InputRefused: too few samples would be left.
    """
    if stride == 1:
        return recording
    if recording.t.size < 8 * stride:
        raise InputRefused(
            f"stride = {stride} leaves {recording.t.size // stride} samples of {recording.name}: lower it"
        )
    parts = tuple(replace(p, first=-(-p.first // stride), last=-(-p.last // stride)) for p in recording.parts)
    return replace(recording.only(slice(None, None, stride)), parts=parts)


def starts_at_zero(recording: Recording) -> bool:
    """Return whether a recording begins at rest without input."""
    return recording.start.state == "rest" and recording.start.input_before == 0.0


def windows_of(recordings: Sequence[Recording], length: int, substeps: int) -> list[Window]:
    """Return the windows of recordings, in order.

    Args:
        length: samples of a window, 0 for whole recordings.
        substeps: steps a sample interval; more of them follow a jump of the input.
    """
    windows = []
    for index, r in enumerate(recordings):
        counts = substep_counts(r.u, r.input_before, substeps)
        fine = Reconstruction(r.u, counts, r.interpolation, clock=r.clock).fine()
        h = np.repeat((r.dt if r.clock is None else np.diff(r.t)) / counts, counts)
        nodes = np.concatenate([[0], np.cumsum(counts)])
        intervals = r.t.size - 1
        pieces = 1 if length == 0 else max(1, round(intervals / (length - 1)))
        edges = np.linspace(0, intervals, pieces + 1).round().astype(int)
        for first, last in pairwise(edges.tolist()):
            steps = slice(nodes[first], nodes[last])
            window = Window(
                index, r.name, first, float(r.t[first]), torch.from_numpy(fine[steps].copy()),
                torch.from_numpy(h[steps].copy()), torch.from_numpy(nodes[first : last + 1] - nodes[first]),
                first == 0 and starts_at_zero(r), first > 0,
            )  # fmt: skip
            windows.append(window)
    return windows


ADAPTIVE = ("dopri5", "dopri8", "bosh3", "adaptive_heun", "fehlberg2")
FIXED = ("euler", "midpoint", "heun2", "heun3", "rk4")

_ROUNDING = 1e-9
_MAX_STEPS = 1_000_000
# States of a shorter share of a recording do not replace those of a longer one.
_LONG = 0.9

# Name of the solver without torchdiffeq.
OWN = "discrete_gradient"

Solver = Callable[[Plant, Sequence[Window], Tensor], list[Tensor]]


def solver_for(settings: Mapping[str, Any], plant: Plant) -> Solver:
    """Return the solver of a training run.

    Args:
        settings: ``name`` is ``discrete_gradient``: the compiled kernel, or where a law has none all windows at once
            in torch; or ``torchdiffeq``, with ``method``, ``adjoint``, ``rtol`` and ``atol`` (in typical states).

    Raises:
        InputRefused: an unknown solver or option, or one that does not suit the model.
    """
    options = dict(settings)
    name = options.pop("name")
    if name == "torchdiffeq":
        unknown = sorted(set(options) - {"method", "adjoint", "rtol", "atol"})
        if unknown:
            raise InputRefused(f"solver.{unknown[0]}: torchdiffeq takes method, adjoint, rtol and atol")
        return Torchdiffeq(plant, **options)
    if name != OWN:
        raise InputRefused(f"solver.name = {name!r}: choose {OWN} or torchdiffeq")
    if options:
        raise InputRefused(f"solver.{min(options)}: {OWN} has no options")
    if isinstance(plant, NetworkPlant):
        return discrete_gradient
    raise InputRefused(f"{OWN} needs an energy, which a {type(plant.core).__name__} has not: take solver=torchdiffeq")


def discrete_gradient(plant: Plant, windows: Sequence[Window], x0: Tensor) -> list[Tensor]:
    """Integrate windows of a network in batches, by compiled code where it can and in torch otherwise."""
    assert isinstance(plant, NetworkPlant)
    compiles = can_compile(plant.system.network)

    def solved(members: Sequence[Window], starts: Tensor) -> Tensor:
        u, h = together(plant, members)
        states = simulated(plant.system, starts, u, h, near=None if compiles else near(plant, members))
        if not compiles:
            remember(plant, members, states.detach())
        return states

    # Compiled code takes one member after the other: there no step should be wasted.
    return _by_groups(solved, windows, x0, [len(w.h) if compiles else len(w.h).bit_length() for w in windows])


def together(plant: Plant, windows: Sequence[Window]) -> tuple[Tensor, Tensor]:
    """Return mean inputs (N, B, P) and steps (N, B) of windows; shorter ones keep their last input, uncounted."""
    count = torch.arange(max(len(w.h) for w in windows))
    rows = [count.clamp_max(len(w.h) - 1) for w in windows]
    u = plant.inputs(torch.stack([w.mean[k] for w, k in zip(windows, rows, strict=True)], dim=1))
    return u, torch.stack([w.h[k] for w, k in zip(windows, rows, strict=True)], dim=1)


def near(plant: NetworkPlant, windows: Sequence[Window]) -> Tensor | None:
    """Return (N+1, B, n) the last known states, interpolated at the times of windows; None where any is missing."""
    known = []
    for w in windows:
        times, states = plant.near.get(w.name, (w.times[:0], w.times[:0]))
        # The last sample of a thinned recording lies up to an interval before that of the recording.
        if len(times) < 2 or times[0] > w.times[0] or 2.0 * times[-1] - times[-2] < w.times[-1] - _ROUNDING:
            return None
        k = (torch.searchsorted(times, w.times, right=True) - 1).clamp(0, len(times) - 2)
        share = ((w.times - times[k]) / (times[k + 1] - times[k])).unsqueeze(-1)
        known.append(states[k] + share * (states[k + 1] - states[k]))
    longest = max(map(len, known))
    return torch.stack([torch.cat([x, x[-1:].expand(longest - len(x), -1)]) for x in known], dim=1)


def remember(plant: NetworkPlant, windows: Sequence[Window], states: Tensor) -> None:
    """Keep the states (N+1, B, n) of windows of whole recordings."""
    for name in dict.fromkeys(w.name for w in windows):
        mine = [(w, states[: len(w.h) + 1, k]) for k, w in enumerate(windows) if w.name == name]
        last = len(mine) - 1
        times = torch.cat([w.times[: None if k == last else -1] for k, (w, _) in enumerate(mine)])
        known = plant.near.get(name)
        if known is None or times[-1] - times[0] > _LONG * (known[0][-1] - known[0][0]):
            plant.near[name] = times, torch.cat([x[: None if k == last else -1] for k, (_, x) in enumerate(mine)])


def grouped(keys: Sequence[Hashable]) -> list[list[int]]:
    """Return the indices of equal keys together, in the order in which the keys first occur."""
    return [[b for b, other in enumerate(keys) if other == key] for key in dict.fromkeys(keys)]


def _by_groups(
    solve: Callable[[Sequence[Window], Tensor], Tensor], windows: Sequence[Window], x0: Tensor, keys: Sequence[Hashable]
) -> list[Tensor]:
    """Return the states at each window's samples; ``solve`` finds those at all steps of windows with equal keys."""
    sampled: list[Tensor] = [x0] * len(windows)
    for members in grouped(keys):
        states = solve([windows[b] for b in members], x0[members])
        for k, b in enumerate(members):
            sampled[b] = states[windows[b].nodes, k]
    return sampled


class Torchdiffeq:
    """Windows by torchdiffeq, in batches.

    The methods of torchdiffeq see all windows at once in the time ``τ`` that counts steps, ``dx/dτ = h_b f(x, u_b)``:
    windows of recordings at different rates then share their output times. The power-preserving step goes window
    lengths and steps apart, one batch for each, in true time.

    Args:
        method: ``phnn``, the power-preserving step (`phnn.integrate.method`), for networks; or an `ADAPTIVE` or
            `FIXED` method of torchdiffeq. Those of several steps have inexact gradients, and scipy's have none.
        adjoint: gradients by `odeint_adjoint`, of adaptive methods; those of ``phnn`` are exact either way.
        rtol, atol: of adaptive methods; ``atol`` in units of the typical states.
    """

    def __init__(
        self, plant: Plant, method: str = METHOD, adjoint: bool = True, rtol: float = 1e-7, atol: float = 1e-9
    ) -> None:
        if method == METHOD and not isinstance(plant, NetworkPlant):
            raise InputRefused(f"method = {method} under torchdiffeq is for networks: take rk4 or dopri5")
        if method not in (METHOD, *ADAPTIVE, *FIXED):
            raise InputRefused(f"method = {method}: choose one of {', '.join((METHOD, *ADAPTIVE, *FIXED))}")
        self.method, self.adjoint, self.rtol, self.atol = method, adjoint, rtol, atol

    def __call__(self, plant: Plant, windows: Sequence[Window], x0: Tensor) -> list[Tensor]:
        """Return the states at the samples of each window."""
        if self.method == METHOD:
            return _by_groups(partial(self._preserving, plant), windows, x0, [w.h.numpy().tobytes() for w in windows])
        return _by_groups(partial(self._general, plant), windows, x0, [0] * len(windows))

    def _general(self, plant: Plant, windows: Sequence[Window], x0: Tensor) -> Tensor:
        counted = _Counted(plant, windows)
        t = torch.arange(counted.h.shape[0] + 1, dtype=torch.float64)
        # A fixed step backwards is not the transpose of the one forwards: the graph alone has its gradients.
        backwards = self.adjoint and self.method in ADAPTIVE
        integrate = torchdiffeq.odeint_adjoint if backwards else torchdiffeq.odeint
        # Both sides of a jump are seen: adaptive steps end there.
        options: dict[str, Any] = {"perturb": True}
        if self.method in ADAPTIVE:
            options = {"jump_t": counted.jumps(), "max_num_steps": _MAX_STEPS}
        adjoint = {"adjoint_atol": self.atol * float(plant.scale.min())} if backwards else {}
        tolerances = {"rtol": self.rtol, "atol": self.atol * plant.scale}
        try:
            states: Tensor = integrate(counted, x0, t, method=self.method, options=options, **tolerances, **adjoint)
        except AssertionError as error:
            raise SolverFailed(f"torchdiffeq stopped: {error}; the model is too stiff for {self.method}") from error
        finite = torch.isfinite(states).flatten(1).all(1)
        if not bool(finite.all()):
            raise SolverFailed(f"{self.method} is unstable from step {int((~finite).int().argmax())} on: add sub-steps")
        return states

    def _preserving(self, plant: Plant, windows: Sequence[Window], x0: Tensor) -> Tensor:
        """Return (N+1, B, n) states of windows with the same steps."""
        assert isinstance(plant, NetworkPlant)
        h = windows[0].h
        t = torch.cat([h.new_zeros(1), h.cumsum(0)])
        fine = torch.stack([w.fine for w in windows], dim=1)

        def inputs(time: Tensor) -> Tensor:
            step = (torch.searchsorted(t, time.detach().reshape(1), right=True)[0] - 1).clamp(0, len(h) - 1)
            # By tensors, for torch.func.vmap.
            start, end, of_step = (
                v.index_select(0, k.reshape(1))[0] for v, k in ((t, step), (t, step + 1), (fine, step))
            )
            return plant.inputs(_quadratic(of_step, (time - start) / (end - start)))

        integrate = torchdiffeq.odeint_adjoint if self.adjoint else torchdiffeq.odeint
        states: Tensor = integrate(plant.system.with_input(inputs), x0, t, method=METHOD)
        return states


def _quadratic(fine: Tensor, share: Tensor) -> Tensor:
    """Return the parabola through the values at the start, middle and end of a step, at a share of it."""
    start, middle, end = fine.unbind(-1)
    linear, bend = -3.0 * start + 4.0 * middle - end, 2.0 * start - 4.0 * middle + 2.0 * end
    return start + share * (linear + share * bend)


class _Counted(nn.Module):
    """``dx/dτ`` of a batch in the time that counts steps."""

    def __init__(self, plant: Plant, windows: Sequence[Window]) -> None:
        super().__init__()
        self.plant = plant
        self.fine = pad_sequence([w.fine for w in windows])
        self.h = pad_sequence([w.h for w in windows])

    def forward(self, tau: Tensor, x: Tensor) -> Tensor:
        step = min(int(tau), self.h.shape[0] - 1)
        u = _quadratic(self.fine[step], tau - step)
        return self.h[step].unsqueeze(-1) * self.plant.rate(x, u)

    def jumps(self) -> Tensor:
        """Return the nodes where the input or the size of a step jumps."""
        # Both sides of a smooth joint come out of a spline, equal up to rounding.
        apart = (self.fine[1:, :, 0] - self.fine[:-1, :, 2]).abs() > _ROUNDING * self.fine.abs().max()
        moved = apart | (self.h[1:] != self.h[:-1])
        return (torch.nonzero(moved.any(1)).flatten() + 1).double()
