"""Compiled walks over bytes: rows of unequal length in a binary PLY, and LZF as PCD files are packed with."""

import numpy as np

from scanmotion.geometry.jit import njit


@njit(cache=True)
def walk_rows(raw, at, rows, length, item, signed, big, which):
    """Where the wanted list of each row begins, how long it is, and where the last row ends.

    Args:
        raw: the file, (k,) uint8.
        at: first byte.
        rows: how many.
        length: bytes of each property's length, 0 for a scalar, (p,).
        item: bytes of each property's values, (p,).
        signed: whether the length is signed, (p,).
        big: whether the most significant byte comes first.
        which: property whose list, or whose value, is wanted; -1 for none.

    Returns:
        Starts (rows,), lengths (rows,), and the end; -1 where the file ends before.
    """
    start = np.zeros(rows, np.int64)
    counts = np.zeros(rows, np.int64)
    for row in range(rows):
        for p in range(len(item)):
            n = 1
            if length[p] > 0:
                if at + length[p] > len(raw):
                    return start, counts, -1
                n = 0
                for b in range(length[p]):
                    k = b if big else length[p] - 1 - b
                    n = n * 256 + np.int64(raw[at + k])
                if n < 0 or n > len(raw) or (signed[p] and length[p] < 8 and n >= 1 << (8 * length[p] - 1)):
                    return start, counts, -1
                at += length[p]
            if p == which:
                start[row] = at
                counts[row] = n
            at += n * item[p]
            if at > len(raw):
                return start, counts, -1
    return start, counts, at


@njit(cache=True)
def unpacked_entry(raw, size):
    """LZF (Lehmann 2000, as in PCL) undone into `size` bytes; None is never read past either end.

    Returns:
        The bytes (size,), and how many were made; less than `size` for a broken stream.
    """
    out = np.zeros(size, np.uint8)
    i, o = 0, 0
    while i < len(raw):
        control = np.int64(raw[i])
        i += 1
        if control < 32:
            run = control + 1
            if i + run > len(raw) or o + run > size:
                return out, -1
            for k in range(run):
                out[o + k] = raw[i + k]
            i += run
            o += run
            continue
        run = control >> 5
        if run == 7:
            if i >= len(raw):
                return out, -1
            run += np.int64(raw[i])
            i += 1
        if i >= len(raw):
            return out, -1
        back = o - ((control & 31) << 8) - np.int64(raw[i]) - 1
        i += 1
        run += 2
        if back < 0 or o + run > size:
            return out, -1
        for k in range(run):
            out[o + k] = out[back + k]
        o += run
    return out, o
