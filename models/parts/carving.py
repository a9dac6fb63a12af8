"""Makes carving.ply, the built-in part: a serpent carved on a plank, 600 x 330 x 200 mm.

The body rises from the plank in arches (tunnels, undercuts), the head and the plank carry slanting pockets:
what a turn of the table with the scanner at a few heights leaves as holes, and local viewpoints can see.
Run `python models/parts/carving.py` to write the file again; a test holds the file against this script.
"""

from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scanmotion.sensing.closed_surface import surface_nets, without_pinches

SIZE = np.array([600.0, 330.0, 200.0])
STEP = 5.0  # grid of the distance field [mm]


def smooth_union(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    """Polynomial smooth minimum of two distances with a fillet of about `k` [mm]."""
    h = np.clip(0.5 + 0.5 * (b - a) / k, 0.0, 1.0)
    return b + (a - b) * h - k * h * (1.0 - h)


def box(p: np.ndarray, centre: tuple, half: tuple, radius: float) -> np.ndarray:
    """Distance to a box with rounded edges."""
    d = np.abs(p - centre) - (np.array(half) - radius)
    return np.linalg.norm(np.maximum(d, 0.0), axis=-1) + np.minimum(d.max(axis=-1), 0.0) - radius


def capsule(p: np.ndarray, a: np.ndarray, b: np.ndarray, ra: float, rb: float) -> np.ndarray:
    """Distance to a segment whose radius runs from ra to rb (nearly exact where they differ little)."""
    ab = b - a
    t = np.clip((p - a) @ ab / (ab @ ab), 0.0, 1.0)
    return np.linalg.norm(p - (a + t[..., None] * ab), axis=-1) - (ra + (rb - ra) * t)


LEAVES = (  # foot of each leaf [mm], turn about the vertical and tilt from it [deg]
    (-70, -118, 70, 5, 12),
    (70, -105, 66, -20, 28),
    (150, -60, 60, 40, 35),
    (-230, 40, 66, 70, 25),
    (-40, 118, 70, 172, 18),
    (70, 125, 64, 190, 40),
)


def leaf(p: np.ndarray, foot: np.ndarray, turn: float, tilt: float) -> np.ndarray:
    """Distance (nearly) to a flat, cupped leaf of about 110 x 28 x 100 mm that leans over the plank."""
    x = np.array([np.cos(turn), np.sin(turn), 0.0])
    y = np.array([-np.sin(turn) * np.cos(tilt), np.cos(turn) * np.cos(tilt), -np.sin(tilt)])
    u, v, w = ((p - foot) @ axis for axis in (x, y, np.cross(x, y)))
    v = v - (u / 55.0) ** 2 * 9.0
    return (np.sqrt((u / 55) ** 2 + (v / 14) ** 2 + (w / 52) ** 2) - 1.0) * 14.0


def distance(p: np.ndarray) -> np.ndarray:
    """Signed distance of the carving at points p, shape (..., 3) [mm]; the base stands on z = 0."""
    d = box(p, (0, 0, 24), (300, 165, 24), 10)
    t = np.linspace(0.0, 1.0, 41)
    line = np.stack(
        [-235 + 430 * t, 82 * np.sin(2.4 * np.pi * t), 78 + 46 * np.sin(4.6 * np.pi * t - 0.7)], axis=1
    )
    radius = 24 + 14 * np.sin(np.pi * t) ** 0.7
    body = np.full(p.shape[:-1], np.inf)
    for a, b, ra, rb in zip(line[:-1], line[1:], radius[:-1], radius[1:], strict=True):
        body = np.minimum(body, capsule(p, a, b, ra, rb))
    body = body - 1.2 * np.sin(p[..., 0] / 7.0) * np.sin(p[..., 1] / 7.0) * np.sin(p[..., 2] / 7.0)
    d = smooth_union(d, body, 14.0)
    head = np.linalg.norm((p - (205, 58, 132)) / (1.25, 1.0, 1.12), axis=-1) - 60
    d = smooth_union(d, head, 18.0)
    d = smooth_union(d, capsule(p, np.array([205.0, 58, 30]), np.array([205.0, 58, 110]), 44, 30), 16.0)
    for x, y, z, turn, tilt in LEAVES:
        d = smooth_union(d, leaf(p, np.array([x, y, z]), np.deg2rad(turn), np.deg2rad(tilt)), 5.0)
    d = d - 0.7 * np.cos(p[..., 0] / 6.0 + p[..., 1] / 11.0) * np.clip(
        (p[..., 2] - 30) / 20, 0, 1
    )  # the chisel's grain
    for a, b, r in (
        ((300, 20, 175), (215, 52, 128), 20),  # mouth
        ((170, 130, 190), (195, 80, 145), 15),  # ear
        ((-150, -175, 26), (-75, -80, 30), 14),  # bore under the leaf, slanting into the plank
        ((255, -120, 70), (205, -75, 36), 20),  # pocket in the plank
        ((-270, 120, 72), (-222, 85, 36), 21),
    ):
        d = np.maximum(d, -capsule(p, np.array(a, float), np.array(b, float), r, r))
    return np.maximum(d, -p[..., 2])


def largest_piece(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The connected piece with most vertices."""
    i, j = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    n = len(vertices)
    _, piece = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    keep = piece == np.bincount(piece).argmax()
    rank = np.cumsum(keep) - 1
    return vertices[keep], rank[triangles[keep[triangles[:, 0]]]]


def carving() -> tuple[np.ndarray, np.ndarray]:
    """Vertices [mm] and triangles; largest piece only, scaled to exactly 600 x 330 x 200 mm."""
    low = np.array([-SIZE[0] / 2, -SIZE[1] / 2, 0.0]) - 2.5 * STEP
    shape = np.ceil((SIZE + 8 * STEP) / STEP).astype(int)
    grid = np.stack(
        np.meshgrid(*(low[i] + STEP * np.arange(shape[i]) for i in range(3)), indexing="ij"), axis=-1
    )
    solid = without_pinches(-gaussian_filter(distance(grid), 0.8), fill=0.3)
    vertices, triangles = surface_nets(-solid)
    vertices, triangles = largest_piece(vertices, triangles)
    vertices = low + STEP * vertices
    vertices -= vertices.min(axis=0)
    vertices *= SIZE / np.ptp(vertices, axis=0)
    return vertices - np.array([SIZE[0] / 2, SIZE[1] / 2, 0.0]), triangles


def ply_bytes(vertices: np.ndarray, triangles: np.ndarray) -> bytes:
    """Binary little-endian PLY."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment scanmotion built-in carving, millimetres\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(triangles), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, triangles
    return header.encode("ascii") + vertices.astype("<f4").tobytes() + faces.tobytes()


if __name__ == "__main__":
    target = Path(__file__).with_suffix(".ply")
    target.write_bytes(ply_bytes(*carving()))
    print(f"{target.name}: {target.stat().st_size / 1e6:.2f} MB")
