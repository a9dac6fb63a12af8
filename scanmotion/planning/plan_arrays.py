"""holes.json and scan.npz of a plan: what pages and pictures need beside the motion."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from scanmotion.core.part import SurfaceSamples
from scanmotion.planning.segment import Segment
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.holes.find import HoleReport


def hole_records(holes: HoleReport | None) -> list[dict[str, Any]]:
    """The holes of the first scan, in metres in O."""
    return [
        {
            "kind": h.kind, "boundary": np.round(h.boundary, 6).tolist(), "center": h.center.tolist(),
            "normal": h.normal.tolist(), "X_OH": h.X_OH.tolist(), "extent": h.extent.tolist(),
            "perimeter": h.perimeter, "area": h.area,
        }
        for h in (holes.holes if holes is not None else ())
    ]  # fmt: skip


def arrays_data(
    cloud: Cloud | None,
    samples: SurfaceSamples | None,
    visible: np.ndarray | None,
    segments: Sequence[Segment],
) -> bytes:
    """What pictures need: the fused cloud, and which surface samples were seen when."""
    arrays: dict[str, np.ndarray] = {}
    if cloud is not None:
        arrays |= {
            "cloud": cloud.points.astype(np.float32),
            "normals": cloud.normals.astype(np.float32),
        }
    if samples is not None and visible is not None:
        arrays |= {
            "samples": samples.points.astype(np.float32),
            "sample_normals": samples.normals.astype(np.float32),
            "visible": visible,
            "seen": np.stack([one.seen for one in segments]) if segments else np.zeros((0, 0), bool),
        }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
