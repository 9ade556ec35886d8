"""The steady state that a network reaches from the zero state under constant inputs, with its derivatives.

    [J − D] ∇H(x) + g ψ(u) = 0,     C x = 0

``C`` are the invariants, ``C [J, b_1, …, b_R, g] = 0``: a charge that no flow changes stays zero. Flows need not
vanish: a tank with a steady inflow reaches the level at which its outlet carries the same flow.

A resistor is silent if its flow is zero around its effort, as in a dead zone. With silent resistors, the steady states
form a set. The solution is the one to which the smallest leaks in parallel with the silent resistors would lead, with
the least ``Σ ε_r²``: uncharged hysterons, in the paper's actuator. Modulator states rest at the equilibrium of their
laws under the steady drives.

First derivatives are complex steps: the equations are evaluated for many copies of a network side by side, each of
which has another state, parameter or input perturbed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.integrate.scheme import merged_couplings
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.namespace import TINY
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, evaluated, form_of, is_passive_by_form
from phnn.network.elements import MultiPort, Network, Ratio, Resistor, Storage

Array = NDArray[np.float64]
Values = Mapping[str, Any]

_ITERATIONS = 60
# Tolerances: of the steps, relative to the state; of the rates, relative to the terms that cancel in them.
_CONVERGED, _BALANCED = 1e-12, 1e-9
# A singular value below this share of the largest counts as zero; rows and columns are equilibrated before.
_RANK = 1e-11
_SWEEPS, _EVEN = 20, 0.1
# Step of central differences, relative to the variable: truncation and rounding are alike there.
_DIFFERENCE = 1e-5
_REMEDY = "declare start: unknown, or input_before: 0.0"


def equilibrium(network: Network, u: Array) -> Array:
    """Return (N,) steady state under constant inputs (P,), by Newton's method from the zero state.

    Raises:
        SolverFailed: there is no steady state, or it is not found: names the storages and the remedy.
    """
    x = np.zeros(len(network.state_names))
    if _nothing_acts(network, u):
        return x
    for _ in range(_ITERATIONS):
        point = _at(network, u, x)
        step, (rows, columns), free = _newton(point, x)
        x = x + step
        size = _CONVERGED * np.abs(x / columns).max()
        x[np.abs(x / columns) <= size] = 0.0  # rounding is no motion, which would make a law of the path conduct
        if not np.isfinite(x).all() or np.abs(step / columns).max() <= size:
            break
    else:
        point = _at(network, u, x)
    terms, stored = rows[: x.size] * point.terms, len(network.storages)
    # A rate with a single term is rounding as a whole: its scale is the largest of all rates of storages.
    terms[:stored] = terms[:stored].max(initial=0.0)
    moving = ~(np.abs(rows[: x.size] * point.rate) <= _BALANCED * terms)
    if moving.any():
        raise SolverFailed(_why(network, free, moving))
    return x


def equilibrium_derivative(network: Network, u: Array, names: Sequence[str]) -> Array:
    """Return (N, K) derivatives of the steady state by the values of parameters.

    The state minimises ``½ |ε_S|²`` of the silent resistors under ``G = (ẋ, C x) = 0``. With the multipliers ``λ`` the
    implicit function theorem gives, for ``L = ½ |ε_S|² + λᵀ G``,

        [ L_xx  G_xᵀ ] [ δx ]     [ L_xθ ]
        [ G_x   0    ] [ δλ ] = − [ G_θ  ] δθ,

    of which the solution of least norm is taken, as in `equilibrium`.

    Args:
        names: of parameters of the network, fixed ones too.

    Raises:
        SolverFailed: there is no steady state close by; names the states that grow without bound.
    """
    if not len(names) or _nothing_acts(network, u):
        return np.zeros((len(network.state_names), len(names)))
    start = np.array([network.parameters[name].value for name in names])
    return _implicit(network, start, lambda y: (u[:, None], dict(zip(names, y, strict=True))), u)


def equilibrium_slope(network: Network, u: Array, port: int) -> Array:
    """Return (N,) derivative of the steady state by the input at one port, as `equilibrium_derivative`."""
    at_port = (np.arange(u.size) == port)[:, None]
    return _implicit(network, u[[port]], lambda y: (np.where(at_port, y, u[:, None]), {}), u)[:, 0]


def _nothing_acts(network: Network, u: Array) -> bool:
    """Return whether the zero state is steady for all values of the parameters: no input, no weight and no memory."""
    weights = (isinstance(s.law, str) and not STORAGE_LAWS[s.law].bounded for s in network.storages)
    return not (u.any() or network.memories or any(weights))


def _rates(
    network: Network, x: NDArray[Any], u: NDArray[Any], values: Values, silent: NDArray[np.bool_] | None = None
) -> tuple[NDArray[Any], Array, NDArray[Any], NDArray[Any]]:
    """Return the equations of B copies of a network at complex states (N, B) and inputs (P, B) or (P, 1).

    Args:
        values: of the parameters, (B,) or (); silent: (R,) resistors without a flow, whatever their efforts.

    Returns:
        (N, B) rates ``ẋ``; (N, B) sums of the absolute values of the terms that cancel in them; (R, B) efforts on the
        resistors; (n, C, B) columns along which storages change: of ``J``, of the resistors, the ports, and of what
        the multi-ports can do.
    """
    place, n, copies = {name: k for k, name in enumerate(network.state_names)}, len(network.storages), x.shape[1]
    factors: dict[str, Any] = {}
    for m in network.modulations:
        factor = FACTOR_LAWS[m.law].factor if isinstance(m.law, str) else _by_torch(m.law)
        factors[m.ratio] = factors.get(m.ratio, 1.0) * factor(x[place[m.by]], *_of(m, values))

    def value(ratio: Ratio) -> Any:
        return values[ratio] * factors.get(ratio, 1.0) if isinstance(ratio, str) else ratio

    vectors = [*(r.on for r in network.resistors), *(p.on for p in network.ports)]
    vectors += [column for multi in network.multi_ports for column in multi.columns]
    touched = np.zeros((n, n + len(vectors), copies), dtype=complex)
    for (to, of, ratio), times in merged_couplings(network).items():
        touched[place[to], place[of]] += times * value(ratio)
        touched[place[of], place[to]] -= times * value(ratio)
    for column, on in enumerate(vectors, n):
        for name, ratio in on.items():
            touched[place[name], column] += value(ratio)
    through = np.zeros((n + len(vectors), copies), dtype=complex)
    efforts, flows = through[:n], through[n:]
    for k, storage in enumerate(network.storages):
        efforts[k] = _effort(storage, x[k], values)
    for shared in network.shared_energies:
        at = [place[name] for name in shared.of]
        efforts[at] += _module("mean_efforts_of", shared.law)(x[at].T).T
    epsilon, resistors, ports = (touched[:, n:] * efforts[:, None]).sum(axis=0), len(network.resistors), len(u)
    for r, resistor in enumerate(network.resistors):
        q = x[place[resistor.modulated_by]] if resistor.modulated_by else None
        if silent is None or not silent[r]:
            flows[r] = -_flow(resistor, epsilon[r], q, values)
    for p, port in enumerate(network.ports):
        flows[resistors + p] = PORT_LAWS[port.law].action(u[p], *_of(port, values))
    first, along = resistors + ports, [touched[:, : n + resistors + ports]]
    for multi in network.multi_ports:
        rows = slice(first, first := first + len(multi.columns))
        reads = x[[place[name] for name in multi.reads]].T
        flows[rows] = -_through(multi, epsilon[rows].T, reads).T
        along.append(np.einsum("nkb,sk->nsb", touched[:, n:][:, rows], _reach(multi, np.real(reads[-1]))))
    drives = {r.name: -e * flow for r, e, flow in zip(network.resistors, epsilon, flows, strict=False)}
    drives |= {s.name: effort for s, effort in zip(network.storages, efforts, strict=True)}
    drives |= {p.name: action for p, action in zip(network.ports, flows[resistors:], strict=False)}
    rate, terms = np.zeros((2, *x.shape), dtype=complex)
    rate[:n], terms[:n] = (touched * through).sum(axis=1), (np.abs(touched) * np.abs(through)).sum(axis=1)
    for memory in network.memories:
        law, k, given = MEMORY_LAWS[memory.law], place[memory.name], _of(memory, values)
        decay = law.decay(*given) * x[k]
        drive = sum(drives[name] for name in network.drives_of(memory))
        rate[k] = -decay if law.anew else law.rate(x[k], drive, *given)
        terms[k] = np.abs(decay) + np.abs(rate[k] + decay)
    return rate, np.real(terms), epsilon[:resistors], np.concatenate(along, axis=1)


def _of(element: Any, values: Values) -> list[Any]:
    """Return the values of an element's parameters."""
    return [values[name] for name in element.parameters]


