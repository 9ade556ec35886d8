"""Structures with many sharp modes and several ports: one passive model for all amplitudes, from periodic recordings.

`phnn.modal.model` has the equations. Each mode is a storage with energy ``½(q² + q̇²/ω²)`` and a damper, joined to the
ports by transformers of ratios b_ij. Outputs only observe:
``y_k(t) = Σ_i c_ki q_i + d_ki q̇_i + Σ_j g_kj f_j`` at ``t − τ_k``.

Reference: Preumont 2018, Vibration Control of Active Structures, ch. 3 and 4 (modes, collocated pairs).
"""
