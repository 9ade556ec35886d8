"""Learn a passive one-port where no element of the catalogue explains the mismatch.

Its law is a sum of generic passive elements with strengths that cannot be negative: one-sided stops at spaced gaps
(a convex spring), friction and drag (a monotone damper), Maxwell cells at spaced times (a passive memory).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.ground import Ground
from phnn.effects import Scales
from phnn.effects.effect import with_network
from phnn.errors import PhnnError
from phnn.identify.fit import Fit, fit, variables_from
from phnn.identify.problem import Problem
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.parameters import Parameter, constant
from phnn.recall import recalled
from phnn.setup import Setup

Array = NDArray[np.float64]

_SHARES = (0.25, 0.4, 0.55, 0.7, 0.8, 0.9)


def learned_setup(setup: Setup, detail: str, scales: Scales) -> Setup | None:
    """The setup with the learned element of a kind at strength almost zero; None where there is none of that kind."""
    build = {"elastic": _springs, "dissipative": _dampers, "memory": _memories}.get(detail)
    return None if build is None else replace(build(setup, scales), name=f"{setup.name}+learned")


@recalled
def learn(ground: Ground, detail: str) -> Fit | None:
    """Fit the learned element together with the base parameters; None where the location has no passive one-port."""
    setup = learned_setup(ground.fit.setup, detail, ground.scales)
    if setup is None:
        return None
    own = [n for n in setup.free if n not in ground.fit.setup.parameters]
    try:
        names = [*ground.fit.variables.names, *_touched(ground, setup, own)]
        return fit(setup, ground.plan, names, ground.fit.held, 60, origin=ground.fit)
    except PhnnError:
        return None


def _touched(ground: Ground, setup: Setup, own: Sequence[str]) -> list[str]:
    """Parameters of a learned element on which some output depends.

    A spring beyond the motion that was recorded has none. An optimiser may carry it anywhere within its bounds, and the
    model would push with any force where nothing was recorded.
    """
    problem = Problem(setup, ground.plan, variables_from(setup, ground.plan, own, ground.fit))
    slopes = problem.jacobian(problem.variables.start(setup))[:, : len(own)]
    return [n for n, used in zip(own, np.any(slopes != 0.0, axis=0), strict=True) if used]


def learned_force(base: Setup, setup: Setup, x: Array, step: float) -> Array:
    """(M,) force of the learned element on the junction [N], against its own variable.

    Args:
        base: the setup without it; setup: with it.
        x: (M,) displacement [m] of a spring, velocity [m/s] of a damper, time [s] after a step of a memory.
        step: height of that step [m].
    """
    values = setup.values()
    force = np.zeros_like(x)
    relaxing = {name for r in setup.network.resistors if r.law == "maxwell" for name in r.on}
    for s in (s for s in setup.network.storages if s not in base.network.storages and s.name not in relaxing):
        force -= np.asarray(STORAGE_LAWS[s.law].mean_effort(x, x, *(values[n] for n in s.parameters)))
    for r in (r for r in setup.network.resistors if r not in base.network.resistors):
        own = [values[n] for n in r.parameters]
        if r.law == "maxwell":
            stiffness, tau = own
            force -= stiffness * step * np.exp(-x / tau)
        else:
            force -= np.asarray(RESISTOR_LAWS[r.law].flow(x, 0.0 * x, *own))
    return force


def _strength(name: str, typical: float, unit: str) -> Parameter:
    return Parameter(name, 1e-4 * typical, unit, 0.0, 1e6 * typical, typical=typical, description="learned strength")


def _springs(setup: Setup, scales: Scales) -> Setup:
    storages, couplings, parameters = [], [], []
    for i, share in enumerate((*_SHARES, *(-s for s in _SHARES))):
        storages.append(Storage(f"x_{i}", "stop", (f"k_x{i}", f"g_x{i}"), "m"))
        couplings.append(Coupling(f"x_{i}", "p", 1.0))
        parameters += [
            _strength(f"k_x{i}", 0.05 * scales.stiffness, "N/m"),
            constant(f"g_x{i}", share * scales.displacement, "m", "gap of the learned spring"),
        ]
    network = setup.network.extend(tuple(storages), (), tuple(couplings), tuple(parameters))
    return with_network(setup, network)


def _dampers(setup: Setup, scales: Scales) -> Setup:
    force = 1e-3 * scales.stiffness * scales.displacement
    slow = scales.velocity * scales.slowest / scales.fastest
    resistors, parameters = [], []
    for i, speed in enumerate((0.1 * slow, slow, 0.1 * scales.velocity)):
        resistors.append(Resistor(f"learned_{i}", "coulomb", {"p": 1.0}, (f"F_x{i}", f"v_x{i}")))
        parameters += [_strength(f"F_x{i}", force, "N"), constant(f"v_x{i}", speed, "m/s", "velocity scale")]
    resistors.append(Resistor("learned_drag", "quadratic_drag", {"p": 1.0}, ("c_x",)))
    parameters.append(_strength("c_x", force / scales.velocity**2, "N s²/m²"))
    return with_network(setup, setup.network.extend((), tuple(resistors), (), tuple(parameters)))


def _memories(setup: Setup, scales: Scales) -> Setup:
    storages, resistors, couplings, parameters = [], [], [], []
    for i, tau in enumerate(np.geomspace(0.3 / scales.fastest, scales.duration, 5)):
        storages.append(Storage(f"s_x{i}", "spring", (f"k_x{i}",), "m"))
        resistors.append(Resistor(f"learned_{i}", "maxwell", {f"s_x{i}": 1.0}, (f"k_x{i}", f"tau_x{i}")))
        couplings.append(Coupling(f"s_x{i}", "p", 1.0))
        strength = _strength(f"k_x{i}", 0.01 * scales.stiffness, "N/m")
        parameters += [
            replace(strength, lower=1e-9 * scales.stiffness),
            constant(f"tau_x{i}", float(tau), "s", "time of a learned memory"),
        ]
    network = setup.network.extend(tuple(storages), tuple(resistors), tuple(couplings), tuple(parameters))
    return with_network(setup, network)