def _effort(storage: Storage, x: NDArray[Any], values: Values) -> NDArray[Any]:
    """Return (B,) ``H'(x)``."""
    law = storage.law
    if isinstance(law, str):
        return np.asarray(STORAGE_LAWS[law].mean_effort(x, x, *_of(storage, values)))
    if form_of(law):
        return np.asarray(evaluated(WIDE_STORAGES[form_of(law)], law.weights().detach().numpy(), x, x))
    return _module("mean_effort_of", law)(x)


def _module(effort: str, law: Any) -> Callable[..., NDArray[Any]]:
    """Return the effort of a torch module, by the name of its function in `phnn.network.checks`, at complex states."""
    from phnn.network import checks  # it needs torch

    return _by_torch(lambda x: getattr(checks, effort)(law, x, x))


def _flow(resistor: Resistor, effort: NDArray[Any], q: NDArray[Any] | None, values: Values) -> NDArray[Any]:
    """Return (B,) ``φ(ε, q)``."""
    law, reads = resistor.law, 0.0 * effort if q is None else q
    if isinstance(law, str):
        return np.asarray(RESISTOR_LAWS[law].flow(effort, reads, *_of(resistor, values)))
    if form_of(law):
        return np.asarray(evaluated(WIDE_RESISTORS[form_of(law)], law.weights().detach().numpy(), effort))
    return _sector(law, _by_torch(law)(effort, *([] if q is None else [q])), effort)


