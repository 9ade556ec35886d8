"""Drives of a modulator state in a step, as expressions of an exported program."""

from __future__ import annotations

from phnn.exporting.balance import Balance
from phnn.network.elements import ModulatorState


def drives(balance: Balance, memory: ModulatorState) -> list[str]:
    """Terms of the mean drive: powers of resistors, efforts of storages, actions of ports.

    Of a reducible storage all resistors drive the modulator state or none does, see `phnn.integrate.compilable`.
    """
    network = balance.network
    resistors, ports = {r.name: r for r in network.resistors}, [p.name for p in network.ports]
    terms: list[str] = []
    emptied: set[str] = set()
    for name in network.drives_of(memory):
        if name in network.storage_names:
            terms.append(balance.mean(name))
        elif name in ports:
            terms.append(balance.action(name))
        elif set(resistors[name].on) <= set(balance.junctions):
            terms.append(balance.power(name))
        else:
            (storage,) = resistors[name].on
            if storage not in emptied:
                terms.append(_dissipated(balance, storage))
            emptied.add(storage)
    return terms


def _dissipated(balance: Balance, name: str) -> str:
    """``i ē − ΔH/h``: what the resistors of a reducible storage take."""
    x, end = balance.x(name), balance.end(name)
    stored = balance.e.mean_effort(balance.storage(name), x, end)
    return f"({balance.current(name)} * {balance.mean(name)} - {stored} * ({end} - {x}) / H)"
