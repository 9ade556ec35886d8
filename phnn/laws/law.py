"""Scalar constitutive laws: the registries that kernels, torch modules and tests share.

A law is a set of plain functions written with `phnn.laws.namespace`. It is registered once and is then
available to the compiled kernel (by its position in the registry), to the torch module (by its name)
and to the contract tests (through its example parameters).

A law states the domain of each of its parameters. Within them its promise holds (a sector, an energy with its minimum
at rest): `register` tries it, networks refuse values outside, and training cannot leave them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from phnn.errors import StructureViolated
from phnn.parameters import POSITIVE, Domain


class _Law:
    """What has parameters, each with a domain; those that are left out are positive."""

    name: str
    example: tuple[float, ...]
    domains: tuple[Domain, ...]

    def __post_init__(self) -> None:
        domains = self.domains or (POSITIVE,) * len(self.example)
        if len(domains) != len(self.example):
            raise StructureViolated(
                f"the law {self.name} has {len(self.example)} parameters and {len(domains)} domains: give one for each"
            )
        object.__setattr__(self, "domains", domains)


@dataclass(frozen=True)
class StorageLaw(_Law):
    """An energy ``H(x; θ) ≥ H(0) = 0``, but for a source of constant effort.

    Attributes:
        name: as used in networks.
        mean_effort: ``ē = (H(b) − H(a))/(b − a)`` as ``mean_effort(a, b, *θ)``, in a form without cancellation. It
            says all: the effort ``H'(x)`` is ``ē(x, x)``, and the energy ``H(x) = x ē(0, x)``.
        example: parameter values for the contract tests.
        convex: whether the effort is monotone.
        bounded: whether ``H ≥ 0``; a weight, whose energy falls without end, is a source and not passive.
        domains: of the parameters; all positive where left out.
    """

    name: str
    mean_effort: Callable[..., Any]
    example: tuple[float, ...]
    convex: bool = True
    bounded: bool = True
    domains: tuple[Domain, ...] = ()

    def energy(self, x: Any, *theta: Any) -> Any:
        """Return ``H(x; θ)`` [J]."""
        return x * self.mean_effort(0.0 * x, x, *theta)


@dataclass(frozen=True)
class ResistorLaw(_Law):
    """A sector law ``ε φ(ε, q; θ) ≥ 0``; ``q`` is a read-only argument (a state of the network).

    Attributes:
        name: as used in networks.
        flow: ``φ(ε, q, *θ)``.
        example: parameter values for the contract tests.
        thresholds: for piecewise linear laws ``(ρ, lo, hi)(q, *θ)`` with
            ``φ = ρ (max(ε − hi, 0) + min(ε − lo, 0))``, ``lo ≤ 0 ≤ hi``; such a law on a linear capacitor has
            the exact flow of `phnn.laws.leaf`.
        path: for laws that depend on the path alone, ``(x⁺, ē) = path(x, i, h, s, *θ)`` of a step of a storage
            ``E = s x`` under the current ``i``, where ``i`` is the velocity ``q/m`` that the law reads.
        spring: law of the nonlinear storage for which ``path`` is written, ``s`` being its stiffness at rest; its
            further parameters are the first and the third of the law. Empty for a linear storage.
        monotone: whether ``φ`` is non-decreasing in ``ε``.
        domains: of the parameters; all positive where left out.
    """

    name: str
    flow: Callable[..., Any]
    example: tuple[float, ...]
    thresholds: Callable[..., Any] | None = None
    path: Callable[..., Any] | None = None
    spring: str = ""
    monotone: bool = True
    domains: tuple[Domain, ...] = ()


@dataclass(frozen=True)
class PortLaw(_Law):
    """How a port's input acts: ``ẋ += g ψ(u)``; the conjugate output is ``y = ψ'(u) gᵀ∇H``.

    Attributes:
        name: as used in networks.
        action: ``ψ(u, *θ)``.
        slope: ``ψ'(u, *θ)``.
        example: parameter values for the contract tests.
        domains: of the parameters; all positive where left out.
    """

    name: str
    action: Callable[..., Any]
    slope: Callable[..., Any]
    example: tuple[float, ...]
    domains: tuple[Domain, ...] = ()


@dataclass(frozen=True)
class FactorLaw(_Law):
    """How a ratio follows a storage's or a memory's state: the ratio is multiplied by ``f(q; θ)``.

    Attributes:
        name: as used in networks.
        factor: ``f(q, *θ)``.
        example: parameter values for the contract tests.
        domains: of the parameters; all positive where left out.
    """

    name: str
    factor: Callable[..., Any]
    example: tuple[float, ...]
    domains: tuple[Domain, ...] = ()


@dataclass(frozen=True)
class MemoryLaw(_Law):
    """How a slow state follows its drive: ``ż = f(z, s; θ)``, affine in ``z`` with the slope ``−d(θ)``.

    Attributes:
        name: as used in networks.
        rate: ``f(z, s, *θ)``.
        decay: ``d(*θ) ≥ 0`` [1/s].
        example: parameter values for the contract tests.
        heats: whether its drive is dissipated power [W] that is kept as heat.
        anew: whether it is zero where a recording begins, whatever came before.
        domains: of the parameters; all positive where left out.
    """

    name: str
    rate: Callable[..., Any]
    decay: Callable[..., Any]
    example: tuple[float, ...]
    heats: bool = False
    anew: bool = False
    domains: tuple[Domain, ...] = ()


Law = StorageLaw | ResistorLaw | PortLaw | FactorLaw | MemoryLaw

STORAGE_LAWS: dict[str, StorageLaw] = {}
RESISTOR_LAWS: dict[str, ResistorLaw] = {}
PORT_LAWS: dict[str, PortLaw] = {}
FACTOR_LAWS: dict[str, FactorLaw] = {}
MEMORY_LAWS: dict[str, MemoryLaw] = {}

TABLES: dict[type, dict[str, Any]] = {
    StorageLaw: STORAGE_LAWS,
    ResistorLaw: RESISTOR_LAWS,
    PortLaw: PORT_LAWS,
    FactorLaw: FACTOR_LAWS,
    MemoryLaw: MEMORY_LAWS,
}
_closed = False
_package: tuple[Any, ...] = ()


def register(law: Law) -> None:
    """Make a law available under its name.

    Compiled code knows the laws that existed when the solver was loaded: register a law directly after ``import phnn``,
    before a network is solved.

    Raises:
        StructureViolated: the name is taken; the law breaks its promise somewhere in the domains of its parameters (a
            resistor outside the sector ``ε φ(ε) ≥ 0``, an energy below that at rest, a value that is not finite); or
            the solver has been loaded already.
    """
    # It needs the laws' types.
    from phnn.laws.sector import check_law

    table = next(table for kind, table in TABLES.items() if isinstance(law, kind))
    if law.name in table:
        raise StructureViolated(f"a law called {law.name!r} exists already: choose another name")
    check_law(law, slopes=bool(_package))
    if _closed:
        raise StructureViolated(
            f"the law {law.name!r} comes too late: the solver is loaded and its compiled code knows the laws of that "
            "moment. Start Python again and register the law directly after `import phnn`"
        )
    table[law.name] = law


def remember_package() -> None:
    """Take the laws that are registered now for those of the package."""
    global _package
    _package = tuple(law for table in TABLES.values() for law in table.values())


def is_of_package(law: Any) -> bool:
    """Return whether a law is one of the package's, and not one that a user registered."""
    return any(law is known for known in _package)


def close_tables() -> None:
    """Accept no further law: compiled code numbers the laws by their order in the tables."""
    global _closed
    _closed = True
