"""Registration of clouds by point-to-plane ICP with Tukey's weights, and how far it can be trusted.

Chen and Medioni 1992 (doi 10.1016/0262-8856(92)90066-C); all clouds are moved at once, so that errors do not
add up along a chain of pairs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import InputError
from scanmotion.geometry.column_products import column_products
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.simulator.captures import inverse, motion

_LEAST_FITNESS = 0.15
_GREATEST_CONDITION = 2000.0
_TUKEY = 4.685


@dataclass(frozen=True, eq=False, kw_only=True)
class Registration:
    """Where a cloud belongs, and how well that is known."""

    X: np.ndarray
    """Pose that takes the cloud's points to their place, shape (4, 4)."""
    fitness: float
    """Share of the cloud's points that have a partner in the other clouds."""
    rms: float
    """Weighted rms of the distances along the partners' normals [m]."""
    condition: float
    """Largest over least eigenvalue of the information matrix, lengths in units of the cloud's size."""
    uncertainty: float
    """Standard deviation along the worst-known motion, at the cloud's rim, if errors are independent [m]."""
    shift: float
    """How far the cloud's centre was moved from its start [m]."""
    turn: float
    """By how much the cloud was turned from its start [rad]."""
    trusted: bool
    statement: str
    """One sentence: whether to trust it and why."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Sheet:
    """A cloud prepared for ICP: all points to be met, some points to ask."""

    points: np.ndarray
    normals: np.ndarray
    tree: cKDTree
    ask: np.ndarray
    centre: np.ndarray
    size: float


def transformed(cloud: Cloud, X: np.ndarray) -> Cloud:
    """The cloud moved by X (4, 4)."""
    R = X[:3, :3]
    return replace(
        cloud, points=cloud.points @ R.T + X[:3, 3], normals=cloud.normals @ R.T,
        view_directions=cloud.view_directions @ R.T, cells=None,
    )  # fmt: skip


def register(
    source: Cloud, target: Cloud, *, start: np.ndarray | None = None, reach: float = 0.008,
    points: int = 8000,
) -> Registration:  # fmt: skip
    """Moves `source` onto `target`, e.g. a local scan onto the global one.

    Args:
        source: cloud that moves.
        target: cloud that stays.
        start: first guess, shape (4, 4); None for the identity.
        reach: greatest distance of partners at the beginning [m].
        points: of the source that are asked for a partner.

    Raises:
        InputError: a cloud has fewer than 50 points.
    """
    guess = np.stack([np.eye(4), np.eye(4) if start is None else start])
    return align((target, source), start=guess, reach=reach, points=points)[1]


def align(
    clouds: Sequence[Cloud], *, start: np.ndarray | None = None, reach: float = 0.008, points: int = 4000,
    turns: int = 30,
) -> tuple[Registration, ...]:  # fmt: skip
    """Moves all clouds but the first onto one another, all at once.

    Args:
        clouds: with normals; the first stays where it is.
        start: first guesses, shape (n, 4, 4); None for the identity.
        reach: greatest distance of partners at the beginning [m]; it shrinks to four times the point spacing.
        points: of each cloud that are asked for partners.
        turns: most iterations.

    Raises:
        InputError: a cloud has fewer than 50 points.
    """
    sheets = [_sheet(c, points, i) for i, c in enumerate(clouds)]
    X = np.tile(np.eye(4), (len(clouds), 1, 1)) if start is None else np.array(start, dtype=float)
    first = X.copy()
    near = min(reach, max(4.0 * _spacing(s) for s in sheets))
    partners: list[_Pairs] = []
    for turn in range(turns):
        distance = max(near, reach * 0.75**turn)
        partners = _all_pairs(sheets, X, distance)
        step = _step(partners, sheets, X)
        X = _moved(X, step, sheets)
        moved = np.abs(step[:, :3]).max() + max(s.size for s in sheets) * np.abs(step[:, 3:]).max()
        # Partners that change places keep real scans moving by a thousandth of their noise for ever.
        noise = _scale(np.concatenate([p.distance for p in partners]))
        if distance <= near and moved < max(1e-7, 2e-3 * noise):
            break
    return tuple(_verdict(i, sheets, X, first, partners) for i in range(len(clouds)))


def _sheet(cloud: Cloud, most: int, index: int) -> _Sheet:
    if len(cloud) < 50:
        raise InputError(f"cloud {index}: {len(cloud)} points are too few to register")
    p = np.asarray(cloud.points, float)
    ask = np.unique(np.linspace(0, len(p) - 1, min(most, len(p))).astype(int))
    centre = p.mean(axis=0)
    size = float(np.sqrt(((p - centre) ** 2).sum(axis=1).mean()))
    return _Sheet(
        points=p, normals=np.asarray(cloud.normals, float), tree=cKDTree(p), ask=ask, centre=centre, size=size
    )


def _spacing(sheet: _Sheet) -> float:
    some = sheet.points[:: max(1, len(sheet.points) // 1000)]
    return float(np.median(sheet.tree.query(some, k=2)[0][:, 1]))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Pairs:
    """Partners of the points of cloud i in cloud j, at the poses they were sought for."""

    i: int
    j: int
    point: np.ndarray
    """In O, shape (k, 3)."""
    normal: np.ndarray
    """Of the partner in O, shape (k, 3)."""
    own: np.ndarray
    """Of the points themselves in O, shape (k, 3)."""
    distance: np.ndarray
    """Along the normal, shape (k,) [m]."""
    index: np.ndarray
    """Which of cloud i's points, shape (k,)."""


