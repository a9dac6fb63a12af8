"""numba for compiled loops that run on threads, with the threads taken from OpenMP: the home of that choice.

Loops on one thread may import numba themselves; every loop on threads takes njit and prange from here.

numba's own order asks TBB first and warns the user of every TBB it finds too old. OpenMP comes with numba's
wheels and bears calls from several threads at once, which numba's work queue, the last resort, does not.
"""

import os

from numba import config, njit, prange

__all__ = ["njit", "prange"]

if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]
