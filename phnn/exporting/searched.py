"""Storages with resistors whose step has no closed form, as functions of a program: `phnn.integrate.stages`."""

from __future__ import annotations

from phnn.exporting import solvers
from phnn.exporting.balance import Balance, scaled
from phnn.exporting.program import function
from phnn.integrate.partition import resistors_of
from phnn.integrate.tables import RADAU


def searched(balance: Balance, name: str) -> str:
    """End state and mean effort of a reducible storage, as an expression with two values."""
    key, e = balance.e.states.of(name), balance.e
    x, current, storage = balance.x(name), balance.current(name), balance.storage(name)
    lost = _lost(balance, name)
    renamed, what, suffix = {"lost": lost, "H": "H"}, f"storage {name}", f"_{key}"
    if balance.rules[name] == RADAU:
        value = e.sources.name_of(solvers.first_stage_value, what, renamed, "", suffix)
        first = e.sources.name_of(solvers.first_root, what, renamed | {"value": value}, "", suffix)
        renamed = renamed | {"first_stage": first}
        value = e.sources.name_of(solvers.second_stage_value, what, renamed, "", suffix)
        stages = e.sources.name_of(solvers.radau, what, renamed | {"value": value}, "", suffix)
        balance.lines.append(f"one_{key}, two_{key} = {stages}(s, {x}, {current})")
        return f"two_{key}, {balance.stiffness(name)} * (0.75 * one_{key} + 0.25 * two_{key})"
    mean = f"effort_{key}"
    e.program.functions[mean] = e.plain(
        mean, ("a", "b"), [f"return {e.mean_effort(storage, 'a', 'b')}"], f"Mean effort of {name} between two states"
    )
    renamed = renamed | {"mean_effort": mean}
    value = e.sources.name_of(solvers.gradient_value, what, renamed, "", suffix)
    end = e.sources.name_of(solvers.gradient, what, renamed | {"value": value}, "", suffix)
    balance.lines.append(f"two_{key} = {end}(s, {x}, {current})")
    return f"two_{key}, {e.mean_effort(storage, x, f'two_{key}')}"


def _lost(balance: Balance, name: str) -> str:
    """The function of the flow into a storage's resistors, at its state or at its mean effort; returns its name."""
    key, e = balance.e.states.of(name), balance.e
    at_state = balance.rules[name] == RADAU
    effort = f"{balance.stiffness(name)} * state" if at_state else "state"
    lines, total = [f"effort = {effort}"], []
    for r in (balance.network.resistors[k] for k in resistors_of(balance.network, name)):
        read = "0.0"
        if r.modulated_by is not None:
            read = e.program.state(f"read_{e.names.of(r.name)}", f"what {r.name} reads")
            balance.lines.append(f"{read} = {balance.reading(r.modulated_by)}")
        if isinstance(r.on[name], str) and r.on[name] in balance.modulated:
            ratio = e.program.state(f"gain_{e.names.of(r.name)}", f"ratio of {r.name}")
            balance.lines.append(f"{ratio} = {balance.ratio(r.on[name])}")
        else:
            ratio = balance.ratio(r.on[name])
        total.append(scaled(1, ratio, e.flow(r, scaled(1, ratio, "effort"), read)))
    lines.append(f"return {' + '.join(total)}")
    found = f"lost_into_{key}"
    about = f"Flow into the resistors of {name} {'at its state' if at_state else 'at its mean effort'}"
    e.program.functions[found] = function(found, ("state",), lines, e.program.functions, about)
    return found
