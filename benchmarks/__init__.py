"""Timing of the compiled solver beside its peers: ``make bench``, or ``python -m benchmarks`` where they are installed.

Everybody gets one thread. The limits only work when they are set before numpy, torch and jax are loaded, hence here.
"""

from __future__ import annotations

import os

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    # XLA takes the size of its thread pool from here.
    "NPROC": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "JAX_PLATFORMS": "cpu",
}

for _name, _value in ONE_THREAD.items():
    os.environ.setdefault(_name, _value)