def _all_pairs(sheets: list[_Sheet], X: np.ndarray, reach: float) -> list[_Pairs]:
    found = []
    back = inverse(X)
    for i, a in enumerate(sheets):
        p_O = a.points[a.ask] @ X[i, :3, :3].T + X[i, :3, 3]
        n_O = a.normals[a.ask] @ X[i, :3, :3].T
        for j, b in enumerate(sheets):
            if i == j:
                continue
            p_j = p_O @ back[j, :3, :3].T + back[j, :3, 3]
            box = (p_j >= b.tree.mins - reach).all(axis=1) & (p_j <= b.tree.maxes + reach).all(axis=1)
            where = np.flatnonzero(box)
            d, k = b.tree.query(p_j[where], distance_upper_bound=reach)
            hit = np.isfinite(d)
            where, k = where[hit], k[hit]
            normal = b.normals[k] @ X[j, :3, :3].T
            agree = np.einsum("ij,ij->i", normal, n_O[where]) > 0.7
            where, k, normal = where[agree], k[agree], normal[agree]
            own = n_O[where]
            q_O = b.points[k] @ X[j, :3, :3].T + X[j, :3, 3]
            r = np.einsum("ij,ij->i", p_O[where] - q_O, normal)
            found.append(_Pairs(i=i, j=j, point=p_O[where], normal=normal, own=own, distance=r, index=where))
    return found


def _scale(distance: np.ndarray) -> float:
    """Robust standard deviation; never below a micrometre, so that perfect data divide by something."""
    return max(1.4826 * float(np.median(np.abs(distance))), 1e-6) if len(distance) else 1e-6


def _weights(distance: np.ndarray, scale: float) -> np.ndarray:
    u = np.clip(np.abs(distance) / (_TUKEY * scale), 0.0, 1.0)
    return (1.0 - u * u) ** 2


def _rows(pairs: _Pairs, centre: np.ndarray, size: float) -> np.ndarray:
    """Change of the distances with a motion of cloud i about `centre`; turns in units of 1 / size, (k, 6)."""
    return np.hstack([pairs.normal, np.cross(pairs.point - centre, pairs.normal) / size])


def _centre(sheet: _Sheet, X: np.ndarray) -> np.ndarray:
    return X[:3, :3] @ sheet.centre + X[:3, 3]