def _through(multi: MultiPort, efforts: NDArray[Any], reads: NDArray[Any]) -> NDArray[Any]:
    """Return (B, k) ``φ(ε, q)`` of a multi-port at efforts (B, k) and the states (B, s) that it reads."""
    return _sector(multi.law, _by_torch(multi.law)(efforts, *([reads] if multi.reads else [])), efforts)


def _reach(multi: MultiPort, reads: Array) -> Array:
    """Return (S, k) flows of a multi-port at efforts of any direction and size, each of norm one, or zero."""
    random, ports = np.random.default_rng(0), len(multi.columns)
    efforts = np.vstack([size * random.standard_normal((2 * ports, ports)) for size in (1e-3, 1.0, 1e3)])
    flows = np.real(_through(multi, efforts + 0j, np.tile(reads, (efforts.shape[0], 1)) + 0j))
    return np.asarray(flows / (np.linalg.norm(flows, axis=1, keepdims=True) + np.finfo(float).tiny))


def _sector(law: Any, flow: NDArray[Any], effort: NDArray[Any]) -> NDArray[Any]:
    """Return the flow of a torch module, zero where one of unknown form would deliver power."""
    power = np.real(effort) * np.real(flow)
    active = power < 0.0 if flow.ndim == 1 else power.sum(axis=-1, keepdims=True) < 0.0
    return flow if is_passive_by_form(law) else np.where(active, 0.0 * flow, flow)


def _by_torch(function: Callable[..., Any]) -> Callable[..., NDArray[Any]]:
    """Return the function of complex arrays that a function of tensors is, perturbations carried to first order."""
    import torch  # a network whose laws all have names does without; its import takes longer than most solves

    def call(*given: NDArray[Any]) -> NDArray[Any]:
        points = tuple(torch.from_numpy(np.real(v).copy()) for v in given)
        along = tuple(torch.from_numpy(np.imag(v) / TINY) for v in given)
        at, change = torch.autograd.functional.jvp(function, points, along)
        return at.numpy() + 1j * TINY * change.numpy()

    return call


