"""How far the table has turned at each instant of a continuous motion, for the search.

The table turns as fast as it may, from rest to rest, and turns back where its range ends or where the plan
says so. Ramps are those of a trapezoid of the same duration and angle as the jerk-limited ones.
"""

import numpy as np

from scanmotion.geometry.jit import njit

MOST_PIECES = 8
"""More turnings back are not looked at."""


@njit(cache=True)
def pieces_of(total, first, second, full, speed, ramp, out):
    """Cuts the time `total` [s] into pieces in which the table turns one way; their number.

    Row k of `out`, shape (MOST_PIECES, 3): when it begins [s], how long it lasts [s], its greatest speed
    [rad/s].

    Args:
        total: time from the first rest to the last [s].
        first, second, full: what the table may turn in the first, the second and later pieces [rad].
        speed: the table's greatest [rad/s].
        ramp: how long it takes to reach it [s].
        out: the pieces.
    """
    begin, count = 0.0, 0
    while count < len(out):
        room = first if count == 0 else (second if count == 1 else full)
        left = total - begin
        peak = speed
        if room < speed * ramp:
            peak = np.sqrt(room * speed / ramp)
        longest = room / peak + ramp * peak / speed
        if left <= longest or count == len(out) - 1:
            last = min(left, longest)
            out[count, 0], out[count, 1] = begin, last
            out[count, 2] = min(speed, speed * last / (2.0 * ramp))
            return count + 1
        out[count, 0], out[count, 1], out[count, 2] = begin, longest, peak
        begin += longest
        count += 1
    return count


@njit(cache=True)
def angle_at(t, pieces, count, sense, speed, ramp, start):
    """The table's angle [rad] at time t [s]; `sense` is that of the first piece, `start` where it begins."""
    angle = start
    for k in range(count):
        begin, lasts, peak = pieces[k, 0], pieces[k, 1], pieces[k, 2]
        h = min(max(t - begin, 0.0), lasts)
        gain = speed / ramp
        up = peak / gain
        if h <= up:
            way = 0.5 * gain * h * h
        elif h <= lasts - up:
            way = 0.5 * peak * up + peak * (h - up)
        else:
            left = lasts - h
            way = peak * (lasts - up) - 0.5 * gain * left * left
        angle += sense * way if k % 2 == 0 else -sense * way
        if t <= begin + lasts:
            break
    return angle
