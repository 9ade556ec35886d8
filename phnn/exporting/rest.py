"""The state of rest under a constant input, as functions of an exported program: `phnn.integrate.rest`, unrolled.

Nothing flows at rest. Storages with resistors are empty, and those without hold what displacements ``y`` of the
junctions carry into them, so that no force is left on any junction.
"""

from __future__ import annotations

from phnn.exporting.balance import Balance, scaled
from phnn.integrate.tables import LOSSLESS
from phnn.laws import STORAGE_LAWS

# The displacement at which a slope is taken, as a share of that which a storage's unit effort needs.
_SHARE = 1e-3


class Rest:
    """Writes the lines of ``rest_balance(s)``, which fills ``force`` and ``size`` at the displacements ``y``."""

    def __init__(self, balance: Balance) -> None:
        self.b, self.e, self.network = balance, balance.e, balance.network
        self.lossless = [n for n in balance.reducible if balance.rules[n] == LOSSLESS]

    @property
    def follows_input(self) -> bool:
        """Whether displacements of the junctions say all about rest."""
        inside = any({to, of} <= set(self.b.junctions) for to, of, _ in self.b.couplings)
        beside = any(name in self.b.reducible for p in self.network.ports for name in p.on)
        return bool(self.b.junctions) and not inside and not beside and all(f > 0.0 for f in self.floors())

    def floors(self) -> list[float]:
        """Stiffness that acts on every junction near zero."""
        total = dict.fromkeys(self.b.junctions, 0.0)
        for name in self.lossless:
            for other, ratio, _ in self.b.links(name):
                factor = self.e.parameters[ratio].value if isinstance(ratio, str) else float(ratio)
                total[other] += factor * factor * self._slope(name)
        return [float(value) for value in total.values()]

    def _slope(self, name: str) -> float:
        storage = self.b.storage(name)
        if not isinstance(storage.law, str):
            return 1.0
        law, values = STORAGE_LAWS[storage.law], self.e.values(storage.parameters)
        ends = [float(law.mean_effort(x, x, *values)) for x in (-_SHARE, _SHARE)]
        return (ends[1] - ends[0]) / (2.0 * _SHARE)

    def write(self) -> list[str]:
        """The lines of the function; states are left at those of the displacements."""
        lines = self._states()
        modulated = dict.fromkeys(m.ratio for m in self.network.modulations)
        lines += [f"{self.b.ratio(r)} = {self.e.parameter(r)}" for r in modulated]
        for m in self.network.modulations:
            name = self.b.ratio(m.ratio)
            read = "0.0" if m.by in self.b.junctions else self.b.x(m.by)
            lines.append(f"{name} = {name} * {self.e.factor(m, read)}")
        for j in range(len(self.b.junctions)):
            lines += [f"s.force[{j}] = 0.0", f"s.size[{j}] = 0.0"]
        for name in self.lossless:
            effort = self.e.mean_effort(self.b.storage(name), self.b.x(name), self.b.x(name))
            lines.append(f"effort = {effort}")
            for other, ratio, sign in self.b.links(name):
                lines += self._added(other, scaled(sign, self.b.ratio(ratio), "effort"))
        for p in self.network.ports:
            for name, ratio in p.on.items():
                if name in self.b.junctions:
                    lines += self._added(name, scaled(-1, self.b.ratio(ratio), self.b.action(p.name)))
        return lines

    def _added(self, junction: str, term: str) -> list[str]:
        j = self.b.junctions.index(junction)
        return [
            f"term = {term}",
            f"s.force[{j}] = s.force[{j}] + term",
            f"s.size[{j}] = s.size[{j}] + absolute(term)",
        ]

    def _states(self) -> list[str]:
        lines = [f"{self.b.x(name)} = 0.0" for name in self.network.storage_names if name not in self.lossless]
        for name in self.lossless:
            terms = []
            for other, ratio, sign in self.b.links(name):
                plain = self.e.parameter(ratio) if isinstance(ratio, str) else repr(float(ratio))
                terms.append(scaled(sign, plain, f"s.y[{self.b.junctions.index(other)}]"))
            lines.append(f"{self.b.x(name)} = {' + '.join(terms) or '0.0'}")
        for memory in self.network.memories:
            drive = " + ".join(self._drives(self.network.drives_of(memory))) or "0.0"
            rate, decay = self.e.memory(memory, "rate", "0.0", drive), self.e.memory(memory, "decay")
            lines.append(f"{self.b.x(memory.name)} = {rate} / {decay}")
        return lines

    def _drives(self, names: tuple[str, ...]) -> list[str]:
        ports = [p.name for p in self.network.ports]
        efforts = [self.e.mean_effort(self.b.storage(n), self.b.x(n), self.b.x(n)) for n in names if n in self.lossless]
        return efforts + [self.b.action(n) for n in names if n in ports]
