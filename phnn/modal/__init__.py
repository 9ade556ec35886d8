"""Structures with many sharp modes and several ports: one passive model for all amplitudes, from periodic recordings.

    q̈_i/ω_i² + 2ζ_i q̇_i/ω_i + q_i = Σ_j b_ij f_j,     x_j = Σ_i b_ij q_i,     f_j = u_j − e_j(x_j)

Each mode is a storage with energy ``½(q² + q̇²/ω²)`` and a damper, joined to the ports by transformers of ratios b_ij;
what pushes back at a port, e_j, is an element on that port's own extension x_j, see `phnn.modal.elements`. Outputs only
observe:
``y_k(t) = Σ_i c_ki q_i + d_ki q̇_i + Σ_j g_kj f_j`` at ``t − τ_k``.

Reference: Preumont 2018, Vibration Control of Active Structures, ch. 3 and 4 (modes, collocated pairs).
"""
