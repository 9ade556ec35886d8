"""The residual force: what has to act on the base model so that it moves as the recordings show.

Rivals of the diagnosis explain this force by a table of terms, by a Gaussian process or by formulas that evolve.
"""
