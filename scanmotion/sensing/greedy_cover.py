"""Few views that see most: the greedy cover of a matrix of what each sees, at a cost each."""

import numpy as np


def greedy_cover(
    matrix: np.ndarray,
    weights: np.ndarray,
    *,
    cost: np.ndarray | None = None,
    target: float = 1.0,
    max_views: int | None = None,
) -> list[int]:
    """Rows that together cover the columns: greedy by weight per cost, then without the redundant ones.

    The greedy choice costs at most ln(m) + 1 times the least (Chvatal 1979, doi 10.1287/moor.4.3.233).

    Args:
        matrix: mask of which row covers which column, shape (n, m).
        weights: of the columns, shape (m,) in any unit, not negative.
        cost: of the rows, shape (n,) in any unit, positive; None for equal.
        target: share of the coverable weight at which to stop.
        max_views: most rows to take.
    """
    weights = np.asarray(weights, dtype=float)
    cost = np.ones(len(matrix)) if cost is None else np.asarray(cost, dtype=float)
    open_ = matrix.any(axis=0)
    goal = target * weights[open_].sum() - 1e-12
    covered, chosen, total = np.zeros(matrix.shape[1], bool), [], 0.0
    while total < goal and (max_views is None or len(chosen) < max_views):
        gain = matrix[:, ~covered] @ weights[~covered] / cost
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        chosen.append(best)
        covered |= matrix[best]
        total = float(weights[covered].sum())
    return _pruned(matrix, weights, cost, chosen)


def _pruned(matrix: np.ndarray, weights: np.ndarray, cost: np.ndarray, chosen: list[int]) -> list[int]:
    """Drops, costliest first, every row whose columns the others cover."""
    kept = list(chosen)
    for row in sorted(chosen, key=lambda r: (-cost[r], -chosen.index(r))):
        others = [r for r in kept if r != row]
        alone = matrix[row] & ~matrix[others].any(axis=0) if others else matrix[row]
        if not (weights[alone] > 0).any():
            kept = others
    return kept
