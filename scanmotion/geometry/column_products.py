"""Products of tall matrices, with the same bytes however many threads there are.

`A.T @ B` sums over all rows. OpenBLAS shares the rows out among its threads and adds the shares up, so that
the last digits follow the number of threads. numpy's einsum sums on one thread, row by row.
"""

import numpy as np


def column_products(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """A.T @ B, shape (a, b), or (a,) where B is one column.

    Args:
        A: shape (n, a).
        B: shape (n, b) or (n,).
    """
    return np.einsum("ki,k->i" if B.ndim == 1 else "ki,kj->ij", A, B)
