"""Scalar constitutive laws of storages, resistors and ports."""

from phnn.laws import factor, port, resistor, storage
from phnn.laws.law import (
    FACTOR_LAWS,
    PORT_LAWS,
    RESISTOR_LAWS,
    STORAGE_LAWS,
    FactorLaw,
    PortLaw,
    ResistorLaw,
    StorageLaw,
    register,
)

__all__ = [
    "FACTOR_LAWS",
    "PORT_LAWS",
    "RESISTOR_LAWS",
    "STORAGE_LAWS",
    "FactorLaw",
    "PortLaw",
    "ResistorLaw",
    "StorageLaw",
    "factor",
    "port",
    "register",
    "resistor",
    "storage",
]
