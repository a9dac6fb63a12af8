"""Frames of one turn of the table from rest to rest, the scanner still: no robot is asked for."""

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.sensing.simulator.captures import Captures


def turn_captures(
    X_WS: np.ndarray, *, speed: float, acceleration: float, fps: float, sense: int = 1, start: float = 0.0,
    X_WT: np.ndarray | None = None, X_TO: np.ndarray | None = None,
) -> Captures:  # fmt: skip
    """A whole turn with constant acceleration, constant speed and the same acceleration to rest.

    Args:
        X_WS: pose of the scanner in the world, shape (4, 4).
        speed: of the table [rad/s].
        acceleration: of the table [rad/s2].
        fps: frames a second.
        sense: +1 or -1.
        start: angle at the beginning [rad].
        X_WT: pose of the table at angle zero; None for the world's.
        X_TO: pose of the object on the table; None for the table's.

    Raises:
        InputError: speed, acceleration or fps are not positive.
    """
    if not min(speed, acceleration, fps) > 0:
        raise InputError("a turn needs a positive speed, acceleration and frame rate")
    speed = min(speed, float(np.sqrt(2 * np.pi * acceleration)))
    ramp = speed / acceleration
    total = 2 * np.pi / speed + ramp
    t = np.arange(0.0, total, 1 / fps)
    up, down = np.minimum(t, ramp), np.maximum(t - (total - ramp), 0.0)
    level = np.clip(t - ramp, 0.0, total - 2 * ramp)
    angle = 0.5 * acceleration * up**2 + speed * (level + down) - 0.5 * acceleration * down**2
    rates = np.zeros((len(t), 7))
    rates[:, 6] = sense * np.clip(np.minimum(acceleration * t, acceleration * (total - t)), 0.0, speed)
    return Captures(
        t=t, X_WS=np.tile(np.asarray(X_WS, float), (len(t), 1, 1)), table_angle=start + sense * angle,
        X_WT=np.eye(4) if X_WT is None else X_WT, X_TO=np.eye(4) if X_TO is None else X_TO,
        table_sense=np.full(len(t), float(sense)), rates=rates,
    )  # fmt: skip
