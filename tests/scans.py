"""Scans and clouds that several tests share."""

import numpy as np

from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.viewpoint import look_at
from scanmotion.sensing.fusion.fuse import Cloud, RawPoints
from scanmotion.sensing.simulator.captures import Captures, motion
from scanmotion.sensing.simulator.simulate import simulate
from scanmotion.sensing.visibility import scene_from

SCANNER = Scanner(rays=(212, 148))


def raw(points, *, camera=(0.0, 0.0, 0.7), sigma=1e-4, frames=1):
    n = len(points)
    return RawPoints(
        points=np.asarray(points, np.float32), frame=(np.arange(n) % frames).astype(np.int32),
        cameras=np.tile(np.asarray(camera, float), (frames, 1)), sigma=np.full(n, sigma, np.float32),
    )  # fmt: skip


def cap(radius, n, rng, *, noise=1e-4):
    """Points on the upper cap of a sphere about the origin."""
    u = rng.standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    u = u[u[:, 2] > 0.5]
    return u * (radius + noise * rng.standard_normal((len(u), 1)))


def bumpy(rings=90, *, size=0.1):
    """A closed lump without symmetry, its base at z = 0."""
    theta = np.linspace(0, np.pi, rings + 1)
    phi = 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    T, P = np.meshgrid(theta, phi, indexing="ij")
    u = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], axis=-1)
    r = (
        1
        + 0.15 * np.sin(3 * u[..., 0] + 1) * np.cos(4 * u[..., 1])
        + 0.12 * np.sin(5 * u[..., 2] + 2 * u[..., 0])
    )
    vertices = (u * r[..., None] * size).reshape(-1, 3)
    w = len(phi)
    i, j = (m.ravel() for m in np.meshgrid(np.arange(rings), np.arange(w), indexing="ij"))
    a, b = i * w + j, i * w + (j + 1) % w
    triangles = np.concatenate(
        [np.column_stack([a, a + w, b])[i > 0], np.column_stack([b, a + w, b + w])[i < rings - 1]]
    )
    # The poles are many vertices at one place; one of each is kept.
    triangles[triangles < w] = 0
    triangles[triangles >= rings * w] = rings * w
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices = vertices[used] - [0, 0, vertices[:, 2].min()]
    return Part(name="lump", vertices=vertices, triangles=triangles.reshape(-1, 3))


def turns(part, errors, *, seed=0, n=45):
    """Three turns of the table: level, from above, and level with the scanner rolled."""
    poses = [
        look_at((0.55, 0, 0.1), (-1, 0, 0)),
        look_at((0.4, 0, 0.45), (-1, 0, -0.9)),
        look_at((0.6, 0, 0.2), (-1, 0, -0.2), roll=np.pi / 2),
    ]
    angle = [s * 2 * np.pi * np.arange(n) / n for s in (1, -1, 1)]
    sense = np.repeat([1.0, -1.0, 1.0], n)
    captures = Captures(
        t=np.arange(3 * n) / 10, X_WS=np.repeat(poses, n, axis=0), table_angle=np.concatenate(angle),
        X_WT=np.eye(4), X_TO=np.eye(4), table_sense=sense,
    )  # fmt: skip
    scene = scene_from(part.vertices, part.triangles, table_radius=0.5)
    return simulate(scene, SCANNER, captures, errors=errors, stride=1, rng=np.random.default_rng(seed))


def wrong(degrees, millimetres, seed):
    rng = np.random.default_rng(seed)
    u, v = rng.standard_normal((2, 3))
    twist = [*(v / np.linalg.norm(v) * millimetres * 1e-3), *(u / np.linalg.norm(u) * np.deg2rad(degrees))]
    return motion(np.array([twist]))[0]


def part_of(cloud, keep):
    """The cloud's points that a mask or an index keeps."""
    names = ("points", "normals", "view_directions", "counts")
    return Cloud(**{n: getattr(cloud, n)[keep] for n in names})
