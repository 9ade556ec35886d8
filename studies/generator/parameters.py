"""The parameters of the concealed actuator: Table 1, the values at which an effect is absent, and extra states."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FORCE_STEP = 25e-6  # s, between the samples of a random force

# Table 1 of the paper, SI; rho is the conductance ϱ⁻¹.
TABLE = {
    "m": 1.0148e-3,
    "k": 24579.0,
    "b": 3.7356,
    "alpha": 0.046311,
    "C_1": 5.6425e-7,
    "C_2": 5.2125e-7,
    "rho_1": 0.6002,
    "rho_2": 1.1528e-4,
    "d_1": 14.7571,
    "d_2": 8.6838,
}

ABSENT = 1e3  # F: a hysteron of this capacitance is no more than a wire

FURTHER = (5, 6)  # numbers of a base's third and fourth hysteron; 3 and 4 belong to effects

# Values at which an effect is absent. inv_C_3 is 1/C_3, so that absence is a number; a τ_V of zero means none.
NEUTRAL = {
    # mechanical
    "k_s": 0.0,
    "tau_s": 1.0,
    "k_l": 0.0,
    "tau_l": 1.0,
    "cells_l": 8.0,
    "kappa_2": 0.0,
    "kappa_3": 0.0,
    "kappa_5": 0.0,
    "kappa_p": 0.0,
    "f_p": 0.0,
    "phi_p": 0.0,
    "F_c": 0.0,
    "v_s": 1e-4,
    "r_s": 1.0,
    "v_st": 1.0,
    "F_l": 0.0,
    "z_l": 1.0,
    "c_2": 0.0,
    "n_c2": 1.0,
    "kappa_b": 0.0,
    "kappa_f": 0.0,
    "k_c": 0.0,
    "q_c": 1.0,
    "n_c": 1.0,
    "side": 1.0,
    "m_2": 0.0,
    "k_2": 0.0,
    "b_2": 0.0,
    # hysterons
    "inv_C_3": 0.0,
    "rho_3": 0.0,
    "d_3": 1.0,
    "rho_4": 0.0,
    "d_4": 1.0,
    "k_w": 0.0,
    "z_w": 1.0,
    "n_w": 1.0,
    "kappa_d": 0.0,
    "kappa_v": 0.0,
    "kappa_C": 0.0,
    "G": 0.0,
    # the third and the fourth hysteron of a base
    "inv_C_5": 0.0,
    "rho_5": 0.0,
    "d_5": 1.0,
    "inv_C_6": 0.0,
    "rho_6": 0.0,
    "d_6": 1.0,
    # another hysteresis in the place of the hysterons: four generalised plays, or a Bouc–Wen state
    "c_play_1": 0.0,
    "c_play_2": 0.0,
    "c_play_3": 0.0,
    "c_play_4": 0.0,
    "r_play_1": 1.0,
    "r_play_2": 1.0,
    "r_play_3": 1.0,
    "r_play_4": 1.0,
    "lean_play": 0.0,
    "gape_play": 0.0,
    "q_play": 1.0,
    "c_bouc": 0.0,
    "z_bouc": 1.0,
    "n_bouc": 1.0,
    "beta_bouc": 0.5,
    # coupling
    "epsilon": 0.0,
    "kappa_a": 0.0,
    "kappa_e": 0.0,
    "delta_z": 0.0,
    "tau_z": 1.0,
    "V_c": 1.0,
    "kappa_T": 0.0,
    "C_T": 1.0,
    "R_T": 1.0,
    # amplifier
    "tau_d": 0.0,
    "Delta_u": 0.0,
    "delta_V": 0.0,
    "S": math.inf,
    "tau_V": 0.0,
    "zeta_V": 0.0,
    "V_max": math.inf,
    "s_V": 0.0,
    # sensor
    "tau_y": 0.0,
    "a_2": 0.0,
    "a_3": 0.0,
    "delta_b": 0.0,
    "kappa_y": 0.0,
    "kappa_t": 0.0,
    # environment
    "A_b": 0.0,
    "f_b": 0.0,
    "phi_b": 0.0,
}

# Typical sizes of the states Q_1, Q_2, q, p, s, Q_3, V [C, C, m, kg m/s, m, C, V]: absolute tolerances follow them.
_SIZES = (4e-6, 4e-6, 1e-4, 1e-5, 1e-4, 4e-6, 75.0)

# States that are there only while their effect is: the parameter that must differ from its neutral value, and sizes.
_EXTRA: dict[str, tuple[str, tuple[float, ...]]] = {
    "at_slew": ("S", (75.0,)),
    "at_filter": ("zeta_V", (75.0,)),
    "at_polarisation": ("delta_z", (1.0,)),
    "at_warmth": ("kappa_T", (1.0,)),
    "at_mode": ("m_2", (1e-4, 1e-2)),
    "at_cells": ("k_l", (1e-4,) * 8),
    "at_bristle": ("F_l", (1e-6,)),
    "at_wen": ("k_w", (1e-5,)),
    "at_sensor": ("tau_y", (1e-4,)),
    "at_hysteron_5": ("inv_C_5", (4e-6,)),
    "at_hysteron_6": ("inv_C_6", (4e-6,)),
    "at_plays": ("c_play_1", (1e-4,) * 4),
    "at_bouc": ("c_bouc", (1e-4,)),
}
_RECORD = np.dtype([(n, np.float64) for n in (*TABLE, *NEUTRAL)] + [(n, np.int64) for n in _EXTRA])


def packed(parameters: Mapping[str, float]) -> tuple[NDArray[np.void], Array]:
    """What the compiled equations read, and typical sizes of the states.

    Args:
        parameters: those of ``TABLE``, and those of ``NEUTRAL`` that are not neutral; SI.

    Returns:
        A record (1,) of all parameters and of the position of each extra state, 0 where it is absent (no extra state
        comes first); and the sizes (states,). Absent states take no part: the paper's equations stay what they are.
    """
    record = np.zeros(1, _RECORD)
    values = {**NEUTRAL, **parameters}
    for name, value in values.items():
        record[name] = value
    sizes = list(_SIZES)
    for name, (needed, extra) in _EXTRA.items():
        if values[needed] != NEUTRAL[needed]:
            record[name] = len(sizes)
            sizes.extend(extra)
    return record, np.array(sizes)