class _Point(NamedTuple):
    """A network at a state.

    Attributes:
        rate, terms: (N,) as of `_rates`; slope: (N, N) derivative of the rate.
        is_silent: (R,) which resistors are silent; silent: (S,) their efforts; by_state: (S, N) derivative.
        touched: (n, C) as of `_rates`; invariants: (c, N) ``C``.
    """

    rate: Array
    terms: Array
    slope: Array
    is_silent: NDArray[np.bool_]
    silent: Array
    by_state: Array
    touched: Array
    invariants: Array


def _at(network: Network, u: Array, x: Array) -> _Point:
    """Return a network at a state (N,) under constant inputs (P,)."""
    values: Values = {name: p.value for name, p in network.parameters.items()}
    # The last copy is not perturbed.
    copies = x[:, None] + 1j * TINY * np.eye(x.size, x.size + 1)
    rate, terms, epsilon, along = _rates(network, copies, u[:, None], values)
    states, is_silent = dict(zip(network.state_names, x, strict=True)), np.zeros(len(network.resistors), dtype=bool)
    for r, resistor in enumerate(network.resistors):
        q = np.array([states[resistor.modulated_by]]) if resistor.modulated_by else None
        perturbed = np.real(epsilon[r, -1:]) + 1j * TINY
        is_silent[r] = np.imag(_flow(resistor, perturbed, q, values))[0] == 0.0
    touched = np.real(along[..., -1])
    left_vectors, size, _ = np.linalg.svd(touched)
    rank = int((size > _RANK * size.max(initial=0.0)).sum())
    return _Point(
        np.real(rate[:, -1]), terms[:, -1], np.imag(rate[:, :-1]) / TINY, is_silent,
        np.real(epsilon[is_silent, -1]), np.imag(epsilon[is_silent, :-1]) / TINY, touched,
        np.pad(left_vectors[:, rank:].T, ((0, 0), (0, len(network.memories)))),
    )  # fmt: skip


def _newton(point: _Point, x: Array) -> tuple[Array, tuple[Array, Array], Array]:
    """Return (N,) step, the factors of rows and columns, and (N, f) directions that the equations leave free."""
    matrix = np.vstack([point.slope, point.invariants])
    right = np.concatenate([-point.rate, -point.invariants @ x])
    rows, columns = _equilibrated(matrix)
    step, free = _least(rows[:, None] * matrix * columns, rows * right)
    if free.size and point.silent.size:
        # The silent resistors determine the free directions.
        along = point.by_state @ (columns[:, None] * free)
        size = np.abs(along).max() or 1.0
        chosen, rest = _least(along / size, -(point.silent + point.by_state @ (columns * step)) / size)
        step, free = step + free @ chosen, free @ rest
    return columns * step, (rows, columns), free


