"""The feed-forward inverse: the voltage with which a model's output follows a reference.

    found = phnn.load("out/model").inverse(t, reference)
    found.voltage, found.error                                # (N,) [V], (N,) [m]

An actuator whose measured displacement belongs to the mass that the voltage pushes is differentially flat: the motion
alone says which voltage it takes (`phnn.inverse.blocks`). Blocks of the measuring chain are inverted one by one. What
this leaves, on the complete model, is removed by iteration (`phnn.inverse.invert`).
"""

from phnn.inverse.invert import Inverse, InverseOptions, invert

__all__ = ["Inverse", "InverseOptions", "invert"]
