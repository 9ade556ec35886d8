"""Rivals whose hysteresis, or static curve, is an operator in front of linear dynamics."""

from __future__ import annotations

from studies.rival_models.operators import Dahl, Plays, Preisach, Static
from studies.rival_models.separable import SeparableRival

_BY = "variable projection: weights by {} least squares, dynamics and shape by a trust region with finite differences"


class PrandtlIshlinskii(SeparableRival):
    """Generalised Prandtl–Ishlinskii, with and without thresholds that grow with the rate."""

    words = "generalised Prandtl–Ishlinskii operator in front of second-order dynamics"
    source = "Al Janaideh, Su, Rakheja 2009; Al Janaideh, Krejčí 2011"
    how = _BY.format("non-negative")
    sizes = (
        (Plays(6), 0),
        (Plays(6, rate=True), 0),
        (Plays(6, "tanh", True), 0),
        (Plays(6, "cubic", True), 0),
        (Plays(14, rate=True), 0),
        (Plays(14, "tanh", True), 0),
        (Plays(14, "cubic", True), 0),
        (Plays(14, "cubic", True), 1),
        (Plays(30, "cubic", True), 1),
    )


class PreisachPlane(SeparableRival):
    """Preisach."""

    words = "discretised Preisach plane in front of second-order dynamics"
    source = "Mayergoyz 1991; Brokate, Sprekels 1996"
    how = _BY.format("non-negative, regularised")
    sizes = (
        (Preisach(4, 6), 0),
        (Preisach(8, 10), 0),
        (Preisach(12, 12), 0),
        (Preisach(12, 12, 1e-5), 0),
        (Preisach(12, 12), 1),
        (Preisach(20, 16), 1),
    )


class DahlDuhem(SeparableRival):
    """Dahl, and Duhem with a loop that leans."""

    words = "Dahl and Duhem operators beside a polynomial, in front of second-order dynamics"
    source = "Dahl 1968; Coleman, Hodgdon 1986"
    how = _BY.format("linear")
    sizes = (
        (Dahl(1, 1), 0),
        (Dahl(3, 1), 0),
        (Dahl(3, 2), 0),
        (Dahl(3, 2, True), 0),
        (Dahl(3, 3, True), 1),
        (Dahl(5, 4, True), 1),
    )


class Hammerstein(SeparableRival):
    """A static polynomial in front of linear dynamics."""

    words = "static polynomial in front of linear dynamics of order 2 to 4 (Hammerstein)"
    source = "Narendra, Gallman 1966; Schoukens, Tiels 2017"
    how = _BY.format("linear")
    sizes = (
        (Static(1), 0),
        (Static(3), 0),
        (Static(5), 0),
        (Static(3), 1),
        (Static(5), 2),
        (Static(9), 2),
    )
