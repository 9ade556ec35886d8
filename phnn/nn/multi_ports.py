"""Learned laws on several variables together, passive whatever their weights, and a learned ratio.

    LearnedDissipation    φ(ε, q) = L(ε, q) L(ε, q)ᵀ ε              εᵀφ ≥ 0
    LearnedCoupling       φ(q) = (A(q)ᵀ − A(q)) ε                   εᵀφ = 0
    LearnedEnergy         H(x) ≥ H(0) = 0, convex                   beside the storages' own energies
    LearnedRatio          f(x), f(0) = 1                            a factor of a transformer's or gyrator's ratio

They join a network by `phnn.network.MultiPort`, `SharedEnergy` and `Modulation`:

    flow = phnn.nn.LearnedDissipation(2, effort_scale=(20.0, 0.1), flow_scale=(1e-3, 5.0))
    network = network.extend(multi_ports=(MultiPort("friction", flow, on=("Q_1", "p")),))

References: Desai et al. 2021, Roth et al. 2025 (learned port-Hamiltonian systems, stable ones with convex energies);
Amos, Xu & Kolter 2017 (input convex networks); McLachlan, Quispel & Robidoux 1999 (discrete gradients).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.laws.wide import convex_unit, hinge, register_compiled
from phnn.network.bounded import LARGEST_WEIGHT, check_weights
from phnn.nn.one_ports import scales

# By how much the entries of a learned matrix vary at the start, of which those on the diagonal are near one.
_VARIED = 0.3
# The ridge that keeps fitted weights small.
_RIDGE = 1e-6
# Steps of units that are spread over a range: their slope over that of one as wide as the range.
_SHARP = 4.0
# Scales of several variables: one for all of them, or one each.
Scale = float | Sequence[float]


class Perceptron(nn.Module):
    """Affine layers with tanh between them, in float64; the weights of a layer have variance 1/fan-in.

    Args:
        sizes: of input, hidden layers and output.
        random: source of the initial weights.
        last: size of the last layer's weights.
    """

    def __init__(self, sizes: Sequence[int], random: torch.Generator, last: float = 1.0) -> None:
        super().__init__()
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for k, (inputs, outputs) in enumerate(pairwise(sizes)):
            final = k == len(sizes) - 2
            size = (last if final else 1.0) * max(inputs, 1) ** -0.5
            drawn = torch.randn(outputs, inputs, generator=random, dtype=torch.float64)
            self.weights.append(nn.Parameter(size * drawn))
            drawn = torch.randn(outputs, generator=random, dtype=torch.float64)
            self.biases.append(nn.Parameter((0.0 if final else 0.5) * drawn))

    def hidden(self, x: Tensor) -> Tensor:  # x: (..., sizes[0])
        """Return (..., sizes[-2]) what the last layer is given."""
        for weight, bias in list(zip(self.weights, self.biases, strict=True))[:-1]:
            x = torch.tanh(x @ weight.mT + bias)
        return x

    def forward(self, x: Tensor) -> Tensor:  # x: (..., sizes[0])
        """Return (..., sizes[-1])."""
        return self.hidden(x) @ self.weights[-1].mT + self.biases[-1]

    @torch.no_grad()
    def fit(self, points: Tensor, values: Tensor) -> None:
        """Fit the last layer to values (N, sizes[-1]) at points (N, sizes[0]), by least squares with a small ridge."""
        hidden = self.hidden(points)
        columns = torch.cat([hidden, torch.ones_like(hidden[:, :1])], dim=1)
        normal = columns.mT @ columns + _RIDGE * len(columns) * torch.eye(columns.shape[1], dtype=torch.float64)
        weights = torch.linalg.solve(normal, columns.mT @ values)
        self.weights[-1].copy_(weights[:-1].mT)
        self.biases[-1].copy_(weights[-1])

    def slopes(self, x: Tensor) -> tuple[Tensor, Tensor]:  # x: (..., sizes[0])
        """Return the values (..., sizes[-1]) and their derivatives (..., sizes[-1], sizes[0]), of one hidden layer."""
        (first, last), (shift, offset) = self.weights, self.biases
        hidden = torch.tanh(x @ first.mT + shift)
        rates = (1.0 - hidden * hidden) @ (last.mT.unsqueeze(-1) * first.unsqueeze(1)).flatten(1)
        return hidden @ last.mT + offset, rates.unflatten(-1, (len(last), x.shape[-1]))

    @torch.no_grad()
    def spread(self, reach: Tensor, inputs: Tensor) -> None:
        """Let each first-layer unit step across one of the inputs (K,), evenly over ``± reach`` (sizes[0],)."""
        unit = torch.arange(len(self.biases[0]))
        each, number = inputs[unit % len(inputs)], unit // len(inputs)
        self.weights[0].zero_()[unit, each] = _SHARP / reach[each]
        self.biases[0].copy_(_SHARP * (2.0 * number / number.max().clamp_min(1) - 1.0))

    @torch.no_grad()
    def begin(self, values: Tensor, share: float = 0.05) -> None:
        """Make it give nearly the same values (sizes[-1],) everywhere.

        A share of the last weights stays, for without any the layers before them would get no gradient.
        """
        self.weights[-1].mul_(share)
        self.biases[-1].copy_(values)


class _OnEfforts(nn.Module):
    """A law on ``k`` efforts by a triangular matrix, whose entries come from one perceptron of one hidden layer.

    That of a dissipation has a diagonal and follows efforts and states, that of a coupling follows states alone.
    """

    ROLE, COUNTS = "multi_port", ("ports", "reads", "width")
    dissipative: bool
    scale: Tensor
    factor: Tensor

    def __init__(
        self,
        ports: int,
        reads: int = 0,
        effort_scale: Scale = 1.0,
        flow_scale: Scale = 1.0,
        state_scale: Scale = 1.0,
        width: int = 16,
        seed: int = 0,
    ) -> None:
        super().__init__()
        _check(ports, width, 1 if self.dissipative else 2, reads)
        self.ports, self.counts = ports, {"ports": ports, "reads": reads, "width": width}
        effort, flow = scales("effort_scale", effort_scale, ports), scales("flow_scale", flow_scale, ports)
        read = scales("state_scale", state_scale, reads)
        self.register_buffer("scale", torch.cat([effort, read]) if self.dissipative else read)
        self.register_buffer("factor", (flow / effort).sqrt())
        rows, columns = torch.tril_indices(ports, ports, 0 if self.dissipative else -1)
        random = torch.Generator().manual_seed(seed)
        self.entries = Perceptron((len(self.scale), width, len(rows)), random, last=_VARIED)
        with torch.no_grad():
            spread = _VARIED if self.dissipative else 1.0
            self.entries.biases[-1].normal_(0.0, spread, generator=random).add_((rows == columns).double())

    def triangle(self, given: Tensor) -> Tensor:
        """Return (..., k, k) the matrix at what it follows, its rows times ``√(f/s)``."""
        check_weights(self, largest=LARGEST_WEIGHT)
        return self._filled(self.entries(given / self.scale.abs()))

    def _filled(self, entries: Tensor) -> Tensor:
        """Return (..., k, k) of the entries on and below the diagonal."""
        n = self.ports
        rows, columns = torch.tril_indices(n, n, 0 if self.dissipative else -1, device=entries.device)
        matrix = entries.new_zeros(*entries.shape[:-1], n * n)
        filled = matrix.index_copy(-1, rows * n + columns, entries).reshape(*entries.shape[:-1], n, n)
        return self.factor.unsqueeze(-1) * filled

    def _followed(self, given: Tensor) -> tuple[Tensor, Tensor]:
        """Return (..., k, k) the matrix, and (..., I, k, k) its derivatives by the ``I`` numbers that it follows."""
        scale = self.scale.abs()
        entries, rates = self.entries.slopes(given / scale)
        return self._filled(entries), self._filled((rates / scale).mT)


class LearnedDissipation(_OnEfforts):
    """A resistor on ``k`` efforts together, coupled and passive by its form.

        φ(ε, q) = R L Lᵀ R ε,     L = L(ε/s, q/s_q) lower triangular,     R = diag √(f/s)

    ``εᵀφ = |Lᵀ R ε|² ≥ 0`` for all weights. ``L`` begins near the unit matrix.

    Args:
        ports: number ``k`` of efforts.
        reads: number of states ``q``.
        effort_scale, flow_scale: typical efforts ``s`` and flows ``f`` [SI], one for all or one each.
        state_scale: typical states ``s_q`` [SI].
        width: of the hidden layer.
        seed: of the initial weights.

    Raises:
        InputRefused: no port, no unit, or a scale that is not positive.
        SolverFailed: at an evaluation, where training has carried a weight beyond use; names it.
    """

    dissipative = True

    def root(
        self,
        effort: Tensor,  # (..., k)
        q: Tensor,  # (..., s)
    ) -> Tensor:
        """Return (..., k, k) ``R L``; its square is the matrix of the flow."""
        return self.triangle(torch.cat([effort, q], dim=-1))

    def forward(
        self,
        effort: Tensor,  # (..., k)
        q: Tensor | None = None,  # (..., s)
    ) -> Tensor:
        """Return (..., k) flows ``φ(ε, q)``."""
        root = self.root(effort, effort[..., :0] if q is None else q)
        return (root @ (root.mT @ effort.unsqueeze(-1))).squeeze(-1)

    def flow_slopes(self, effort: Tensor, q: Tensor) -> Tensor:
        """Return (..., k, k+s) derivatives of the flows by efforts and states."""
        root, rates = self._followed(torch.cat([effort, q], dim=-1))
        inner = (root.mT @ effort.unsqueeze(-1)).squeeze(-1)
        # Of R L (Lᵀ R ε) by L, column by column.
        moved = (rates * inner[..., None, None, :]).sum(-1)
        back = (rates * effort[..., None, :, None]).sum(-2)
        by_root = (moved + back @ root.mT).mT
        return by_root + nn.functional.pad(root @ root.mT, (0, q.shape[-1]))


class LearnedCoupling(_OnEfforts):
    """A power-conserving coupling between ``k`` efforts, which a network adds to its ``J(x)``.

        φ(ε, q) = −S(q) ε,     S = F (A − Aᵀ) F,     A = A(q/s_q) strictly lower triangular,     F = diag √(f/s)

    Args:
        ports: number ``k ≥ 2`` of efforts.
        reads: number of states ``q``; without any ``S`` is constant.
        effort_scale, flow_scale, state_scale, width, seed: as of `LearnedDissipation`.

    Raises:
        InputRefused, SolverFailed: as of `LearnedDissipation`.
    """

    dissipative = False

    def lower(
        self,
        q: Tensor,  # (..., s)
    ) -> Tensor:
        """Return (..., k, k) ``F A F``, whose difference to its transpose is ``S``."""
        return self.triangle(q) * self.factor

    def forward(
        self,
        effort: Tensor,  # (..., k)
        q: Tensor | None = None,  # (..., s)
    ) -> Tensor:
        """Return (..., k) flows ``−S(q) ε`` that leave the storages."""
        half = self.lower(effort[..., :0] if q is None else q)
        return ((half.mT - half) @ effort.unsqueeze(-1)).squeeze(-1)

    def flow_slopes(self, effort: Tensor, q: Tensor) -> Tensor:
        """Return (..., k, k+s) derivatives of the flows by efforts and states."""
        half, rates = (v * self.factor for v in self._followed(q))
        by_state = ((rates.mT - rates) * effort[..., None, None, :]).sum(-1).mT
        return torch.cat([(half.mT - half).expand(*by_state.shape[:-1], self.ports), by_state], dim=-1)


# All units of a learned energy together bend it by this share of its scale at the start.
_BEND = 0.2


class LearnedEnergy(nn.Module):
    """A convex energy of ``k`` states together, zero and least at rest for all weights.

        H(x) = E Σ_i w_i [S(z_i) − S(b_i) − σ(b_i) W_i x/s],     z = W x/s + b,     w_i = c S(r_i/c) > 0

    with the hinge ``S(y) = (y + √(4 + y²))/2`` and its slope ``σ``. Each bracket is ``S`` less its tangent at rest,
    hence not negative and convex. It has no quadratic part of its own: it stands beside the energies of its storages.

    The sum of functions of one projection each has a symmetric discrete gradient in closed form,

        ∇̄H(a, b) = (E/s) Wᵀ w ∘ [ΔS/Δz − σ(b)],       ∇̄H·(b − a) = H(b) − H(a) exactly,

    which needs neither the quadrature of the mean-value gradient nor the division by ‖b − a‖² of Gonzalez's.

    Args:
        states: number ``k`` of states.
        state_scale: typical states ``s`` [SI], one for all or one each.
        energy_scale: typical energy ``E`` [J].
        width: number of units.
        seed: of the initial weights.

    Raises:
        InputRefused, SolverFailed: as of `LearnedDissipation`.

    References: Kolter & Manek 2019 (a convex network less its tangent at rest is a Lyapunov function); Barron 2021.
    """

    ROLE, COUNTS = "shared_energy", ("states", "width")
    scale: Tensor
    typical: Tensor

    def __init__(
        self, states: int, state_scale: Scale = 1.0, energy_scale: float = 1.0, width: int = 16, seed: int = 0
    ) -> None:
        super().__init__()
        _check(states, width)
        self.counts = {"states": states, "width": width}
        self.register_buffer("scale", scales("state_scale", state_scale, states))
        self.register_buffer("typical", scales("energy_scale", energy_scale)[0])
        random = torch.Generator().manual_seed(seed)
        self.directions = nn.Parameter(torch.randn(width, states, generator=random, dtype=torch.float64))
        self.positions = nn.Parameter(torch.randn(width, generator=random, dtype=torch.float64))
        self.heights = nn.Parameter(torch.zeros(width, dtype=torch.float64))
        # At r = 0 all units together bend the energy by some percent, and r moves w by half as much.
        self.smoothing = _BEND / width

    def _weights(self) -> Tensor:
        """Return (U,) ``E w > 0``."""
        check_weights(self, largest=LARGEST_WEIGHT)
        return self.typical.abs() * self.smoothing * hinge(self.heights / self.smoothing)[0]

    def energy(self, x: Tensor) -> Tensor:  # x: (..., k)
        """Return (...) ``H(x)`` [J]."""
        projected = x @ (self.directions / self.scale.abs()).mT
        return (projected * convex_unit(0.0 * projected, projected, self._weights(), 1.0, self.positions)).sum(-1)

    def mean_efforts(
        self,
        a: Tensor,  # (..., k) states at the start of a step
        b: Tensor,  # (..., k) and at its end
    ) -> Tensor:
        """Return (..., k) ``∇̄H(a, b)``, and ``∇H(a)`` where ``b = a``."""
        directions = self.directions / self.scale.abs()
        ends = a @ directions.mT, (a if a is b else b) @ directions.mT
        return convex_unit(*ends, self._weights(), 1.0, self.positions) @ directions

    def effort_slopes(self, a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
        """Return (..., k, k) derivatives of the mean efforts by the states at the start and at the end of a step."""
        directions, weights = self.directions / self.scale.abs(), self._weights()
        at = [hinge(x @ directions.mT + self.positions) for x in (a, b)]
        product = at[0][0] * at[1][0]
        # Of AB/(1 + AB), where S' = S/r.
        shared = weights * product / (1.0 + product).square()
        outer = (directions.unsqueeze(-1) * directions.unsqueeze(-2)).flatten(1)
        by_start, by_end = ((shared / r @ outer).unflatten(-1, (a.shape[-1], -1)) for _, r in at)
        return by_start, by_end

    def forward(self, x: Tensor) -> Tensor:  # x: (..., k)
        """Return (..., k) efforts ``∇H(x)``."""
        return self.mean_efforts(x, x)


class LearnedRatio(nn.Module):
    """A factor of a ratio that follows a state; the coupling stays power-conserving whatever it is.

        f(x) = 1 + Σ_i w_i [tanh(k_i x/s + c_i) − tanh(c_i)]

    It begins as ``f = 1``. As the law of a `phnn.network.Modulation` it needs neither sign nor bound.

    Args:
        state_scale: typical state ``s`` [SI].
        width: number of units.

    Raises:
        InputRefused, SolverFailed: as of `LearnedDissipation`.
    """

    ROLE, COUNTS = "modulation", ("width",)
    scale: Tensor

    def __init__(self, state_scale: float = 1.0, width: int = 8) -> None:
        super().__init__()
        _check(1, width)
        self.counts = {"width": width}
        self.register_buffer("scale", scales("state_scale", state_scale)[0])
        self.heights = nn.Parameter(torch.zeros(width, dtype=torch.float64))
        self.gains = nn.Parameter(torch.full((width,), 2.0, dtype=torch.float64))
        self.positions = nn.Parameter(torch.linspace(-3.0, 3.0, width, dtype=torch.float64))

    def forward(self, x: Tensor) -> Tensor:  # x: (...)
        """Return (...) ``f(x)``."""
        check_weights(self, largest=LARGEST_WEIGHT)
        rise = torch.tanh(self.gains * x.unsqueeze(-1) / self.scale.abs() + self.positions) - torch.tanh(self.positions)
        return 1.0 + (rise * self.heights).sum(-1)


def _check(count: int, width: int, least: int = 1, reads: int = 0) -> None:
    if count < least or width < 1 or reads < 0:
        raise InputRefused(f"{count} variables, width = {width}: give {least} and one unit at least")


for _law in (LearnedDissipation, LearnedCoupling, LearnedEnergy, LearnedRatio):
    register_compiled(_law)
