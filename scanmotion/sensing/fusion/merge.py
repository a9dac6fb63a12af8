"""A fused cloud grown by the fusion of new scans, without touching the old raw points again."""

from dataclasses import replace

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.sensing.fusion.fuse import Cloud


def merged(cloud: Cloud, new: Cloud, *, voxel: float = 0.002) -> Cloud:
    """One cloud of two that were fused with the same voxel: a voxel that both hold gets their mean by counts.

    Where the two show opposite sides of a thin wall in one voxel, the side with more raw points stays, as it
    would in one fusion; `cloud`'s where they are equal. Against fusing all raw points at once the occupied
    voxels are the same, but for flying pixels that have company only in the other cloud; each half was fitted
    through its own points alone.

    Args:
        cloud: fused earlier.
        new: fused from further scans in the same frame.
        voxel: edge of both clouds' voxels [m].

    Raises:
        InputError: the voxel is not a positive number.
    """
    if not np.isfinite(voxel) or voxel <= 0:
        raise InputError(f"voxel {voxel:g} m: a positive length is expected")
    if not len(cloud) or not len(new):
        return new if not len(cloud) else cloud
    cells = [_cells(c, voxel) for c in (cloud, new)]
    low = np.minimum(*(c.min(axis=0) for c in cells))
    shape = np.maximum(*(c.max(axis=0) for c in cells)) - low + 1
    keys = [np.ravel_multi_index((c - low).T, shape) for c in cells]
    _, one, two = np.intersect1d(keys[0], keys[1], return_indices=True)
    alone = np.ones(len(new), bool)
    alone[two] = False
    joined = _means(_taken(cloud, one), _taken(new, two))
    parts = {
        name: np.concatenate([getattr(cloud, name), getattr(new, name)[alone]])
        for name in ("points", "normals", "view_directions", "counts")
    }
    for name, values in joined.items():
        parts[name][one] = values
    return Cloud(**parts, cells=np.concatenate([cells[0], cells[1][alone]]))


def _cells(cloud: Cloud, voxel: float) -> np.ndarray:
    """Which voxel each point stands for; that of its place where the cloud does not say."""
    if cloud.cells is not None:
        return cloud.cells
    return np.floor(cloud.points / voxel).astype(np.int32)


def _taken(cloud: Cloud, index: np.ndarray) -> Cloud:
    names = ("points", "normals", "view_directions", "counts")
    return replace(cloud, cells=None, **{n: getattr(cloud, n)[index] for n in names})


def _means(a: Cloud, b: Cloud) -> dict[str, np.ndarray]:
    """Values of the voxels that both clouds hold."""
    opposed = np.einsum("ij,ij->i", a.normals, b.normals) < 0
    wa, wb = a.counts.astype(float), b.counts.astype(float)
    wa, wb = np.where(opposed & (wa < wb), 0.0, wa), np.where(opposed & (wa >= wb), 0.0, wb)
    share = (wa / np.maximum(wa + wb, 1e-30))[:, None]
    out = {n: share * getattr(a, n) + (1 - share) * getattr(b, n) for n in ("points", "normals")}
    out["view_directions"] = share * a.view_directions + (1 - share) * b.view_directions
    for name in ("normals", "view_directions"):
        out[name] /= np.maximum(np.linalg.norm(out[name], axis=1, keepdims=True), 1e-30)
    return {**out, "counts": a.counts + b.counts}
