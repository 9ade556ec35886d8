"""The actuator with a learned field added to its equations, in batches, differentiable by torch.

    q̇ = v + f_q,   m v̇ = α u − k q − b v − α Σ V_i + m f_v,   Q̇_i = α q̇ − ϱ_i dz(V_i; d_i) + f_i,   V_i = Q_i / C_i

A step ``h`` between samples solves the mass, spring and damper exactly under a force that is linear in time, and the
dead zones ``dz`` by the implicit Euler rule; explicit rules, those of torchdiffeq among them, would need steps of a
microsecond for ``ϱ_i / C_i``. The learned field is constant during a step. Two iterations of Newton's method find the
displacement at the end, a piecewise linear equation.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from phnn.errors import SolverFailed

_NEWTON = 2
_BASE = ("k", "b", "alpha")


class Field(nn.Module):
    """The learned field ``F_a`` of the scaled state and input: two hidden layers; it begins at zero.

    Args:
        inputs: of the network; outputs: rates of ``q``, ``v`` and each charge; hidden: width.
    """

    def __init__(self, inputs: int, outputs: int, hidden: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(
            nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, outputs)
        ).double()
        last: nn.Linear = self.inner[-1]  # type: ignore[assignment]
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def forward(self, z: Tensor) -> Tensor:  # z: (B, inputs)
        """(B, outputs)."""
        found: Tensor = self.inner(z)
        return found


class Augmented(nn.Module):
    """Base model and learned field.

    Args:
        values: of the base model [SI]: m, k, b, alpha, and C_i, rho_i, d_i of each hysteron.
        sizes: (2 + H + 1,) typical sizes of q, v, Q_i and u; rates: (2 + H,) those of the rates.
        seed, hidden: of the field.

    Raises:
        SolverFailed: the base model is no actuator of this form.
    """

    def __init__(self, values: Mapping[str, float], sizes: Tensor, rates: Tensor, seed: int, hidden: int = 24) -> None:
        super().__init__()
        absent = [n for n in ("m", *_BASE) if n not in values]
        if absent:
            raise SolverFailed(
                f"aphynity: the base model has no parameter {absent[0]}: it is no actuator with hysterons"
            )
        self.mass, self.sizes, self.rates = values["m"], sizes, rates
        self.hysterons = sum(n.startswith("C_") for n in values)
        torch.manual_seed(seed)
        self.field = Field(self.hysterons + 3, self.hysterons + 2, hidden)
        known = [values[n] for n in _BASE]
        own = [[values[f"{n}_{i + 1}"] for i in range(self.hysterons)] for n in ("C", "rho", "d")]
        self.origin, self.own = torch.tensor(known), torch.tensor(own).reshape(3, self.hysterons)
        # Factors of the base parameters, as logarithms.
        self.base = nn.Parameter(torch.zeros(3, dtype=torch.float64))
        self.hysteretic = nn.Parameter(torch.zeros_like(self.own))

    def responses(self, h: Tensor) -> Tensor:
        """(B, 2, 4) what q and v at the end of a step are, by q, v, and the forces at its begin and end.

        Args:
            h: (B,) steps [s].
        """
        k, b, _ = (self.origin * self.base.exp()).unbind()
        zero, one = torch.zeros_like(k), torch.ones_like(k)
        # States q, v, force, and the slope of the force; the force is linear in time.
        rows = [(zero, one, zero, zero), (-k / self.mass, -b / self.mass, one / self.mass, zero)]
        rows += [(zero, zero, zero, one), (zero, zero, zero, zero)]
        matrix = torch.stack([torch.stack(r) for r in rows])
        scale = torch.stack([torch.ones_like(h), torch.ones_like(h), torch.ones_like(h), h], -1)
        end = torch.linalg.matrix_exp(matrix * h[:, None, None]) / scale[:, None, :]
        return torch.stack([end[:, :2, 0], end[:, :2, 1], end[:, :2, 2] - end[:, :2, 3], end[:, :2, 3]], -1)

    def run(self, start: Tensor, u: Tensor, h: Tensor, with_field: bool = True) -> tuple[Tensor, Tensor]:
        """States at all samples, and the learned field during the steps in units of its rates.

        Args:
            start: (B, 2 + H); u: (B, T + 1) input at the samples; h: (B,) steps.

        Returns:
            (B, T + 1, 2 + H) and (B, T, 2 + H).
        """
        e, (_, _, alpha) = self.responses(h), (self.origin * self.base.exp()).unbind()
        capacitance, slope, width = (self.own * self.hysteretic.exp()).unbind()
        width = 0.5 * width
        ratio = h[:, None] * slope / capacitance
        share, by_q = ratio / (1.0 + ratio), alpha / capacitance
        q, v, charge = start[:, 0], start[:, 1], start[:, 2:]
        states, fields = [start], []
        none = torch.zeros_like(start)
        for n in range(u.shape[1] - 1):
            z = torch.cat([torch.stack([q, v], -1), charge, u[:, n : n + 1]], -1) / self.sizes
            f = self.field(z) if with_field else none
            pushed = f * self.rates
            pull = self.mass * pushed[:, 1]
            before = alpha * (u[:, n] - (charge / capacitance).sum(-1)) + pull
            free = e[:, 0, 0] * q + e[:, 0, 1] * v + e[:, 0, 2] * before + h * pushed[:, 0]
            free = free + e[:, 0, 3] * (alpha * u[:, n + 1] + pull)
            rest = charge / capacitance + h[:, None] * pushed[:, 2:] / capacitance
            pull_back = e[:, 0, 3] * alpha
            with torch.no_grad():
                moved = h * v
                for _ in range(_NEWTON - 1):
                    moved = _newton(moved, rest, by_q, width, share, free - q, pull_back)
            # One step at the solution has the derivatives of the solution.
            moved = _newton(moved, rest, by_q, width, share, free - q, pull_back)
            raw = rest + by_q * moved[:, None]
            volts = raw - share * _dead(raw, width)
            after = alpha * (u[:, n + 1] - volts.sum(-1)) + pull
            q, v = q + moved, e[:, 1, 0] * q + e[:, 1, 1] * v + e[:, 1, 2] * before + e[:, 1, 3] * after
            charge = volts * capacitance
            states.append(torch.cat([torch.stack([q, v], -1), charge], -1))
            fields.append(f)
        return torch.stack(states, 1), torch.stack(fields, 1)


def _newton(
    moved: Tensor, rest: Tensor, by_q: Tensor, width: Tensor, share: Tensor, free: Tensor, pull: Tensor
) -> Tensor:  # fmt: skip
    """(B,) a step of Newton's method for the displacement in a step of time, ``x = free − pull Σ V_i(x)``."""
    raw = rest + by_q * moved[:, None]
    inside = 1.0 - share * (raw.abs() > width)
    volts = raw - share * _dead(raw, width)
    return moved - (moved - free + pull * volts.sum(-1)) / (1.0 + pull * (by_q * inside).sum(-1))


def _dead(x: Tensor, width: Tensor) -> Tensor:
    """What exceeds a dead zone."""
    return x - torch.clamp(x, min=-width, max=width)
