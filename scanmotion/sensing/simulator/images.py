"""A scan's points back in the pixels of its frames."""

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.sensing.simulator.simulate import Scan


def depth_images(scan: Scan, scanner: Scanner, *, stride: int = 1) -> np.ndarray:
    """Depth images of all frames, `stride` by `stride` pixels in one.

    Args:
        scan: of `simulate`, or read from files.
        scanner: its pixels.
        stride: with which the scan was made.

    Returns:
        shape (frames, height // stride, width // stride), float32 [m]; NaN where nothing was measured.
    """
    width, height = (n // stride for n in scanner.rays)
    images = np.full((len(scan.captures), height, width), np.nan, np.float32)
    row, column = np.divmod(scan.pixel, scanner.rays[0])
    images[scan.frame, np.minimum(row // stride, height - 1), np.minimum(column // stride, width - 1)] = (
        scan.depth
    )
    return images
