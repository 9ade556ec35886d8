"""Scalar constitutive laws of storages, resistors and ports."""

from phnn.laws import port, resistor, storage
from phnn.laws.law import PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS, PortLaw, ResistorLaw, StorageLaw, register

__all__ = [
    "PORT_LAWS",
    "RESISTOR_LAWS",
    "STORAGE_LAWS",
    "PortLaw",
    "ResistorLaw",
    "StorageLaw",
    "port",
    "register",
    "resistor",
    "storage",
]
