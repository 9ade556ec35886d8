"""Scalar constitutive laws of storages, resistors, ports and modulator states."""

from phnn.laws import other, resistor, storage
from phnn.laws.law import (
    FACTOR_LAWS,
    MEMORY_LAWS,
    PORT_LAWS,
    RESISTOR_LAWS,
    STORAGE_LAWS,
    FactorLaw,
    MemoryLaw,
    PortLaw,
    ResistorLaw,
    StorageLaw,
    register,
    remember_package,
)

# All modules with laws are imported above.
remember_package()

__all__ = [
    "FACTOR_LAWS",
    "MEMORY_LAWS",
    "PORT_LAWS",
    "RESISTOR_LAWS",
    "STORAGE_LAWS",
    "FactorLaw",
    "MemoryLaw",
    "PortLaw",
    "ResistorLaw",
    "StorageLaw",
    "other",
    "register",
    "resistor",
    "storage",
]
