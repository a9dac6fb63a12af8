"""What the robots look like: convex hulls of a few discs and blocks per link, from the offsets of their joints."""

import numpy as np

ORANGE, BLACK, GREY = (1.0, 0.36, 0.02, 1.0), (0.10, 0.10, 0.11, 1.0), (0.55, 0.56, 0.58, 1.0)
GRAPHITE, SILVER, BLUE = (0.90, 0.89, 0.86, 1.0), (0.74, 0.76, 0.78, 1.0), (0.33, 0.60, 0.78, 1.0)

Bodies = dict[str, list[tuple[np.ndarray, tuple]]]
"""Convex bodies (corner points, colour) of each link in its frame."""


def disc(centre: tuple, axis: str, radius: float, length: float, n: int = 28) -> np.ndarray:
    """Corners of a bevelled cylinder along x, y or z, shape (4 n, 3)."""
    t = np.arange(n) / n * 2 * np.pi
    bevel = min(0.08 * radius, 0.2 * length)
    rings = [(radius - bevel, -length / 2), (radius, -length / 2 + bevel)]
    rings += [(radius, length / 2 - bevel), (radius - bevel, length / 2)]
    points = np.concatenate([np.stack([r * np.cos(t), r * np.sin(t), np.full(n, h)], 1) for r, h in rings])
    order = {"x": (2, 0, 1), "y": (0, 2, 1), "z": (0, 1, 2)}[axis]
    return points[:, order] + np.asarray(centre)