def _implicit(
    network: Network, start: Array, placed: Callable[[NDArray[Any]], tuple[NDArray[Any], Values]], u: Array
) -> Array:
    """Return (N, K) derivatives of the steady state by variables that are ``start`` (K,).

    ``placed`` gives inputs and values of parameters where they are complex (K, B).
    """
    x = equilibrium(network, u)
    point, first = _at(network, u, x), len(network.storages)
    n, y = x.size, np.concatenate([x, start])
    values = {name: p.value for name, p in network.parameters.items()}
    # The invariants depend on the ratios: δC = −C δA A⁺ for C A = 0.
    by_ratio = np.linalg.pinv(point.touched, rcond=_RANK) @ x[:first]

    def conditions(y: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return (n + c, B) ``G`` and (S, B) efforts of the silent resistors at states and variables (N + K, B)."""
        inputs, changed = placed(y[n:])
        rate, _, epsilon, touched = _rates(network, y[:n], inputs, {**values, **changed}, point.is_silent)
        held = point.invariants @ y[:n] - point.invariants[:, :first] @ np.tensordot(touched, by_ratio, (1, 0))
        return np.vstack([rate, held]), epsilon[point.is_silent]

    def curvature(multipliers: NDArray[Any]) -> NDArray[Any]:
        """Return (n, n + K) second derivatives of ``ε_S·ε(y) + λ·G(y)``: central differences of complex steps."""
        # A state that is zero has the size of one that moves the equations as much.
        _, natural = _equilibrated(np.vstack([point.slope, point.invariants]))
        sizes = np.concatenate([natural * (np.abs(x / natural).max() or 1.0), np.ones(start.size)])
        steps = _DIFFERENCE * np.where(y == 0.0, sizes, np.abs(y))
        ends = (y[:, None] + np.hstack([np.diag(steps), -np.diag(steps)]))[:, :, None]
        moved = ends + 1j * TINY * np.eye(y.size)[:, None, :n]
        both = [np.imag(v).reshape(-1, 2, y.size, n) / TINY for v in conditions(moved.reshape(y.size, -1))]
        by, silent = ((v[:, 0] - v[:, 1]) / (2.0 * steps[:, None]) for v in both)
        return (np.tensordot(multipliers, by, 1) + np.tensordot(point.silent, silent, 1)).T

    by, silent = (np.asarray(np.imag(v) / TINY) for v in conditions(y[:, None] + 1j * TINY * np.eye(y.size)))
    constraint, count = by[:, :n], by.shape[0]
    multipliers = np.linalg.lstsq(constraint.T, -silent[:, :n].T @ point.silent, rcond=_RANK)[0]
    second: NDArray[Any] = silent[:, :n].T @ silent
    if point.silent.any():
        second = second + curvature(multipliers)
    matrix = np.block([[second[:, :n], constraint.T], [constraint, np.zeros((count, count))]])
    right = -np.vstack([second[:, n:], by[:, n:]])
    rows, columns = _equilibrated(matrix)
    scaled, right = rows[:, None] * matrix * columns, rows[:, None] * right
    solution, _ = _least(scaled, right)
    # Residual at the level of rounding.
    solution = solution + _least(scaled, right - scaled @ solution)[0]
    defect = np.abs(scaled @ solution - right).max(axis=1)
    if (defect > _BALANCED * np.abs(right).max(initial=0.0)).any():
        # A small change makes a state grow without bound.
        raise SolverFailed(_why(network, _newton(point, x)[2], defect[n : 2 * n] > 0.0))
    return np.asarray((columns[:, None] * solution)[:n])


def _equilibrated(matrix: Array) -> tuple[Array, Array]:
    """Return the factors of rows and columns that bring all their largest entries near to one; Ruiz 2001."""
    rows, columns = np.ones(matrix.shape[0]), np.ones(matrix.shape[1])
    for _ in range(_SWEEPS):
        scaled = np.abs(rows[:, None] * matrix * columns)
        by_row, by_column = scaled.max(axis=1), scaled.max(axis=0)
        by_row[by_row == 0.0] = by_column[by_column == 0.0] = 1.0
        if max(abs(by_row - 1.0).max(), abs(by_column - 1.0).max()) <= _EVEN:
            break
        rows, columns = rows / np.sqrt(by_row), columns / np.sqrt(by_column)
    return rows, columns


def _least(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Return the least-squares solution of least norm, and the null space."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise SolverFailed("no rest state was found: the network's rates, or their derivatives, are not finite there")
    left_vectors, size, across = np.linalg.svd(matrix)
    rank = int((size > _RANK * size.max(initial=0.0)).sum())
    inverse = across[:rank].T / size[:rank]
    return inverse @ (left_vectors[:, :rank].T @ right), across[rank:].T


def _why(network: Network, free: Array, moving: NDArray[np.bool_]) -> str:
    """Say which states nothing holds under a constant input, or which move on."""
    names = np.array(network.state_names)
    loose = names[np.abs(free).max(axis=1, initial=0.0) > _BALANCED]
    if not loose.size:
        which = ", ".join(names[moving])
        return f"no rest state under a constant input was found, {which} would not stand still: {_REMEDY}"
    them = "it" if loose.size == 1 else "them"
    return f"a constant input moves {', '.join(loose)} for ever, nothing holds {them}: {_REMEDY}"