def _step(partners: list[_Pairs], sheets: list[_Sheet], X: np.ndarray) -> np.ndarray:
    """Gauss-Newton step of all clouds but the first, (n, 6); directions that nothing holds do not move."""
    n = len(sheets)
    A, b = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
    scale = _scale(np.concatenate([p.distance for p in partners]))
    for p in partners:
        w = _weights(p.distance, scale)[:, None]
        Ji = _rows(p, _centre(sheets[p.i], X[p.i]), sheets[p.i].size)
        Jj = -_rows(p, _centre(sheets[p.j], X[p.j]), sheets[p.j].size)
        si, sj = slice(6 * p.i, 6 * p.i + 6), slice(6 * p.j, 6 * p.j + 6)
        A[si, si] += column_products(Ji, w * Ji)
        A[sj, sj] += column_products(Jj, w * Jj)
        A[si, sj] += column_products(Ji, w * Jj)
        A[sj, si] += column_products(Jj, w * Ji)
        b[si] -= column_products(Ji, w[:, 0] * p.distance)
        b[sj] -= column_products(Jj, w[:, 0] * p.distance)
    values, vectors = np.linalg.eigh(A[6:, 6:])
    keep = values > 1e-6 * max(float(values.max(initial=0.0)), 1e-12)
    step = vectors[:, keep] @ ((vectors[:, keep].T @ b[6:]) / values[keep])
    out = np.zeros((n, 6))
    out[1:] = step.reshape(-1, 6)
    out[:, 3:] /= np.array([s.size for s in sheets])[:, None]
    return out


def _moved(X: np.ndarray, step: np.ndarray, sheets: list[_Sheet]) -> np.ndarray:
    """Applies each cloud's motion about its own centre."""
    out = X.copy()
    for i, D in enumerate(motion(step)):
        c = _centre(sheets[i], X[i])
        D[:3, 3] += c - D[:3, :3] @ c
        out[i] = D @ X[i]
    return out


def _information(mine: list[_Pairs], w: np.ndarray, centre: np.ndarray, size: float) -> np.ndarray:
    """What the partners say about the cloud's motion, (6, 6), without what their normals' noise pretends.

    The normals of a plane scatter, and their squares would hold the plane against sliding. Both sides of a
    pair scatter on their own: the product of the two means what the shape means.
    """
    if not mine:
        return np.zeros((6, 6))
    J = np.concatenate([_rows(p, centre, size) for p in mine])
    own = np.concatenate([_rows(replace(p, normal=p.own), centre, size) for p in mine])
    A = column_products(J, w[:, None] * own)
    return (A + A.T) / 2


def _verdict(
    i: int, sheets: list[_Sheet], X: np.ndarray, first: np.ndarray, partners: list[_Pairs]
) -> Registration:
    mine = [p for p in partners if p.i == i]
    sheet = sheets[i]
    distance = np.concatenate([p.distance for p in mine]) if mine else np.zeros(0)
    w = _weights(distance, _scale(distance))
    held = np.unique(np.concatenate([p.index for p in mine])) if mine else np.zeros(0, int)
    fitness = len(held) / len(sheet.ask)
    rms = float(np.sqrt((w * distance**2).sum() / max(w.sum(), 1e-30)))
    values = np.linalg.eigvalsh(_information(mine, w, _centre(sheet, X[i]), sheet.size))
    condition = float(values[-1] / values[0]) if values[0] > 1e-12 * max(values[-1], 1e-30) else np.inf
    uncertainty = rms / float(np.sqrt(values[0])) if np.isfinite(condition) else np.inf
    change = X[i] @ inverse(first[i : i + 1])[0]
    cosine = np.clip((np.trace(change[:3, :3]) - 1) / 2, -1, 1)
    shift = float(np.linalg.norm(_centre(sheet, X[i]) - _centre(sheet, first[i])))
    doubts = []
    if fitness < _LEAST_FITNESS:
        doubts.append(f"only {fitness:.0%} of its points have a partner")
    if condition > _GREATEST_CONDITION:
        doubts.append("the shape leaves a motion free (it slides or turns on itself)")
    found = f"rms {rms * 1e3:.3f} mm, {fitness:.0%} of the points have a partner, condition {condition:.0f}"
    statement = f"not to be trusted: {' and '.join(doubts)} ({found})" if doubts else f"trusted: {found}"
    return Registration(
        X=X[i], fitness=fitness, rms=rms, condition=condition, uncertainty=uncertainty, shift=shift,
        turn=float(np.arccos(cosine)), trusted=not doubts, statement=statement,
    )  # fmt: skip