def block(low: tuple, high: tuple, bevel: float = 0.03) -> np.ndarray:
    """Corners of a box with bevelled edges."""
    low_, high_ = np.asarray(low, float), np.asarray(high, float)
    points = []
    for axis in range(3):
        inset = np.full(3, bevel)
        inset[axis] = 0.0
        a, b = low_ + inset, high_ - inset
        points += [[(a, b)[i][0], (a, b)[j][1], (a, b)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    return np.array(points)


def kuka(offsets: np.ndarray) -> Bodies:
    """KUKA KR QUANTEC."""
    arm, up, fore, wrist = offsets[2][0], offsets[3][2], offsets[4][0], offsets[5][0]
    y = -0.21
    return {
        "base_link": [
            (block((-0.50, -0.36, 0), (0.37, 0.36, 0.06)), BLACK),
            (disc((0, 0, 0.19), "z", 0.33, 0.28), ORANGE),
            (block((-0.55, -0.19, 0.06), (-0.1, 0.19, 0.30)), BLACK),
        ],
        "link_1": [
            (disc((0, 0, -0.25), "z", 0.33, 0.18), ORANGE),
            (np.concatenate([disc((0.33, -0.02, 0), "y", 0.21, 0.30), disc((0.02, -0.02, -0.2), "z", 0.27, 0.1)]), ORANGE),
            (disc((0.33, -0.30, 0), "y", 0.16, 0.26), BLACK),
            (disc((-0.38, -0.05, -0.08), "z", 0.13, 0.36), BLACK),
        ],
        "link_2": [
            (np.concatenate([disc((0, y, 0), "y", 0.19, 0.24), disc((arm, y, 0), "y", 0.14, 0.18)]), ORANGE),
            (np.concatenate([disc((0.1, y - 0.2, 0), "x", 0.05, 0.2), disc((arm - 0.1, y - 0.2, 0), "x", 0.05, 0.1)]), BLACK),
        ],
        "link_3": [
            (np.concatenate([disc((0, 0, 0), "y", 0.15, 0.24), disc((0.05, 0, up), "x", 0.19, 0.36)]), ORANGE),
            (np.concatenate([disc((0.2, 0, up), "x", 0.18, 0.1), disc((0.70, 0, up), "x", 0.12, 0.1)]), ORANGE),
            (disc((-0.28, 0.08, up + 0.02), "x", 0.11, 0.26), BLACK),
            (disc((-0.25, -0.10, up + 0.02), "x", 0.08, 0.24), BLACK),
        ],
        "link_4": [
            (np.concatenate([disc((0.72, 0, 0), "x", 0.12, 0.06), disc((fore - 0.16, 0, 0), "x", 0.10, 0.1)]), ORANGE),
            (np.concatenate([disc((fore - 0.15, 0, 0), "x", 0.085, 0.05), disc((fore, 0, 0), "y", 0.085, 0.13)]), ORANGE),
        ],
        "link_5": [
            (disc((0, 0.07, 0), "y", 0.10, 0.10), BLACK),
            (np.concatenate([disc((0.02, 0, 0), "x", 0.095, 0.1), disc((wrist - 0.05, 0, 0), "x", 0.09, 0.05)]), ORANGE),
        ],
        "link_6": [(disc((-0.02, 0, 0), "x", 0.09, 0.04), GREY)],
    }  # fmt: skip


def abb(offsets: np.ndarray) -> Bodies:
    """ABB IRB 6700."""
    arm, up, fore, wrist = offsets[2][2], offsets[3][2], offsets[4][0], offsets[5][0]
    y = -0.23
    return {
        "base_link": [
            (block((-0.60, -0.35, 0), (0.37, 0.35, 0.07)), BLACK),
            (disc((0, 0, 0.22), "z", 0.34, 0.28), GRAPHITE),
            (block((-0.47, -0.25, 0.06), (-0.1, 0.25, 0.30)), GRAPHITE),
        ],
        "link_1": [
            (disc((0, 0, -0.33), "z", 0.34, 0.18), GRAPHITE),
            (np.concatenate([disc((0.32, 0.06, 0), "y", 0.20, 0.24), disc((0.02, 0, -0.26), "z", 0.30, 0.1)]), GRAPHITE),
            (disc((-0.56, -0.19, -0.17), "x", 0.10, 0.36), BLACK),
        ],
        "link_2": [
            (np.concatenate([disc((0, y, 0), "y", 0.18, 0.24), disc((0, y, arm), "y", 0.14, 0.16)]), GRAPHITE),
            (disc((0, y - 0.10, 0.4), "z", 0.07, 0.60), BLACK),
        ],
        "link_3": [
            (np.concatenate([disc((0, 0, 0), "y", 0.15, 0.24), disc((-0.05, 0, up), "x", 0.17, 0.40)]), GRAPHITE),
            (disc((-0.2, 0.12, up + 0.04), "x", 0.10, 0.15), BLACK),
        ],
        "link_4": [
            (np.concatenate([disc((0.16, 0, 0), "x", 0.14, 0.06), disc((fore - 0.20, 0, 0), "x", 0.10, 0.1)]), GRAPHITE),
            (disc((fore, 0, 0), "y", 0.10, 0.24), GRAPHITE),
        ],
        "link_5": [(np.concatenate([disc((0, 0, 0), "x", 0.09, 0.1), disc((wrist - 0.06, 0, 0), "x", 0.09, 0.04)]), GRAPHITE)],
        "link_6": [(disc((-0.02, 0, 0), "x", 0.09, 0.04), GREY)],
    }  # fmt: skip


def ur(offsets: np.ndarray) -> Bodies:
    """Universal Robots, e-series: tubes between round joints."""
    upper, fore = offsets[2][0], offsets[3][0]
    return {
        "base_link": [(disc((0, 0, 0.05), "z", 0.094, 0.10), GREY)],
        "link_1": [
            (disc((0, 0, -0.01), "z", 0.074, 0.14), SILVER),
            (disc((0, -0.05, 0), "y", 0.074, 0.08), BLUE),
        ],
        "link_2": [
            (disc((0, -0.18, 0), "y", 0.075, 0.17), SILVER),
            (disc((upper / 2, -0.18, 0), "x", 0.055, -upper - 0.08), SILVER),
            (disc((upper, -0.18, 0), "y", 0.060, 0.15), BLUE),
        ],
        "link_3": [
            (disc((0, -0.045, 0), "y", 0.057, 0.115), SILVER),
            (disc((fore / 2, -0.045, 0), "x", 0.045, -fore - 0.06), SILVER),
            (disc((fore, -0.045, 0), "y", 0.045, 0.12), BLUE),
        ],
        "link_4": [(disc((0, 0.01, 0), "y", 0.046, 0.11), SILVER), (disc((0, 0, -0.01), "z", 0.045, 0.11), BLUE)],
        "link_5": [(disc((0, 0, 0), "z", 0.046, 0.09), SILVER), (disc((0, -0.01, 0), "y", 0.045, 0.11), BLUE)],
        "link_6": [(disc((0, 0.022, 0), "y", 0.044, 0.044), GREY)],
    }  # fmt: skip


SHAPES = {"kuka": kuka, "abb": abb, "ur": ur}
