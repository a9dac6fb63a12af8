"""Rigid poses in the YAML: four rows, or a place with angles; as a hand-eye calibration gives them."""

import math
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator
from scipy.spatial.transform import Rotation

_SQUARE = 1e-3
"""Rounded matrices are this near to a rotation; they are made one."""
_FARTHEST_M = 100.0


def _finite(values: Any, n: int, what: str) -> np.ndarray:
    if not isinstance(values, list | tuple) or len(values) != n:
        raise ValueError(f"{what}: {n} numbers are expected, not {str(values)[:60]!r}")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{what}: a number is expected, not {str(value)[:40]!r}")
    return np.array(values, dtype=float)


def _rigid(value: Any) -> Any:
    """A pose as four rows of four, its rotation exact."""
    if value is None:
        return None
    if isinstance(value, dict):
        X = _from_parts(value)
    elif isinstance(value, list | tuple) and len(value) == 4:
        X = np.array([_finite(row, 4, f"row {n + 1}") for n, row in enumerate(value)])
    else:
        raise ValueError("four rows of four numbers are expected, or {position_m: [..], rpy_deg: [..]}")
    if np.abs(X[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise ValueError(f"the last row of a pose is [0, 0, 0, 1], not {X[3].tolist()}")
    if np.abs(X[:3, 3]).max() > _FARTHEST_M:
        raise ValueError(f"{np.abs(X[:3, 3]).max():g} m is too far; is it in millimetres?")
    if np.abs(X[:3, :3] @ X[:3, :3].T - np.eye(3)).max() > _SQUARE or np.linalg.det(X[:3, :3]) < 0:
        raise ValueError("its rotation is not a rotation (orthonormal, right-handed)")
    U, _, Vt = np.linalg.svd(X[:3, :3])
    X[:3, :3] = U @ Vt
    return tuple(tuple(float(v) for v in row) for row in X)


def _from_parts(value: dict) -> np.ndarray:
    turns = {"rpy_deg", "quaternion_wxyz"} & set(value)
    if set(value) - turns != {"position_m"} or len(turns) != 1:
        raise ValueError("position_m and one of rpy_deg, quaternion_wxyz are expected")
    X = np.eye(4)
    X[:3, 3] = _finite(value["position_m"], 3, "position_m")
    if "rpy_deg" in turns:
        # As in a URDF: about the fixed x, then y, then z.
        X[:3, :3] = Rotation.from_euler(
            "xyz", _finite(value["rpy_deg"], 3, "rpy_deg"), degrees=True
        ).as_matrix()
        return X
    q = _finite(value["quaternion_wxyz"], 4, "quaternion_wxyz")
    if abs(np.linalg.norm(q) - 1) > _SQUARE:
        raise ValueError(f"quaternion_wxyz: its length is {np.linalg.norm(q):g}, not 1")
    X[:3, :3] = Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix()
    return X


RigidPose = Annotated[tuple[tuple[float, float, float, float], ...] | None, BeforeValidator(_rigid)]
"""A pose, shape (4, 4) [m], or None."""


def differs(settings: BaseModel, *keys: str) -> bool:
    """Whether one of the keys has another value than its default; a plan's cell.json holds all of them."""
    fields = type(settings).model_fields
    return any(getattr(settings, key) != fields[key].default for key in keys)
