"""Networks from bond graphs: describe what is connected with what; causality and equations follow."""

from __future__ import annotations

from phnn.network.bondgraph.description import GY, TF, Bond, BondGraph, C, I, R, Se, Sf

__all__ = ["GY", "TF", "Bond", "BondGraph", "C", "I", "R", "Se", "Sf"]
